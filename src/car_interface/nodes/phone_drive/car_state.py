"""What the pages show of the car: the groups of ``teleop.phone_messages``, from the states that the nodes publish.

It listens to topics alone, and asks neither the master nor a node.
"""
from __future__ import annotations

import math
from typing import Any, Callable

from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import Range
from std_msgs.msg import Float32

from car_interface.common.declared import read
from car_interface.common.errors import ConfigError
from car_interface.common.params import Params
from car_interface.common.sources import SOURCE_NAMES, TELEOP
from car_interface.common.staleness import TimedInput
from car_interface.common.vehicle_geometry import SONARS
from car_interface.msg import LinkStatus, PlannerState, SteeringState, TeleopState, ThrottleState
from car_interface.ros.diagnostics import ERROR, OK
from car_interface.ros.inbox import Inbox
from car_interface.ros.reconfigure import TunedNode
from car_interface.ros.topics import listen, subscribe
from car_interface.teleop.phone_messages import CENTER, NEUTRAL, number
from car_interface.throttle.battery import REPORT as BATTERY
from car_interface.throttle.obstacle_stop import ObstacleConfig

SILENT_S = 1.0  # of a node that repeats its state 10 times a second
REPORT_SILENT_S = 5.0  # of one that reports once a second
FORGOTTEN_S = 60.0  # its node was ended on purpose by then
MAX_REPORTS = 200  # of a message, and that are kept: only an open page has old ones forgotten
MAX_TEXT = 300  # characters
SOURCES = {source: name.lower().replace("_", " ") for source, name in enumerate(SOURCE_NAMES)}
BOARD = "servo board"  # pca9685's on /diagnostics


class CarState:
    """The newest of what the nodes publish."""

    def __init__(self, inbox: Inbox):
        def newest(topic, message_type, silent_s=SILENT_S):
            return listen(topic, message_type, inbox, silent_s, wakes=False)
        self._teleop = newest("teleop_logi/state", TeleopState)
        self._stick = newest("teleop_logi/tele_steer_req", Float32)
        self._steering = newest("turn_arb/state", SteeringState)
        self._throttle = newest("throttle_arb/state", ThrottleState)
        self._planner = newest("planner_interface/state", PlannerState)
        self._link = newest("teensy_sensor_hub/link", LinkStatus, REPORT_SILENT_S)
        self._sonars = {name: newest(f"sonar/{name}", Range) for name in SONARS}
        self._reports: dict[str, TimedInput] = {}  # of this car's nodes, by name
        self._namespace = inbox.graph.namespace().strip("/")
        self._layout = _layout(inbox)
        # The node that saves it, its tunable values, and the name among them.
        self.tuned = {CENTER: ("turn_arb", TunedNode(inbox, "turn_arb"), "servo_center"),
                      NEUTRAL: ("throttle_arb", TunedNode(inbox, "throttle_arb/servo"), "neutral")}
        subscribe("/diagnostics", DiagnosticArray, inbox, self._on_reports, queue_size=50, wakes=False)

    def groups(self, now_ns: int) -> dict[str, Any]:
        """Return all groups but those of recordings and calibration, as JSON has them."""
        return {
            "who": _state(self._teleop, now_ns, _cause),
            "steering": _state(self._steering, now_ns, self._steering_group),
            "throttle": _state(self._throttle, now_ns, lambda state: {
                **_decision(state), "mode": state.mode, "scale": number(state.human_scale, 2),
                "asked": number(state.asked, 2), "granted": number(state.granted, 2)}),
            "speed": next((number(state.value.speed, 2) for state in (self._throttle, self._steering)
                           if not state.is_stale(now_ns)), None),
            "planner": _state(self._planner, now_ns, lambda state: {
                **_cause(state), "source": state.source, "speed": number(state.speed, 2)}),
            "esc": _state(self._throttle, now_ns, lambda state: {
                "profile": state.profile, "state": state.esc, "text": _short(state.esc_reason)}),
            "sonars": {name: [number(sonar.value.range, 2), number(sonar.silence_s(now_ns), 1)]
                       for name, sonar in self._sonars.items() if sonar.was_received} or None,
            "layout": self._layout,
            "board": self._report(BOARD, now_ns), "battery": self._report(BATTERY, now_ns),
            "teensy": _state(self._link, now_ns, lambda state: {
                "level": state.level, "text": _short(state.words or state.state), "remedy": _short(state.next_step),
                "delay": number(state.round_trip, 4)}),
            "worst": self._worst(now_ns),
            "trims": {trim: _trim(tuned, name) for trim, (_, tuned, name) in self.tuned.items()},
        }

    def _on_reports(self, array, now_ns):
        for status in array.status[:MAX_REPORTS]:
            namespace, _, node = status.name.partition(":")[0].rpartition("/")
            if namespace == self._namespace and node and (
                    status.name in self._reports or len(self._reports) < MAX_REPORTS):
                remedy = next((pair.value for pair in status.values if pair.key == "remedy"), "")
                self._reports.setdefault(status.name, TimedInput(status.name, REPORT_SILENT_S)).update(
                    _fault(min(status.level, ERROR), _short(status.message), _short(remedy)), now_ns)

    # --- groups ---

    def _steering_group(self, state):
        asked = self._stick.value.data if state.source == TELEOP and self._stick.was_received else math.nan
        return {**_decision(state), "asked": number(asked, 2), "granted": self._granted(state.duty),
                "asked_radius": number(state.asked_radius, 2), "radius": number(state.turn_radius, 2)}

    def _granted(self, duty):
        values = self.tuned[CENTER][1].values
        if not {"servo_left", "servo_center", "servo_right"} <= set(values):
            return None
        left, right = (values[side] - values["servo_center"] for side in ("servo_left", "servo_right"))
        offset = duty - values["servo_center"]
        span, sign = (left, 1) if offset * left > 0 else (right, -1)
        return number(sign * min(1.0, offset / span), 2) if span else None

    def _report(self, what, now_ns):
        """Return a node's report of a device; the whole name has the node's before it."""
        return next((_aged(report, now_ns) for name, report in self._reports.items() if name.endswith(f": {what}")),
                    None)

    def _worst(self, now_ns):
        self._reports = {name: report for name, report in self._reports.items()
                         if report.silence_s(now_ns) <= FORGOTTEN_S}
        aged = {name: _aged(self._reports[name], now_ns) for name in sorted(self._reports)}
        name = max(aged, key=lambda name: aged[name]["level"], default=None)
        if name is None:
            return None
        if aged[name]["level"] == OK:
            return _fault(OK, "no node reports a fault")
        return {**aged[name], "text": f"{name}: {aged[name]['text']}"}


def _state(newest: TimedInput, now_ns: int, build: Callable[[Any], dict]):
    """Return a group by a node's newest state; None: it was never heard."""
    if newest.was_received and newest.is_stale(now_ns):
        return {"cause": "silent", **_fault(ERROR, f"{newest.name.partition('/')[0]} is silent")}
    return build(newest.value) if newest.was_received else None


def _aged(report, now_ns):
    return report.fresh(now_ns) or _fault(ERROR, f"{report.name.partition(':')[0]} has stopped reporting")


def _fault(level, text, remedy=""):
    return {"level": level, "text": text, "remedy": remedy}


def _short(text):
    return text if len(text) <= MAX_TEXT else text[:MAX_TEXT - 1] + "…"


def _cause(state):
    return {"cause": state.cause, "text": _short(state.reason)}


def _decision(state):
    return {**_cause(state), "source": SOURCES.get(state.source), "limit": state.limit,
            "limit_text": _short(state.limit_reason)}


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
