"""The two clocks of a node: the only place in ``nodes`` and ``ros`` that reads a clock or sleeps.

Ages and timers go by the monotonic clock, stamps by ROS time, which is the computer's clock and gets slewed and set.
``RosClock`` translates between them, and ``StampedAge`` says how old a message was when it arrived.

A node reads them from its inbox. A test gives the inbox clocks of its own: a whole car then runs on the test's time.
Whatever belongs to the process instead of a node uses ``SYSTEM``. The guard's process, ``pca9685_guard``, reads the
monotonic clock by itself, since it must act however little of this package works.
"""
from __future__ import annotations

import time
from typing import TYPE_CHECKING, Callable

from car_interface.common.units import NS_PER_S

if TYPE_CHECKING:
    import rospy

SAME_OFFSET_NS = 200_000  # the system's clock is slewed by 0.5 ms a second at most
SET_BACK_NS = NS_PER_S // 2  # a clock that goes back by more was set on purpose
ODD_STAMP_S = 10.0  # this far from now
# The clocks of two computers differ, and one is slewed, by less than this; a larger change was a step.
CLOCK_NS = NS_PER_S // 20
# After a step no stamp counts until one is of this age again: what is under way was stamped before it, and another
# computer's clock may not have been set. Nothing older is waited for anyhow.
AGREES_NS = NS_PER_S


class Clocks:
    """The clocks of this computer."""

    now_ns = staticmethod(time.monotonic_ns)  # of the monotonic clock: for ages and timers
    local_time = staticmethod(time.strftime)  # date and time of day in a format: for the names of files
    sleep = staticmethod(time.sleep)  # seconds

    def ros_now(self) -> rospy.Time:
        """Return ROS time: for stamps."""
        import rospy  # not for those that run before ROS is there
        return rospy.Time.now()

    def wait_for(self, condition: Callable[[], bool], within_s: float, poll_s: float) -> bool:
        """Block until a condition is true; return False if it isn't after ``within_s``."""
        deadline_ns = self.now_ns() + round(within_s * 1e9)
        while not condition():
            if self.now_ns() >= deadline_ns:
                return False
            self.sleep(poll_s)
        return True

    def ros_offset_ns(self) -> tuple[int, int]:
        """Return ROS time minus the monotonic clock, and how far that can be off, both ns.

        One is read after the other, so that a thread that is held up between them measures a wrong difference.
        """
        before_ns = self.now_ns()
        ros_ns = self.ros_now().to_nsec()
        after_ns = self.now_ns()
        return ros_ns - (before_ns + after_ns) // 2, after_ns - before_ns


SYSTEM = Clocks()


class RosClock:
    """Translate monotonic times to ROS times, for messages whose stamps rise strictly.

    The difference of the clocks is kept until it has changed by more than a reading can be off. Otherwise two messages
    a moment apart could be stamped in the wrong order.
    """

    def __init__(self, clocks: Clocks):
        self._clocks = clocks
        self._offset_ns: int | None = None
        self._newest_ns: dict = {}  # stamp of each kind of message

    def stamp(self, kind, time_ns: int) -> rospy.Time:
        """Return a ROS time later than that of the ``kind``'s message before, unless the clock was set.

        Before ROS time began, as while /use_sim_time waits for a /clock, it is 0: no message carries less.
        """
        import rospy
        stamp_ns = self._offset() + time_ns
        if stamp_ns <= 0:
            return rospy.Time()
        newest_ns = self._newest_ns.get(kind)
        if newest_ns is not None and newest_ns - SET_BACK_NS < stamp_ns <= newest_ns:
            stamp_ns = newest_ns + 1
        self._newest_ns[kind] = stamp_ns
        return rospy.Time(nsecs=stamp_ns)

    def monotonic_ns(self, stamp: rospy.Time) -> int:
        """Return the monotonic time of a ROS time."""
        return stamp.to_nsec() - self._offset()

    def _offset(self):
        offset_ns, error_ns = self._clocks.ros_offset_ns()
        if self._offset_ns is None or abs(offset_ns - self._offset_ns) > SAME_OFFSET_NS + error_ns:
            self._offset_ns = offset_ns
        return self._offset_ns


class StampedAge:
    """Say how old one topic's messages are when they arrive. Freshness goes by arrival; a stamp can only add to it.

    A stamp of 0, one in the future, and any after ROS time was set, until they agree with it again, say nothing: then
    an age is 0, and it counts from arrival alone. Each of these is logged once.
    """

    def __init__(self, topic: str, clocks: Clocks):
        self._topic, self._clocks = topic, clocks
        self._offset_ns: int | None = None  # of ROS time to the monotonic clock
        self._was_set = False  # ROS time, and no stamp has agreed with it since
        self._logged: set[str] = set()

    def at_arrival_ns(self, stamp: rospy.Time, arrival_ns: int) -> int:
        """Return the age in ns, at least 0, of a message that arrived at a monotonic time."""
        was_ns, (offset_ns, error_ns) = self._offset_ns, self._clocks.ros_offset_ns()
        self._offset_ns = offset_ns
        if was_ns is not None and abs(offset_ns - was_ns) > CLOCK_NS + error_ns:
            self._was_set = True
            self._log("step", f"ROS time was set by {(offset_ns - was_ns) / NS_PER_S:.1f} s: until the stamps agree "
                              "with it ages count from arrival alone")
        age_ns = offset_ns + arrival_ns - stamp.to_nsec()
        if stamp.is_zero():
            self._log("zero", "the stamp is zero: its age counts from arrival alone")
            return 0
        if 0 <= age_ns < AGREES_NS:
            self._was_set = False
        if self._was_set:
            return 0
        if age_ns < -CLOCK_NS:
            self._log("future", f"the stamp is {-age_ns / NS_PER_S:.2f} s in the future: its age counts from "
                                "arrival alone")
        return max(0, age_ns)

    def _log(self, kind, text):
        import rospy
        if kind not in self._logged:
            self._logged.add(kind)
            (rospy.loginfo if kind == "zero" else rospy.logwarn)("%s: %s", self._topic, text)


def odd_stamp(stamp: rospy.Time, now: rospy.Time) -> str:
    """Describe what is odd about a stamp: ``is 60 s in the future``; empty = nothing."""
    offset_s = (stamp - now).to_sec()
    if abs(offset_s) <= ODD_STAMP_S:
        return ""
    if stamp.is_zero():
        return "is zero"
    return f"is {abs(offset_s):.0f} s in the {'future' if offset_s > 0 else 'past'}"
