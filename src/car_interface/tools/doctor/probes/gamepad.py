"""What the gamepad sends to teleop_logi, and what that says of it."""
from __future__ import annotations

import math
import threading
import time
from typing import Any

import rospy
from sensor_msgs.msg import Joy

from car_interface.common import causes
from car_interface.common.errors import CarInterfaceError
from car_interface.common.params import Params
from car_interface.msg import TeleopState
from car_interface.teleop.gamepad import read_gamepad
from car_interface.tools.doctor.checks.car import Node
from car_interface.tools.doctor.checks.gamepad import Gamepad, JoySample
from car_interface.tools.doctor.probes.master import Master

JOY_TYPE = "sensor_msgs/Joy"
SAMPLE_S = 1.0  # for the rate: 20 messages of a joy_node that repeats


class GamepadListener:
    """Listens to a gamepad and to its teleop_logi. ``start`` needs a node.

    Args:
        master: the ROS master.
        node: teleop_logi.
    """

    def __init__(self, master: Master, node: Node):
        self._node = node.path
        self._topic, self._publishers = _find_topic(master, node.path)
        self._config = _read_config(master, node.path)
        self._lock = threading.Lock()
        self._arrivals_s: list[float] = []
        self._newest: Any = None
        self._values: dict = {}
        self._state: Any = None

    def start(self) -> None:
        """Subscribe."""
        rospy.Subscriber(self._topic, Joy, self._on_joy)
        rospy.Subscriber(f"{self._node}/state", TeleopState, self._on_state)

    def is_done(self) -> bool:
        """Whether enough came."""
        with self._lock:
            arrivals_s = self._arrivals_s
            is_sampled = len(arrivals_s) > 1 and arrivals_s[-1] - arrivals_s[0] >= SAMPLE_S
            return self._state is not None and (is_sampled or not self._publishers)

    def result(self) -> Gamepad:
        """What came so far."""
        with self._lock:
            count = len(self._arrivals_s)
            end_s = self._arrivals_s[-1] if count > 1 else time.monotonic()
            period_s = (end_s - self._arrivals_s[0]) / max(1, count - 1) if count else math.inf
            axes, buttons = (len(self._newest.axes), len(self._newest.buttons)) if count else (0, 0)
            cause, reason = (self._state.cause, self._state.reason) if self._state else ("", "")
            sticks = (self._state.steering_stick, self._state.throttle_stick) if self._state else ()
            stick_cause = causes.NOT_AT_REST if causes.NOT_AT_REST in sticks else ""
            return Gamepad(self._node, self._topic, self._publishers, self._config,
                           JoySample(count, period_s, axes, buttons, dict(self._values)), cause, reason,
                           stick_cause)

    def _on_joy(self, message):
        with self._lock:
            self._arrivals_s.append(time.monotonic())
            self._newest = message
            self._values.update((index, value) for index, value in enumerate(message.axes) if not math.isfinite(value))

    def _on_state(self, message):
        with self._lock:
            self._state = message


def _find_topic(master, path):
    """The topic on which teleop_logi takes the gamepad, which may be remapped, and the nodes that publish it."""
    publishers, subscribers, _ = master.ask("getSystemState")
    types = dict(master.ask("getTopicTypes"))
    usual = f"{path.rpartition('/')[0]}/joy"
    subscribed = [topic for topic, nodes in subscribers if path in nodes and types.get(topic) == JOY_TYPE]
    topic = usual if usual in subscribed or not subscribed else subscribed[0]
    return topic, next((sorted(nodes) for name, nodes in publishers if name == topic), [])


def _read_config(master, path):
    """How teleop_logi is set; ``None`` when it would refuse its parameters."""
    try:
        return read_gamepad(Params(master.parameter(path) or {}))
    except CarInterfaceError:
        return None
