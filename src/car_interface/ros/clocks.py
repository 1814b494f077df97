"""The two clocks of a node, and its pauses: the only place in ``nodes`` and ``ros`` that reads a clock or sleeps.

A node reads them from its inbox. A test gives the inbox clocks of its own: a whole car then runs on the test's time.
Whatever belongs to the process instead of a node uses ``SYSTEM``. The guard's process, ``pca9685_guard``, reads the
monotonic clock by itself, since it must act however little of this package works.
"""
from __future__ import annotations

import time
from typing import TYPE_CHECKING, Callable

if TYPE_CHECKING:
    import rospy


class Clocks:
    """The clocks of this computer."""

    def now_ns(self) -> int:
        """Return the time of the monotonic clock, ns: for ages and timers."""
        return time.monotonic_ns()

    def ros_now(self) -> rospy.Time:
        """Return ROS time: for stamps."""
        import rospy  # not for those that run before ROS is there
        return rospy.Time.now()

    def local_time(self, form: str) -> str:
        """Return the date and time of day as ``time.strftime`` formats it: for the names of files."""
        return time.strftime(form)

    def sleep(self, duration_s: float) -> None:
        """Block the calling thread."""
        time.sleep(duration_s)

    def wait_for(self, condition: Callable[[], bool], within_s: float, poll_s: float) -> bool:
        """Block until a condition is true; return False if it isn't after ``within_s``."""
        deadline_ns = self.now_ns() + round(within_s * 1e9)
        while not condition():
            if self.now_ns() >= deadline_ns:
                return False
            self.sleep(poll_s)
        return True


SYSTEM = Clocks()
