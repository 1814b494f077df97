"""A gamepad's axes and buttons → steering and throttle requests, and whether a human holds a deadman.

The deadman is a level, not a toggle: releasing it acts at once, and so does a gamepad that is stale or that sends fewer
axes or buttons than configured. After such a fault, and after the start, all deadmen must be released before one
counts: a car must not set off when a radio link recovers, or when a node is restarted.
"""
from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, Sequence

from car_interface.common import causes
from car_interface.common.errors import ConfigError
from car_interface.common.staleness import DROPPED, TimedInput
from car_interface.interlock.motion_interlock import STARTED

REARM_TEXT = "let go of the deadman, then hold it again"
REPORT = "gamepad"  # teleop_logi's on /diagnostics
# What to do about a gamepad that doesn't work. The switch is that of Logitech's F310 and F710, whose X mode has 8 axes
# and 11 buttons, and whose D mode has 6 and 12, with the cross in the place of the right stick.
MODE_REMEDY = ("Is the gamepad in another mode? A Logitech F710 or F310 needs its switch at X for the shipped indices. "
               "For another gamepad set teleop_logi's indices: rostopic echo {joy}")
REMEDIES = {
    causes.JOY_NEVER_RECEIVED: "See whether joy_node runs and finds the gamepad: rostopic info {joy}; ls /dev/input/js*",
    causes.JOY_STALE: "See whether the gamepad is on, charged and in range, and joy_node runs: rostopic hz {joy}",
    causes.JOY_INCOMPLETE: MODE_REMEDY,
    causes.JOY_NOT_FINITE: "See what sends it: rostopic info {joy}; rostopic echo {joy}",
}
# Distance from neutral of the request of a stick at rest: in deadbands, and its minimum. A servo doesn't resolve it.
REST_DEADBANDS, MIN_REST = 2, 0.002


@dataclass(frozen=True)
class GamepadConfig:
    """Which axis and button does what (indices into sensor_msgs/Joy), and the scale of each axis.

    Attributes:
        steer_axis, throttle_axis: indices of axes.
        steer_scale, throttle_scale: −1 inverts an axis.
        manual_button: deadman: the human steers.
        autonomous_button: deadman: the planner steers while a human watches.
        steer_neutral: the request that means "not steering".
        steer_deadband: requests this near to it mean the same. Both as in turn_arb.
        joy_timeout_s: a message older than this releases the deadman; 0 = never.

    Raises:
        ConfigError: naming the ROS parameter.
    """

    steer_axis: int
    throttle_axis: int
    manual_button: int
    autonomous_button: int
    steer_scale: float = 1.0
    throttle_scale: float = 1.0
    steer_neutral: float = 0.0
    steer_deadband: float = 0.001
    joy_timeout_s: float = 0.25

    def __post_init__(self):
        if self.manual_button == self.autonomous_button:
            raise ConfigError("autonomous_button", self.autonomous_button, "a button other than manual_button's")


class Requests(NamedTuple):
    """What the gamepad requests."""

    human_in_loop: bool
    steering: float  # −1 right .. +1 left
    throttle: float  # −1 .. +1
    cause: str  # one of car_interface.common.causes
    reason: str

    @property
    def must_rearm(self) -> bool:
        """Whether a deadman is held that doesn't count until it was released."""
        return self.cause == causes.NOT_REARMED


def remedy(cause: str, topic: str) -> str:
    """What to do about a cause; empty when there is nothing to do, or the reason says it.

    Args:
        cause: one of ``common.causes``.
        topic: the gamepad's, with its namespace.
    """
    return REMEDIES.get(cause, "").format(joy=topic)


class Gamepad:
    """Converts the gamepad's newest message to requests."""

    def __init__(self, config: GamepadConfig):
        self._config = config
        self._joy = TimedInput("joy", config.joy_timeout_s)
        self._rearm_reason = STARTED  # why the deadmen must be released first; empty: they were
        self.axes = self.buttons = 0  # how many the newest message had

    def update(self, axes: Sequence[float], buttons: Sequence[int], now_ns: int) -> None:
        """A message: axes −1..1, buttons 0 or 1."""
        if self._joy.was_received and self._joy.is_stale(now_ns):
            self._rearm_reason = DROPPED if self._joy.is_marked_stale else "the gamepad was silent"
        self.axes, self.buttons = len(axes), len(buttons)
        self._joy.update(self._read(axes, buttons), now_ns)

    def mark_stale(self) -> None:
        """Messages were dropped before they got here: no deadman counts until all were released."""
        self._joy.mark_stale()

    def requests(self, now_ns: int) -> Requests:
        """The requests at ``now_ns``."""
        if self._joy.is_stale(now_ns):
            cause = causes.JOY_STALE if self._joy.was_received else causes.JOY_NEVER_RECEIVED
            return self._released(cause, self._joy.stale_reason(now_ns))
        return self._joy.value

    def joy_age_s(self, now_ns: int) -> float:
        """Seconds since the last message; inf = never received."""
        return self._joy.age_s(now_ns)

    def _released(self, cause, reason):
        return Requests(False, self._config.steer_neutral, 0.0, cause, reason)

    def _read(self, axes, buttons):
        config = self._config
        missing = missing_index(config, len(axes), len(buttons))
        if missing is not None:
            name, reason = missing
            self._rearm_reason = f"the gamepad had no {name}"
            return self._released(causes.JOY_INCOMPLETE, reason)
        for name, index, scale in (("steer_axis", config.steer_axis, config.steer_scale),
                                   ("throttle_axis", config.throttle_axis, config.throttle_scale)):
            if not math.isfinite(scale * axes[index]):
                self._rearm_reason = f"the gamepad's {name} was {axes[index]}"
                return self._released(causes.JOY_NOT_FINITE,
                                      f"the gamepad's {name} {index} is {axes[index]}, no number to act on")
        steering = config.steer_scale * axes[config.steer_axis]
        throttle = config.throttle_scale * axes[config.throttle_axis]
        if not (buttons[config.manual_button] or buttons[config.autonomous_button]):
            self._rearm_reason = ""
            return self._released(causes.NO_DEADMAN, "no deadman is held")
        if self._rearm_reason:
            return self._released(causes.NOT_REARMED, f"{self._rearm_reason}; {REARM_TEXT}")
        if buttons[config.manual_button]:
            return Requests(True, self._steered(_unit(steering)), _unit(throttle), causes.MANUAL,
                            "manual deadman held")
        return Requests(True, config.steer_neutral, 0.0, causes.AUTONOMOUS, "autonomous deadman held")

    def _steered(self, steering):
        """The request of a stick, never neutral: under the manual deadman a neutral one would let the planner steer."""
        neutral, rest = self._config.steer_neutral, max(REST_DEADBANDS * self._config.steer_deadband, MIN_REST)
        if abs(steering - neutral) >= rest:
            return steering
        return neutral + (rest if neutral <= 0 else -rest)


def missing_index(config: GamepadConfig, axes: int, buttons: int) -> tuple[str, str] | None:
    """The first configured axis or button that a message with so many of them lacks: parameter and reason."""
    for name, index, count, singular, plural in (
            ("steer_axis", config.steer_axis, axes, "axis", "axes"),
            ("throttle_axis", config.throttle_axis, axes, "axis", "axes"),
            ("manual_button", config.manual_button, buttons, "button", "buttons"),
            ("autonomous_button", config.autonomous_button, buttons, "button", "buttons")):
        if index >= count:
            found = {0: f"no {plural}", 1: f"1 {singular} (0)"}.get(count, f"{count} {plural} (0 to {count - 1})")
            return name, f"the gamepad has {found}, but {name} is {index}"
    return None


def _unit(x):
    return max(-1.0, min(1.0, x))
