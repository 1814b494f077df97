"""What a message's stamp says of its age. Freshness goes by arrival; a stamp can only add to it, and an odd one adds
nothing.
"""
from __future__ import annotations

import rospy

from car_interface.common.units import NS_PER_S
from car_interface.ros.clocks import Clocks

ODD_STAMP_S = 10.0  # this far from now
# The clocks of two computers differ, and one is slewed, by less than this; a larger change was a step.
CLOCK_NS = NS_PER_S // 20
# After a step no stamp counts until one is of this age again: what is under way was stamped before it, and another
# computer's clock may not have been set. Nothing older is waited for anyhow.
AGREES_NS = NS_PER_S


class StampedAge:
    """How old one topic's messages are when they arrive, by their stamps.

    A stamp of 0, one in the future, and any after ROS time was set, until they agree with it again, say nothing: then
    an age is 0, and it counts from arrival alone. Each of these is logged once.

    Args:
        topic: for the log.
        clocks: the node's.
    """

    def __init__(self, topic: str, clocks: Clocks):
        self._topic, self._clocks = topic, clocks
        self._offset_ns: int | None = None  # of ROS time to the monotonic clock
        self._was_set = False  # ROS time, and no stamp has agreed with it since
        self._told: set[str] = set()

    def at_arrival_ns(self, stamp: rospy.Time, arrival_ns: int) -> int:
        """The age in ns, at least 0, of a message that arrived at a monotonic time."""
        before_ns = self._clocks.now_ns()
        ros_ns = self._clocks.ros_now().to_nsec()
        after_ns = self._clocks.now_ns()
        was_ns, offset_ns = self._offset_ns, ros_ns - after_ns
        self._offset_ns = offset_ns
        if was_ns is not None and abs(offset_ns - was_ns) > CLOCK_NS + after_ns - before_ns:
            self._was_set = True
            self._tell("step", f"ROS time was set by {(offset_ns - was_ns) / NS_PER_S:.1f} s: until the stamps agree "
                               "with it ages count from arrival alone")
        age_ns = offset_ns + arrival_ns - stamp.to_nsec()
        if stamp.is_zero():
            self._tell("zero", "the stamp is zero: its age counts from arrival alone", rospy.loginfo)
            return 0
        if 0 <= age_ns < AGREES_NS:
            self._was_set = False
        if not self._was_set:
            if age_ns < -CLOCK_NS:
                self._tell("future", f"the stamp is {-age_ns / NS_PER_S:.2f} s in the future: its age counts from "
                                     "arrival alone")
            return max(0, age_ns)
        return 0

    def _tell(self, kind, text, log=rospy.logwarn):
        if kind not in self._told:
            self._told.add(kind)
            log("%s: %s", self._topic, text)


def odd_stamp(stamp: rospy.Time, now: rospy.Time) -> str:
    """What is odd about a stamp, in words: ``is 60 s in the future``; empty = nothing."""
    offset_s = (stamp - now).to_sec()
    if abs(offset_s) <= ODD_STAMP_S:
        return ""
    if stamp.is_zero():
        return "is zero"
    return f"is {abs(offset_s):.0f} s in the {'future' if offset_s > 0 else 'past'}"
