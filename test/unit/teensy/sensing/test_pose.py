"""Dead reckoning: where distances and turns lead, and how uncertain that gets."""

import math
import random

import pytest

from car_interface.teensy.sensing.pose import Pose, UnseenPath


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
def test_sigmas_of_distance_and_heading_grow_with_the_root_of_the_way_however_it_is_divided(steps):
    pose, turned = Pose(0.02, 0.0), Pose(0.0, 0.01)
    for _ in range(steps):
        pose.move(4.0 / steps, 0.0)
        turned.move(4.0 / steps, 0.0)
    covariance = pose.covariance(0.0, 0.0)
    assert covariance[0][0] == pytest.approx((0.02 * 2) ** 2) and covariance[1][1] == 0.0
    assert turned.covariance(0.0, 0.0)[2][2] == pytest.approx((0.01 * 2) ** 2)


def test_uncertain_heading_makes_a_long_straight_uncertain_sideways():
    pose = Pose(0.0, 0.0)
    pose.add_variance(0.0, 0.01 ** 2)
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
    assert (xx, yy) == pytest.approx((true_xx, true_yy), rel=0.1)


def test_way_and_heading_that_are_off_together_stay_so_on_a_circle():
    rng, path = random.Random(1), UnseenPath(along_variance=0.1, heading_variance=0.3, heading_covariance=0.15)
    steps = [(0.8, 0.9), (1.5, 1.6), (1.5, 1.6)]  # m, rad
    pose, off = Pose(0.0, 0.0), []
    pose.move(*steps[0])
    pose.add_path(path)
    for _ in range(4000):
        one, other = rng.gauss(0.0, 1.0), rng.gauss(0.0, 1.0)
        true = Pose(0.0, 0.0)
        true.move(*steps[0])
        turned = math.sqrt(0.3) * one
        along = 0.15 / math.sqrt(0.3) * one + math.sqrt(0.1 - 0.15 ** 2 / 0.3) * other
        true.move(along, 0.0)
        true.yaw_rad += turned
        for step in steps[1:]:
            true.move(*step)
        off.append(true)
    for step in steps[1:]:
        pose.move(*step)
    (xx, xy, xa), (_, yy, ya), _ = pose.covariance(0.0, 0.0)
    errors = [(true.x_m - pose.x_m, true.y_m - pose.y_m, true.yaw_rad - pose.yaw_rad) for true in off]
    products = zip(*((x * x, x * y, x * a, y * y, y * a) for x, y, a in errors))
    moments = [sum(each) / len(errors) for each in products]
    assert (xx, xy, xa, yy, ya) == pytest.approx(moments, rel=0.1, abs=0.02)


def test_way_that_is_off_by_as_much_as_the_heading_shows_leads_aside_on_what_follows():
    """The way is off by k e along x, then d (exp(i e) − 1) is added: E of x y is k d E e sin(e) = k d v exp(−v / 2)."""
    k_m, v, d_m = 0.5, 0.3, 2.0
    pose = Pose(0.0, 0.0)
    pose.add_path(UnseenPath(along_variance=k_m ** 2 * v, heading_variance=v, heading_covariance=k_m * v))
    pose.move(d_m, 0.0)
    (xx, xy, _), (_, yy, _), _ = pose.covariance(0.0, 0.0)
    assert xy == pytest.approx(k_m * d_m * v * math.exp(-v / 2))
    assert xx + yy == pytest.approx(k_m ** 2 * v + d_m ** 2 * (2 - 2 * math.exp(-v / 2)))


def test_variance_along_the_heading_turns_with_it():
    pose = Pose(0.0, 0.0)
    pose.yaw_rad = math.pi / 2
    pose.add_variance(0.04, 0.01, 0.03, 0.02)  # along it, of it, across it, and of along and across
    (xx, xy, _), (_, yy, _), (_, _, aa) = pose.covariance(0.0, 0.0)
    assert (xx, xy, yy, aa) == pytest.approx((0.03, -0.02, 0.04, 0.01))


def test_what_is_unknown_below_a_pulse_does_not_accumulate():
    pose = Pose(0.0, 0.0)
    for _ in range(3):
        covariance = pose.covariance(0.5, 0.25)
    assert [covariance[i][i] for i in range(3)] == [0.5, 0.5, 0.25]
