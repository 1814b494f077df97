"""A node's reports on /diagnostics, once a second.

The node's loop publishes them: the ``Updater`` of diagnostic_updater follows ROS time, which can be set back, and asks
the master, which can be dead.
"""
from __future__ import annotations

from typing import Callable

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from diagnostic_updater import DiagnosticStatusWrapper

from car_interface.common.rate_timer import RateTimer
from car_interface.common.units import NS_PER_S
from car_interface.ros.inbox import Inbox
from car_interface.ros.topics import advertise

RATE_HZ = 1
OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR

Report = Callable[[DiagnosticStatusWrapper], None]


class Diagnostics:
    """Publishes one node's reports.

    Args:
        hardware_id: the device that the reports are about, e.g. ``PCA9685 at 0x40 on /dev/i2c-1``.
        reports: functions by name; each fills in a status.
        now_ns: the first report is due a second later.
    """

    def __init__(self, inbox: Inbox, hardware_id: str, reports: dict[str, Report], now_ns: int):
        self._inbox = inbox
        self._hardware_id = hardware_id
        self._reports = reports
        self._publisher = advertise("/diagnostics", DiagnosticArray, inbox)
        self._timer = RateTimer(RATE_HZ, now_ns + NS_PER_S // RATE_HZ)

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
        array = DiagnosticArray(status=[self._status(name, report) for name, report in self._reports.items()])
        array.header.stamp = self._inbox.clocks.ros_now()
        self._publisher.publish(array)

    def _status(self, name, report):
        """Return a report under the node's name, which may differ from the process's, and what the inbox dropped."""
        status = DiagnosticStatusWrapper(level=ERROR, name=f"{self._inbox.node_name[1:]}: {name}", message="no report",
                                         hardware_id=self._hardware_id)
        report(status)
        self._inbox.report(status)
        return status


def age_text(age_s: float) -> str:
    """Return an age as a report has it: ``0.02 s``, or ``never heard``."""
    return "never heard" if age_s == float("inf") else f"{age_s:.2f} s"
