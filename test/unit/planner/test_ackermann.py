"""Ackermann commands, by the definition of ackermann_msgs/AckermannDrive. Numbers by hand, wheelbase 0.3 m.

The tangent of 45° is 1 and that of 0.4636476 rad a half, so that the radii are 0.3 m and 0.6 m.
"""
from __future__ import annotations

import math

import pytest

from car_interface.common import causes
from car_interface.planner.ackermann import from_ackermann
from car_interface.planner.request import PlannerRequest, Refusal

HALF = 0.4636476090008061
INF, NAN = math.inf, math.nan


@pytest.mark.parametrize("angle, speed, radius_m", [
    pytest.param(HALF, 2.0, 0.6, id="left_forward"),
    pytest.param(-HALF, 2.0, -0.6, id="right_forward"),
    pytest.param(HALF, -2.0, 0.6, id="left_backward_the_wheels_point_to_the_left_as_well"),
    pytest.param(-HALF, -2.0, -0.6, id="right_backward"),
    pytest.param(math.pi / 4, 0.0, 0.3, id="wheels_turn_while_it_stands"),
    pytest.param(0.0, 2.0, INF, id="straight_on"),
    pytest.param(-0.0, -2.0, INF, id="straight_back"),
    pytest.param(0.0, 0.0, INF, id="zero_stops_straight_on"),
])
def test_steering_angle_is_the_wheels_whichever_way_it_drives(angle, speed, radius_m):
    request = from_ackermann(angle, speed, 0.0, 0.0, 0.3)
    assert isinstance(request, PlannerRequest)
    assert (request.radius_m, request.speed_mps) == (pytest.approx(radius_m), speed)
    assert request[2:] == (0.0, 0.0, 0.0, None)


def test_acceleration_and_jerk_are_magnitudes():
    assert from_ackermann(0.0, 2.0, 1.5, 4.0, 0.3)[2:4] == (1.5, 4.0)
    assert from_ackermann(0.0, 0.0, -1.5, -4.0, 0.3)[2:] == (1.5, 4.0, 0.0, None)


@pytest.mark.parametrize("value", [NAN, INF, -INF])
@pytest.mark.parametrize("index, field", enumerate(["steering_angle", "speed", "acceleration", "jerk"]))
def test_what_is_no_number_is_refused(index, field, value):
    fields = [0.1, 1.0, 0.0, 0.0]
    fields[index] = value
    assert from_ackermann(*fields, 0.3) == Refusal(
        causes.REQUEST_NOT_FINITE, f"drive.{field} is {value}, no number to act on")


def test_angle_in_degrees_is_refused():
    refusal = from_ackermann(20.0, 1.0, 0.0, 0.0, 0.3)
    assert isinstance(refusal, Refusal) and "(degrees?)" in refusal.reason
