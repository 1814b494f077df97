"""Limit how tight a car may turn at its speed, and how quickly it may turn in.

Pure: the requested curvature and the measured speed in, the granted curvature and the reason out. A turn that the
wheels can't do is reported, and replaced by the tightest one that they can do. The lateral acceleration of a turn is
v²·|κ|: a limit of it bounds |κ|, and a limit of its rise (jerk) bounds how quickly the car turns in. Steering back to
straight on is never limited.

If no speed was ever received, nothing is limited. When the speed is lost, the last bound stays.
"""
from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from car_interface.common import causes, declared
from car_interface.common.measured_speed import MeasuredSpeed
from car_interface.common.staleness import TimedInput
from car_interface.common.units import NS_PER_S

# A request for a radius below this part of the tightest one is reported. A planner may use its own measurement of the
# tightest turn, or ask for slightly less, so that its controller brings the wheels to their stops.
TIGHT_RATIO = 0.9
# A request that was too tight is reported on /diagnostics, which come once a second, for this long; and a planner whose
# requests swing from side to side, too tight in between, is logged once.
TOO_TIGHT_FOR_NS = 2 * NS_PER_S
# The jerk is averaged over this time: a planner's request comes in steps, of 50 ms at 20 Hz.
JERK_OVER_S = 0.05


@dataclass(frozen=True)
class SourceLimits:
    """What one source may ask of the tyres; 0 = no limit."""

    max_lateral_mps2: float = declared.number(
        "max_lateral_acceleration", 0.0, "[limit](limits.md) of how tight turns may be at the measured speed, 0 = none",
        "m/s²", low=0.0, high=20.0)
    max_jerk_mps3: float = declared.number(
        "max_lateral_jerk", 0.0, "limit of how quickly the car turns in, 0 = none", "m/s³", low=0.0, high=1000.0)

    @property
    def is_off(self) -> bool:
        """Return whether it limits nothing."""
        return not (self.max_lateral_mps2 or self.max_jerk_mps3)


@dataclass(frozen=True)
class SteeringLimits:
    """The limits of the steering, for each source.

    4 m/s² is 0.4 g, half of what rubber holds on a dry floor. Autoware's gate allows 5 m/s² to cars that are wider for
    their height.
    """

    human: SourceLimits = declared.group(SourceLimits(), "human/")
    planner: SourceLimits = declared.group(SourceLimits(max_lateral_mps2=4.0, max_jerk_mps3=40.0), "planner/")
    odometry_timeout_s: float = declared.timeout(
        "odometry_timeout", 0.5, "age at which the speed is lost; the last bound stays")


def too_tight_reason(asked_m: float, slow_m: float, driven_m: float, speed_mps: float) -> str:
    """Return why the wheels can't do a requested turn; empty: they can, or nearly.

    Args:
        asked_m: the requested radius, left positive.
        slow_m, driven_m: the tightest one to that side, driven slowly and at this speed.
    """
    radius_m, side = abs(asked_m), "left" if asked_m > 0 else "right"
    if radius_m < TIGHT_RATIO * slow_m:
        return f"asks for {radius_m:.2f} m, this car turns on {slow_m:.2f} m to the {side}: rad? rad/s? wheelbase?"
    if radius_m < TIGHT_RATIO * driven_m:
        return (f"asks for {radius_m:.2f} m, this car turns on {driven_m:.2f} m to the {side} at "
                f"{abs(speed_mps):.1f} m/s, as its turns widen with speed")
    return ""


TOO_TIGHT_REMEDY = ("See that the planner sends rad or rad/s and not degrees, by the car's wheelbase and by the turns "
                    "that it can do: docs/planners.md")


class Turn(NamedTuple):
    """The granted part of a request to turn."""

    curvature_per_m: float  # exactly the requested one, where nothing limits it
    cause: str = ""  # one of car_interface.common.causes; empty: nothing limits it
    reason: str = ""
    max_speed_mps: float = 0.0  # the highest at which the request is within the limit; inf: straight on; 0 = no limit

    @property
    def is_cut(self) -> bool:
        """Return whether the granted curvature differs from the request."""
        return self.cause in causes.STEERING_CUTS


class SteeringLimiter:
    """Limit one car's turns.

    Attributes:
        cuts: how often a request began to be limited.
        too_tight: why a request was more than the wheels can do, fresh until TOO_TIGHT_FOR_NS after it.
    """

    def __init__(self, limits: SteeringLimits):
        self.speed = MeasuredSpeed(limits.odometry_timeout_s)
        self.cuts = 0
        self._is_cut = False
        self.too_tight = TimedInput("a turn that is too tight", TOO_TIGHT_FOR_NS / NS_PER_S)
        self._granted_per_m = 0.0
        self._granted_ns: int | None = None
        self._credit_mps2 = 0.0  # by which the lateral acceleration may rise at once

    def release(self, curvature_per_m: float, now_ns: int) -> None:
        """Take the present curvature while nobody steers, or a source without limits does."""
        self._granted_per_m, self._granted_ns, self._is_cut = curvature_per_m, now_ns, False
        self._credit_mps2 = math.inf

    def limit(self, curvature_per_m: float, limits: SourceLimits, now_ns: int, too_tight: str = "") -> Turn:
        """Return the turn that is granted to a source that asks for this curvature (1/m, left positive).

        It is no more than the wheels can do; ``too_tight`` says why more was asked for (``too_tight_reason``).
        """
        was_cut, turn = self._is_cut, self._by_speed(curvature_per_m, limits, now_ns)
        if too_tight:
            self.too_tight.update(too_tight, now_ns)
            reason = f"{too_tight}; {turn.reason}" if turn.is_cut else too_tight
            turn = turn._replace(cause=causes.TOO_TIGHT, reason=reason)
        if turn.is_cut and not was_cut:
            self.cuts += 1
        self._is_cut = turn.is_cut
        return turn

    def _by_speed(self, curvature_per_m, limits, now_ns):
        """Return the turn by the limits for the measured speed."""
        if not self.speed.was_received:
            self.release(curvature_per_m, now_ns)
            return Turn(curvature_per_m, causes.LIMITS_OFF, "odom was never heard: nothing limits the steering")
        turn = self._held(self._bounded(curvature_per_m, limits, now_ns), limits, now_ns)
        self._granted_per_m, self._granted_ns = turn.curvature_per_m, now_ns
        return turn

    def _bounded(self, curvature_per_m, limits, now_ns):
        """Return the turn by the limit of the lateral acceleration."""
        limit_mps2, magnitude = limits.max_lateral_mps2, abs(curvature_per_m)
        if not limit_mps2:
            return Turn(curvature_per_m)
        if not magnitude:
            return Turn(curvature_per_m, max_speed_mps=math.inf)
        speed_mps = self.speed.highest_mps(now_ns)
        max_speed_mps = math.sqrt(limit_mps2 / magnitude)
        if speed_mps <= max_speed_mps:
            return Turn(curvature_per_m, max_speed_mps=max_speed_mps)
        bound_per_m = limit_mps2 / (speed_mps * speed_mps)
        reason = (f"{limit_mps2:g} m/s² sideways: at {speed_mps:.1f} m/s no tighter than {1 / bound_per_m:.2f} m, "
                  f"{1 / magnitude:.2f} m was asked for")
        return Turn(math.copysign(bound_per_m, curvature_per_m), causes.LATERAL_LIMITED,
                    reason + self._lost(now_ns), max_speed_mps)

    def _held(self, turn, limits, now_ns):
        """Return the turn by the limit of the jerk."""
        jerk_mps3 = limits.max_jerk_mps3
        if not jerk_mps3:
            return turn
        speed_mps = self.speed.highest_mps(now_ns)
        before, wanted = self._granted_per_m, turn.curvature_per_m
        before = abs(before) if before * wanted > 0 else 0.0
        elapsed_s = 1.0 if self._granted_ns is None else (now_ns - self._granted_ns) / NS_PER_S
        credit_mps2 = min(jerk_mps3 * JERK_OVER_S, self._credit_mps2 + jerk_mps3 * max(0.0, elapsed_s))
        rise_mps2 = (abs(wanted) - before) * speed_mps * speed_mps
        if rise_mps2 <= credit_mps2:
            self._credit_mps2 = credit_mps2 - max(0.0, rise_mps2)
            return turn
        self._credit_mps2 = 0.0
        granted = math.copysign(before + credit_mps2 / (speed_mps * speed_mps), wanted)
        reason = f"{jerk_mps3:g} m/s³ sideways at {speed_mps:.1f} m/s: it turns in more slowly"
        return turn._replace(curvature_per_m=granted, cause=turn.cause or causes.JERK_LIMITED,
                             reason=turn.reason or reason + self._lost(now_ns))

    def _lost(self, now_ns):
        return f"; by the last speed, {self.speed.stale_reason(now_ns)}" if self.speed.is_stale(now_ns) else ""
