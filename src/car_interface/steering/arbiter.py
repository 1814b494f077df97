"""Who steers, and with what duty.

Consumes what was heard (emergency stop, deadman, the gamepad's steering, the planner's turn radius), each with its
arrival on the monotonic clock, and answers with a ``Decision``: source, duty, and the reason in words. It calls no
clock: ``now_ns`` is passed in. Silence never grants control, it takes it away.

Steering −1 is right and +1 left; a turn radius is in metres, right negative; a duty is 0..65535 of the PWM period.
"""
from __future__ import annotations

import math
from typing import NamedTuple

from car_interface.common.lookup_table import LookupTable, round_half_away
from car_interface.common.staleness import TimedInput
from car_interface.common.units import NS_PER_S
from car_interface.interlock.motion_interlock import MotionInterlock
from car_interface.steering.calibration import SteeringConfig

# Values of SteeringState.source, in order of priority.
LOCKED, NO_HUMAN, NEUTRAL, TELEOP, PLANNER = range(5)
SOURCE_NAMES = ("LOCKED", "NO_HUMAN", "NEUTRAL", "TELEOP", "PLANNER")

NO_RADIUS_M = 0.001  # a requested radius this close to 0 means "no request", as in the original
FLOAT32_SLACK = 1 + 2 ** -23  # 0.001 arrives from a Float32 as 0.001000000047


def source_name(source: int) -> str:
    """The name of a value of SteeringState.source, or its number when it has none."""
    return SOURCE_NAMES[source] if 0 <= source < len(SOURCE_NAMES) else str(source)


class Decision(NamedTuple):
    """What the servo shall do, and why."""

    source: int
    duty: int
    cause: str  # the kind of reason: stays the same while the reason's numbers count on
    reason: str
    e_stop_age_s: float  # inf = never heard
    human_age_s: float
    teleop_age_s: float
    planner_age_s: float

    def differs_from(self, other: Decision | None) -> bool:
        """Whether this is another decision, not the same one with older ages."""
        return other is None or self[:3] != other[:3]


class SteeringArbiter:
    """Decides who steers from the newest of each input.

    Locked or no human → neutral; else the gamepad, if it steers; else the planner, if it asks; else neutral. A gamepad
    that was heard once and fell silent or sends nonsense means neutral, not the planner: its owner thinks he steers.
    """

    def __init__(self, config: SteeringConfig):
        self.calibrate(config)
        self._interlock = MotionInterlock(config.interlock)
        self._teleop = TimedInput("tele_steer_req", config.teleop_timeout_s)
        self._planner = TimedInput("av_turnrad_req", config.planner_timeout_s)
        self._slewed_duty: float = config.servo_center
        self._slewed_ns = 0

    def calibrate(self, config: SteeringConfig) -> None:
        """Go by another calibration from now on; timeouts and interlock stay as they were at start.

        Raises:
            ConfigError: naming the parameter; then the one before stays.
        """
        left = LookupTable(config.radius_axis_m, config.left_duties,
                           "m_turnrad_axis_servo", "k_pwmcmd_left_table_servo")
        right = LookupTable(config.radius_axis_m, config.right_duties,
                            "m_turnrad_axis_servo", "k_pwmcmd_right_table_servo")
        self._config, self._left, self._right = config, left, right

    def update_e_stop(self, locked: bool, now_ns: int) -> None:
        """The emergency stop: true = neutral, whoever asks for what."""
        self._interlock.update_e_stop(locked, now_ns)

    def update_human(self, present: bool, now_ns: int) -> None:
        """The deadman: true while a human holds it."""
        self._interlock.update_human(present, now_ns)

    def update_teleop(self, steering: float, now_ns: int) -> None:
        """The gamepad's steering, −1 right to +1 left."""
        self._teleop.update(steering, now_ns)

    def update_planner(self, radius_m: float, now_ns: int) -> None:
        """The planner's turn radius in metres, right negative; 0 = no request."""
        self._planner.update(radius_m, now_ns)

    def mark_stale(self, now_ns: int) -> None:
        """Messages were dropped before they got here: all that was heard is lost."""
        self._interlock.mark_stale(now_ns)
        self._teleop.mark_stale()
        self._planner.mark_stale()

    def decide(self, now_ns: int) -> Decision:
        """Who steers at ``now_ns``, with what duty, and why. With a slew limit the duty depends on the calls before."""
        source, duty, cause, reason = self._rule(now_ns)
        return Decision(source, self._slewed(source, duty, now_ns), cause, reason,
                        self._interlock.e_stop_age_s(now_ns), self._interlock.human_age_s(now_ns),
                        self._teleop.age_s(now_ns), self._planner.age_s(now_ns))

    def _slewed(self, source, duty, now_ns):
        """``duty``, or as far towards it as the limit allows by now; never slower to neutral."""
        now_ns = max(now_ns, self._slewed_ns)
        if source in (TELEOP, PLANNER) and self._config.slew_limit:
            reach = self._config.slew_limit * (now_ns - self._slewed_ns) / NS_PER_S
            duty = max(self._slewed_duty - reach, min(self._slewed_duty + reach, duty))
        self._slewed_duty, self._slewed_ns = duty, now_ns
        return round_half_away(duty)

    def _rule(self, now_ns):
        center = self._config.servo_center
        inhibit = self._interlock.inhibit(now_ns)
        if inhibit is not None:
            return LOCKED if inhibit.locked else NO_HUMAN, center, inhibit.cause, inhibit.reason
        if self._teleop.was_received:
            if self._teleop.is_stale(now_ns):
                return NEUTRAL, center, "teleop silent", self._teleop.stale_reason(now_ns)
            steering = self._teleop.value
            if not math.isfinite(steering):
                return NEUTRAL, center, "teleop not finite", f"tele_steer_req is {steering}, no number to act on"
            if abs(steering - self._config.tele_steer_neutral) > self._config.tele_steer_deadband * FLOAT32_SLACK:
                return TELEOP, self.teleop_duty(steering), "teleop", f"tele_steer_req is {steering:.3f}"
        return self._planner_rule(now_ns)

    def _planner_rule(self, now_ns):
        center = self._config.servo_center
        if not self._planner.was_received:
            return NEUTRAL, center, "no request", "neither tele_steer_req nor av_turnrad_req asks for anything"
        if self._planner.is_stale(now_ns):
            return NEUTRAL, center, "planner silent", self._planner.stale_reason(now_ns)
        radius_m = self._planner.value
        if not math.isfinite(radius_m):
            return NEUTRAL, center, "planner not finite", f"av_turnrad_req is {radius_m}, no number to act on"
        if abs(radius_m) <= NO_RADIUS_M * FLOAT32_SLACK:
            return NEUTRAL, center, "no radius", "av_turnrad_req is 0, which asks for nothing"
        return PLANNER, self.planner_duty(radius_m), "planner", f"av_turnrad_req is {radius_m:.3f} m"

    def teleop_duty(self, steering: float) -> int:
        """The duty for a gamepad request, clamped to −1..1: linear to each side, and each side by its own scale."""
        config = self._config
        steering = max(-1.0, min(1.0, steering))
        side = config.servo_center - config.servo_left if steering > 0 else config.servo_right - config.servo_center
        return round_half_away(config.servo_center - steering * side)

    def planner_duty(self, radius_m: float) -> int:
        """The duty for a turn radius: looked up by magnitude, saturated beyond the axis; the sign picks the table."""
        table = self._left if radius_m > 0 else self._right
        return round_half_away(table(abs(radius_m)))

    def turn_radius_m(self, duty: float) -> float:
        """The turn radius that the tables have for a duty, right negative; inf: straight on, or beyond the axis."""
        config = self._config
        to_the_left = (duty - config.servo_center) * (config.servo_left - config.servo_center) > 0
        table, sign = (self._left, 1) if to_the_left else (self._right, -1)
        towards = 1 if table.values[0] > config.servo_center else -1  # from the center to the tightest turn
        if towards * (duty - config.servo_center) <= 0:
            return math.inf
        if towards * (duty - table.values[0]) >= 0:
            return sign * table.axis[0]
        for radius, wider, tight, wide in zip(table.axis, table.axis[1:], table.values, table.values[1:]):
            if towards * (duty - wide) >= 0:
                return sign * (radius + (wider - radius) * (tight - duty) / (tight - wide))
        return math.inf
