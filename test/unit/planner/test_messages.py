"""Planners' messages as requests: Ackermann commands, Autoware's Control with its gear, and twists by both conventions.

Numbers by hand, wheelbase 0.3 m. The tangent of 45° is 1 and that of 0.4636476 rad a half, so that the radii are 0.3 m
and 0.6 m. Gears as autoware_vehicle_msgs counts them. Twists by REP-103: x forward, counterclockwise positive. A car
that rolls backward with its wheels to the right turns counterclockwise: its tail swings right, its nose left.
"""
import math

import pytest

from car_interface.common import causes
from car_interface.planner.messages import (
    ANGLE,
    RATE,
    PlannerRequest,
    Refusal,
    clamped_radius,
    from_ackermann,
    from_control,
    from_twist,
    radius_of_angle,
    sane_radius_m,
)

HALF, RIGHT_ANGLE = 0.4636476090008061, math.pi / 2
INF, NAN = math.inf, math.nan
NONE, NEUTRAL, DRIVE, DRIVE_18, REVERSE, REVERSE_2, PARK, LOW, LOW_2 = 0, 1, 2, 19, 20, 21, 22, 23, 24


@pytest.mark.parametrize("angle_rad, radius_m", [
    (0.0, INF), (-0.0, INF), (math.pi / 4, 0.3), (-math.pi / 4, -0.3), (HALF, 0.6), (-HALF, -0.6), (1e-320, INF),
    (1.5707, 0.01)])
@pytest.mark.parametrize("speed_mps", [2.0, -2.0, 0.0])
def test_steering_angle_is_the_wheels_whichever_way_it_drives(angle_rad, radius_m, speed_mps):
    assert radius_of_angle("angle", angle_rad, 0.3) == pytest.approx(radius_m)
    request = (pytest.approx(radius_m), speed_mps, 0.0, 0.0, 0.0, None)
    assert from_ackermann(angle_rad, speed_mps, 0.0, 0.0, 0.3) == request
    assert from_twist(speed_mps, angle_rad, ANGLE, 0.3) == request


@pytest.mark.parametrize("angle_rad", [RIGHT_ANGLE, -RIGHT_ANGLE, 20.0, -90.0])
@pytest.mark.parametrize("field, convert", [
    ("drive.steering_angle", lambda angle_rad: from_ackermann(angle_rad, 1.0, 0.0, 0.0, 0.3)),
    ("lateral.steering_tire_angle", lambda angle_rad: from_control(angle_rad, 1.0, 0.0, 0.0, DRIVE, 0.3)),
    ("angular.z", lambda angle_rad: from_twist(1.0, angle_rad, ANGLE, 0.3)),
])
def test_angle_that_no_wheel_turns_to_is_refused(field, convert, angle_rad):
    assert convert(angle_rad) == Refusal(
        causes.REQUEST_REFUSED, f"{field} of {angle_rad:.3g} rad (degrees?): no wheel turns so far", True)


@pytest.mark.parametrize("value", [NAN, INF, -INF])
@pytest.mark.parametrize("fields, convert", [
    ("drive.steering_angle drive.speed drive.acceleration drive.jerk", lambda *values: from_ackermann(*values, 0.3)),
    ("lateral.steering_tire_angle longitudinal.velocity longitudinal.acceleration longitudinal.jerk",
     lambda *values: from_control(*values, DRIVE, 0.3)),
    ("linear.x angular.z", lambda *values: from_twist(*values, RATE, 0.3)),
    ("linear.x angular.z", lambda *values: from_twist(*values, ANGLE, 0.3)),
], ids=["ackermann", "autoware", "rate", "angle"])
def test_what_is_no_number_is_refused(fields, convert, value):
    names = fields.split()
    for index, name in enumerate(names):
        values = [0.5] * len(names)
        values[index] = value
        assert convert(*values) == Refusal(causes.REQUEST_NOT_FINITE, f"{name} is {value}, no number to act on")


def test_acceleration_and_jerk_of_an_ackermann_command_are_magnitudes():
    assert from_ackermann(0.0, 2.0, 1.5, 4.0, 0.3)[2:4] == (1.5, 4.0)
    assert from_ackermann(0.0, 0.0, -1.5, -4.0, 0.3)[2:] == (1.5, 4.0, 0.0, None)


@pytest.mark.parametrize("gear, angle, velocity, acceleration, expected", [
    (DRIVE, HALF, 2.0, 1.0, (0.6, 2.0, 1.0, 0.5, 0.0, "drive")),
    (DRIVE_18, -HALF, 2.0, 1.0, (-0.6, 2.0, 1.0, 0.5, 0.0, "drive")),
    (LOW, 0.0, 2.0, 0.0, (INF, 2.0, 0.0, 0.5, 0.0, "drive")),
    (LOW_2, 0.0, 0.0, 0.0, (INF, 0.0, 0.0, 0.5, 0.0, "drive")),
    (DRIVE, 0.0, 2.0, -1.0, (INF, 2.0, 1.0, 0.5, 1.0, "drive")),
    (DRIVE, 0.0, 0.0, -1.5, (INF, 0.0, 1.5, 0.5, 1.5, "drive")),  # how Autoware holds a stopped car
    (DRIVE, 0.0, -0.1, 0.0, (INF, 0.0, 0.0, 0.5, 0.0, "drive")),  # what a controller leaves of 0
    (REVERSE, HALF, -2.0, 1.0, (0.6, -2.0, 1.0, 0.5, 0.0, "reverse")),
    (REVERSE_2, -HALF, -2.0, -1.0, (-0.6, -2.0, 1.0, 0.5, 1.0, "reverse")),
    (REVERSE, 0.0, 0.1, 0.0, (INF, 0.0, 0.0, 0.5, 0.0, "reverse")),
    (None, 0.0, 2.0, 1.0, (INF, 2.0, 1.0, 0.5, 0.0, "drive")),
    (PARK, HALF, 2.0, 1.0, (0.6, 0.0, 0.0, 0.0, 0.0, "park")),
    (NEUTRAL, HALF, 2.0, 1.0, (0.6, 0.0, 0.0, 0.0, 0.0, "neutral")),
])
def test_autoware_s_acceleration_is_in_the_direction_of_its_gear(gear, angle, velocity, acceleration, expected):
    request = from_control(angle, velocity, acceleration, 0.5, gear, 0.3)
    assert isinstance(request, PlannerRequest)
    assert request.radius_m == pytest.approx(expected[0]) and tuple(request)[1:] == expected[1:]


@pytest.mark.parametrize("gear, velocity, reason", [
    (DRIVE, -0.11, "longitudinal.velocity is -0.11 m/s in gear DRIVE"),
    (None, -1.0, "longitudinal.velocity is -1 m/s in gear DRIVE, as no gear_cmd was received"),
    (REVERSE, 0.11, "longitudinal.velocity is 0.11 m/s in gear REVERSE"),
    (NONE, 1.0, "gear_cmd is 0, which is no gear"),
    (99, 1.0, "gear_cmd is 99, which is no gear"),
])
def test_velocity_against_the_gear_and_gears_that_are_none_are_refused(gear, velocity, reason):
    assert from_control(0.0, velocity, 0.0, 0.0, gear, 0.3) == Refusal(causes.REQUEST_REFUSED, reason)


@pytest.mark.parametrize("linear_x, angular_z, radius_m", [
    (2.0, 0.5, 4.0), (2.0, -0.5, -4.0), (-2.0, 0.5, -4.0), (-2.0, -0.5, 4.0),
    (2.0, 0.0, INF), (-2.0, -0.0, INF), (2.0, 1e-320, INF), (0.0, 0.0, None), (1e-17, -1e-17, None),
    (0.001, 2.0, 0.01), (0.001, -2.0, -0.01),  # tighter than any car, and still a request
])
def test_rate_of_a_twist_is_speed_by_radius(linear_x, angular_z, radius_m):
    request = from_twist(linear_x, angular_z, RATE, 0.3)
    assert request == (radius_m if radius_m is None else pytest.approx(radius_m), linear_x, 0.0, 0.0, 0.0, None)


@pytest.mark.parametrize("linear_x, angular_z", [(-0.0, -0.5), (1e-12, 3.0), (0.0009, 0.001)])
def test_rate_at_no_speed_is_refused(linear_x, angular_z):
    assert from_twist(linear_x, angular_z, RATE, 0.3) == Refusal(
        causes.REQUEST_REFUSED, f"angular.z is {angular_z:.3g} rad/s at linear.x {linear_x:.3g} m/s: a car can't turn "
        "on the spot")


def test_radius_is_never_so_tight_that_it_means_no_request_and_the_sane_one_is_that_of_1_rad():
    assert [clamped_radius(radius_m) for radius_m in (0.0001, -0.0001, -5.0, -INF)] == [0.01, -0.01, -5.0, -INF]
    assert sane_radius_m(0.3) == radius_of_angle("angle", 1.0, 0.3) == pytest.approx(0.1926, abs=1e-4)
