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

from car_interface.common import causes
from car_interface.planner.request import (
    DRIVE,
    NEUTRAL,
    PARK,
    REVERSE,
    PlannerRequest,
    Refusal,
    clamped_radius,
    not_finite,
    radius_of_angle,
)

RATE, ANGLE = "rate", "angle"
ANGULAR = (RATE, ANGLE)
ZERO = 1e-3  # m/s, rad/s: a planner's arithmetic may leave this much of a 0
# autoware_vehicle_msgs/GearCommand: NEUTRAL 1, DRIVE 2 and DRIVE_2 to DRIVE_18 up to 19, REVERSE 20, REVERSE_2 21,
# PARK 22, LOW 23, LOW_2 24. 0 is NONE: no gear is commanded.
GEARS = {1: NEUTRAL, **dict.fromkeys(range(2, 20), DRIVE), 20: REVERSE, 21: REVERSE, 22: PARK, 23: DRIVE, 24: DRIVE}
# A velocity against the gear up to this is a stop: a controller may leave this much of a 0.
AGAINST_GEAR_MPS = 0.1


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
