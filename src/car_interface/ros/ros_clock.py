"""Stamps that rise strictly, though the computer's clock is slewed or set back a little meanwhile."""
from __future__ import annotations

import rospy

from car_interface.common.units import NS_PER_S
from car_interface.ros.clocks import Clocks

SAME_OFFSET_NS = 200_000  # the system's clock is slewed by 0.5 ms a second at most
SET_BACK_NS = NS_PER_S // 2  # a clock that goes back by more was set on purpose


class RosClock:
    """Monotonic times as ROS times, for messages whose stamps rise strictly.

    ROS time is the computer's clock, which gets slewed and set: setting it disturbs nothing that is measured. Both are
    read one after the other, never at the same time, so that their difference is kept until it has changed by more than
    the reading can be off. Otherwise two messages a moment apart could be stamped in the wrong order.

    Args:
        clocks: the node's.
    """

    def __init__(self, clocks: Clocks):
        self._clocks = clocks
        self._offset_ns = None
        self._newest_ns: dict = {}  # stamp of each kind of message

    def stamp(self, kind, time_ns: int) -> rospy.Time:
        """The ROS time of a monotonic one, later than that of the ``kind``'s message before, unless the clock was set.

        Before ROS time began, as while /use_sim_time waits for a /clock, it is 0: no message carries less.
        """
        stamp_ns = self._offset() + time_ns
        if stamp_ns <= 0:
            return rospy.Time()
        newest_ns = self._newest_ns.get(kind)
        if newest_ns is not None and newest_ns - SET_BACK_NS < stamp_ns <= newest_ns:
            stamp_ns = newest_ns + 1
        self._newest_ns[kind] = stamp_ns
        return rospy.Time(nsecs=stamp_ns)

    def monotonic_ns(self, stamp: rospy.Time) -> int:
        """The monotonic time of a ROS time."""
        return stamp.to_nsec() - self._offset()

    def _offset(self):
        """From monotonic to ROS time."""
        before_ns = self._clocks.now_ns()
        ros_ns = self._clocks.ros_now().to_nsec()
        after_ns = self._clocks.now_ns()
        offset_ns = ros_ns - (before_ns + after_ns) // 2
        # The longer a thread is held up between the readings, the larger the error.
        if (self._offset_ns is None
                or abs(offset_ns - self._offset_ns) > SAME_OFFSET_NS + after_ns - before_ns):
            self._offset_ns = offset_ns
        return self._offset_ns
