"""Listens to a running car: who drives, the Teensy's link, the gamepad, and the reports on /diagnostics."""
from __future__ import annotations

import logging
import math
import threading
import time
import traceback
from typing import Iterable, NamedTuple, Sequence

import rospy
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import Joy

from car_interface.common.declared import read
from car_interface.common.errors import CarInterfaceError
from car_interface.common.params import CONFIG_FOLDER, Params
from car_interface.msg import LinkStatus, SteeringState, TeleopState
from car_interface.ros.clocks import SYSTEM
from car_interface.ros.tcpros_limits import limit_connections
from car_interface.teleop.gamepad import DRIVER_REPORT, GamepadConfig
from car_interface.teleop.handover import PHONE_TOPIC
from car_interface.teleop.mappings import config_for, load_entries, model_of
from car_interface.tools.doctor.car import GamepadFacts, Node, Report
from car_interface.tools.doctor.master import Car, Master

JOY_TYPE = "sensor_msgs/Joy"
SAMPLE_S = 1.0  # for the rate: 20 messages of a joy_node that repeats
LISTEN_S = 3.0  # for what comes once a second, behind a connection that may take a moment
POLL_S = 0.02


class GamepadListener:
    """Listens to a gamepad and to its teleop_logi."""

    def __init__(self, master: Master, node: Node):
        self._node, self._params = node.path, Params(master.parameter(node.path) or {})
        self._topic, self._publishers = _find_topic(master, node.path)
        self._joys: list[tuple[float, Joy]] = []  # with their arrivals in s
        self._states: list[TeleopState] = []
        rospy.Subscriber(self._topic, Joy, lambda message: self._joys.append((time.monotonic(), message)))
        rospy.Subscriber(f"{self._node}/state", TeleopState, self._states.append)

    def is_done(self) -> bool:
        """Return whether enough came."""
        is_sampled = len(self._joys) > 1 and self._joys[-1][0] - self._joys[0][0] >= SAMPLE_S
        return bool(self._states) and (is_sampled or not self._publishers)

    def result(self, reports: Iterable[Report]) -> GamepadFacts:
        """Return what came so far."""
        joys = list(self._joys)
        end_s = joys[-1][0] if len(joys) > 1 else time.monotonic()
        newest = joys[-1][1] if joys else Joy()
        return GamepadFacts(
            self._node, self._topic, self._publishers, self._config(newest),
            messages=len(joys), period_s=(end_s - joys[0][0]) / max(1, len(joys) - 1) if joys else math.inf,
            axes=len(newest.axes), buttons=len(newest.buttons),
            odd={index: value for _, message in joys for index, value in enumerate(message.axes)
                 if not math.isfinite(value)},
            state=self._states[-1] if self._states else TeleopState(),
            driver=next((report for report in reports if report.about == DRIVER_REPORT and report.remedy
                         and f"/{report.node}" in self._publishers), None))

    def _config(self, newest):
        """Return what teleop_logi takes a message's axes and buttons for; ``None`` = that isn't known."""
        model = model_of(newest.header.frame_id, len(newest.axes), len(newest.buttons))
        try:
            return config_for(model, read(self._params, GamepadConfig),
                              load_entries(self._params.path(CONFIG_FOLDER, None)))
        except CarInterfaceError:
            return None


def _find_topic(master, path):
    """Return the topic on which teleop_logi takes the gamepad, which may be remapped, and the nodes that publish it."""
    publishers, subscribers, _ = master.ask("getSystemState")
    types = dict(master.ask("getTopicTypes"))
    usual = f"{path.rpartition('/')[0]}/joy"
    subscribed = [topic for topic, nodes in subscribers if path in nodes and types.get(topic) == JOY_TYPE
                  and not topic.endswith(f"/{PHONE_TOPIC}")]
    topic = usual if usual in subscribed or not subscribed else subscribed[0]
    return topic, next((sorted(nodes) for name, nodes in publishers if name == topic), [])


class TopicReports(NamedTuple):
    """What came."""

    link: LinkStatus | None  # the newest
    steering: list  # each SteeringState
    reports: list
    gamepad: GamepadFacts | None


def _reports_in(array):
    """Return the entries of a DiagnosticArray by their names. genpy gives a byte as a number, or as one of bytes."""
    return {status.name: Report(status.name, ord(status.level) if isinstance(status.level, bytes) else status.level,
                                status.message,
                                next((value.value for value in status.values if value.key == "remedy"), ""))
            for status in array.status}


def listen(car: Car, hub: Node | None, reporting: Sequence[str]) -> TopicReports:
    """Listen until everything that is expected has come, at most for ``LISTEN_S``.

    Args:
        hub: ``None`` when its link is not to be listened to.
        reporting: the paths of the nodes that report on /diagnostics.
    """
    logging.disable(logging.CRITICAL)  # what goes wrong between rospy and the nodes becomes a finding
    # rospy prints tracebacks of a peer that leaves in a handshake, and of a server that ends before its thread waits.
    traceback.print_exc = threading.excepthook = lambda *_, **__: None
    rospy.core.configure_logging = lambda *_: None  # it would leave a log file behind, an empty one
    limit_connections()  # a publisher that never answers must not keep the doctor from ending
    teleop_logi, turn_arb = car.runs("teleop_logi"), car.runs("turn_arb")
    rospy.init_node("doctor", anonymous=True, disable_signals=True, disable_rosout=True)
    gamepad = GamepadListener(car.master, teleop_logi) if teleop_logi else None
    links, states, reports = [], [], {}
    if hub:
        rospy.Subscriber(f"{hub.path}/link", LinkStatus, links.append)
    if turn_arb:
        rospy.Subscriber(f"{turn_arb.path}/state", SteeringState, states.append)
    rospy.Subscriber("/diagnostics", DiagnosticArray, lambda array: reports.update(_reports_in(array)))
    wanted = {path.strip("/") for path in reporting}

    def has_all():
        return ((links or not hub) and (len(states) > 1 or not turn_arb) and (not gamepad or gamepad.is_done())
                and wanted <= {report.node for report in list(reports.values())})
    SYSTEM.wait_for(has_all, LISTEN_S, POLL_S)
    found = list(reports.values())
    return TopicReports(links[-1] if links else None, states, found, gamepad and gamepad.result(found))


def leave() -> None:
    """Unregister from the master."""
    rospy.signal_shutdown("the doctor is done")
