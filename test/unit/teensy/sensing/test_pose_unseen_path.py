"""The paths of cars that nobody saw: the true one is within what is claimed, for many that a car can have driven."""

import math
import random

import pytest

from car_interface.teensy.sensing.pose import (
    CURVATURE_NOISE,
    CURVATURE_VARIANCE,
    Pose,
    UnseenPath,
    curved_path,
    reversed_path,
)


def drive(legs):
    """Pose of the end of (distance_m, turned_rad) legs, without variances."""
    pose = Pose(0.0, 0.0)
    for leg in legs:
        pose.move(*leg)
    return pose


def test_curvature_that_stayed_leaves_nothing_open():
    assert curved_path(3.0, 1.5, 0.5, 0.0) == curved_path(0.0, 0.0, 0.5, 0.25)
    assert curved_path(4.0, 0.0, 0.02, 0.0) == curved_path(0.0, 0.0, None, 0.0), "a straight"
    assert curved_path(1.0, 0.1, 0.0, 0.0) == UnseenPath(), "a change of 0.1 1/m is the filter's noise"


@pytest.mark.parametrize("distance_m", [2.0, -2.0], ids=["forward", "backward"])
def test_curve_that_changed_on_the_way_is_within_what_is_claimed(distance_m):
    rng, offs = random.Random(1), []
    while len(offs) < 200:
        before, after, part = rng.uniform(-0.8, 0.8), rng.uniform(-0.8, 0.8), rng.uniform(0.0, 0.9)
        first_m, last_m = part * distance_m, (1 - part) * distance_m
        turned = before * first_m + after * last_m
        if abs(turned / distance_m - before) <= CURVATURE_NOISE:
            continue  # it is not seen to have changed
        path = curved_path(distance_m, turned, before, 0.0)
        leg_m, leg_rad = path.leg
        there = drive([(first_m, before * first_m), (last_m, after * last_m)])
        guess = drive([(leg_m, leg_rad), (distance_m - leg_m, turned - leg_rad)])
        offs.append(math.hypot(there.x_m - guess.x_m, there.y_m - guess.y_m) / math.sqrt(path.across_variance))
    assert sum(off <= 3 for off in offs) >= 198


def test_long_slalom_is_as_uncertain_along_its_way_as_the_average_over_all_that_can_have_been():
    rng, length_m, usual, before, turned = random.Random(3), 8.0, 0.4, 0.3, -0.4
    path, squares = curved_path(length_m, turned, before, usual ** 2), []
    guess = drive([path.leg, (length_m - path.leg[0], turned - path.leg[1])])
    latest = 1 - abs(turned / length_m - before) / 2
    for _ in range(4000):
        part, swing = rng.uniform(0, latest), rng.uniform(-usual, usual)
        legs, begin = [], 0.0
        for until in sorted((part, 0.5, 1.0)):
            curvature = before if until <= part else (turned / length_m - before * part) / (1 - part)
            leg_m = (until - begin) * length_m
            legs.append((leg_m, (curvature + (swing if until <= 0.5 else -swing)) * leg_m))
            begin = until
        end = drive(legs)
        x_m, y_m = end.x_m - guess.x_m, end.y_m - guess.y_m
        squares.append((x_m ** 2, y_m ** 2, x_m * y_m))
    means = [sum(values) / len(squares) for values in zip(*squares)]
    assert (path.along_variance, path.across_variance, path.both_covariance) == pytest.approx(means, rel=0.1)


def test_short_way_into_a_curve_is_open_across_by_where_the_curve_began():
    """A way S that turns by m S, after a straight part u of it, ends m S² (1 − u) / 2 aside; here u is in 0 .. ½."""
    length_m, mean_per_m = 0.01, 1.0
    path = curved_path(length_m, mean_per_m * length_m, 0.0, 0.0)
    assert path.leg == (length_m / 4, 0.0)
    assert path.across_variance == pytest.approx((mean_per_m * length_m ** 2 / 2) ** 2 * 0.5 ** 2 / 12, rel=0.03)


@pytest.mark.parametrize("curvature_per_m", [0.0, None], ids=["straight_before", "stood_before"])
def test_car_that_was_steered_to_both_sides_may_have_gone_on_with_it(curvature_per_m):
    """Half of a short way S with the curvature c and half with −c end c S² / 4 aside; the mean of c² is a third."""
    path = curved_path(0.01, 0.0, curvature_per_m, 0.5 ** 2)
    assert path.across_variance == pytest.approx((0.5 * 0.01 ** 2 / 4) ** 2 / 3, rel=1e-4)
    assert curved_path(3.0, 0.0, curvature_per_m, 0.5 ** 2).across_variance > 0.1


def test_reversals_are_as_uncertain_as_the_average_over_all_that_can_have_been():
    rng, length_m = random.Random(2), 2.0
    sigma = math.sqrt(CURVATURE_VARIANCE)
    ends, known = [], []
    for _ in range(20_000):
        part, forward, back = rng.random(), rng.gauss(0.0, sigma), rng.gauss(0.0, sigma)
        legs = [(part * length_m, forward * part * length_m), ((part - 1) * length_m, back * (part - 1) * length_m)]
        ends.append(((2 * part - 1) * length_m, sum(turn for _, turn in legs)))
        known.append((forward * part + back * (1 - part)) * length_m)
    mean_square = sum(difference ** 2 for difference in known) / len(known)
    path = reversed_path(length_m, math.sqrt(mean_square), False)
    assert path.leg == (0.0, 0.0)
    assert path.along_variance == pytest.approx(sum(along ** 2 for along, _ in ends) / len(ends), rel=0.05)
    assert path.heading_variance == pytest.approx(sum(turn ** 2 for _, turn in ends) / len(ends), rel=0.15)
    together = sum(along * turn * difference for (along, turn), difference in zip(ends, known)) / len(ends)
    assert path.heading_covariance * math.sqrt(mean_square) == pytest.approx(together, rel=0.15)


def test_short_way_with_a_reversal_is_as_uncertain_across_as_the_average_over_all_that_can_have_been():
    rng, length_m, sigma, square = random.Random(2), 0.2, math.sqrt(CURVATURE_VARIANCE), 0.0
    for _ in range(20_000):
        part, forward, back = rng.random(), rng.gauss(0.0, sigma), rng.gauss(0.0, sigma)
        square += drive([(part * length_m, forward * part * length_m),
                         ((part - 1) * length_m, back * (part - 1) * length_m)]).y_m ** 2
    assert reversed_path(length_m, 0.0, False).across_variance == pytest.approx(square / 20_000, rel=0.1)


def test_one_reversal_is_the_likeliest_and_three_are_within_three_sigma():
    path = reversed_path(-1.5, 0.3, True)
    assert path.leg == (-1.5, 0.3)
    assert 3 * math.sqrt(path.along_variance) == pytest.approx(2 * 1.5), "all of it may have been the other way"
    tight = reversed_path(-0.5, 0.6, True)
    assert 0.9 < tight.heading_covariance ** 2 / (tight.along_variance * tight.heading_variance) < 1.0
