"""Converts a gamepad's axes and buttons to steering and throttle requests, and to whether a human holds a deadman.

The deadman is a level, not a toggle: releasing it acts at once, and so does a gamepad that is stale or that sends fewer
axes or buttons than configured. After such a fault, and after the start, all deadmen must be released before one is
obeyed: a car must not set off when a radio link recovers or a node is restarted.

The human goes first: a stick that is moved beyond a dead band controls its actuator, also under a deadman that gives
the actuator to the planner (``teleop.stick``).
"""
from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, Sequence

from car_interface.common import causes, declared
from car_interface.common.causes import HUMAN_DRIVES, HUMAN_STEERING, HUMAN_STEERS, HUMAN_THROTTLE, MANUAL, MODES
from car_interface.common.declared import REQUIRED
from car_interface.common.errors import ConfigError
from car_interface.common.staleness import DROPPED, STARTED, TimedInput
from car_interface.common.units import NS_PER_S
from car_interface.teleop.stick import Stick

REARM_TEXT = "let go of the deadman, then hold it again"
REPLACED = "another gamepad sends"  # as the reason to re-arm
MAX_INDEX = 63  # of an axis or a button
NONE = -1  # as an index: the gamepad has no such axis or button
CHANGES_SCALE = "a press changes the scale of driving by hand by throttle_arb's `scale_step`; −1 = none"
REPORT, DRIVER_REPORT = "gamepad", "gamepad device"  # teleop_logi's and gamepad_joy's on /diagnostics
# Remedies for a gamepad that doesn't work. Logitech's F310 and F710 have a switch: in X mode they have 8 axes and 11
# buttons; in D mode 6 and 12, with the cross in the place of the right stick.
MODE_REMEDY = ("Is the gamepad in another mode? A Logitech F710 or F310 needs its switch at X for the shipped indices. "
               "For another gamepad set teleop_logi's indices: rostopic echo {joy}")
D_MODE_AXES, D_MODE_BUTTONS, D_MODE_CROSS = 6, 12, (4, 5)
REST_REMEDY = ("Let go of the stick. If the axis stays where it is, it is a trigger, or the stick rests beyond "
               "override_deadband: set teleop_logi's indices, or throttle_axis -1; or override_deadband. ")
REMEDIES = {
    causes.JOY_NEVER_RECEIVED: ("See whether joy_node runs and finds the gamepad: rostopic info {joy}; "
                                "rostopic echo -n 1 /diagnostics"),
    causes.JOY_STALE: "See whether the gamepad is on, charged and in range and joy_node runs: rostopic hz {joy}",
    causes.JOY_INCOMPLETE: MODE_REMEDY,
    causes.JOY_UNMAPPED: "Map it: rosrun car_interface map_gamepad FOLDER, with your car's folder; then launch again",
    causes.NOT_AT_REST: REST_REMEDY + MODE_REMEDY,
    causes.JOY_NOT_FINITE: "See what sends it: rostopic info {joy}; rostopic echo {joy}",
}
# A stick that steers straight on requests at least this distance from neutral: in deadbands, and its minimum. A servo
# doesn't resolve it: 0.002 of 1300 duty are 0.8 µs.
REST_DEADBANDS, MIN_REST = 2, 0.002
# A cross gives -1, 0 and 1 only, but for rounding; any value in between comes from a stick.
CROSS_TOLERANCE = 0.01
# When a planner's deadman is pressed, throttle_arb may not know it yet: mode is a topic of its own, and reads manual
# while no deadman is held. A second pull would then be reverse. So for this long (throttle_arb's default mode_timeout
# of 0.5 s, and as much for the message) a pull that follows another begins with a stop (NaN), on the pulls' own topic.
MODE_SETTLES_NS = round(1.0 * NS_PER_S)
# Seven messages, of which a stall may cost five or six. No more: where a stop doesn't brake, the brake has to wait.
STOP_NS = round(0.15 * NS_PER_S)
LOG_PERIOD_NS = 10 * NS_PER_S  # as all warnings of this package
PULL_BEGINS = 0.02  # the least that esc/dead_band_reverse can be


@dataclass(frozen=True)
class GamepadConfig:
    """Which axis and button does what, by their indices in sensor_msgs/Joy.

    Without a throttle axis (``NONE``) the throttle's request is NaN. A gamepad that lacks one of the buttons that
    change the scale does without.
    """

    steer_axis: int = declared.integer(
        "steer_axis", REQUIRED, "index of the axis in the message; `rostopic echo /joy` shows it", low=0,
        high=MAX_INDEX)
    throttle_axis: int = declared.integer(
        "throttle_axis", REQUIRED, "the same of the throttle; −1 = none: you only steer", low=NONE, high=MAX_INDEX)
    manual_button: int = declared.integer(
        "manual_button", REQUIRED, "index of the deadman's button: you steer and drive", low=0, high=MAX_INDEX)
    autonomous_button: int = declared.integer(
        "autonomous_button", REQUIRED, "the same of the other deadman: the planner drives, and you watch", low=0,
        high=MAX_INDEX)
    steer_scale: float = declared.number("steer_scale", 1.0, "−1 inverts the axis", low=-1, high=1)
    throttle_scale: float = declared.number("throttle_scale", 1.0, "−1 inverts the axis", low=-1, high=1)
    steer_neutral: float = declared.number("steer_neutral", 0.0, "turn_arb's `tele_steer_neutral`", low=-1, high=1)
    steer_deadband: float = declared.number(
        "steer_deadband", 0.001, "turn_arb's `tele_steer_deadband`; the stick at rest sends twice this, at least 0.002",
        low=0.0, high=0.4)
    joy_timeout_s: float = declared.timeout("joy_timeout", 0.25, "a gamepad older than this releases the deadman")
    third_button: int = declared.integer("third_button", NONE, "another deadman; −1 = none", low=NONE, high=MAX_INDEX)
    third_mode: str = declared.choice(
        "third_mode", HUMAN_STEERING, "who does what then: you steer and the planner drives, or the other way round",
        choices=(HUMAN_THROTTLE, HUMAN_STEERING))
    faster_button: int = declared.integer("faster_button", NONE, CHANGES_SCALE, low=NONE, high=MAX_INDEX)
    slower_button: int = declared.integer("slower_button", NONE, CHANGES_SCALE, low=NONE, high=MAX_INDEX)
    override_deadband: float = declared.number(
        "override_deadband", 0.1, "a stick beyond it overrides the planner; an axis at rest is within", low=0.02,
        high=0.9)

    def __post_init__(self):
        taken = {self.manual_button: "manual_button"}
        for name in ("autonomous_button", "third_button", "faster_button", "slower_button"):
            button = getattr(self, name)
            if button in taken:
                raise ConfigError(name, button, f"a button other than {taken[button]}'s")
            if button != NONE:
                taken[button] = name


class Requests(NamedTuple):
    human_in_loop: bool
    steering: float  # −1 right .. +1 left
    throttle: float  # −1 .. +1; NaN: stop, as the human drives and no axis for it is trusted
    cause: str  # one of car_interface.common.causes
    reason: str
    steering_stick: str = ""  # OVERRIDE, OFF_CENTER or NOT_AT_REST of causes; empty: as the mode has it
    throttle_stick: str = ""

    @property
    def holds_deadman(self) -> bool:
        """Return whether a deadman is held, also one that has to be released first."""
        return self.human_in_loop or self.cause == causes.NOT_REARMED

    @property
    def mode(self) -> str:
        """Return who steers and who drives: one of ``causes.MODES``; MANUAL without a deadman."""
        return self.cause if self.cause in MODES else MANUAL

    @property
    def kind(self) -> tuple:
        """Return all but the numbers; a change of it is published at once, and logged."""
        return self.cause, self.steering_stick, self.throttle_stick

    @property
    def differs_by(self) -> tuple:
        """Return the kind, and whether the throttle is a stop."""
        return (*self.kind, math.isnan(self.throttle))

    @property
    def stick_cause(self) -> str:
        """Return NOT_AT_REST if an axis isn't trusted, else empty."""
        return causes.NOT_AT_REST if causes.NOT_AT_REST in (self.steering_stick, self.throttle_stick) else ""


def remedy(cause: str, topic: str) -> str:
    """Return the remedy of a cause; empty when there is nothing to do, or the reason names it.

    Args:
        cause: one of ``common.causes``.
        topic: the gamepad's, with its namespace.
    """
    return REMEDIES.get(cause, "").format(joy=topic)


class Gamepad:
    """Converts the gamepad's newest message to requests.

    Args:
        rearm_reason: why the deadmen must be released first.
        unmapped: why it drives nothing, as nobody has said what they do; empty: somebody has.
        topic, name: in reasons.

    Attributes:
        joy: the newest message, with its age; once it is marked stale no deadman is obeyed until all were released.
        axes, buttons: how many it had.
    """

    def __init__(self, config: GamepadConfig, rearm_reason: str = STARTED, unmapped: str = "", topic: str = "joy",
                 name: str = "the gamepad"):
        self._config, self._name = config, name
        self._unmapped = unmapped
        self.joy = TimedInput(topic, config.joy_timeout_s)
        self._rearm_reason = rearm_reason  # empty: they were released
        self.axes = self.buttons = 0
        self._scale_button = 0
        self._steering = Stick(config.override_deadband, brakes=False)
        self._throttle = Stick(config.override_deadband, brakes=True)
        self._moved_between: set[int] = set()  # axes that gave what a cross doesn't
        self._mode = ""  # of the deadman that is held and counts
        self._human_ns = self._held_ns = -math.inf  # when the human's mode was last published, and a deadman held
        self._had_pull = self._was_pulled = self._was_planners = False  # of the throttle
        self._stops_until_ns = -math.inf

    def update(self, axes: Sequence[float], buttons: Sequence[int], now_ns: int) -> None:
        """Take a message: axes −1..1, buttons 0 or 1."""
        was_stale = self.joy.was_received and self.joy.is_stale(now_ns)
        if was_stale:
            self._rearm_reason = DROPPED if self.joy.is_marked_stale else f"{self._name} was silent"
        if was_stale or (len(axes), len(buttons)) != (self.axes, self.buttons):
            self._distrust_sticks()
        self.axes, self.buttons = len(axes), len(buttons)
        broken = self._broken(axes)
        if broken is None:
            self._scale_button = (self._is_pressed(self._config.faster_button, buttons)
                                  - self._is_pressed(self._config.slower_button, buttons))
            self.joy.update(self._read(axes, buttons, now_ns), now_ns)
        else:
            self._scale_button = 0
            self._distrust_sticks()
            self.joy.update(broken, now_ns)

    def requests(self, now_ns: int) -> Requests:
        if self.joy.is_stale(now_ns):
            cause = causes.JOY_STALE if self.joy.was_received else causes.JOY_NEVER_RECEIVED
            return self._released(cause, self.joy.stale_reason(now_ns))
        if self._mode:
            return self._held(self._mode, now_ns)
        requests = self.joy.value
        is_whole = requests.cause in (causes.NO_DEADMAN, causes.NOT_REARMED)
        return self._with_sticks(requests, now_ns) if is_whole else requests

    def follow(self, now_ns: int) -> None:
        """Take note that another source's deadman counts: its pulls count as earlier ones of this source."""
        self._had_pull, self._held_ns = True, now_ns

    def scale_button(self, now_ns: int) -> int:
        """Return 1 or −1 while the button for more or less speed by hand is pressed; 0: neither is, or both are."""
        return 0 if self.joy.is_stale(now_ns) else self._scale_button

    def _released(self, cause, reason):
        return Requests(False, self._config.steer_neutral, 0.0, cause, reason)

    # --- a message ---

    def _broken(self, axes):
        """Return the requests where the message can't be used, else ``None``."""
        config = self._config
        if self._unmapped:
            return self._released(causes.JOY_UNMAPPED, self._unmapped)
        missing = missing_index(config, self.axes, self.buttons)
        if missing is not None:
            name, reason = missing
            self._rearm_reason = f"{self._name} had no {name}"
            return self._released(causes.JOY_INCOMPLETE, reason)
        for name, index, scale in (("steer_axis", config.steer_axis, config.steer_scale),
                                   ("throttle_axis", config.throttle_axis, config.throttle_scale)):
            if index != NONE and not math.isfinite(scale * axes[index]):
                self._rearm_reason = f"{self._name}'s {name} was {axes[index]}"
                return self._released(causes.JOY_NOT_FINITE,
                                      f"{self._name}'s {name} {index} is {axes[index]}, no number to act on")
        return None

    def _read(self, axes, buttons, now_ns):
        """Return the requests without the sticks, which also change with time; None: a deadman counts."""
        mode = self._held_mode(buttons)
        if not mode:
            self._rearm_reason = ""
        self._mode = "" if self._rearm_reason else mode
        self._read_sticks(axes, now_ns)
        self._look_for_pulls(now_ns)
        if not mode:
            return self._released(causes.NO_DEADMAN, "no deadman is held")
        if self._rearm_reason:
            return self._released(causes.NOT_REARMED, f"{self._rearm_reason}; {REARM_TEXT}")
        return None

    def _held_mode(self, buttons):
        """Return the mode of the held deadman; empty: none. Of several, the one in which the human does more."""
        config = self._config
        if buttons[config.manual_button]:
            return causes.MANUAL
        if self._is_pressed(config.third_button, buttons):
            return config.third_mode
        return causes.AUTONOMOUS if buttons[config.autonomous_button] else ""

    @staticmethod
    def _is_pressed(button, buttons):
        return button != NONE and button < len(buttons) and bool(buttons[button])

    # --- its sticks ---

    def _distrust_sticks(self):
        self._moved_between.clear()
        self._mode = ""
        for stick in (self._steering, self._throttle):
            stick.distrust()

    def _read_sticks(self, axes, now_ns):
        config, mode = self._config, self._mode
        sticks = [(self._steering, config.steer_axis, config.steer_scale, config.steer_neutral, HUMAN_STEERS)]
        if config.throttle_axis != NONE:
            sticks.append((self._throttle, config.throttle_axis, config.throttle_scale, 0.0, HUMAN_DRIVES))
        for stick, index, scale, center, humans in sticks:
            if CROSS_TOLERANCE < abs(axes[index]) < 1 - CROSS_TOLERANCE:
                self._moved_between.add(index)
            stick.update(max(-1.0, min(1.0, scale * axes[index])) - center, bool(mode) and mode not in humans,
                         not self._is_cross(index), now_ns)

    def _is_cross(self, index):
        """Return whether an axis is where a Logitech gamepad in D mode has its cross, and moved like a cross."""
        return is_d_mode_cross(index, self.axes, self.buttons) and index not in self._moved_between

    def _look_for_pulls(self, now_ns):
        """Have a pull begin with a stop where throttle_arb may take it for the second one under a human's deadman."""
        stick, is_planners = self._throttle, bool(self._mode) and self._mode not in HUMAN_DRIVES
        if not is_planners:
            self._human_ns = now_ns
        if self._mode:
            self._held_ns = now_ns
        elif now_ns - self._held_ns >= MODE_SETTLES_NS:
            self._had_pull = False
        pull = self._overriding_throttle(now_ns) if is_planners else stick.deflection * stick.counts
        is_pulled = bool(self._mode) and pull <= -PULL_BEGINS
        begins = is_pulled and not (self._was_pulled and is_planners == self._was_planners)
        if not is_planners:
            self._stops_until_ns = -math.inf
        elif begins and self._had_pull and now_ns - self._human_ns < MODE_SETTLES_NS:
            self._stops_until_ns = now_ns + STOP_NS
        self._had_pull = self._had_pull or is_pulled
        self._was_pulled, self._was_planners = is_pulled, is_planners

    # --- requests ---

    def _held(self, mode, now_ns):
        config = self._config
        reason = f"{mode} deadman held"
        steering = config.steer_neutral
        if mode in HUMAN_STEERS:
            steering = self._steered(config.steer_neutral + self._steering.deflection * self._steering.counts)
        elif self._steering.overrides(now_ns):
            steering = self._steered(config.steer_neutral + self._steering.override())
        if mode in HUMAN_DRIVES and config.throttle_axis == NONE:
            throttle, reason = math.nan, f"{reason}, but throttle_axis is {NONE}: this gamepad drives no throttle"
        elif mode in HUMAN_DRIVES:
            throttle = self._throttle.deflection if self._throttle.counts else math.nan
        elif now_ns < self._stops_until_ns:
            throttle, reason = math.nan, f"{reason}; a pull just after another deadman begins with a stop"
        else:
            throttle = self._overriding_throttle(now_ns)
        return self._with_sticks(Requests(True, steering, throttle, mode, reason), now_ns)

    def _overriding_throttle(self, now_ns):
        """Return the throttle under a planner's deadman; 0: the planner drives, or the stick came back.

        throttle_arb has a smaller dead band, and its own half second until the planner drives again: with 0 for a stick
        that rests between the two dead bands, that time starts when the stick came back.
        """
        stick = self._throttle
        return stick.override() if stick.is_out and stick.overrides(now_ns) else 0.0

    def _with_sticks(self, requests, now_ns):
        """Return the requests with the cause of each stick."""
        config = self._config
        steering, steering_note = self._stick(self._steering, "steer_axis", config.steer_axis, "steering", now_ns)
        throttle, throttle_note = "", ""
        if config.throttle_axis != NONE:
            throttle, throttle_note = self._stick(self._throttle, "throttle_axis", config.throttle_axis, "throttle",
                                                  now_ns)
        reason = "; ".join(text for text in (requests.reason, steering_note, throttle_note) if text)
        return requests._replace(reason=reason, steering_stick=steering, throttle_stick=throttle)

    def _stick(self, stick, parameter, index, name, now_ns):
        """Return cause and words for one stick; both empty: the mode decides alone."""
        value, overrides = stick.deflection, stick.overrides(now_ns)
        if not stick.counts:
            why = (f"is where a gamepad with {self.axes} axes and {self.buttons} buttons has its cross"
                   if self._is_cross(index) else f"is {value:.2f} and was not seen at its rest")
            brakes = ": it only brakes" if overrides else ": it doesn't count"
            return causes.NOT_AT_REST, f"{self._name}'s {parameter} {index} {why}{brakes}"
        if overrides:
            return causes.OVERRIDE, f"the {name} stick overrides the planner by {stick.override():.2f}"
        if stick.is_off_center:
            return causes.OFF_CENTER, (f"the {name} stick, at {value:.2f}, was off its center when the deadman was "
                                       "pressed: center it once")
        return "", ""

    def _steered(self, steering):
        """Return the request of a stick that steers. It is never neutral: a neutral one would let the planner steer."""
        neutral, rest = self._config.steer_neutral, max(REST_DEADBANDS * self._config.steer_deadband, MIN_REST)
        if abs(steering - neutral) >= rest:
            return steering
        return neutral + (rest if neutral <= 0 else -rest)


class RequestsLogFilter:
    """Finds changes of the cause, and of the causes of the sticks.

    Each change is new where a human comes, goes or is there. Without a human each cause is new at most once in 10 s,
    since a gamepad at the edge of its range comes and goes several times a second. A cause that lasts becomes new in
    the end.
    """

    def __init__(self):
        self._logged: Requests | None = None
        self._next_ns: dict[tuple, int] = {}  # by kind

    def is_new(self, requests: Requests, now_ns: int) -> bool:
        """Return whether to log ``requests`` at ``now_ns``; if so, the next ones are compared with them."""
        logged = self._logged
        if logged is not None and logged.kind == requests.kind:
            return False
        without_human = logged is not None and not (logged.human_in_loop or requests.human_in_loop)
        if without_human and now_ns < self._next_ns.get(requests.kind, now_ns):
            return False
        self._logged, self._next_ns[requests.kind] = requests, now_ns + LOG_PERIOD_NS
        return True


def is_d_mode_cross(index: int, axes: int, buttons: int) -> bool:
    """Return whether an axis is where a Logitech gamepad in D mode has its cross, by the counts of axes and buttons."""
    return (axes, buttons) == (D_MODE_AXES, D_MODE_BUTTONS) and index in D_MODE_CROSS


def missing_index(config: GamepadConfig, axes: int, buttons: int) -> tuple[str, str] | None:
    """Return parameter and reason of the first configured axis or button that a message of this size lacks."""
    for name in ("steer_axis", "throttle_axis", "manual_button", "autonomous_button", "third_button"):
        index = getattr(config, name)
        count, singular, plural = (axes, "axis", "axes") if name.endswith("axis") else (buttons, "button", "buttons")
        if index >= count:
            found = {0: f"no {plural}", 1: f"1 {singular} (0)"}.get(count, f"{count} {plural} (0 to {count - 1})")
            return name, f"the gamepad has {found}, but {name} is {index}"
    return None
