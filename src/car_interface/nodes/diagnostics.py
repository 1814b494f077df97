"""What a node reports on /diagnostics, once a second.

``diagnostic_updater`` makes the messages. Its own pace follows ROS time, which can be set back, and asks the master,
which can be dead; so the node's heartbeat paces it.
"""
from __future__ import annotations

from typing import Callable

from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_updater import DiagnosticStatusWrapper, Updater

from car_interface.nodes.node import Heartbeat

RATE_HZ = 1
OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR

Report = Callable[[DiagnosticStatusWrapper], DiagnosticStatusWrapper]


class Diagnostics:
    """One node's reports.

    Args:
        hardware_id: what the reports are about, e.g. ``PCA9685 at 0x40 on /dev/i2c-1``.
        reports: by name; each fills in the status that it's given, and returns it.
        now_ns: the first report comes a second later.
    """

    def __init__(self, hardware_id: str, reports: dict[str, Report], now_ns: int):
        self._updater = Updater()
        self._updater.setHardwareID(hardware_id)
        for name, report in reports.items():
            self._updater.add(name, report)
        self._heartbeat = Heartbeat(RATE_HZ, now_ns + 1_000_000_000 // RATE_HZ)

    @property
    def due_ns(self) -> int:
        """When the next report is due."""
        return self._heartbeat.due_ns

    def step(self, now_ns: int) -> None:
        """Report, if it's time."""
        if self._heartbeat.is_due(now_ns):
            self._updater.force_update()


def age_text(age_s: float) -> str:
    """An age for a report: ``0.02 s``, or ``never heard``."""
    return "never heard" if age_s == float("inf") else f"{age_s:.2f} s"
