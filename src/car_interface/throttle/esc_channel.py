"""Whether the ESC gets the converted value or neutral, and why.

The ESC is driven only while a human holds the deadman, the steering arbiter is alive and not locked, and command and
odometry are fresh. Steering and throttle stop together.
"""
from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple, Sequence

from car_interface.common import causes
from car_interface.common.errors import ConfigError
from car_interface.common.lookup_table import LookupTable, round_half_away
from car_interface.common.servo_channels import MAX_DUTY
from car_interface.common.staleness import TimedInput
from car_interface.interlock.motion_interlock import InterlockConfig, MotionInterlock
from car_interface.steering.arbiter import NEUTRAL, PLANNER, TELEOP, source_name
from car_interface.throttle.converter import Conversion, Converter


@dataclass(frozen=True)
class ThrottleConfig:
    """The ESC's channel and its calibration, named as the parameters under ``servo/``.

    Attributes:
        channel: 0..15.
        value_axis, duty_table: the duty for each value, linear between, saturated beyond.
        neutral: the duty that neither drives nor brakes.
        interlock: the rules of lock and deadman.
        steering_timeout_s, command_timeout_s: an older input is stale; 0 = never.

    Raises:
        ConfigError: naming the parameter.
    """

    channel: int
    value_axis: Sequence[float]
    duty_table: Sequence[float]
    neutral: int
    interlock: InterlockConfig = field(default_factory=InterlockConfig)
    steering_timeout_s: float = 0.25
    command_timeout_s: float = 0.5

    def __post_init__(self):
        is_valid_table = self.duty_table and len(self.duty_table) == len(self.value_axis)  # else LookupTable refuses it
        if is_valid_table and not min(self.duty_table) <= self.neutral <= max(self.duty_table):
            raise ConfigError("servo/neutral", self.neutral, "a duty within the range of servo/duty_table")


def trimmed(config: ThrottleConfig, neutral: int) -> ThrottleConfig:
    """An ESC's calibration with another neutral and the table shifted by the same, so that a value of 0 stays neutral.

    Raises:
        ConfigError: naming the parameter.
    """
    shift = neutral - config.neutral
    return replace(config, neutral=neutral,
                   duty_table=[max(0, min(MAX_DUTY, duty + shift)) if shift else duty for duty in config.duty_table])


def duty_of_value(config: ThrottleConfig) -> LookupTable:
    """The duty for each value.

    Raises:
        ConfigError: naming the parameter.
    """
    return LookupTable(config.value_axis, config.duty_table, "servo/value_axis", "servo/duty_table")


class ThrottleDecision(NamedTuple):
    """The duty for the ESC, and why."""

    duty: int
    driving: bool  # False: neutral
    cause: str  # one of car_interface.common.causes
    reason: str


class Throttle:
    """Decides the ESC's duty from the newest of each input."""

    def __init__(self, config: ThrottleConfig, converter: Converter):
        self.calibrate(config)
        self._converter = converter
        self._interlock = MotionInterlock(config.interlock)
        self._steering = TimedInput("turn_arb's state", config.steering_timeout_s)
        self._command = TimedInput("control_cmd", config.command_timeout_s)

    def calibrate(self, config: ThrottleConfig) -> None:
        """Use another calibration from now on; timeouts and interlock stay as they were at start.

        Raises:
            ConfigError: naming the parameter; the calibration before stays.
        """
        duty = duty_of_value(config)
        self.config, self._duty = config, duty

    def update_e_stop(self, locked: bool, now_ns: int) -> None:
        """The emergency stop: true = neutral."""
        self._interlock.update_e_stop(locked, now_ns)

    def update_human(self, present: bool, now_ns: int) -> None:
        """The deadman: true while a human holds it."""
        self._interlock.update_human(present, now_ns)

    def update_steering(self, source: int, now_ns: int) -> None:
        """Who steers: a value of SteeringState.source."""
        self._steering.update(source, now_ns)

    def update_conversion(self, conversion: Conversion, now_ns: int) -> None:
        """The converter's answer to the newest command."""
        self._command.update(conversion, now_ns)

    def mark_stale(self, now_ns: int) -> None:
        """Messages were dropped before they got here: all inputs are stale."""
        self._interlock.mark_stale(now_ns)
        self._steering.mark_stale()
        self._command.mark_stale()

    def decide(self, now_ns: int) -> ThrottleDecision:
        """The ESC's duty at ``now_ns``, and why."""
        blocked = self._why_blocked(now_ns)
        if blocked is not None:
            return ThrottleDecision(self.config.neutral, False, *blocked)
        value = self._command.value.value
        duty = max(0, min(MAX_DUTY, round_half_away(self._duty(value))))
        return ThrottleDecision(duty, True, causes.DRIVING, f"the value is {value:.3f}")

    def ages_s(self, now_ns: int) -> dict[str, float]:
        """Seconds since the last message of each input, by name; inf = never received."""
        return {"e_stop": self._interlock.e_stop_age_s(now_ns), "human_in_loop": self._interlock.human_age_s(now_ns),
                self._steering.name: self._steering.age_s(now_ns), self._command.name: self._command.age_s(now_ns)}

    def _why_blocked(self, now_ns) -> Sequence[str] | None:
        """Cause and reason why the ESC must be neutral, or ``None``."""
        inhibit = self._interlock.inhibit(now_ns)
        if inhibit is not None:
            return inhibit.cause, inhibit.reason
        if self._steering.is_stale(now_ns):
            return causes.STEERING_STALE, self._steering.stale_reason(now_ns)
        if self._steering.value not in (NEUTRAL, TELEOP, PLANNER):
            return causes.STEERING_STOPPED, f"turn_arb says {source_name(self._steering.value)}"
        if self._command.is_stale(now_ns):
            return causes.COMMAND_STALE, self._command.stale_reason(now_ns)
        trouble = self._command.value if self._command.value.value is None else self._converter.odometry_trouble(now_ns)
        return None if trouble is None else (trouble.cause, trouble.reason)
