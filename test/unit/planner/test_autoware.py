"""Autoware's Control with its gear. Numbers by hand, wheelbase 0.3 m; gears as autoware_vehicle_msgs counts them."""
from __future__ import annotations

import math

import pytest

from car_interface.common import causes
from car_interface.planner.autoware import from_control
from car_interface.planner.request import PlannerRequest, Refusal

HALF = 0.4636476090008061  # rad, whose tangent is a half
INF, NAN = math.inf, math.nan
NONE, NEUTRAL, DRIVE, DRIVE_18, REVERSE, REVERSE_2, PARK, LOW, LOW_2 = 0, 1, 2, 19, 20, 21, 22, 23, 24


@pytest.mark.parametrize("gear, angle, velocity, acceleration, expected", [
    pytest.param(DRIVE, HALF, 2.0, 1.0, (0.6, 2.0, 1.0, 0.5, 0.0, "drive"), id="drive_left"),
    pytest.param(DRIVE_18, -HALF, 2.0, 1.0, (-0.6, 2.0, 1.0, 0.5, 0.0, "drive"), id="drive_right"),
    pytest.param(LOW, 0.0, 2.0, 0.0, (INF, 2.0, 0.0, 0.5, 0.0, "drive"), id="low_gear_and_as_quickly_as_allowed"),
    pytest.param(LOW_2, 0.0, 0.0, 0.0, (INF, 0.0, 0.0, 0.5, 0.0, "drive"), id="low_gear_at_rest"),
    pytest.param(DRIVE, 0.0, 2.0, -1.0, (INF, 2.0, 1.0, 0.5, 1.0, "drive"), id="negative_acceleration_brakes"),
    pytest.param(DRIVE, 0.0, 0.0, -1.5, (INF, 0.0, 1.5, 0.5, 1.5, "drive"), id="how_autoware_holds_a_stopped_car"),
    pytest.param(DRIVE, 0.0, -0.05, 0.0, (INF, 0.0, 0.0, 0.5, 0.0, "drive"), id="what_a_controller_leaves_of_zero"),
    pytest.param(REVERSE, HALF, -2.0, 1.0, (0.6, -2.0, 1.0, 0.5, 0.0, "reverse"),
                 id="in_reverse_a_positive_acceleration_drives_backward"),
    pytest.param(REVERSE_2, -HALF, -2.0, -1.0, (-0.6, -2.0, 1.0, 0.5, 1.0, "reverse"),
                 id="in_reverse_a_negative_acceleration_brakes"),
    pytest.param(REVERSE, 0.0, 0.05, 0.0, (INF, 0.0, 0.0, 0.5, 0.0, "reverse"), id="reverse_at_rest"),
    pytest.param(None, 0.0, 2.0, 1.0, (INF, 2.0, 1.0, 0.5, 0.0, "drive"), id="no_gear_is_drive"),
    pytest.param(PARK, HALF, 2.0, 1.0, (0.6, 0.0, 0.0, 0.0, 0.0, "park"), id="park_stops"),
    pytest.param(NEUTRAL, HALF, 2.0, 1.0, (0.6, 0.0, 0.0, 0.0, 0.0, "neutral"), id="neutral_coasts"),
])
def test_control_and_gear(gear, angle, velocity, acceleration, expected):
    request = from_control(angle, velocity, acceleration, 0.5, gear, 0.3)
    assert isinstance(request, PlannerRequest)
    assert request.radius_m == pytest.approx(expected[0]) and tuple(request)[1:] == expected[1:]


@pytest.mark.parametrize("gear, velocity, reason", [
    (DRIVE, -1.0, "longitudinal.velocity is -1 m/s in gear DRIVE"),
    (None, -1.0, "longitudinal.velocity is -1 m/s in gear DRIVE, as no gear_cmd was received"),
    (REVERSE, 1.0, "longitudinal.velocity is 1 m/s in gear REVERSE"),
    (NONE, 1.0, "gear_cmd is 0, which is no gear"),
    (99, 1.0, "gear_cmd is 99, which is no gear"),
])
def test_velocity_against_the_gear_and_gears_that_are_none_are_refused(gear, velocity, reason):
    assert from_control(0.0, velocity, 0.0, 0.0, gear, 0.3) == Refusal(causes.REQUEST_REFUSED, reason)


@pytest.mark.parametrize("value", [NAN, INF, -INF])
@pytest.mark.parametrize("index, field", enumerate(["lateral.steering_tire_angle", "longitudinal.velocity",
                                                    "longitudinal.acceleration", "longitudinal.jerk"]))
def test_what_is_no_number_is_refused(index, field, value):
    fields = [0.1, 1.0, 0.0, 0.0]
    fields[index] = value
    assert from_control(*fields, DRIVE, 0.3) == Refusal(
        causes.REQUEST_NOT_FINITE, f"{field} is {value}, no number to act on")


def test_angle_in_degrees_is_refused():
    refusal = from_control(20.0, 1.0, 0.0, 0.0, DRIVE, 0.3)
    assert isinstance(refusal, Refusal) and "(degrees?)" in refusal.reason
