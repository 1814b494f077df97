"""What the topics of a running car say: who drives, the Teensy's link, and the reports on /diagnostics."""
from __future__ import annotations

import logging
import threading
import time
import traceback
from typing import NamedTuple

import rospy
from diagnostic_msgs.msg import DiagnosticArray

from car_interface.msg import LinkStatus, SteeringState
from car_interface.ros.tcpros_limits import limit_connections
from car_interface.steering.arbiter import source_name
from car_interface.tools.doctor.checks.car import Report, Steering
from car_interface.tools.doctor.checks.gamepad import Gamepad
from car_interface.tools.doctor.checks.port import Link
from car_interface.tools.doctor.probes.gamepad import GamepadListener

LISTEN_S = 3.0  # for what comes once a second, behind a connection that may take a moment
POLL_S = 0.02


class TopicReports(NamedTuple):
    """The newest of each topic; ``None`` where nothing came."""

    link: Link | None
    steering: Steering | None
    reports: list
    gamepad: Gamepad | None = None


class _Listener:
    """Collects what came."""

    def __init__(self):
        self.links, self.states, self.reports = [], [], {}
        self._lock = threading.Lock()

    def on_reports(self, array):
        with self._lock:
            for status in array.status:
                remedy = next((value.value for value in status.values if value.key == "remedy"), "")
                self.reports[status.name] = Report(status.name, _level(status.level), status.message, remedy)

    def reporters(self):
        """The nodes whose reports came."""
        with self._lock:
            return {name.partition(":")[0] for name in self.reports}


def _level(level):
    """genpy gives a byte as a number or, for ROS 2's sake, as bytes."""
    return level[0] if isinstance(level, bytes) else level


def listen(hub: str | None, turn_arb: str | None, reporting, gamepad: GamepadListener | None = None) -> TopicReports:
    """Listen until everything that is expected has come, at most for ``LISTEN_S``.

    Args:
        hub: the Teensy hub's path; ``None`` when it doesn't run.
        turn_arb: turn_arb's; likewise.
        reporting: the paths of the nodes that report on /diagnostics.
        gamepad: listens to the gamepad; ``None`` when teleop_logi doesn't run.
    """
    logging.disable(logging.CRITICAL)  # what goes wrong between rospy and the nodes becomes a finding
    # rospy prints tracebacks of a peer that leaves in a handshake, and of a server that ends before its thread waits.
    traceback.print_exc = threading.excepthook = lambda *_, **__: None
    rospy.core.configure_logging = lambda *_: None  # it would leave a log file behind, an empty one
    limit_connections()  # a publisher that never answers must not keep the doctor from ending
    rospy.init_node("doctor", anonymous=True, disable_signals=True, disable_rosout=True)
    listener = _Listener()
    if hub:
        rospy.Subscriber(f"{hub}/link", LinkStatus, listener.links.append)
    if turn_arb:
        rospy.Subscriber(f"{turn_arb}/state", SteeringState, listener.states.append)
    rospy.Subscriber("/diagnostics", DiagnosticArray, listener.on_reports)
    if gamepad:
        gamepad.start()
    wanted = {path.strip("/") for path in reporting}
    deadline_s = time.monotonic() + LISTEN_S
    while time.monotonic() < deadline_s:
        has_link, has_state = listener.links or not hub, len(listener.states) > 1 or not turn_arb
        has_gamepad = not gamepad or gamepad.is_done()
        if has_link and has_state and has_gamepad and wanted <= listener.reporters():
            break
        time.sleep(POLL_S)
    return TopicReports(_link(listener.links), _steering(listener.states), list(listener.reports.values()),
                        gamepad and gamepad.result())


def leave() -> None:
    """Unregister from the master."""
    rospy.signal_shutdown("the doctor is done")


def _link(links):
    if not links:
        return None
    link = links[-1]
    return Link(link.level, link.state, link.words, link.next_step, link.round_trip, link.firmware_checksum)


def _steering(states):
    if not states:
        return None
    state = states[-1]
    return Steering(source_name(state.source), state.reason, state.duty, repeats=len(states) > 1)
