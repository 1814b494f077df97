"""How strongly a car slows down by itself, in each direction, as its rolls in neutral show it."""

import math

import numpy
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from car_interface.throttle.esc_config import EscConfig
from car_interface.throttle.slope import Estimate, Fit, Roll, Slope

MS, S = 1_000_000, 1_000_000_000
ESC = EscConfig(drag_deceleration_mps2=0.3, brake_deceleration_mps2=3.0)


class Car:
    """A car with a motor's lag on a slope; its odometry comes 50 times a second, some ms late."""

    def __init__(self, speed_mps=1.0, lag_s=0.05, downhill_mps2=0.0, late_ms=0):
        self.slope, self.now_ns = Slope(ESC), 10 * S
        self.speed_mps, self.force_mps2, self.lag_s = speed_mps, 0.0, lag_s
        self.downhill_mps2, self.late_ms, self.curvature_per_m = downhill_mps2, late_ms, 0.0

    def run(self, seconds, fraction=0.0, pushes_mps2=0.0, drag_mps2=0.3):
        """The ESC gets a fraction, which makes the motor push so, or brake with less than 0."""
        for _ in range(round(seconds * 50)):
            self.slope.update_esc(fraction, self.now_ns)
            self.now_ns += 20 * MS
            self.force_mps2 += (pushes_mps2 - self.force_mps2) * min(1.0, 0.02 / self.lag_s)
            total_mps2 = self.force_mps2 + self.downhill_mps2 - math.copysign(drag_mps2, self.speed_mps)
            self.speed_mps += 0.02 * total_mps2
            if abs(self.speed_mps) < 0.01 and abs(self.downhill_mps2) < drag_mps2 and not pushes_mps2:
                self.speed_mps = 0.0
            self.slope.update_speed(self.speed_mps, self.now_ns - self.late_ms * MS, self.curvature_per_m)
        return self.slope


@pytest.mark.parametrize("late_ms", [0, 150])
@pytest.mark.parametrize("lag_s", [0.02, 0.15])
@pytest.mark.parametrize("downhill_mps2", [-0.4, 0.0, 0.2, 0.49])
def test_a_roll_shows_how_it_slows_down_whatever_the_motor_s_lag(downhill_mps2, lag_s, late_ms):
    car = Car(lag_s=lag_s, late_ms=late_ms, downhill_mps2=downhill_mps2)
    car.run(0.5, 0.4, 2.3)
    truth_mps2 = 0.3 - downhill_mps2
    for _ in range(60):
        certain_mps2, likely_mps2 = car.run(0.02).coasting(False)
        assert certain_mps2 <= min(0.3, truth_mps2) + 0.19  # soon after it began
    assert certain_mps2 <= min(0.3, truth_mps2)
    assert likely_mps2 == pytest.approx(truth_mps2, abs=0.06)
    assert certain_mps2 == pytest.approx(min(0.3, truth_mps2), abs=0.1)


@pytest.mark.parametrize("lag_s", [0.02, 0.15])
@pytest.mark.parametrize("downhill_mps2", [-0.49, 0.0, 0.2])
def test_many_short_rolls_are_not_taken_for_more_than_one(downhill_mps2, lag_s):
    """Each shows too little of how it slows down, or too much, by the same lag."""
    car, truth_mps2 = Car(lag_s=lag_s, downhill_mps2=downhill_mps2), 0.3 - downhill_mps2
    for _ in range(8):
        car.run(0.5, 0.4, truth_mps2 + 0.2)
        certain_mps2, likely_mps2 = car.run(0.2).coasting(False)
        assert certain_mps2 <= min(0.3, truth_mps2)
        assert likely_mps2 == pytest.approx(truth_mps2, abs=0.4)
    car.run(0.5, 0.4, truth_mps2 + 0.2)
    assert car.run(0.8).coasting(False).likely_mps2 == pytest.approx(truth_mps2, abs=0.06)


def test_before_the_first_roll_nothing_is_certain_and_a_push_shows_nothing():
    slope = Car().run(2.0, 0.4, 1.0)
    assert slope.coasting(False).certain_mps2 < 0.0 and slope.coasting(False).likely_mps2 == pytest.approx(0.5)


@pytest.mark.parametrize(("speed_mps", "brakes_s"), [(1.6, 0.36), (0.62, 0.3)], ids=["it_rolls_on", "it_stands_soon"])
def test_what_is_left_of_a_brake_is_not_taken_for_drag(speed_mps, brakes_s):
    car = Car(speed_mps=speed_mps, lag_s=0.15, downhill_mps2=0.25)
    car.run(brakes_s, -0.5, -2.0)
    for _ in range(40):
        assert car.run(0.02).coasting(False).certain_mps2 <= 0.05 + 0.05


def test_what_is_left_of_a_brake_too_short_to_show_in_the_reports_is_not_taken_for_drag():
    car = Car(speed_mps=1.6, lag_s=0.15, downhill_mps2=0.25)
    car.run(0.5, 0.1, 0.3)
    car.run(0.1, -0.5, -2.0)
    for _ in range(40):
        assert car.run(0.02).coasting(False).certain_mps2 <= 0.05


def reported(slope, at_ms, speeds_mps, curvature_per_m=0.0):
    """A slope that has taken speeds at these times since 10 s."""
    for time_ms, speed_mps in zip(at_ms, speeds_mps):
        slope.update_speed(speed_mps, 10 * S + round(time_ms * MS), curvature_per_m)
    return slope


def test_a_brake_leaves_no_force_in_a_car_that_it_has_stopped():
    slope = Slope(ESC)
    slope.update_esc(-0.5, 9 * S)
    reported(slope, range(-500, 1, 20), [0.0] * 26)
    slope.update_esc(0.0, 10 * S)
    rolls_s = [0.02 * count for count in range(1, 32)]  # down a hill that pulls by 0.9 m/s²
    reported(slope, (1000.0 * at_s for at_s in rolls_s), (0.6 * at_s for at_s in rolls_s))
    assert slope.coasting(False).likely_mps2 == pytest.approx(-0.6, abs=0.04)


@pytest.mark.parametrize(("last_ms", "is_measured"), [(129, False), (130, True)])
def test_a_roll_is_measured_over_a_tenth_of_a_second_at_least(last_ms, is_measured):
    """It begins 30 ms after the decision for neutral."""
    slope = Slope(ESC)
    slope.update_esc(0.4, 9 * S)
    slope.update_esc(0.0, 10 * S)
    reported(slope, (30, 60, 90, last_ms), (1.0, 0.98, 0.96, 0.94))
    assert (slope.coasting(False).likely_mps2 != 0.5) == is_measured


def test_a_brake_is_measured_over_half_a_second_at_a_time():
    """A brake of 1.5 m/s² slows down by 1.0 m/s² and then by 1.3, in reports 62.5 ms apart, as its lag is over."""
    slope, speed_mps, lacks_mps2 = Slope(ESC), 3.0, []
    slope.update_esc(-0.5, 10 * S)
    for count in range(18):
        reported(slope, [687.5 + 62.5 * count], [speed_mps])
        speed_mps -= 0.0625 * (1.0 if count < 8 else 1.3)
        lacks_mps2.append(slope.brake_lacks_mps2)
    assert lacks_mps2 == pytest.approx([0.0] * 8 + [0.5] * 9 + [0.2])


def test_a_weak_brake_lacks_what_it_lacks_and_says_nothing_about_drag():
    slope = Car(speed_mps=3.0).run(1.2, -0.5, -0.7)
    assert slope.brake_lacks_mps2 == pytest.approx(1.5 - 1.0, abs=0.03)
    assert slope.coasting(False).certain_mps2 < 0.0
    assert Car(speed_mps=3.0).run(1.0, -0.5, -2.0).brake_lacks_mps2 == 0.0


def turned(downhill_mps2, *turns_rad):
    """A car that has rolled on a slope (downhill at the heading 0), at each of some headings."""
    car, heading_rad = Car(), 0.0
    for turn_rad in turns_rad:
        car.speed_mps, car.force_mps2 = 1.0, 0.0
        car.downhill_mps2, car.curvature_per_m = 0.0, turn_rad / 0.5
        car.run(0.5, 0.3, 0.3)
        heading_rad += turn_rad
        car.downhill_mps2, car.curvature_per_m = downhill_mps2 * math.cos(heading_rad), 0.0
        car.speed_mps, car.force_mps2 = 2.0, 0.0
        car.run(0.1, 0.2, 0.3)
        car.run(1.0)
    return car.slope


def test_the_farther_it_turns_the_less_is_certain():
    slope = turned(0.0, 0.0)
    certain_mps2 = [slope.coasting(False, turn_rad).certain_mps2 for turn_rad in (0.0, 0.3, 0.8, 1.5)]
    assert certain_mps2 == sorted(certain_mps2, reverse=True) and certain_mps2[0] > 0.2 > 0.0 > certain_mps2[-1]
    assert slope.coasting(True) == pytest.approx(slope.coasting(False, math.pi))


def test_what_climbs_one_way_is_expected_to_go_down_the_other_way():
    slope = turned(-0.45, 0.0)
    assert slope.coasting(False) == pytest.approx((0.3, 0.75), abs=0.06)
    assert slope.coasting(True).likely_mps2 < 0.35 and slope.coasting(True).certain_mps2 < 0.0


def test_rolls_at_three_headings_show_the_whole_plane():
    slope = turned(0.4, 0.0, 1.2, 1.2)
    for turn_rad in (0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0):
        truth_mps2 = 0.3 - 0.4 * math.cos(2.4 + turn_rad)
        assert slope.coasting(False, turn_rad).likely_mps2 == pytest.approx(truth_mps2, abs=0.12)
        assert min(0.3, truth_mps2) - 0.3 < slope.coasting(False, turn_rad).certain_mps2 <= truth_mps2


def test_other_ground_is_believed_at_once():
    car = Car(speed_mps=2.0)
    for _ in range(5):
        car.speed_mps = 2.0
        car.run(1.0)
    car.speed_mps, car.downhill_mps2 = 1.0, 0.4
    assert car.run(0.6).coasting(False).likely_mps2 == pytest.approx(-0.1, abs=0.06)


def test_a_car_that_has_stood_for_long_may_stand_somewhere_else():
    car = Car()
    car.run(1.0)
    assert car.slope.coasting(False).certain_mps2 > 0.2
    car.speed_mps = 0.0
    assert car.run(2.5, 0.0).coasting(False).certain_mps2 > 0.2
    assert car.run(1.0, 0.0).coasting(False).certain_mps2 < 0.0


def test_two_short_stands_are_not_a_long_one():
    slope = Car().run(1.0)
    reported(slope, range(1100, 5200, 100), [0.0] * 20 + [0.1] + [0.0] * 20)
    assert slope.coasting(False) != Slope(ESC).coasting(False)


@pytest.mark.parametrize(("speed_mps", "is_known"), [(0.05, True), (0.0499, False), (-0.05, True)])
def test_a_car_that_moves_at_0_05_mps_does_not_stand(speed_mps, is_known):
    slope = Car().run(1.0)
    reported(slope, range(1100, 5000, 100), [speed_mps] * 39)
    assert (slope.coasting(False) != Slope(ESC).coasting(False)) == is_known


@pytest.mark.parametrize("gap_s", [1.5, 5.0])
def test_while_no_report_comes_it_drives_on_for_a_second_at_most(gap_s):
    """On an arc of 1 m at 1.4 m/s, after a roll straight on: it is known best 1.4 rad back."""
    slope = Car(speed_mps=1.0).run(1.0)
    reported(slope, [1000 + 1000 * gap_s], [1.4], 1.0)
    best_mps2 = slope.coasting(False, -1.4).certain_mps2
    assert best_mps2 > max(slope.coasting(False, turn_rad).certain_mps2 for turn_rad in (-1.3, -1.5))


def test_the_slope_may_change_on_the_way():
    car = Car(speed_mps=2.0)
    car.run(1.0)
    before_mps2 = car.slope.coasting(False).certain_mps2
    car.run(20.0, 0.2, 0.3)
    assert car.slope.coasting(False).certain_mps2 < before_mps2 - 0.02


def test_the_present_acceleration_is_that_of_the_magnitude():
    assert Car(speed_mps=1.0).run(0.5, 0.5, 1.3).acceleration_mps2 == pytest.approx(1.0, abs=0.05)
    assert Car(speed_mps=-1.0).run(0.5, -0.5, -1.3).acceleration_mps2 == pytest.approx(1.0, abs=0.05)
    assert Slope(ESC).acceleration_mps2 == 0.0


def test_the_present_acceleration_is_that_of_the_last_0_12_s():
    slope, times_ms, speeds_mps = Slope(ESC), range(0, 180, 20), (1.0, 3.0, 1.0, 1.1, 1.3, 1.6, 2.0, 2.5, 3.1)
    reported(slope, times_ms, speeds_mps)
    times_s = numpy.array(times_ms) / 1000
    assert slope.acceleration_mps2 == pytest.approx(numpy.polyfit(times_s[2:], speeds_mps[2:], 1)[0])


@pytest.mark.once
@settings(max_examples=40)
@given(speeds=st.lists(st.one_of(st.floats(-5.0, 5.0), st.just(math.nan), st.just(math.inf)), max_size=80),
       fraction=st.sampled_from([0.0, 0.4, -0.5]), curvature=st.floats(-2.0, 2.0))
def test_whatever_it_is_told_it_promises_no_more_than_configured(speeds, fraction, curvature):
    slope = Slope(ESC)
    slope.update_esc(fraction, 10 * S)
    for index, speed_mps in enumerate(speeds):
        slope.update_speed(speed_mps, 10 * S + index * 20 * MS, curvature)
        for is_backward in (False, True):
            coasting = slope.coasting(is_backward)
            assert coasting.certain_mps2 <= 0.3 and math.isfinite(coasting.certain_mps2 + coasting.likely_mps2)
        assert math.isfinite(slope.acceleration_mps2) and slope.brake_lacks_mps2 >= 0.0


@pytest.mark.parametrize("speed_mps, later_ms", [
    (math.nan, 20), (math.inf, 20), (1e200, 20), (-100.1, 20), (5.0, 0), (5.0, -20)])
def test_speed_that_is_no_car_s_or_not_newer_changes_nothing(speed_mps, later_ms):
    car = Car()
    car.run(0.5, 0.4, 2.3)
    before = car.run(0.5).coasting(False)
    car.slope.update_speed(speed_mps, car.now_ns + later_ms * MS, 0.0)
    assert car.slope.coasting(False) == before


def test_a_window_s_deceleration_is_that_of_least_squares():
    times_s, speeds_mps = [0.3, 0.34, 0.4, 0.53], [1.0, 0.97, 0.99, 0.8]
    fit = Fit()
    for time_s, speed_mps in zip(times_s, speeds_mps):
        fit.add(time_s, speed_mps)
    assert fit.slope() == pytest.approx(numpy.polyfit(times_s, speeds_mps, 1)[0])
    assert (fit.count, fit.span_s, fit.mean_s) == (4, pytest.approx(0.23), pytest.approx(numpy.mean(times_s)))
    alone = Fit()
    alone.add(1.0, 2.0)
    assert (alone.count, alone.span_s, alone.slope()) == (1, 0.0, 0.0)


UNKNOWN = Estimate.unknown(0.3)
ROLLS = [Roll(0.4, 0.2, 0.1, 0.5, 0.6), Roll(1.5, 0.45, 0.05, -0.2, 0.3), Roll(-2.0, 0.1, 0.2, -3.0, 0.5),
         Roll(0.0, 0.6, 0.1)]


def seen(state, roll):
    """The deceleration that a car of this drag, pull and lag shows in a roll."""
    drag, x, y, share = state
    coasts_mps2 = drag - x * math.cos(roll.yaw_rad) - y * math.sin(roll.yaw_rad)
    return coasts_mps2 - share * roll.left * max(0.0, roll.accelerated_mps2 + coasts_mps2)


def same(one, other):
    return numpy.allclose(one.state, other.state) and numpy.allclose(one.errors, other.errors)


def test_before_the_first_roll_a_floor_of_5_percent_a_drag_brake_and_any_lag_are_within_the_bounds():
    assert UNKNOWN.state == (0.5, 0.0, 0.0, 0.5)
    assert numpy.allclose(UNKNOWN.errors, numpy.diag([0.2 ** 2, 0.5 ** 2, 0.5 ** 2, 0.7 ** 2]), atol=0.0)


def test_a_roll_is_taken_by_an_extended_kalman_filter_of_drag_pull_and_lag():
    """Its derivatives are those of what a roll shows, by differences."""
    estimate, step = UNKNOWN, 1e-6
    for roll in ROLLS:
        before, errors = map(numpy.array, estimate)
        looks = numpy.array([(seen(before + move, roll) - seen(before - move, roll)) / (2 * step)
                             for move in step * numpy.eye(4)])
        shape = 0.25 * looks[3]
        variance = looks @ errors @ looks + roll.bound_mps2 ** 2 + shape ** 2
        gain = errors @ looks / variance
        estimate = estimate.measured(roll, 0.3)
        assert estimate.state == pytest.approx(before + gain * (roll.slows_mps2 - seen(before, roll)), abs=1e-6)
        assert numpy.allclose(estimate.errors, errors - numpy.outer(gain, looks @ errors), atol=1e-6)
        coasting = numpy.array([1.0, -math.cos(1.1), -math.sin(1.1), 0.0])
        bound_mps2 = math.sqrt(coasting @ estimate.errors @ coasting)
        assert estimate.coasting(1.1) == (pytest.approx(coasting @ estimate.state), pytest.approx(bound_mps2))


def test_no_less_than_nothing_and_no_more_than_all_is_left_of_a_force():
    assert UNKNOWN.measured(Roll(0.0, -1.3, 0.01, 1.0, 0.9), 0.3).state[3] == 1.0
    assert UNKNOWN.measured(Roll(0.0, 1.1, 0.01, 3.0, 0.9), 0.3).state[3] == 0.0


@pytest.mark.parametrize("beyond", [1.99, 2.01])
def test_a_roll_that_is_off_by_more_than_twice_the_bound_is_the_first_of_the_same_motor_on_other_ground(beyond):
    known = UNKNOWN.measured(Roll(0.0, 0.2, 0.05, 0.5, 0.7), 0.3)
    likely_mps2, bound_mps2 = known.coasting(1.0)
    roll = Roll(1.0, likely_mps2 + beyond * math.hypot(bound_mps2, 0.1), 0.1)
    errors = numpy.diag([0.04, 0.25, 0.25, known.errors[3][3]])
    other = Estimate((0.5, 0.0, 0.0, known.state[3]), errors.tolist())
    assert same(known.measured(roll, 0.3), other.measured(roll, 0.3)) == (beyond > 2.0)


def test_on_the_way_the_pull_may_change_by_0_015_mps2_in_a_metre_and_drag_and_lag_do_not():
    before = UNKNOWN.measured(ROLLS[0], 0.3)
    assert before.after(0.0) is before
    change = numpy.diag([0.0, 4.0 * 0.015 ** 2, 4.0 * 0.015 ** 2, 0.0])
    assert numpy.allclose(before.after(4.0).errors, before.errors + change, atol=0.0)
    assert before.after(4.0).state == before.state
