"""The radius of a steering angle, and refusals of what is no number."""
from __future__ import annotations

import math

import pytest

from car_interface.common import causes
from car_interface.planner.request import Refusal, clamped_radius, not_finite, radius_of_angle

INF, NAN = math.inf, math.nan


@pytest.mark.parametrize("angle_rad, radius_m", [
    pytest.param(0.0, INF, id="straight_on"),
    pytest.param(math.pi / 4, 0.3, id="45_degrees_to_the_left_is_the_wheelbase"),
    pytest.param(-math.pi / 4, -0.3, id="to_the_right_it_is_negative"),
    pytest.param(0.4636476090008061, 0.6, id="an_angle_whose_tangent_is_a_half"),
    pytest.param(-0.4636476090008061, -0.6, id="the_same_to_the_right"),
    pytest.param(1e-320, INF, id="an_angle_of_almost_nothing"),
    pytest.param(1.5707, 0.01, id="almost_a_right_angle_is_not_tighter_than_what_counts_as_a_request"),
])
def test_radius_is_the_wheelbase_by_the_tangent(angle_rad, radius_m):
    assert radius_of_angle("angle", angle_rad, 0.3) == pytest.approx(radius_m)


@pytest.mark.parametrize("angle_rad", [math.pi / 2, -math.pi / 2, 20.0, -90.0])
def test_angle_that_no_wheel_turns_to_is_refused(angle_rad):
    refusal = radius_of_angle("drive.steering_angle", angle_rad, 0.3)
    assert isinstance(refusal, Refusal) and refusal.cause == causes.REQUEST_REFUSED
    assert refusal.reason == f"drive.steering_angle of {angle_rad:.3g} rad (degrees?): no wheel turns so far"
    assert refusal.is_of_angle


@pytest.mark.parametrize("value, text", [(NAN, "nan"), (INF, "inf"), (-INF, "-inf")])
def test_value_that_is_not_finite_is_refused_with_its_field(value, text):
    assert not_finite(drive__speed=1.0, drive__jerk=value) == Refusal(
        causes.REQUEST_NOT_FINITE, f"drive.jerk is {text}, no number to act on")


def test_finite_values_are_not_refused():
    assert not_finite(speed=0.0, jerk=-1e300) is None


def test_radius_is_never_so_tight_that_it_means_no_request():
    assert [clamped_radius(radius_m) for radius_m in (0.0001, -0.0001, -5.0, -INF)] == [0.01, -0.01, -5.0, -INF]
