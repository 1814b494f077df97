"""ackermann_msgs/AckermannDrive, as F1TENTH's stacks publish it on ``drive``.

By its definition: steering_angle is that of a virtual wheel in the middle of the front axle, left positive; speed,
acceleration and jerk are those of the rear axle. Speed has a sign, backward negative. Acceleration and jerk are
magnitudes, for speeding up and slowing down alike; 0 means as quickly as possible. steering_angle_velocity is not used.
"""
from __future__ import annotations

from car_interface.planner.request import PlannerRequest, Refusal, not_finite, radius_of_angle


def from_ackermann(steering_angle: float, speed: float, acceleration: float, jerk: float, wheelbase_m: float
                   ) -> PlannerRequest | Refusal:
    """What a drive command asks for; rad, m/s, m/s², m/s³."""
    refusal = not_finite(drive__steering_angle=steering_angle, drive__speed=speed, drive__acceleration=acceleration,
                         drive__jerk=jerk)
    radius_m = refusal or radius_of_angle("drive.steering_angle", steering_angle, wheelbase_m)
    if isinstance(radius_m, Refusal):
        return radius_m
    return PlannerRequest(radius_m, speed, abs(acceleration), abs(jerk))
