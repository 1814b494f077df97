"""Heading and curvature, from the wheels' difference and the commanded steering."""

import pytest

from car_interface.teensy.sensing.pose import CURVATURE_NOISE, CURVATURE_VARIANCE, HEADING_VARIANCE, HeadingFilter

STEP_M, STEP_S = 0.015, 0.015


def drive(heading, curvature_per_m, steps, variance=1e-5):
    """A circle, measured exactly at each step."""
    yaw_rad = heading.yaw_rad
    for _ in range(steps):
        heading.predict(STEP_M, STEP_S)
        yaw_rad += curvature_per_m * STEP_M
        heading.update(yaw_rad, variance)
    return yaw_rad


def test_heading_begins_as_certain_as_one_of_1_mrad_and_tells_nothing_of_the_curvature():
    heading = HeadingFilter()
    heading.update(0.004, 0.001 ** 2)
    assert (heading.yaw_rad, heading.curvature_per_m) == (pytest.approx(0.002), 0.0)


def test_heading_that_begins_anew_tells_nothing_of_the_curvature_either():
    heading = HeadingFilter()
    drive(heading, 0.5, 60)
    before = heading.curvature_per_m
    heading.begin(0.0, 0.001 ** 2)
    heading.update(0.004, 0.001 ** 2)
    assert (heading.yaw_rad, heading.curvature_per_m) == (pytest.approx(0.002), before)


def test_unknown_curvature_opens_the_heading_by_its_sigma_times_the_way_however_that_is_divided():
    """After a metre it is as open as what is measured here, and all of what is off comes from the curvature."""
    heading = HeadingFilter()
    for _ in range(2):
        heading.predict(0.5, 0.0)
    heading.update(1.0, CURVATURE_VARIANCE * 1.0 ** 2)
    assert (heading.yaw_rad, heading.curvature_per_m) == pytest.approx((0.5, 0.5), abs=1e-5)


@pytest.mark.parametrize("curvature_per_m", [-1.0, 0.0, 1.2])
def test_curvature_of_a_circle_is_learned_and_predicts_the_heading(curvature_per_m):
    heading = HeadingFilter()
    assert (heading.yaw_rad, heading.curvature_per_m, heading.curvature_variance) == (0.0, 0.0, CURVATURE_VARIANCE)
    yaw_rad = drive(heading, curvature_per_m, 60)
    assert heading.curvature_per_m == pytest.approx(curvature_per_m, abs=0.02)
    heading.predict(0.1, 0.1)
    assert heading.yaw_rad == pytest.approx(yaw_rad + 0.1 * curvature_per_m, abs=0.005)


def test_curvature_gets_uncertain_with_time_up_to_a_bound_while_rolling_and_not_while_it_stands():
    heading = HeadingFilter()
    drive(heading, 0.5, 60)
    before = (heading.yaw_rad, heading.curvature_per_m, heading.curvature_variance)
    heading.predict(0.0, 10.0)
    assert (heading.yaw_rad, heading.curvature_per_m, heading.curvature_variance) == before
    heading.predict(STEP_M, 0.1)
    assert heading.curvature_variance > before[-1]
    heading.predict(STEP_M, 1e6)
    assert heading.curvature_variance == 2 * CURVATURE_VARIANCE


def test_begin_sets_the_heading_forgets_the_variances_and_keeps_the_curvature():
    heading = HeadingFilter()
    drive(heading, 0.5, 60)
    heading.begin(1.0, HEADING_VARIANCE)
    assert heading.yaw_rad == 1.0 and heading.curvature_variance == CURVATURE_VARIANCE
    assert heading.curvature_per_m == pytest.approx(0.5, abs=0.02)
    heading.begin(2.0, 0.01, 0.04)
    assert (heading.yaw_rad, heading.curvature_variance) == (2.0, 0.04)


def test_commanded_curvature_counts_the_more_the_longer_it_lasts_and_nothing_for_no_time():
    none, once, long = HeadingFilter(), HeadingFilter(), HeadingFilter()
    for heading, lasted_s in ((none, 0.0), (once, 0.005), (long, 0.5)):
        heading.update_curvature(1.0, lasted_s)
    assert 0.0 == none.curvature_per_m < once.curvature_per_m < long.curvature_per_m < 1.0
    assert once.curvature_variance > long.curvature_variance


@pytest.mark.parametrize("curvature_per_m, sigma_per_m", [(0.0, 0.05), (1.0, 0.35), (-1.0, 0.35)])
def test_commanded_curvature_is_known_to_0_05_per_m_and_30_percent_after_half_a_second(curvature_per_m, sigma_per_m):
    heading = HeadingFilter()
    heading.update_curvature(curvature_per_m, 0.5)
    assert heading.curvature_variance == pytest.approx(1 / (1 / CURVATURE_VARIANCE + 1 / sigma_per_m ** 2))


def test_commanded_curvature_is_learned_in_the_end():
    heading = HeadingFilter()
    for _ in range(1000):
        heading.update_curvature(1.0, 0.5)
    assert heading.curvature_per_m == pytest.approx(1.0, abs=0.1)


def test_usual_curvature_is_the_largest_of_the_last_metres():
    heading = HeadingFilter()
    drive(heading, 0.8, 60)
    assert heading.usual_square == pytest.approx(0.8 ** 2, abs=0.1)
    drive(heading, 0.0, 20)
    assert heading.usual_square > 0.4 ** 2  # a slalom passes through the middle, too
    drive(heading, 0.0, 800)
    assert heading.usual_square == 0.0


def test_usual_curvature_is_the_mean_of_3_decimetres_and_its_square_fades_over_2_m():
    heading = HeadingFilter()
    heading.curvature_per_m = 0.8
    heading.predict(0.6, 0.6)
    assert (heading.recent_curvature, heading.usual_square) == pytest.approx((0.8, 0.8 ** 2 - CURVATURE_NOISE ** 2))
    heading.curvature_per_m = 0.0
    heading.predict(0.3, 0.3)
    assert heading.recent_curvature == pytest.approx(0.0)
    assert heading.usual_square == pytest.approx(0.8 ** 2 * (1 - 0.3 / 2.0) - CURVATURE_NOISE ** 2)
