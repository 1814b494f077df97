"""The reference speed: limits of acceleration and jerk."""

import itertools

import pytest

from car_interface.throttle.speed_control import SpeedReference

DT_S = 0.02
ROUNDED_JERK = 2 * 20.0 + 1e-6  # to come out exactly at the target the last step may be a double one


def course(begin_mps, target_mps, seconds=3.0, acceleration=2.0, braking=3.0, jerk=20.0):
    reference = SpeedReference()
    reference.reset(begin_mps)
    speeds = [begin_mps]
    for _ in range(round(seconds / DT_S)):
        reference.step(target_mps, acceleration, braking, jerk, DT_S)
        speeds.append(reference.speed_mps)
    return speeds


def differences(values):
    return [(after - before) / DT_S for before, after in zip(values, values[1:])]


def reached_s(speeds, target_mps):
    return next(index for index, speed in enumerate(speeds) if abs(speed - target_mps) < 1e-9) * DT_S


@pytest.mark.parametrize("begin, target, limits, takes_s", [
    (0.0, 3.0, {"jerk": 1e9}, 1.5),
    (3.0, 0.0, {"jerk": 1e9}, 1.0),
    (0.0, 3.0, {}, 1.6),  # the jerk adds the time that the acceleration takes to rise
    (0.0, 3.0, {"acceleration": 1.0, "jerk": 1e9}, 3.0),
])
def test_change_takes_the_time_that_the_limits_allow(begin, target, limits, takes_s):
    assert reached_s(course(begin, target, 4.0, **limits), target) == pytest.approx(takes_s, abs=0.1)


@pytest.mark.parametrize("begin, target", list(itertools.product((0.0, 0.3, 3.0), repeat=2)))
def test_limits_hold_and_the_target_is_neither_overshot_nor_left(begin, target):
    speeds = course(begin, target)
    assert speeds[-1] == target and min(speeds) >= min(begin, target) and max(speeds) <= max(begin, target)
    accelerations = differences(speeds)
    assert max(accelerations) <= 2.0 + 1e-9 and min(accelerations) >= -3.0 - 1e-9
    assert max(map(abs, differences(accelerations))) <= ROUNDED_JERK


def test_target_that_changes_on_the_way_is_followed_within_the_limits_until_it_begins_again():
    reference = SpeedReference()
    reference.step(3.0, 2.0, 3.0, 20.0, 0.0)
    assert (reference.speed_mps, reference.acceleration_mps2) == (0.0, 0.0)  # no time has passed
    accelerations = []
    for target in [3.0] * 30 + [0.5] * 100:
        reference.step(target, 2.0, 3.0, 20.0, DT_S)
        accelerations.append(reference.acceleration_mps2)
    assert reference.speed_mps == 0.5
    assert max(map(abs, differences(accelerations))) <= ROUNDED_JERK
    reference.step(3.0, 2.0, 3.0, 20.0, DT_S)
    reference.reset(-0.2)
    assert (reference.speed_mps, reference.acceleration_mps2) == (0.0, 0.0)
