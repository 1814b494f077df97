"""geometry_msgs/Twist, as move_base and most others publish it on ``cmd_vel``.

linear.x is the speed, backward negative. What angular.z is differs, and nothing in the message says it:

* RATE: the yaw rate, counterclockwise positive (REP-103). The curvature is ω / v: the same ω steers to the left forward
  and to the right backward. At v = 0 there is none, and ω is refused: a car can't turn on the spot.
* ANGLE: the angle of a virtual front wheel, left positive, forward and backward alike, as TEB sends it with
  cmd_angle_instead_rotvel.
"""
from __future__ import annotations

import math

from car_interface.common import causes
from car_interface.planner.request import (
    PlannerRequest,
    Refusal,
    clamped_radius,
    not_finite,
    radius_of_angle,
)

RATE, ANGLE = "rate", "angle"
ANGULAR = (RATE, ANGLE)
# What a planner's arithmetic leaves of a 0, m/s and rad/s.
ZERO = 1e-3


def from_twist(linear_x: float, angular_z: float, angular: str, wheelbase_m: float) -> PlannerRequest | Refusal:
    """What a twist asks for.

    Args:
        linear_x: m/s.
        angular_z: rad/s, or rad with ANGLE.
        angular: RATE or ANGLE.
        wheelbase_m: between the axles.
    """
    refusal = not_finite(linear__x=linear_x, angular__z=angular_z)
    if refusal is not None:
        return refusal
    radius_m = (radius_of_angle("angular.z", angular_z, wheelbase_m) if angular == ANGLE
                else _radius_of_rate(linear_x, angular_z))
    return radius_m if isinstance(radius_m, Refusal) else PlannerRequest(radius_m, linear_x)


def _radius_of_rate(linear_x, angular_z):
    """``None`` for a twist of 0: it stops the car and says nothing about the steering."""
    if abs(linear_x) < ZERO:
        if abs(angular_z) < ZERO:
            return None
        return Refusal(causes.REQUEST_REFUSED, f"angular.z is {angular_z:.3g} rad/s at linear.x {linear_x:.3g} m/s: a "
                       "car can't turn on the spot")
    return clamped_radius(linear_x / angular_z) if angular_z else math.inf
