"""How fast a car may get, how quickly, and how hard it may brake."""
import math
import time

import pytest

from car_interface.common import causes
from car_interface.common.errors import ConfigError
from car_interface.common.params import Params
from car_interface.steering.arbiter import NEUTRAL, PLANNER, TELEOP
from car_interface.throttle.arbiter import Arbitration
from car_interface.throttle.limits import DriveLimits, SpeedBound, ThrottleLimiter, ThrottleLimits, read_limits
from car_interface.throttle.value_map import ValueMap

S = 1_000_000_000
# Acceleration is twice the value; the ESC's whole range are the values of -5 and 3.
MAP = ValueMap([-5.0, 0.0, 3.0], [0.0, 10.0], [[-10.0, -10.0], [0.0, 0.0], [6.0, 6.0]])


def asked(request, source=PLANNER, stops=False):
    return Arbitration(source, causes.PLANNER, "", request, request, request, stops)


NO_LIMITS = DriveLimits()


def limiter_at(speed_mps, planner=NO_LIMITS, human=NO_LIMITS, **limits):
    limiter = ThrottleLimiter(ThrottleLimits(planner=planner, human=human, **limits),
                              lambda value: value / 3.0 if value > 0 else value / 5.0)
    if speed_mps is not None:
        limiter.speed.update(speed_mps, 0)
    return limiter


def limited(limiter, request, source=PLANNER, is_reverse=False, turn_max_mps=0.0, bounds=()):
    return limiter.limit(asked(request, source), is_reverse, turn_max_mps, S // 10, bounds)


TO_3 = DriveLimits(max_speed_mps=3.0)


@pytest.mark.parametrize(("speed_mps", "request_", "granted"), [
    (2.4, 1.0, 1.0), (2.75, 1.0, 0.5), (2.75, 0.5, 0.5), (3.0, 1.0, 0.0), (3.05, 1.0, 0.0)])
def test_towards_max_speed_the_throttle_is_taken_away_evenly_and_the_reason_says_so(speed_mps, request_, granted):
    answer = limited(limiter_at(speed_mps, TO_3), request_)
    assert answer.arbitration.drive == pytest.approx(granted)
    assert answer.is_cut == (granted != request_) and answer.max_speed_mps == 3.0
    if answer.is_cut:
        assert (answer.cause, answer.reason) == (
            causes.SPEED_LIMITED, f"max_speed 3.00 m/s, it has {speed_mps:.2f}: {granted:.2f} instead of 1.00")


def test_below_the_limits_the_very_same_arbitration_comes_back():
    limiter = limiter_at(1.0, DriveLimits(3.0, 6.0, 10.0), value_map=MAP)
    for request in (0.3, 0.0, -0.3):
        one = asked(request)
        assert limiter.limit(one, False, 2.5, S // 10).arbitration is one


def test_a_planner_s_car_beyond_it_brakes_the_more_the_faster_it_is():
    slightly, much = (limited(limiter_at(speed_mps, TO_3), 1.0) for speed_mps in (3.2, 6.0))
    assert slightly.arbitration.drive == slightly.arbitration.brake == pytest.approx(-0.1)
    assert much.arbitration.drive == much.arbitration.brake == -0.5
    assert much.reason == "max_speed 3.00 m/s, it has 6.00: it brakes"
    for request in (-0.5, -0.8):  # of one that brakes as hard itself
        answer = limited(limiter_at(6.0, TO_3), request)
        assert answer.arbitration.brake == request and not answer.is_cut


def test_a_human_s_car_beyond_it_rolls_and_each_source_has_limits_of_its_own():
    answer = limited(limiter_at(6.0, human=TO_3), 1.0, TELEOP)
    assert answer.arbitration.drive == 0.0 and answer.is_cut
    assert limited(limiter_at(6.0, human=TO_3), 0.0, TELEOP).arbitration.drive == 0.0
    assert not limited(limiter_at(6.0, human=TO_3), 1.0, PLANNER).is_cut
    assert not limited(limiter_at(6.0, planner=TO_3), 1.0, TELEOP).is_cut


@pytest.mark.parametrize(("speed_mps", "is_reverse", "granted"), [
    (-1.0, True, -1.0), (-2.75, True, -0.5), (-3.5, True, 0.0), (-2.75, False, -0.5), (2.75, False, -1.0)])
def test_backward_the_same_speed_holds(speed_mps, is_reverse, granted):
    answer = limited(limiter_at(speed_mps, TO_3), -1.0, is_reverse=is_reverse)
    assert answer.arbitration.drive == pytest.approx(granted)
    assert answer.arbitration.brake == -1.0


@pytest.mark.parametrize(("speed_mps", "granted"), [(0.0, 0.0), (-0.09, 0.0), (-0.11, 1.0)])
def test_a_car_that_rolls_backward_by_less_than_odometry_s_noise_counts_as_standing(speed_mps, granted):
    bound = SpeedBound(0.0, causes.OBSTACLE_SLOWED, "an obstacle allows")
    assert limited(limiter_at(speed_mps), 1.0, TELEOP, bounds=[bound]).arbitration.drive == granted


def test_a_push_forward_that_brakes_a_car_rolling_backward_is_never_taken_away():
    answer = limited(limiter_at(-5.0, TO_3), 1.0)
    assert answer.arbitration.brake == 1.0 and not answer.is_cut


@pytest.mark.parametrize("speed_mps", [0.0, 5.0])
def test_a_stop_and_neutral_without_a_source_pass(speed_mps):
    limiter = limiter_at(speed_mps, DriveLimits(1.0, 1.0, 1.0), value_map=MAP)
    for one in (asked(0.0, PLANNER, stops=True), asked(0.0, NEUTRAL)):
        answer = limiter.limit(one, False, 0.5, 1)
        assert answer.arbitration is one and not answer.cause


def test_a_planner_s_car_slows_to_the_speed_that_its_turn_allows_and_the_least_speed_counts():
    answer = limited(limiter_at(4.0), 0.3, turn_max_mps=2.0)
    assert answer.arbitration.drive == -0.5 and answer.cause == causes.CURVE_SLOWED
    assert answer.reason == "the turn that is asked for allows 2.00 m/s, it has 4.00: it brakes"
    assert not limited(limiter_at(4.0), 0.3, TELEOP, turn_max_mps=2.0).is_cut
    assert not limited(limiter_at(4.0, slow_down=False), 0.3, turn_max_mps=2.0).is_cut
    bound = SpeedBound(0.5, causes.OBSTACLE_SLOWED, "an obstacle allows")
    answer = limited(limiter_at(0.4, TO_3), 1.0, turn_max_mps=2.0, bounds=[bound])
    assert (answer.cause, answer.max_speed_mps) == (causes.OBSTACLE_SLOWED, 0.5)


FASTER_BY_3, BRAKED_BY_4 = DriveLimits(max_acceleration_mps2=3.0), DriveLimits(max_braking_mps2=4.0)


@pytest.mark.parametrize(("limits", "speed_mps", "request_", "drive", "brake", "cause"), [
    (FASTER_BY_3, 2.0, 0.8, 0.5, 0.8, causes.ACCELERATION_LIMITED),
    (FASTER_BY_3, 2.0, 0.5, 0.5, 0.5, ""),
    (FASTER_BY_3, 2.0, -0.8, -0.8, -0.8, ""),
    (FASTER_BY_3, -2.0, -0.8, -0.5, -0.8, causes.ACCELERATION_LIMITED),
    (BRAKED_BY_4, 2.0, -0.8, -0.8, -0.4, causes.BRAKING_LIMITED),
    (BRAKED_BY_4, 2.0, -0.4, -0.4, -0.4, ""),
    (BRAKED_BY_4, 2.0, 0.8, 0.8, 0.8, ""),
])
def test_accelerations_are_limited_through_the_value_map(limits, speed_mps, request_, drive, brake, cause):
    answer = limited(limiter_at(speed_mps, limits, value_map=MAP), request_)
    assert answer.arbitration.drive == pytest.approx(drive) and answer.arbitration.brake == pytest.approx(brake)
    assert answer.cause == cause


def test_the_limiter_s_own_brake_keeps_to_max_braking():
    answer = limited(limiter_at(6.0, DriveLimits(3.0, 0.0, 2.0), value_map=MAP), 1.0)
    assert answer.arbitration.brake == pytest.approx(-0.2) and answer.cause == causes.BRAKING_LIMITED


def test_without_any_odometry_nothing_is_limited_and_once_it_is_lost_the_last_speed_counts():
    answer = limited(limiter_at(None, human=TO_3), 1.0, TELEOP)
    assert answer.arbitration.drive == 1.0 and not answer.is_cut
    assert (answer.cause, answer.reason) == (causes.LIMITS_OFF, "odom was never heard: nothing limits the throttle")
    lost = limiter_at(2.75, human=TO_3)
    assert lost.limit(asked(1.0, TELEOP), False, 0.0, 3600 * S).arbitration.drive == pytest.approx(0.5)


def test_a_planner_s_throttle_waits_while_reports_of_the_speed_are_missing():
    limiter = limiter_at(1.0)
    assert not limiter.limit(asked(0.5), False, math.inf, S // 10).is_cut
    late = limiter.limit(asked(0.5), False, math.inf, 6 * S // 10)
    assert late.arbitration.drive == 0.0
    assert (late.cause, late.reason) == (causes.SPEED_LATE, "odom silent for 0.60 s: no throttle until its next report")
    assert not limiter.limit(asked(-0.5), False, math.inf, 6 * S // 10).is_cut
    assert not limiter.limit(asked(0.5), False, 0.0, 6 * S // 10).is_cut


def test_cuts_are_counted_when_they_begin():
    limiter = limiter_at(3.0, TO_3)
    for request in (1.0, 0.9, 0.0, 1.0):
        limited(limiter, request)
    assert limiter.cuts == 2


def test_parameters_are_read_by_source_with_the_defaults_that_are_documented():
    assert read_limits(Params({})) == ThrottleLimits(DriveLimits(), DriveLimits(), True, None, 0.5)
    limits = read_limits(Params({"human": {"max_speed": 3}, "planner": {"max_speed": 5}, "slow_down": False}))
    assert (limits.human.max_speed_mps, limits.planner.max_speed_mps, limits.slow_down) == (3.0, 5.0, False)


@pytest.mark.parametrize("values, message", [
    ({"human": {"max_acceleration": 2.0}}, "human/max_acceleration is 2.0.*csv_path_value_map"),
    ({"human": {"max_braking": 2.0}}, "human/max_braking is 2.0.*csv_path_value_map"),
    ({"planner": {"max_speed": -1}}, "planner/max_speed"),
    ({"planner": {"max_acceleration": -1}}, "planner/max_acceleration"),
    ({"planner": {"max_braking": -1}}, "planner/max_braking"),
])
def test_an_impossible_limit_or_one_that_needs_a_value_map_is_refused_by_name(values, message):
    with pytest.raises(ConfigError, match=message):
        read_limits(Params(values))


def test_the_value_map_is_read_where_it_is_needed(tmp_path):
    path = tmp_path / "map.csv"
    path.write_text("default,0,10\n-5,-10,-10\n0,0,0\n3,6,6\n")
    values = {"csv_path_value_map": str(path), "planner": {"max_braking": 2}}
    assert read_limits(Params(values)).value_map.acceleration_at(-5, 0) == -10
    assert read_limits(Params({"csv_path_value_map": "/nowhere/map.csv"})).value_map is None


def test_a_limit_costs_less_than_50_microseconds():
    limiter = limiter_at(2.9, DriveLimits(3.0, 3.0, 3.0), value_map=MAP)
    took_s = []
    for _ in range(50):  # the least of the processor's own time: the machine has other work
        begin_s = time.thread_time()
        for _ in range(100):
            limited(limiter, 1.0, turn_max_mps=2.0)
        took_s.append((time.thread_time() - begin_s) / 100)
    assert min(took_s) < 50e-6
