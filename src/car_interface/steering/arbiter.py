"""Decide who steers, and with what duty.

Consumes emergency stop, deadman, the gamepad's steering and the planner's turn radius or steering, each with its
arrival on the monotonic clock, and answers with a ``Decision``: source, duty, cause and reason. Pure: ``now_ns`` is
passed in. An input that stops arriving never grants control; it takes it away.

Steering −1 is right and +1 left; a turn radius is in metres, right negative; a duty is 0..65535 of the PWM period.
"""
from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from car_interface.common import causes, declared
from car_interface.common.lookup_table import round_half_away
from car_interface.common.sources import LOCKED, NEUTRAL, NO_HUMAN, PLANNER, TELEOP
from car_interface.common.staleness import TimedInput
from car_interface.common.units import NS_PER_S
from car_interface.interlock.motion_interlock import InterlockConfig, MotionInterlock
from car_interface.steering.calibration import SteeringCalibration
from car_interface.steering.limits import SteeringLimiter, SteeringLimits, too_tight_reason

MAX_SLEW_LIMIT = 1e9  # duty per second: from end to end within a timer period, many times over
NO_RADIUS_M = 0.001  # a requested radius this close to 0 means "no request", as in the original
FLOAT32_TOLERANCE = 1 + 2 ** -23  # 0.001 arrives from a Float32 as 0.001000000047


@dataclass(frozen=True)
class SteeringArbiterConfig:
    """The rules of who steers."""

    tele_steer_neutral: float = declared.number(
        "tele_steer_neutral", 0.0, 'the gamepad\'s request that means "not steering"; 0.5 for an old 0..1 stack',
        low=-1, high=1)
    tele_steer_deadband: float = declared.number(
        "tele_steer_deadband", 0.001, "requests this near to it mean the same", low=0, high=1)
    slew_limit: float = declared.number(
        "slew_limit", 0.0, "rate limit for gamepad and planner, 0 = none; never slows the return to neutral", "duty/s",
        low=0, high=MAX_SLEW_LIMIT)
    interlock: InterlockConfig = declared.group(InterlockConfig(), same_as={"human_timeout": "input_timeout"})
    limits: SteeringLimits = declared.group(SteeringLimits())
    input_timeout_s: float = declared.timeout(
        "input_timeout", 0.5, "sets the timeouts that name it")
    teleop_timeout_s: float = declared.timeout(
        "teleop_timeout", 0.5, "age at which the requests are stale", same_as="input_timeout")
    planner_timeout_s: float = declared.timeout(
        "planner_timeout", 0.5, "age at which the requests are stale", same_as="input_timeout")


class Decision(NamedTuple):
    """The duty for the servo, and why."""

    source: int
    duty: int
    cause: str  # one of car_interface.common.causes
    reason: str
    e_stop_age_s: float  # inf = never received
    human_age_s: float
    teleop_age_s: float
    planner_age_s: float
    limit: str = ""  # the cause of a limit that changes the request, or causes.LIMITS_OFF
    limit_reason: str = ""
    asked_radius_m: float = 0.0  # right negative, inf: straight on; 0 = no request, or its source has no limits
    max_speed_mps: float = 0.0  # the highest at which that keeps within the limit; inf: straight on; 0 = no limit

    @property
    def differs_by(self) -> tuple:
        """Return all but ages, and numbers in reasons, which always differ."""
        return (*self[:3], self.limit)

    @property
    def kind(self) -> tuple:
        """Return who steers and why, and what limits that: what a log reports when it changes."""
        return self.source, self.cause, self.limit


class SteeringArbiter(MotionInterlock):
    """Decide who steers from the newest of each input.

    Locked or no human → neutral; else the gamepad, if it steers; else the planner, if it requests a radius; else
    neutral. A gamepad that was received once and is stale or not finite means neutral, not the planner: the human may
    think that they are steering. So does one that was never received while teleop_logi runs. A planner asks by radius
    or by steering: while both are fresh neither is obeyed.

    From the first ``explain_human`` on the planner steers only once the gamepad's steering was received, too.

    Attributes:
        limiter: its speed takes odometry's, forward positive.
        overrides: the gamepad overrides the planner, by teleop_logi; it is quoted in a reason as long as what that
            explained is fresh.
        planner_explanation: why no planner is heard; only quoted in the reason while none ever was. Empty = nobody
            knows.
    """

    def __init__(self, calibration: SteeringCalibration, config: SteeringArbiterConfig = SteeringArbiterConfig()):
        super().__init__(config.interlock)
        self._calibration, self._steering_config = calibration, config
        self._teleop = TimedInput("tele_steer_req", config.teleop_timeout_s)
        self.overrides = False
        self._planner = TimedInput("av_turnrad_req", config.planner_timeout_s)
        self._planner_steering = TimedInput("av_steer_req", config.planner_timeout_s)
        self.planner_explanation = ""
        self.limiter = SteeringLimiter(config.limits)
        self._sources = {TELEOP: config.limits.human, PLANNER: config.limits.planner}
        # Duty (None: nobody steered) and time of the newest decision, if no limit held for it.
        self._unlimited: tuple[int | None, int] | None = None
        self._slewed_duty: float = calibration.servo_center
        self._slewed_ns = 0

    def calibrate(self, calibration: SteeringCalibration) -> None:
        """Use another calibration from now on."""
        self._calibration = calibration

    def update_teleop(self, steering: float, now_ns: int) -> None:
        """Take the gamepad's steering, −1 right to +1 left."""
        self._teleop.update(steering, now_ns)

    def update_planner(self, radius_m: float, now_ns: int) -> None:
        """Take the planner's turn radius in metres, right negative; ±inf = straight on, 0 = no request."""
        self._planner.update(radius_m, now_ns)

    def update_planner_steering(self, steering: float, now_ns: int) -> None:
        """Take the steering of a planner that sends no radius, −1 right to +1 left."""
        self._planner_steering.update(steering, now_ns)

    def turn_radius_m(self, duty: float) -> float:
        """Return the radius on which a duty turns at the newest speed, right negative; inf = straight ahead."""
        return self._calibration.turn_radius_m(duty, self._known_speed_mps)

    def mark_stale(self, now_ns: int) -> None:
        """Take note that messages were dropped before they got here: all inputs are stale."""
        super().mark_stale(now_ns)
        self.limiter.speed.mark_stale()
        self._teleop.mark_stale()
        self._planner.mark_stale()
        self._planner_steering.mark_stale()

    def decide(self, now_ns: int) -> Decision:
        """Return who steers at ``now_ns``, with what duty, and why. With a slew limit earlier calls affect the duty."""
        source, duty, cause, reason = self._arbitrate(now_ns)
        limits = self._sources.get(source)
        ages_s = (self._e_stop.age_s(now_ns), self._human.age_s(now_ns), self._teleop.age_s(now_ns),
                  min(self._planner.age_s(now_ns), self._planner_steering.age_s(now_ns)))
        # 0: another source steers, or the planner sent a steering.
        requested_m = self._planner.value if source == PLANNER and not self._planner.is_stale(now_ns) else 0.0
        too_tight = self._too_tight(requested_m)
        if limits is None or limits.is_off and not too_tight:
            self._unlimited = None if limits is None else duty, now_ns
            return Decision(source, self._slewed(source, duty, now_ns), cause, reason, *ages_s)
        if self._unlimited is not None:  # computed only now, when a limit needs it
            before, at_ns = self._unlimited
            self.limiter.release(0.0 if before is None else 1.0 / self.turn_radius_m(before), at_ns)
            self._unlimited = None
        asked_m = requested_m or self.turn_radius_m(duty)
        # Of a turn that is too tight the wheels do the tightest one, driven slowly.
        possible_m = max(abs(asked_m), self._calibration.tightest_radius_m(asked_m))
        turn = self.limiter.limit(math.copysign(1.0 / possible_m, asked_m), limits, now_ns, too_tight)
        if turn.is_cut:
            radius_m = 1.0 / turn.curvature_per_m if turn.curvature_per_m else math.inf
            duty = self._calibration.planner_duty(radius_m, self._known_speed_mps)
        return Decision(source, self._slewed(source, duty, now_ns), cause, reason, *ages_s, turn.cause, turn.reason,
                        asked_m, turn.max_speed_mps)

    def _too_tight(self, radius_m):
        """Return why the wheels can't do a requested radius; empty: they can, or none is requested."""
        if not radius_m or math.isinf(radius_m):
            return ""
        speed_mps = self._known_speed_mps
        return too_tight_reason(radius_m, self._calibration.tightest_radius_m(radius_m),
                                self._calibration.tightest_radius_m(radius_m, speed_mps), speed_mps)

    @property
    def _known_speed_mps(self):
        """Return the newest speed; 0: none was ever received."""
        return self.limiter.speed.last_mps if self.limiter.speed.was_received else 0.0

    def _slewed(self, source, duty, now_ns):
        """Return ``duty``, or as near to it as the slew limit allows by now. Neutral isn't limited."""
        now_ns = max(now_ns, self._slewed_ns)
        if source in (TELEOP, PLANNER) and self._steering_config.slew_limit:
            max_step = self._steering_config.slew_limit * (now_ns - self._slewed_ns) / NS_PER_S
            duty = max(self._slewed_duty - max_step, min(self._slewed_duty + max_step, duty))
        self._slewed_duty, self._slewed_ns = duty, now_ns
        return round_half_away(duty)

    def _arbitrate(self, now_ns):
        center = self._calibration.servo_center
        inhibit = self.inhibit(now_ns)
        if inhibit is not None:
            return LOCKED if inhibit.locked else NO_HUMAN, center, inhibit.cause, inhibit.reason
        if self._teleop.was_received:
            if self._teleop.is_stale(now_ns):
                return NEUTRAL, center, causes.TELEOP_STALE, self._teleop.stale_reason(now_ns)
            steering = self._teleop.value
            if not math.isfinite(steering):
                return (NEUTRAL, center, causes.TELEOP_NOT_FINITE,
                        f"tele_steer_req is {steering}, no number to act on")
            deadband = self._steering_config.tele_steer_deadband * FLOAT32_TOLERANCE
            if abs(steering - self._steering_config.tele_steer_neutral) > deadband:
                overrides = not self._explanation.is_stale(now_ns) and self.overrides
                return (TELEOP, self._calibration.teleop_duty(steering), causes.TELEOP,
                        f"tele_steer_req is {steering:.3f}{': it overrides the planner' if overrides else ''}")
        elif self._explanation.was_received:  # the mode may be one in which the human steers
            return NEUTRAL, center, causes.TELEOP_STALE, "tele_steer_req was never heard, though teleop_logi runs"
        return self._arbitrate_planner(now_ns)

    def _arbitrate_planner(self, now_ns):
        center = self._calibration.servo_center
        radius, steering = self._planner, self._planner_steering
        received = [timed for timed in (radius, steering) if timed.was_received]
        fresh = [timed for timed in received if not timed.is_stale(now_ns)]
        if not received:
            return (NEUTRAL, center, causes.NO_REQUEST,
                    self.planner_explanation or "neither tele_steer_req nor av_turnrad_req asks for anything")
        if not fresh:
            newest = min(received, key=lambda timed: timed.age_s(now_ns))
            return NEUTRAL, center, causes.PLANNER_STALE, newest.stale_reason(now_ns)
        if len(fresh) > 1:
            return (NEUTRAL, center, causes.TWO_REQUESTS,
                    "av_turnrad_req and av_steer_req are both published: neither is obeyed")
        value = fresh[0].value
        if math.isnan(value) or fresh[0] is steering and math.isinf(value):
            return NEUTRAL, center, causes.PLANNER_NOT_FINITE, f"{fresh[0].name} is {value}, no number to act on"
        return self._by_steering(value) if fresh[0] is steering else self._by_radius(value)

    def _by_steering(self, steering):
        return PLANNER, self._calibration.teleop_duty(steering), causes.PLANNER, f"av_steer_req is {steering:.3f}"

    def _by_radius(self, radius_m):
        center = self._calibration.servo_center
        if math.isinf(radius_m):
            return PLANNER, center, causes.PLANNER, f"av_turnrad_req is {radius_m}: straight on"
        if abs(radius_m) <= NO_RADIUS_M * FLOAT32_TOLERANCE:
            return NEUTRAL, center, causes.NO_RADIUS, "av_turnrad_req is 0, which asks for nothing"
        return (PLANNER, self._calibration.planner_duty(radius_m, self._known_speed_mps), causes.PLANNER,
                f"av_turnrad_req is {radius_m:.3f} m")
