"""How tight a car may turn at its speed."""
import math

import pytest

from car_interface.common import causes
from car_interface.steering.limits import SourceLimits, SteeringLimiter, SteeringLimits, Turn, too_tight_reason

MS, S = 1_000_000, 1_000_000_000
LATERAL = SourceLimits(max_lateral_mps2=4.0)
JERK = SourceLimits(max_jerk_mps3=40.0)
AT_4_MPS = "4 m/s² sideways: at 4.0 m/s no tighter than 4.00 m, 1.00 m was asked for"
ODD = 0.1 + 0.2  # no number that a detour over radius and back would keep


def limiter_at(speed_mps):
    """One that has had this speed at 50 Hz for two seconds, up to now, 0."""
    limiter = SteeringLimiter(SteeringLimits())
    for report in range(-100, 1):
        limiter.speed.update(speed_mps, report * 20 * MS)
    return limiter


@pytest.mark.parametrize(("speed_mps", "asked_per_m", "turn"), [
    (2.0, 1.0, (1.0, "", "", 2.0)),
    (2.0, -1.0, (-1.0, "", "", 2.0)),
    (4.0, 1.0, (0.25, causes.LATERAL_LIMITED, AT_4_MPS, 2.0)),
    (4.0, -1.0, (-0.25, causes.LATERAL_LIMITED, AT_4_MPS, 2.0)),
    (-4.0, 1.0, (0.25, causes.LATERAL_LIMITED, AT_4_MPS, 2.0)),
    (0.0, 1.0, (1.0, "", "", 2.0)),
    (4.0, 0.0, (0.0, "", "", math.inf)),
    (2.0, ODD, (ODD, "", "", pytest.approx(math.sqrt(4.0 / 0.3)))),
])
def test_a_turn_is_no_tighter_than_the_lateral_acceleration_allows(speed_mps, asked_per_m, turn):
    found = limiter_at(speed_mps).limit(asked_per_m, LATERAL, MS)
    assert found == turn and found.is_cut == bool(turn[1])


def test_without_any_odometry_nothing_is_limited_and_the_car_turns_in_from_where_it_is_once_there_is_one():
    limiter = SteeringLimiter(SteeringLimits())
    assert limiter.limit(1.0, LATERAL, S) == (
        1.0, causes.LIMITS_OFF, "odom was never heard: nothing limits the steering", 0.0)
    limiter.speed.update(4.0, S)
    assert limiter.limit(1.0, JERK, S + MS).curvature_per_m == 1.0


def test_when_odometry_is_lost_or_no_speed_the_last_bound_stays():
    limiter = limiter_at(4.0)
    for now_ns in (S, 3600 * S):  # for 0.1 s it may have gained speed before anything noticed
        turn = limiter.limit(1.0, LATERAL, now_ns)
        assert turn.curvature_per_m == pytest.approx(4.0 / (4.0 + 6.0 * 0.1) ** 2, rel=0.01)
        assert turn.reason.endswith(f"by the last speed, odom silent for {now_ns // S}.00 s")
    nonsense = limiter_at(4.0)
    nonsense.speed.update(math.nan, MS)
    assert nonsense.limit(1.0, LATERAL, 20 * MS).curvature_per_m == 0.25


def test_the_bound_is_that_of_the_speed_that_the_car_will_have_and_may_have_while_reports_are_missing():
    limiter = limiter_at(3.0)
    for tick in range(1, 11):
        limiter.speed.update(3.0 + 0.1 * tick, tick * 20 * MS)  # 5 m/s²
    turn = limiter.limit(1.0, LATERAL, 200 * MS)
    assert turn.curvature_per_m == pytest.approx(4.0 / (4.0 + 5.0 * 0.06) ** 2)
    limiter = limiter_at(2.0)
    fresh, late = (limiter.limit(1.0, LATERAL, now_ns) for now_ns in (20 * MS, 100 * MS))
    assert fresh.curvature_per_m == 1.0
    assert late.curvature_per_m == pytest.approx(4.0 / (2.0 + 6.0 * 0.06) ** 2, rel=0.01)


def turned_in(limiter, asked_per_m, limits=JERK, start_ns=0, ticks=20):
    """What is granted, tick by tick of 10 ms, at the same speed."""
    granted = []
    for now_ns in range(start_ns, start_ns + ticks * 10 * MS, 10 * MS):
        limiter.speed.update(limiter.speed.last_mps, now_ns)
        granted.append(limiter.limit(asked_per_m, limits, now_ns).curvature_per_m)
    return granted


def test_the_car_turns_in_no_quicker_than_the_jerk_allows():
    granted = turned_in(limiter_at(4.0), 0.5)  # 8 m/s² sideways: 2 at once, the rest takes 0.15 s
    lateral = [16 * curvature for curvature in granted]
    assert lateral[0] == pytest.approx(2.0) and lateral[1] == pytest.approx(2.4)
    assert lateral[15] == pytest.approx(8.0) and granted[-1] == 0.5


def test_back_to_straight_on_is_never_slowed_and_from_side_to_side_begins_at_straight_on():
    limiter = limiter_at(4.0)
    turned_in(limiter, 0.5)
    assert turned_in(limiter, 0.1, start_ns=200 * MS, ticks=1) == [0.1]
    assert turned_in(limiter, 0.0, start_ns=201 * MS, ticks=1) == [0.0]
    turned_in(limiter, 0.5, start_ns=300 * MS)
    other_side = limiter.limit(-0.5, JERK, 500 * MS)
    assert 16 * other_side.curvature_per_m == pytest.approx(-2.0)
    assert (other_side.cause, other_side.reason) == (
        causes.JERK_LIMITED, "40 m/s³ sideways at 4.0 m/s: it turns in more slowly")


def test_steps_of_a_planner_that_turn_in_slowly_on_the_whole_pass_unchanged():
    limiter = limiter_at(3.0)
    for step in range(8):  # 20 Hz, 0.45 m/s² each: 9 m/s³
        wanted = step * 0.05
        assert turned_in(limiter, wanted, start_ns=step * 50 * MS, ticks=5) == [wanted] * 5


def test_what_rises_at_once_is_used_up_until_it_has_grown_again():
    assert limiter_at(4.0).limit(0.125, JERK, 0) == Turn(0.125)  # exactly the 2 m/s²
    limiter = limiter_at(4.0)
    assert turned_in(limiter, 0.0625, ticks=1) == [0.0625]  # 1 m/s² of the 2 that may rise at once
    assert turned_in(limiter, 0.5, start_ns=MS, ticks=1) == [pytest.approx(0.0625 + 1.04 / 16)]
    assert turned_in(limiter, 0.5, start_ns=2 * MS, ticks=1) == [pytest.approx(0.0625 + 1.08 / 16)]


def test_after_someone_else_steered_it_may_rise_at_once_again():
    limiter = limiter_at(4.0)
    turned_in(limiter, 0.5, ticks=1)
    limiter.release(0.125, MS)
    assert turned_in(limiter, 0.5, start_ns=2 * MS, ticks=1) == [pytest.approx(0.125 + 2.0 / 16)]


def test_cuts_are_counted_when_they_begin():
    limiter = limiter_at(4.0)
    for asked_per_m in (1.0, 0.9, 0.1, 1.0, 1.0):
        limiter.limit(asked_per_m, LATERAL, MS)
    assert limiter.cuts == 2
    limiter.release(0.0, MS)
    limiter.limit(1.0, LATERAL, MS)
    assert limiter.cuts == 3


@pytest.mark.parametrize("asked_m, tightest_m, speed_mps, reason", [
    (0.9, (1.0, 1.0), 1.0, ""),
    (-0.9, (1.0, 1.0), 1.0, ""),
    (0.89, (1.0, 1.0), 1.0, "asks for 0.89 m, this car turns on 1.00 m to the left: rad? rad/s? wheelbase?"),
    (-0.17, (1.03, 1.5), 1.0, "asks for 0.17 m, this car turns on 1.03 m to the right: rad? rad/s? wheelbase?"),
    (-1.03, (1.03, 1.5), -3.0,
     "asks for 1.03 m, this car turns on 1.50 m to the right at 3.0 m/s, as its turns widen with speed"),
])
def test_a_turn_is_too_tight_below_nine_tenths_of_the_tightest_and_the_reason_says_what_to_look_for(
        asked_m, tightest_m, speed_mps, reason):
    assert too_tight_reason(asked_m, *tightest_m, speed_mps) == reason


@pytest.mark.parametrize("speed_mps, limits, turn", [
    (1.0, LATERAL, (1.0, causes.TOO_TIGHT, "asks for too much", 2.0)),
    (1.0, JERK, (1.0, causes.TOO_TIGHT, "asks for too much", 0.0)),
    (1.0, SourceLimits(), (1.0, causes.TOO_TIGHT, "asks for too much", 0.0)),
    (None, LATERAL, (1.0, causes.TOO_TIGHT, "asks for too much", 0.0)),
    (4.0, LATERAL, (0.25, causes.TOO_TIGHT, f"asks for too much; {AT_4_MPS}", 2.0)),
])
def test_the_tightest_turn_is_granted_and_its_reason_kept_and_counted_once_when_it_begins(speed_mps, limits, turn):
    limiter = SteeringLimiter(SteeringLimits()) if speed_mps is None else limiter_at(speed_mps)
    for tick in range(1, 10):
        assert limiter.limit(1.0, limits, tick * MS, "asks for too much") == turn
    assert limiter.cuts == 1
    limiter.limit(0.1, limits, 20 * MS)
    limiter.limit(1.0, limits, 21 * MS, "asks for too much")
    assert limiter.cuts == 2


def test_it_stays_known_for_2_s_so_that_swings_from_side_to_side_are_one():
    limiter = limiter_at(1.0)
    assert limiter.too_tight.fresh(0) is None
    limiter.limit(1.0, LATERAL, S, "asks for too much")
    limiter.limit(0.1, LATERAL, S + MS)
    assert (limiter.too_tight.fresh(3 * S), limiter.too_tight.fresh(3 * S + 1)) == ("asks for too much", None)
