"""Twists by both conventions. Numbers by hand; REP-103: x forward, counterclockwise positive.

A car that rolls backward with its wheels to the right turns counterclockwise: its tail swings right, its nose left.
"""
from __future__ import annotations

import math

import pytest

from car_interface.common import causes
from car_interface.planner.request import PlannerRequest, Refusal
from car_interface.planner.twist import ANGLE, RATE, from_twist

HALF = 0.4636476090008061  # rad, whose tangent is a half
INF, NAN = math.inf, math.nan


@pytest.mark.parametrize("linear_x, angular_z, radius_m", [
    pytest.param(2.0, 0.5, 4.0, id="forward_and_counterclockwise_is_to_the_left"),
    pytest.param(2.0, -0.5, -4.0, id="forward_and_clockwise_is_to_the_right"),
    pytest.param(-2.0, 0.5, -4.0, id="backward_and_counterclockwise_is_to_the_right"),
    pytest.param(-2.0, -0.5, 4.0, id="backward_and_clockwise_is_to_the_left"),
    pytest.param(2.0, 0.0, INF, id="straight_on"),
    pytest.param(-2.0, 0.0, INF, id="straight_back"),
    pytest.param(-2.0, -0.0, INF, id="straight_back_with_a_negative_zero"),
    pytest.param(0.0, 0.0, None, id="zero_stops_and_says_nothing_about_the_steering"),
    pytest.param(1e-17, -1e-17, None, id="what_arithmetic_leaves_of_zero"),
    pytest.param(0.001, 2.0, 0.01, id="tighter_than_any_car_is_still_a_request"),
    pytest.param(0.001, -2.0, -0.01, id="and_keeps_its_side"),
    pytest.param(2.0, 1e-320, INF, id="a_rate_of_almost_nothing"),
])
def test_rate_is_speed_by_radius(linear_x, angular_z, radius_m):
    request = from_twist(linear_x, angular_z, RATE, 0.3)
    assert isinstance(request, PlannerRequest) and request.speed_mps == linear_x
    assert request.radius_m == (radius_m if radius_m is None else pytest.approx(radius_m))
    assert request[2:] == (0.0, 0.0, 0.0, None)


@pytest.mark.parametrize("linear_x, angular_z", [(0.0, 0.5), (-0.0, -0.5), (1e-12, 3.0), (0.0009, 0.001)])
def test_rate_at_no_speed_is_refused(linear_x, angular_z):
    refusal = from_twist(linear_x, angular_z, RATE, 0.3)
    assert isinstance(refusal, Refusal) and refusal.cause == causes.REQUEST_REFUSED
    assert refusal.reason == (f"angular.z is {angular_z:.3g} rad/s at linear.x {linear_x:.3g} m/s: a car can't turn on "
                              "the spot")


@pytest.mark.parametrize("linear_x, angular_z, radius_m", [
    pytest.param(2.0, HALF, 0.6, id="forward_left"),
    pytest.param(2.0, -HALF, -0.6, id="forward_right"),
    pytest.param(-2.0, HALF, 0.6, id="backward_left_is_the_same_side_of_the_wheels"),
    pytest.param(-2.0, -HALF, -0.6, id="backward_right"),
    pytest.param(0.0, HALF, 0.6, id="while_it_stands"),
    pytest.param(0.0, 0.0, INF, id="zero"),
])
def test_angle_is_the_wheels_whichever_way_it_drives(linear_x, angular_z, radius_m):
    request = from_twist(linear_x, angular_z, ANGLE, 0.3)
    assert isinstance(request, PlannerRequest)
    assert (request.radius_m, request.speed_mps) == (pytest.approx(radius_m), linear_x)


def test_rate_sent_as_an_angle_is_refused_where_no_wheel_turns_so_far():
    refusal = from_twist(1.0, 2.0, ANGLE, 0.3)
    assert refusal == Refusal(causes.REQUEST_REFUSED,
                              "angular.z of 2 rad (degrees?): no wheel turns so far", True)


@pytest.mark.parametrize("angular", [RATE, ANGLE])
@pytest.mark.parametrize("value", [NAN, INF, -INF])
def test_what_is_no_number_is_refused(value, angular):
    assert from_twist(value, 0.1, angular, 0.3) == Refusal(
        causes.REQUEST_NOT_FINITE, f"linear.x is {value}, no number to act on")
    assert from_twist(1.0, value, angular, 0.3) == Refusal(
        causes.REQUEST_NOT_FINITE, f"angular.z is {value}, no number to act on")
