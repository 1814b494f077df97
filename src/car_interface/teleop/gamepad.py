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
from car_interface.common.drive_modes import HUMAN_DRIVES, HUMAN_STEERING, HUMAN_STEERS, HUMAN_THROTTLE, MANUAL, MODES
from car_interface.common.errors import ConfigError
from car_interface.common.staleness import DROPPED, TimedInput
from car_interface.interlock.motion_interlock import STARTED

REARM_TEXT = "let go of the deadman, then hold it again"
MAX_INDEX = 63  # of an axis or a button
NONE = -1  # as an index: the gamepad has no such axis or button
REPORT = "gamepad"  # teleop_logi's on /diagnostics
# What to do about a gamepad that doesn't work. The switch is that of Logitech's F310 and F710, whose X mode has 8 axes
# and 11 buttons, and whose D mode has 6 and 12, with the cross in the place of the right stick.
MODE_REMEDY = ("Is the gamepad in another mode? A Logitech F710 or F310 needs its switch at X for the shipped indices. "
               "For another gamepad set teleop_logi's indices: rostopic echo {joy}")
REMEDIES = {
    causes.JOY_NEVER_RECEIVED: ("See whether joy_node runs and finds the gamepad: rostopic info {joy}; "
                                "ls /dev/input/js*"),
    causes.JOY_STALE: "See whether the gamepad is on, charged and in range and joy_node runs: rostopic hz {joy}",
    causes.JOY_INCOMPLETE: MODE_REMEDY,
    causes.JOY_NOT_FINITE: "See what sends it: rostopic info {joy}; rostopic echo {joy}",
}
# Distance from neutral of the request of a stick at rest: in deadbands, and its minimum. A servo doesn't resolve it.
REST_DEADBANDS, MIN_REST = 2, 0.002


@dataclass(frozen=True)
class GamepadConfig:
    """Which axis and button does what (indices into sensor_msgs/Joy), and the scale of each axis.

    Attributes:
        steer_axis, throttle_axis: indices of axes. Without a throttle axis (``NONE``) the throttle's request is NaN.
        steer_scale, throttle_scale: −1 inverts an axis.
        manual_button: deadman: the human steers.
        autonomous_button: deadman: the planner steers while a human watches.
        third_button: deadman of ``third_mode``; ``NONE`` = there is none.
        third_mode: HUMAN_THROTTLE or HUMAN_STEERING of ``common.drive_modes``.
        faster_button, slower_button: change the scale of driving by hand; ``NONE`` = there is none. A gamepad that
            lacks one of them does without.
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
    third_button: int = NONE
    third_mode: str = HUMAN_STEERING
    faster_button: int = NONE
    slower_button: int = NONE

    def __post_init__(self):
        taken = {self.manual_button: "manual_button"}
        for name in ("autonomous_button", "third_button", "faster_button", "slower_button"):
            button = getattr(self, name)
            if button in taken:
                raise ConfigError(name, button, f"a button other than {taken[button]}'s")
            if button != NONE:
                taken[button] = name


def read_gamepad(params) -> GamepadConfig:
    """The configuration from teleop_logi's parameters."""
    return GamepadConfig(
        steer_axis=params.integer("steer_axis", low=0, high=MAX_INDEX),
        throttle_axis=params.integer("throttle_axis", low=NONE, high=MAX_INDEX),
        manual_button=params.integer("manual_button", low=0, high=MAX_INDEX),
        autonomous_button=params.integer("autonomous_button", low=0, high=MAX_INDEX),
        steer_scale=params.number("steer_scale", 1.0, low=-1, high=1),
        throttle_scale=params.number("throttle_scale", 1.0, low=-1, high=1),
        steer_neutral=params.number("steer_neutral", 0.0, low=-1, high=1),
        steer_deadband=params.number("steer_deadband", 0.001, low=0.0, high=0.4),
        joy_timeout_s=params.timeout("joy_timeout", 0.25),
        third_button=params.integer("third_button", NONE, low=NONE, high=MAX_INDEX),
        third_mode=params.choice("third_mode", HUMAN_STEERING, (HUMAN_THROTTLE, HUMAN_STEERING)),
        faster_button=params.integer("faster_button", NONE, low=NONE, high=MAX_INDEX),
        slower_button=params.integer("slower_button", NONE, low=NONE, high=MAX_INDEX),
    )


class Requests(NamedTuple):
    """What the gamepad requests."""

    human_in_loop: bool
    steering: float  # −1 right .. +1 left
    throttle: float  # −1 .. +1; NaN: the gamepad has no throttle axis
    cause: str  # one of car_interface.common.causes
    reason: str

    @property
    def mode(self) -> str:
        """Who steers and who drives: one of ``common.drive_modes``. Without a deadman the human's."""
        return self.cause if self.cause in MODES else MANUAL

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
        self._scale_button = 0

    def update(self, axes: Sequence[float], buttons: Sequence[int], now_ns: int) -> None:
        """A message: axes −1..1, buttons 0 or 1."""
        if self._joy.was_received and self._joy.is_stale(now_ns):
            self._rearm_reason = DROPPED if self._joy.is_marked_stale else "the gamepad was silent"
        self.axes, self.buttons = len(axes), len(buttons)
        self._scale_button = (self._is_pressed(self._config.faster_button, buttons)
                              - self._is_pressed(self._config.slower_button, buttons))
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

    def scale_button(self, now_ns: int) -> int:
        """1 or −1 while the button for more or less speed by hand is pressed; 0: neither is, or both are."""
        return 0 if self._joy.is_stale(now_ns) else self._scale_button

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
            if index != NONE and not math.isfinite(scale * axes[index]):
                self._rearm_reason = f"the gamepad's {name} was {axes[index]}"
                return self._released(causes.JOY_NOT_FINITE,
                                      f"the gamepad's {name} {index} is {axes[index]}, no number to act on")
        mode = self._held_mode(buttons)
        if not mode:
            self._rearm_reason = ""
            return self._released(causes.NO_DEADMAN, "no deadman is held")
        if self._rearm_reason:
            return self._released(causes.NOT_REARMED, f"{self._rearm_reason}; {REARM_TEXT}")
        return self._held(mode, axes)

    def _held_mode(self, buttons):
        """The mode of the deadman that is held; empty: none is. Of several the one in which the human does more."""
        config = self._config
        if buttons[config.manual_button]:
            return causes.MANUAL
        if self._is_pressed(config.third_button, buttons):
            return config.third_mode
        return causes.AUTONOMOUS if buttons[config.autonomous_button] else ""

    def _held(self, mode, axes):
        config = self._config
        steering, throttle, reason = config.steer_neutral, 0.0, f"{mode} deadman held"
        if mode in HUMAN_STEERS:
            steering = self._steered(_unit(config.steer_scale * axes[config.steer_axis]))
        if mode in HUMAN_DRIVES and config.throttle_axis == NONE:
            throttle, reason = math.nan, f"{reason}, but throttle_axis is {NONE}: this gamepad drives no throttle"
        elif mode in HUMAN_DRIVES:
            throttle = _unit(config.throttle_scale * axes[config.throttle_axis])
        return Requests(True, steering, throttle, mode, reason)

    @staticmethod
    def _is_pressed(button, buttons):
        return button != NONE and button < len(buttons) and bool(buttons[button])

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
            ("autonomous_button", config.autonomous_button, buttons, "button", "buttons"),
            ("third_button", config.third_button, buttons, "button", "buttons")):
        if index >= count:
            found = {0: f"no {plural}", 1: f"1 {singular} (0)"}.get(count, f"{count} {plural} (0 to {count - 1})")
            return name, f"the gamepad has {found}, but {name} is {index}"
    return None


def _unit(x):
    return max(-1.0, min(1.0, x))
