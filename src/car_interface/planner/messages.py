"""Convert planners' messages to requests: Ackermann commands, twists, and Autoware's Control with its gear.

AckermannDrive (ackermann_msgs), as F1TENTH's stacks publish it on ``drive``. By its definition steering_angle is the
angle of a virtual wheel in the middle of the front axle, left positive; speed, acceleration and jerk are measured at
the rear axle. Speed has a sign, backward negative. Acceleration and jerk are magnitudes, for speeding up and slowing
down alike; 0 means as quickly as possible. steering_angle_velocity is not used.

Twist (geometry_msgs), as move_base and most others publish it on ``cmd_vel``. linear.x is the speed, backward negative.
angular.z has one of two meanings, and the message doesn't show which:

* RATE: the yaw rate, counterclockwise positive (REP-103). The curvature is ω / v: the same ω steers to the left forward
  and to the right backward. At v = 0 there is none, and ω is refused: a car can't turn on the spot.
* ANGLE: the angle of a virtual front wheel, left positive, forward and backward alike, as TEB sends it with
  cmd_angle_instead_rotvel.

Control (autoware_control_msgs). steering_tire_angle is the angle of a virtual front wheel, left positive. velocity is
the body's, negative backward; acceleration is in the direction of the gear: in REVERSE a positive one drives backward
faster. A negative one brakes with at least that, regardless of velocity. Its jerk is taken by magnitude. Acceleration
and jerk are used also where the flags is_defined_… are false, as stacks older than the flags leave them: 0 means as
quickly as allowed.
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
RATE, ANGLE = "rate", "angle"
ANGULAR = (RATE, ANGLE)
ZERO = 1e-3  # m/s, rad/s: a planner's arithmetic may leave this much of a 0
# autoware_vehicle_msgs/GearCommand: NEUTRAL 1, DRIVE 2 and DRIVE_2 to DRIVE_18 up to 19, REVERSE 20, REVERSE_2 21,
# PARK 22, LOW 23, LOW_2 24. 0 is NONE: no gear is commanded.
GEARS = {1: NEUTRAL, **dict.fromkeys(range(2, 20), DRIVE), 20: REVERSE, 21: REVERSE, 22: PARK, 23: DRIVE, 24: DRIVE}
# A velocity against the gear up to this is a stop: a controller may leave this much of a 0.
AGAINST_GEAR_MPS = 0.1


class PlannerRequest(NamedTuple):
    """A command that can be obeyed, at the middle of the rear axle."""

    # Left positive, ±inf straight on; ``None`` = as before: a command to stop that has no steering.
    radius_m: float | None
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


def from_ackermann(steering_angle: float, speed: float, acceleration: float, jerk: float, wheelbase_m: float
                   ) -> PlannerRequest | Refusal:
    """Return the request of a drive command; rad, m/s, m/s², m/s³."""
    refusal = not_finite(drive__steering_angle=steering_angle, drive__speed=speed, drive__acceleration=acceleration,
                         drive__jerk=jerk)
    radius_m = refusal or radius_of_angle("drive.steering_angle", steering_angle, wheelbase_m)
    if isinstance(radius_m, Refusal):
        return radius_m
    return PlannerRequest(radius_m, speed, abs(acceleration), abs(jerk))


def from_twist(linear_x: float, angular_z: float, angular: str, wheelbase_m: float) -> PlannerRequest | Refusal:
    """Return the request of a twist; m/s, and rad/s or, where ``angular`` is ANGLE, rad."""
    refusal = not_finite(linear__x=linear_x, angular__z=angular_z)
    if refusal is not None:
        return refusal
    radius_m = (radius_of_angle("angular.z", angular_z, wheelbase_m) if angular == ANGLE
                else _radius_of_rate(linear_x, angular_z))
    return radius_m if isinstance(radius_m, Refusal) else PlannerRequest(radius_m, linear_x)


def _radius_of_rate(linear_x, angular_z):
    """Return the radius; ``None`` for a twist of 0, which stops the car and leaves the steering alone."""
    if abs(linear_x) < ZERO:
        if abs(angular_z) < ZERO:
            return None
        return Refusal(causes.REQUEST_REFUSED, f"angular.z is {angular_z:.3g} rad/s at linear.x {linear_x:.3g} m/s: a "
                       "car can't turn on the spot")
    return clamped_radius(linear_x / angular_z) if angular_z else math.inf


def from_control(steering_tire_angle: float, velocity: float, acceleration: float, jerk: float, gear: int | None,
                 wheelbase_m: float) -> PlannerRequest | Refusal:
    """Return the request of a Control command; rad, m/s, m/s², m/s³.

    ``gear`` is the newest GearCommand's number; ``None`` = there was none: DRIVE.
    """
    refusal = not_finite(lateral__steering_tire_angle=steering_tire_angle, longitudinal__velocity=velocity,
                         longitudinal__acceleration=acceleration, longitudinal__jerk=jerk)
    radius_m = refusal or radius_of_angle("lateral.steering_tire_angle", steering_tire_angle, wheelbase_m)
    if isinstance(radius_m, Refusal):
        return radius_m
    name = DRIVE if gear is None else GEARS.get(gear)
    if name is None:
        return Refusal(causes.REQUEST_REFUSED, f"gear_cmd is {gear}, which is no gear")
    if name in (NEUTRAL, PARK):
        return PlannerRequest(radius_m, 0.0, gear=name)
    against_mps = velocity if name == REVERSE else -velocity
    if against_mps > AGAINST_GEAR_MPS:
        heard = "" if gear is not None else ", as no gear_cmd was received"
        return Refusal(causes.REQUEST_REFUSED,
                       f"longitudinal.velocity is {velocity:.3g} m/s in gear {name.upper()}{heard}")
    speed_mps = 0.0 if against_mps > 0 else velocity
    return PlannerRequest(radius_m, speed_mps, abs(acceleration), abs(jerk), max(0.0, -acceleration), name)


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
