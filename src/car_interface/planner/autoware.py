"""Autoware's Control with its gear.

steering_tire_angle is that of a virtual front wheel, left positive. velocity is that of the body, negative backward;
acceleration is in the direction of the gear: in REVERSE a positive one drives backward faster. A negative one brakes
with at least that, whatever velocity says. Its jerk is taken by magnitude. Acceleration and jerk count also where
the flags is_defined_… are false, as stacks older than the flags leave them: 0 means as quickly as allowed.
"""
from __future__ import annotations

from car_interface.common import causes
from car_interface.planner.request import (
    DRIVE,
    NEUTRAL,
    PARK,
    REVERSE,
    PlannerRequest,
    Refusal,
    not_finite,
    radius_of_angle,
)

# autoware_vehicle_msgs/GearCommand: NEUTRAL 1, DRIVE 2 and DRIVE_2 to DRIVE_18 up to 19, REVERSE 20, REVERSE_2 21,
# PARK 22, LOW 23, LOW_2 24. 0 is NONE: no gear is commanded.
GEARS = {1: NEUTRAL, **dict.fromkeys(range(2, 20), DRIVE), 20: REVERSE, 21: REVERSE, 22: PARK, 23: DRIVE, 24: DRIVE}
# A velocity against the gear that is no more than this is a stop: what a controller leaves of a 0.
AGAINST_GEAR_MPS = 0.1


def from_control(steering_tire_angle: float, velocity: float, acceleration: float, jerk: float, gear: int | None,
                 wheelbase_m: float) -> PlannerRequest | Refusal:
    """What a Control command asks for.

    Args:
        steering_tire_angle, velocity, acceleration, jerk: rad, m/s, m/s², m/s³.
        gear: the newest GearCommand's number; ``None`` = there was none: DRIVE.
        wheelbase_m: between the axles.
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
