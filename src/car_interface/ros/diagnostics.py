"""A node's reports on /diagnostics, once a second.

``diagnostic_updater`` makes the messages. Its own timer follows ROS time, which can be set back, and asks the master,
which can be dead; so the node's loop calls it.
"""
from __future__ import annotations

import time
from typing import Callable

import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from diagnostic_updater import DiagnosticStatusWrapper, Updater

from car_interface.common.rate_timer import RateTimer
from car_interface.common.units import NS_PER_S
from car_interface.ros.inbox import Inbox

RATE_HZ = 1
OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR

Report = Callable[[DiagnosticStatusWrapper], DiagnosticStatusWrapper]


class _Updater(Updater):
    """Reports under the node's name, which may differ from the process's."""

    def __init__(self, node_name):
        self._prefix = node_name[1:]
        super().__init__()

    def publish(self, msg):
        statuses = msg if isinstance(msg, list) else [msg]
        for status in statuses:
            status.name = f"{self._prefix}: {status.name}"
        array = DiagnosticArray(status=statuses)
        array.header.stamp = rospy.Time.now()
        self.publisher.publish(array)


class Diagnostics:
    """Publishes one node's reports.

    Args:
        inbox: the node's.
        hardware_id: the device that the reports are about, e.g. ``PCA9685 at 0x40 on /dev/i2c-1``.
        reports: functions by name; each fills in a status and returns it.
        now_ns: the first report is due a second later.
    """

    def __init__(self, inbox: Inbox, hardware_id: str, reports: dict[str, Report], now_ns: int):
        self._updater = _Updater(inbox.node_name)
        inbox.on_close(self._updater.publisher.unregister)
        self._updater.setHardwareID(hardware_id)
        self._inbox = inbox
        for name, report in reports.items():
            self._updater.add(name, self._with_inbox(report))
        self._timer = RateTimer(RATE_HZ, now_ns + NS_PER_S // RATE_HZ)

    def _with_inbox(self, report):
        """Add what the inbox dropped to a report."""
        def report_both(status):
            report(status)
            if self._inbox.stood_still_recently(time.monotonic_ns()):
                status.mergeSummary(WARN, self._inbox.standstill_text)
            if self._inbox.overflowed_recently(time.monotonic_ns()):
                status.mergeSummary(ERROR, self._inbox.overflow_text)
            if self._inbox.dropped:
                status.add("messages dropped by its inbox", self._inbox.dropped)
            if self._inbox.old_messages:
                status.add("messages dropped after it stood still", self._inbox.old_messages)
            return status
        return report_both

    @property
    def due_ns(self) -> int:
        """When the next report is due."""
        return self._timer.due_ns

    def report_now(self) -> None:
        """Have the next ``step`` report."""
        self._timer.due_ns = 0

    def step(self, now_ns: int) -> None:
        """Report if it is due."""
        if self._timer.is_due(now_ns):
            self.force()

    def force(self) -> None:
        """Report now."""
        self._updater.force_update()


def age_text(age_s: float) -> str:
    """An age for a report: ``0.02 s``, or ``never heard``."""
    return "never heard" if age_s == float("inf") else f"{age_s:.2f} s"
