"""The request of a planner, whatever message it sends: a turn radius, a speed, how quickly, and a gear.

Turn radius and speed are measured at the middle of the rear axle: metres, left positive, ±inf straight on; m/s, forward
positive. Pure.
"""
from __future__ import annotations

import math
from typing import NamedTuple

from car_interface.common import causes

DRIVE, REVERSE, NEUTRAL, PARK = "drive", "reverse", "neutral", "park"
# The tightest radius that is passed on. turn_arb takes a radius up to 0.001 m for no request, and saturates this one.
MIN_RADIUS_M = 0.01
# After a planner sent a right angle or more, smaller angles up to this one show that it sends radians now. The wheels
# of cars turn by 0.4 to 0.8 rad, the wheels of crawlers by 0.9.
MAX_SANE_RAD = 1.0


class PlannerRequest(NamedTuple):
    """A command that can be obeyed."""

    radius_m: float | None  # ``None`` = as before: a command to stop that has no steering
    speed_mps: float  # backward negative
    acceleration_mps2: float = 0.0  # how quickly the speed may change, 0 or more; 0 = as quickly as allowed
    jerk_mps3: float = 0.0  # how quickly that may change, 0 or more; 0 = as quickly as allowed
    braking_mps2: float = 0.0  # brake with at least this, regardless of the speed; 0 or more
    gear: str | None = None  # DRIVE, REVERSE, NEUTRAL or PARK; ``None`` = by the sign of the speed


class Refusal(NamedTuple):
    """The reason why a command isn't obeyed. The car stops while it lasts."""

    cause: str  # one of car_interface.common.causes
    reason: str
    is_of_angle: bool = False  # the planner's units are wrong: its next commands aren't obeyed at once


def not_finite(**values: float) -> Refusal | None:
    """Return a refusal of the first value that is not finite, or ``None``. Names are fields, with ``__`` for dots."""
    for name, value in values.items():
        if not math.isfinite(value):
            return Refusal(causes.REQUEST_NOT_FINITE, f"{name.replace('__', '.')} is {value}, no number to act on")
    return None


def radius_of_angle(name: str, angle_rad: float, wheelbase_m: float) -> float | Refusal:
    """Return the turn radius for the angle of a virtual front wheel in the middle of the front axle, left positive.

    The angle is finite. A right angle or more is refused, by the field's name: it is likely in degrees.
    """
    if abs(angle_rad) >= math.pi / 2:
        return Refusal(causes.REQUEST_REFUSED,
                       f"{name} of {angle_rad:.3g} rad (degrees?): no wheel turns so far", True)
    slope = math.tan(angle_rad)
    return clamped_radius(wheelbase_m / slope if slope else math.inf)


def sane_radius_m(wheelbase_m: float) -> float:
    """Return the turn radius of the largest angle that a wheel can have."""
    return wheelbase_m / math.tan(MAX_SANE_RAD)


def clamped_radius(radius_m: float) -> float:
    """Return the radius, widened where it is so tight that it would mean "no request"."""
    return math.copysign(max(MIN_RADIUS_M, abs(radius_m)), radius_m)
