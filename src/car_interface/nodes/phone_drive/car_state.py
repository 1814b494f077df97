"""What the pages show of the car: the groups of ``teleop.phone_messages``, from the states that the nodes publish.

It listens to topics alone, and asks neither the master nor a node.
"""
from __future__ import annotations

import math
from functools import partial
from typing import Any, Callable, Mapping

from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import Range
from std_msgs.msg import Float32

from car_interface.common.declared import read
from car_interface.common.errors import ConfigError
from car_interface.common.params import Params
from car_interface.common.units import NS_PER_S
from car_interface.common.vehicle_geometry import SONARS
from car_interface.msg import CalibrationState, LinkStatus, PlannerState, SteeringState, TeleopState, ThrottleState
from car_interface.ros.diagnostics import ERROR, OK
from car_interface.ros.inbox import Inbox
from car_interface.ros.reconfigure import TunedNode
from car_interface.ros.topics import subscribe
from car_interface.teleop.phone_messages import CENTER, NEUTRAL, number
from car_interface.throttle.battery import REPORT as BATTERY
from car_interface.throttle.obstacle_stop import ObstacleConfig

SILENT_NS = NS_PER_S  # of a node that repeats its state 10 times a second
REPORT_SILENT_NS = 5 * NS_PER_S  # of one that reports once a second
FORGOTTEN_NS = 60 * NS_PER_S  # its node was ended on purpose by then
MAX_REPORTS = 200
MAX_TEXT = 300  # characters
# SteeringState and ThrottleState have the same values.
SOURCES = {SteeringState.LOCKED: "locked", SteeringState.NO_HUMAN: "no human", SteeringState.NEUTRAL: "neutral",
           SteeringState.TELEOP: "teleop", SteeringState.PLANNER: "planner"}
STATES = {"teleop_logi/state": TeleopState, "turn_arb/state": SteeringState, "throttle_arb/state": ThrottleState,
          "planner_interface/state": PlannerState, "teensy_sensor_hub/link": LinkStatus,
          "calibration_drive/state": CalibrationState, "teleop_logi/tele_steer_req": Float32,
          **{f"sonar/{name}": Range for name in SONARS}}
BOARD = "servo board"  # pca9685's on /diagnostics


class CarState:
    """The newest of what the nodes publish."""

    def __init__(self, inbox: Inbox):
        self._newest: dict[str, tuple[Any, int]] = {}  # message and arrival, by topic
        self._reports: dict[str, tuple[dict, int]] = {}  # of this car's nodes, by name
        self._namespace = inbox.graph.namespace().strip("/")
        self._layout = _layout(inbox)
        self.tuned = {CENTER: (TunedNode(inbox, "turn_arb"), "servo_center"),
                      NEUTRAL: (TunedNode(inbox, "throttle_arb/servo"), "neutral")}
        for topic, message_type in STATES.items():
            subscribe(topic, message_type, inbox, partial(self._keep, topic), wakes=False)
        subscribe("/diagnostics", DiagnosticArray, inbox, self._on_reports, queue_size=50, wakes=False)

    def groups(self, now_ns: int) -> dict[str, Any]:
        """Return all groups but those of recordings, as JSON has them."""
        return {
            "who": self._state("teleop_logi/state", now_ns, _cause),
            "steering": self._state("turn_arb/state", now_ns, self._steering),
            "throttle": self._state("throttle_arb/state", now_ns, _throttle),
            "speed": self._speed(now_ns),
            "planner": self._state("planner_interface/state", now_ns, lambda state: {
                **_cause(state), "source": state.source, "speed": number(state.speed, 2)}),
            "esc": self._state("throttle_arb/state", now_ns, lambda state: {
                "profile": state.profile, "state": state.esc, "text": _short(state.esc_reason)}),
            "sonars": {name: self._range(f"sonar/{name}", now_ns) for name in SONARS
                       if f"sonar/{name}" in self._newest} or None,
            "layout": self._layout,
            "board": self._report(BOARD, now_ns), "battery": self._report(BATTERY, now_ns),
            "teensy": self._state("teensy_sensor_hub/link", now_ns, _link, REPORT_SILENT_NS),
            "worst": self._worst(now_ns),
            "trims": {name: _trim(*tuned) for name, tuned in self.tuned.items()},
        }

    def calibration(self, now_ns: int) -> CalibrationState | None:
        """Return calibration_drive's newest state, unless it is silent."""
        state, arrival_ns = self._newest.get("calibration_drive/state", (None, 0))
        return state if now_ns - arrival_ns <= SILENT_NS else None

    # --- what arrives ---

    def _keep(self, topic, message, now_ns):
        self._newest[topic] = message, now_ns

    def _on_reports(self, array, now_ns):
        for status in array.status[:MAX_REPORTS]:
            namespace, _, node = status.name.partition(":")[0].rpartition("/")
            if namespace == self._namespace and node and (
                    status.name in self._reports or len(self._reports) < MAX_REPORTS):
                remedy = next((pair.value for pair in status.values if pair.key == "remedy"), "")
                self._reports[status.name] = {"level": min(status.level, ERROR), "text": _short(status.message),
                                              "remedy": _short(remedy)}, now_ns

    # --- groups ---

    def _state(self, topic, now_ns, build: Callable[[Any], Mapping], silent_ns=SILENT_NS):
        state, arrival_ns = self._newest.get(topic, (None, 0))
        if state is None:
            return None
        if now_ns - arrival_ns > silent_ns:
            return {"cause": "silent", "level": ERROR, "text": f"{topic.partition('/')[0]} is silent", "remedy": ""}
        return build(state)

    def _steering(self, state):
        teleop, _ = self._newest.get("teleop_logi/tele_steer_req", (Float32(math.nan), 0))
        is_by_hand = state.source == SteeringState.TELEOP
        return {**_cause(state), "source": SOURCES.get(state.source), **_limit(state),
                "asked": number(teleop.data, 2) if is_by_hand else None, "granted": self._granted(state.duty),
                "asked_radius": number(state.asked_radius, 2), "radius": number(state.turn_radius, 2)}

    def _granted(self, duty):
        values = self.tuned[CENTER][0].values
        if not {"servo_left", "servo_center", "servo_right"} <= set(values):
            return None
        left, right = (values[side] - values["servo_center"] for side in ("servo_left", "servo_right"))
        offset = duty - values["servo_center"]
        span, sign = (left, 1) if offset * left > 0 else (right, -1)
        return number(sign * min(1.0, offset / span), 2) if span else None

    def _speed(self, now_ns):
        for topic in ("throttle_arb/state", "turn_arb/state"):
            state, arrival_ns = self._newest.get(topic, (None, 0))
            if state is not None and now_ns - arrival_ns <= SILENT_NS:
                return number(state.speed, 2)
        return None

    def _range(self, topic, now_ns):
        message, arrival_ns = self._newest[topic]
        return [number(message.range, 2), number((now_ns - arrival_ns) / NS_PER_S, 1)]

    def _report(self, what, now_ns):
        """Return a node's report of a device; the whole name has the node's before it."""
        return next((self._aged(name, now_ns) for name in self._reports if name.endswith(f": {what}")), None)

    def _aged(self, name, now_ns):
        report, arrival_ns = self._reports[name]
        if now_ns - arrival_ns <= REPORT_SILENT_NS:
            return report
        return {"level": ERROR, "text": f"{name.partition(':')[0]} has stopped reporting", "remedy": ""}

    def _worst(self, now_ns):
        for name in [name for name, (_, arrival_ns) in self._reports.items() if now_ns - arrival_ns > FORGOTTEN_NS]:
            del self._reports[name]
        aged = {name: self._aged(name, now_ns) for name in sorted(self._reports)}
        name = max(aged, key=lambda name: aged[name]["level"], default=None)
        if name is None:
            return None
        if aged[name]["level"] == OK:
            return {"level": OK, "text": "no node reports a fault", "remedy": ""}
        return {**aged[name], "text": f"{name}: {aged[name]['text']}"}


def _short(text):
    return text if len(text) <= MAX_TEXT else text[:MAX_TEXT - 1] + "…"


def _cause(state):
    return {"cause": state.cause, "text": _short(state.reason)}


def _limit(state):
    return {"limit": state.limit, "limit_text": _short(state.limit_reason)}


def _throttle(state):
    return {**_cause(state), "source": SOURCES.get(state.source), **_limit(state), "mode": state.mode,
            "scale": number(state.human_scale, 2), "asked": number(state.asked, 2),
            "granted": number(state.granted, 2)}


def _link(state):
    return {"level": state.level, "text": _short(state.words or state.state), "remedy": _short(state.next_step),
            "delay": number(state.round_trip, 4)}


def _trim(tuned, name):
    if name not in tuned.values or tuned.low.get(name) == tuned.high.get(name):
        return None
    return {"value": tuned.values[name], "low": tuned.low[name], "high": tuned.high[name]}


def _layout(inbox):
    """Return where the sonars are, and the car's outline; None where the parameters don't say it."""
    graph, resolve = inbox.graph, inbox.resolve_name
    hub, throttle = (graph.parameter(resolve(node), {}) for node in ("teensy_sensor_hub", "throttle_arb"))
    try:
        config = read(Params({"sonar_hub": hub, **throttle, "obstacle_stop": True}), ObstacleConfig)
    except (ConfigError, TypeError):
        return None
    outline = config.outline
    return {"sonars": {name: list(mount) for name, mount in config.mounts.items()},
            "field_of_view": config.field_of_view_rad, "max_range": config.max_range_m,
            "front": outline.front_m, "rear": outline.rear_m, "width": outline.width_m}
