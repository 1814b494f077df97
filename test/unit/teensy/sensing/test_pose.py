"""Dead reckoning: where distances and turns lead, and how uncertain that gets."""

import math
import random

import pytest

from car_interface.teensy.sensing.pose import Pose


def test_there_and_back_is_twice_the_distance():
    pose = Pose(0.02, 0.01)
    pose.move(2.0, 0.0)
    assert (pose.x_m, pose.y_m, pose.yaw_rad, pose.distance_m) == (2.0, 0.0, 0.0, 2.0)
    for sign in (1, -1):
        pose.move(sign * 1.0, sign * 0.4)
    assert (pose.x_m, pose.y_m, pose.yaw_rad) == pytest.approx((2.0, 0.0, 0.0), abs=1e-12)
    assert pose.distance_m == 4.0


def test_quarter_of_a_circle_to_the_left_is_exact_in_one_step():
    pose = Pose(0.0, 0.0)
    pose.move(math.pi / 2, math.pi / 2)  # of radius 1 m
    assert (pose.x_m, pose.y_m) == pytest.approx((1.0, 1.0)) and pose.yaw_rad == math.pi / 2


@pytest.mark.parametrize("steps", [1, 10, 1000])
def test_sigma_of_the_distance_grows_with_its_root_however_it_is_divided(steps):
    pose = Pose(0.02, 0.0)
    for _ in range(steps):
        pose.move(4.0 / steps, 0.0)
    covariance = pose.covariance(0.0, 0.0)
    assert covariance[0][0] == pytest.approx((0.02 * 2) ** 2) and covariance[1][1] == 0.0


def test_uncertain_heading_makes_a_long_straight_uncertain_sideways():
    pose = Pose(0.0, 0.0)
    pose.set_yaw(0.0, 0.01 ** 2)
    pose.move(10.0, 0.0)
    (xx, xy, xa), (yx, yy, ya), (ax, ay, aa) = pose.covariance(0.0, 0.0)
    assert (yy, aa, ya) == pytest.approx((0.1 ** 2, 0.01 ** 2, 0.1 * 0.01), rel=1e-3) and xx < 0.001 ** 2
    assert (xy, xa, ya) == (yx, ax, ay)


def test_heading_that_may_be_off_by_far_makes_the_way_uncertain_along_it_too():
    rng = random.Random(1)
    steps = [(1.0, 0.3, 0.2), (2.0, -0.5, 0.0), (0.5, 1.2, 0.8), (1.5, 0.0, 0.1)]  # m, rad, and rad² before
    pose, off = Pose(0.0, 0.0), [[0.0, 0.0] for _ in range(4000)]
    for distance_m, turned_rad, variance in steps:
        pose.add_variance(0.0, variance)
        pose.move(distance_m, turned_rad)
    for each in off:
        true = Pose(0.0, 0.0)
        for distance_m, turned_rad, variance in steps:
            true.yaw_rad += rng.gauss(0.0, math.sqrt(variance))
            true.move(distance_m, turned_rad)
        each[:] = true.x_m - pose.x_m, true.y_m - pose.y_m
    (xx, _, _), (_, yy, _), _ = pose.covariance(0.0, 0.0)
    true_xx, true_yy = (sum(square ** 2 for square in axis) / len(off) for axis in zip(*off))
    assert true_xx * 0.9 < xx < true_xx * 2 and true_yy * 0.9 < yy < true_yy * 2


def test_variance_along_the_heading_turns_with_it():
    pose = Pose(0.0, 0.0)
    pose.set_yaw(math.pi / 2, 0.0)
    pose.add_variance(0.04, 0.01)
    (xx, _, _), (_, yy, _), (_, _, aa) = pose.covariance(0.0, 0.0)
    assert (xx, yy, aa) == pytest.approx((0.0, 0.04, 0.01))


def test_what_is_unknown_below_a_pulse_does_not_accumulate():
    pose = Pose(0.0, 0.0)
    for _ in range(3):
        covariance = pose.covariance(0.5, 0.25)
    assert [covariance[i][i] for i in range(3)] == [0.5, 0.5, 0.25]
