"""Limit what a human or a planner requests: speed, acceleration and braking.

``ThrottleLimiter.limit`` takes an arbitration, and returns the arbitration that the ESC's rules get, with cause and
reason if it was cut. A request is a fraction, not a speed, so a speed is limited by the measured one: from BAND_MPS
below the limit the throttle falls evenly to none at the limit. Above it a planner's car brakes. A human's car rolls,
since a pull that the human hasn't made must not count as one. Accelerations are limited by the value map, and as
accurately as that is.

A stop and neutral are never limited. Pure: ``now_ns`` is passed in.
"""
from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Callable, NamedTuple

from car_interface.common import causes, declared
from car_interface.common.errors import require
from car_interface.common.measured_speed import MeasuredSpeed
from car_interface.throttle.arbiter import PLANNER, STALE, TELEOP, Arbitration
from car_interface.throttle.esc_intention import DRIVE
from car_interface.throttle.value_map import ALLOW_PLATEAUS, ValueMap, load_value_map

BAND_MPS = 0.5  # full throttle is left this far below a limit, and none at it
OVER_MPS = 0.1  # a planner's car brakes from this far above a limit on: less is odometry's noise
BRAKE_PER_MPS = 0.5  # the fraction of the ESC's brake for each m/s above the limit
MIN_BRAKE, MAX_BRAKE = 0.1, 0.5  # more locks a Slash's wheels on smooth floors, and locked wheels don't steer
BACKWARD_MPS = -0.1


@dataclass(frozen=True)
class DriveLimits:
    """Configure the limits of one source; 0 = no limit."""

    max_speed_mps: float = declared.number(
        "max_speed", 0.0, "[limit](limits.md) of the measured speed, forward and backward; 0 = none", "m/s", low=0.0,
        high=100.0)
    max_acceleration_mps2: float = declared.number(
        "max_acceleration", 0.0, "limit by the value map; 0 = none", "m/s²", low=0.0, high=100.0)
    max_braking_mps2: float = declared.number(
        "max_braking", 0.0, "limit by the value map; 0 = none", "m/s²", low=0.0, high=100.0)


@dataclass(frozen=True)
class ThrottleLimits:
    """Configure the limits of each source; without ``value_map`` no acceleration is limited."""

    human: DriveLimits = declared.group(DriveLimits(), "human/")
    planner: DriveLimits = declared.group(DriveLimits(), "planner/")
    slow_down: bool = declared.flag(
        "slow_down", True, "a planner's car that is too fast for the turn that is asked for slows down")
    value_map: ValueMap | None = None
    odometry_timeout_s: float = declared.timeout("odometry_timeout", 0.5, STALE)
    map_path: str | None = declared.path(
        "csv_path_value_map", None, "the value map, for limits of accelerations", default_text="`value_map.csv`")
    allow_plateaus: bool = declared.flag("allow_plateaus", False, ALLOW_PLATEAUS)

    def completed(self, params) -> ThrottleLimits:
        """Return the same with the value map, if an acceleration is limited.

        Raises:
            ConfigError: naming the parameter, or the place in the map's file.
        """
        limited = [(f"{name}/{limit}", value) for name, limits in (("human", self.human), ("planner", self.planner))
                   for limit, value in (("max_acceleration", limits.max_acceleration_mps2),
                                        ("max_braking", limits.max_braking_mps2)) if value]
        if not limited:
            return self
        require(self.map_path is not None, *limited[0],
                "0, or csv_path_value_map, the value map that says what the ESC's duties do")
        return replace(self, value_map=load_value_map(self.map_path, self.allow_plateaus))


class SpeedBound(NamedTuple):
    """A speed that the car may have, with its reason."""

    speed_mps: float
    cause: str  # one of car_interface.common.causes
    words: str  # what allows the speed, to begin a reason with: ``max_speed``
    max_throttle: float = 1.0  # 0..1: the most throttle on the way to that speed
    is_stop: bool = False  # the car exceeds it, and has to stop


class Limited(NamedTuple):
    """An arbitration within the limits, and the limit that cut it."""

    arbitration: Arbitration  # the same object if nothing limits it
    cause: str = ""  # one of car_interface.common.causes; empty: nothing limits it
    reason: str = ""
    max_speed_mps: float = 0.0  # the lowest speed limit in force; 0 = there is none

    @property
    def is_cut(self) -> bool:
        """Return whether less is granted than was requested."""
        return self.cause in causes.THROTTLE_CUTS

    def cut(self, cause: str, reason: str, **changes) -> Limited:
        """Return the same with changes of the arbitration."""
        return self._replace(arbitration=self.arbitration._replace(**changes), cause=cause, reason=reason)


class ThrottleLimiter:
    """Limit one car's throttle."""

    def __init__(self, limits: ThrottleLimits, request_of_value: Callable[[float], float]):
        self.limits = limits
        self.speed = MeasuredSpeed(limits.odometry_timeout_s)
        self.cuts = 0  # how often a limit began to cut the request
        self._is_cut = False
        self._request_of_value = request_of_value

    def limit(self, arbitration: Arbitration, is_reverse: bool, turn_max_mps: float, now_ns: int,
              bound: SpeedBound | None = None) -> Limited:
        """Return what an arbitration is granted.

        Args:
            turn_max_mps: the speed up to which the requested turn is allowed; inf = straight on, 0 = no limit.
            bound: another bound of the speed, in the direction in which the car drives; ``None`` = there is none.
        """
        limited = self._limit(arbitration, is_reverse, turn_max_mps, now_ns, bound)
        if limited.is_cut and not self._is_cut:
            self.cuts += 1
        self._is_cut = limited.is_cut
        return limited

    def _limit(self, arbitration, is_reverse, turn_max_mps, now_ns, bound):
        source = arbitration.source
        if arbitration.is_stop or source not in (TELEOP, PLANNER):
            return Limited(arbitration)
        if bound is not None and bound.is_stop:
            return Limited(arbitration, max_speed_mps=bound.speed_mps).cut(
                bound.cause, f"{self._words(bound)}: it stops", drive=0.0, brake=0.0, is_stop=True)
        limits = self.limits.planner if source == PLANNER else self.limits.human
        bounds = [] if bound is None else [bound]
        if limits.max_speed_mps:
            bounds.append(SpeedBound(limits.max_speed_mps, causes.SPEED_LIMITED, "max_speed"))
        slows_down = turn_max_mps and self.limits.slow_down and source == PLANNER
        if slows_down and turn_max_mps < math.inf:
            bounds.append(SpeedBound(turn_max_mps, causes.CURVE_SLOWED, "the turn that is asked for allows"))
        if not (bounds or slows_down or limits.max_acceleration_mps2 or limits.max_braking_mps2):
            return Limited(arbitration)
        if not self.speed.was_received:
            return Limited(arbitration, causes.LIMITS_OFF, "odom was never heard: nothing limits the throttle")
        limited = Limited(arbitration)
        if bounds:
            limited = self._by_speed(arbitration, min(bounds), is_reverse)
        if (bounds or slows_down) and source == PLANNER and self.speed.is_late(now_ns):
            limited = self._without_speed(limited, now_ns)
        return self._by_map(limited, limits, is_reverse)

    def _by_speed(self, arbitration, bound, is_reverse):
        """Return what the lowest bound of the speed grants: a brake, less throttle, or all of it."""
        speed_mps, max_mps = self.speed.last_mps, bound.speed_mps
        limited = Limited(arbitration, max_speed_mps=max_mps)
        backward = speed_mps <= BACKWARD_MPS
        over_mps = self.speed.magnitude_mps - max_mps
        room = max(0.0, min(bound.max_throttle, -over_mps / BAND_MPS))
        # From standstill this pull may already be reverse.
        may_reverse = is_reverse or backward or speed_mps < -BACKWARD_MPS and arbitration.gear != DRIVE
        drives_on = arbitration.drive > 0 and not backward or arbitration.drive < 0 and may_reverse
        if over_mps > OVER_MPS and not backward and arbitration.source == PLANNER and not is_reverse:
            brake = -min(MAX_BRAKE, max(MIN_BRAKE, over_mps * BRAKE_PER_MPS))
            if brake < arbitration.brake:
                return limited.cut(bound.cause, f"{self._words(bound)}: it brakes", drive=brake, brake=brake)
        if drives_on and abs(arbitration.drive) > room:
            drive = room if arbitration.drive > 0 else -room
            reason = f"{self._words(bound)}: {drive:.2f} instead of {arbitration.drive:.2f}"
            return limited.cut(bound.cause, reason, drive=drive)
        return limited

    def _without_speed(self, limited, now_ns):
        """Return the same without a push, since reports of the speed are missing."""
        if limited.arbitration.drive <= 0:
            return limited
        reason = f"{self.speed.stale_reason(now_ns)}: no throttle until its next report"
        return limited.cut(causes.SPEED_LATE, reason, drive=0.0)

    def _words(self, bound):
        return f"{bound.words} {bound.speed_mps:.2f} m/s, it has {self.speed.magnitude_mps:.2f}"

    def _by_map(self, limited, limits, is_reverse):
        """Return what the limits of acceleration and braking grant, by the value map."""
        arbitration, value_map = limited.arbitration, self.limits.value_map
        if value_map is None:
            return limited
        speed_mps = max(0.0, self.speed.last_mps)
        drives_on = arbitration.drive > 0 or is_reverse or self.speed.last_mps <= BACKWARD_MPS
        if limits.max_acceleration_mps2 and drives_on:
            most = max(0.0, self._request_of_value(value_map.value_at(limits.max_acceleration_mps2, speed_mps)))
            if abs(arbitration.drive) > most:
                drive = most if arbitration.drive > 0 else -most
                reason = f"{limits.max_acceleration_mps2:g} m/s²: {drive:.2f} instead of {arbitration.drive:.2f}"
                limited = limited.cut(causes.ACCELERATION_LIMITED, reason, drive=drive)
        if limits.max_braking_mps2 and arbitration.brake < 0:
            most = min(0.0, self._request_of_value(value_map.value_at(-limits.max_braking_mps2, speed_mps)))
            if arbitration.brake < most:
                reason = f"{limits.max_braking_mps2:g} m/s² of braking: {most:.2f} instead of {arbitration.brake:.2f}"
                limited = limited.cut(causes.BRAKING_LIMITED, reason, brake=most)
        return limited
