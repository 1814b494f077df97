"""The driven turn beside the commanded one. Time is passed in; a car is a line that says what it does."""
from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from car_interface.common.errors import ConfigError
from car_interface.steering.monitor import SteeringCheck, SteeringCheckConfig

S = 1_000_000_000
START_NS = 1000 * S
STEP_NS = S // 50  # 20 ms from report to report
INF, NAN = math.inf, math.nan


class Car:
    """A check that hears a drive: commanded radius, driven radius, speed."""

    def __init__(self, **config):
        self.check = SteeringCheck(SteeringCheckConfig(**config))
        self.now_ns = START_NS

    def drives(self, commanded_m, driven_m, seconds, speed_mps=1.0, step_ns=STEP_NS):
        """Drive on; the warning after each report. A commanded ``None`` is silence."""
        warnings = []
        end_ns = self.now_ns + round(seconds * S)
        while self.now_ns < end_ns:
            if commanded_m is not None:
                self.check.update_command(commanded_m, self.now_ns)
            self.check.update_motion(speed_mps, speed_mps / driven_m, self.now_ns)
            self.now_ns += step_ns
            warnings.append(self.check.judge(self.now_ns).warning)
        return warnings

    @property
    def judgement(self):
        return self.check.judge(self.now_ns)

    @property
    def warning(self):
        return self.judgement.warning


@pytest.fixture
def car():
    return Car()


# --- the radii ---


@pytest.mark.parametrize("speed_mps", [1.0, -1.0])
@pytest.mark.parametrize("commanded_m, driven_m", [(2.0, 2.1), (-3.0, -2.9), (INF, INF), (INF, -50.0)])
def test_judgement_has_both_radii_forward_and_in_reverse(car, commanded_m, driven_m, speed_mps):
    car.drives(commanded_m, driven_m, 1.0, speed_mps)
    assert car.judgement == (commanded_m, pytest.approx(driven_m), "")


def test_judgement_before_anything_was_heard_knows_nothing(car):
    assert car.judgement == (pytest.approx(NAN, nan_ok=True), pytest.approx(NAN, nan_ok=True), "")


def test_estimate_is_that_of_the_last_half_second(car):
    car.drives(2.0, 2.0, 2.0)
    car.drives(3.0, 3.0, 0.7)
    assert car.judgement.estimated_m == pytest.approx(3.0)


@pytest.mark.parametrize("what, speed_mps, seconds, after_s", [
    pytest.param("slower_than_half_a_metre_a_second", 0.3, 1.0, 0.0, id="slower_than_half_a_metre_a_second"),
    pytest.param("standing", 0.0, 1.0, 0.0, id="standing"),
    pytest.param("silent", 1.0, 1.0, 0.6, id="wheels_silent_for_over_half_a_second"),
    pytest.param("begun", 1.0, 0.3, 0.0, id="not_yet_driving_for_half_a_second"),
    pytest.param("nan", NAN, 1.0, 0.0, id="speed_nan"),
    pytest.param("inf", INF, 1.0, 0.0, id="speed_infinite"),
])
def test_estimate_is_unknown_when(car, what, speed_mps, seconds, after_s):
    car.drives(2.0, 2.0, seconds, speed_mps)
    assert math.isnan(car.check.judge(car.now_ns + round(after_s * S)).estimated_m)


@pytest.mark.parametrize("commanded_m, after_s", [
    pytest.param(NAN, 0.0, id="nan"),
    pytest.param(0.0, 0.0, id="zero"),
    pytest.param(2.0, 0.6, id="silent_for_over_half_a_second"),
])
def test_commanded_radius_is_unknown_when(car, commanded_m, after_s):
    car.drives(commanded_m, 2.0, 1.0)
    assert math.isnan(car.check.judge(car.now_ns + round(after_s * S)).commanded_m)


# --- a car that turns as told ---


@pytest.mark.parametrize("speed_mps", [0.5, 1.0, 1.9, -1.0])
@pytest.mark.parametrize("commanded_m, driven_m", [
    pytest.param(2.0, 2.0, id="exactly"),
    pytest.param(2.0, 2.9, id="nearly_half_wider"),
    pytest.param(2.0, 1.05, id="nearly_half_tighter"),
    pytest.param(-1.0, -1.4, id="nearly_half_wider_to_the_right"),
    pytest.param(15.0, 21.0, id="wide"),
    pytest.param(21.0, -21.0, id="both_straight_though_to_different_sides"),
    pytest.param(INF, 21.0, id="straight_as_far_as_one_can_tell"),
    pytest.param(16.0, INF, id="hardly_a_turn"),
])
def test_turn_that_is_near_enough_is_no_warning(car, commanded_m, driven_m, speed_mps):
    assert set(car.drives(commanded_m, driven_m, 10.0, speed_mps)) == {""}


def test_drive_through_all_turns_is_no_warning_while_the_servo_is_on_its_way(car):
    for radius_m in (2.0, -2.0, 1.0, INF, -5.0, 2.0) * 3:
        late = car.check.judge(car.now_ns).estimated_m
        assert set(car.drives(radius_m, INF if math.isnan(late) else late, 0.45)) == {""}
        assert set(car.drives(radius_m, radius_m, 4.0)) == {""}


def test_steering_that_never_rests_is_judged_by_all_that_it_commanded(car):
    warnings = set()
    for index in range(400):
        radius_m = 2.0 + math.sin(index / 10)
        warnings.update(car.drives(radius_m, 2.0, 0.04))
    assert warnings == {""}
    for index in range(400):
        car.drives(2.0 + math.sin(index / 10), 9.0, 0.04)
    assert "commanded left" in car.warning


@pytest.mark.once
@given(st.lists(st.tuples(st.sampled_from([1.5, -2.0, 4.0, INF, -12.0]), st.floats(0.1, 4.0),
                          st.sampled_from([-1.5, -0.6, 0.0, 0.3, 0.45, 0.6, 1.5])), max_size=8))
def test_car_that_does_what_it_is_told_is_never_warned_of(drives):
    car = Car()
    for radius_m, seconds, speed_mps in drives:
        assert set(car.drives(radius_m, radius_m, seconds, speed_mps)) <= {""}


# --- a car that doesn't ---


@pytest.mark.parametrize("speed_mps", [0.6, 1.9, -1.0])
@pytest.mark.parametrize("commanded_m, driven_m, words", [
    pytest.param(2.0, 3.2, "commanded left, 2.0 m, the car went left, 3.2 m", id="over_half_wider"),
    pytest.param(-2.0, -3.2, "commanded right, 2.0 m, the car went right, 3.2 m", id="over_half_wider_to_the_right"),
    pytest.param(3.0, 1.4, "commanded left, 3.0 m, the car went left, 1.4 m", id="over_half_tighter"),
    pytest.param(2.0, INF, "commanded left, 2.0 m, the car went straight on", id="not_at_all"),
    pytest.param(INF, -7.0, "commanded straight on, the car went right, 7.0 m", id="straight_that_is_none"),
])
def test_radius_off_by_more_than_half_for_two_seconds_is_a_warning(car, commanded_m, driven_m, words, speed_mps):
    assert set(car.drives(commanded_m, driven_m, 2.4, speed_mps)) == {""}  # and half a second for the servo
    car.drives(commanded_m, driven_m, 0.3, speed_mps)
    assert car.warning.startswith(words + ": steering calibration? Measure which duty drives ")


@pytest.mark.parametrize("speed_mps", [0.6, 1.4, -1.0])
@pytest.mark.parametrize("commanded_m, driven_m, words", [
    pytest.param(2.0, -2.0, "commanded left, 2.0 m, the car went right, 2.0 m", id="left_that_turns_right"),
    pytest.param(-2.0, 3.0, "commanded right, 2.0 m, the car went left, 3.0 m", id="right_that_turns_left"),
])
def test_turn_to_the_other_side_is_a_warning_after_half_a_second(car, commanded_m, driven_m, words, speed_mps):
    assert set(car.drives(commanded_m, driven_m, 0.9, speed_mps)) == {""}  # and half a second for the servo
    car.drives(commanded_m, driven_m, 0.3, speed_mps)
    assert car.warning.startswith(words + ": steering calibration? See whether the servo")
    car.drives(commanded_m, driven_m, 5.0, speed_mps)
    assert "wrong way round" in car.warning


def test_wide_turn_to_the_other_side_takes_longer_to_tell_from_straight_on(car):
    assert set(car.drives(10.0, -10.0, 1.5)) == {""}
    car.drives(10.0, -10.0, 1.5)
    assert "commanded left, 10.0 m, the car went right, 10.0 m" in car.warning


@pytest.mark.parametrize("commanded_m, speed_mps", [
    pytest.param(2.0, 0.45, id="slow"),
    pytest.param(1.0, 2.5, id="too_fast_for_the_tyres"),
    pytest.param(NAN, 1.0, id="told_nothing"),
    pytest.param(None, 1.0, id="told_never"),
])
def test_turn_is_not_judged_when(car, commanded_m, speed_mps):
    assert set(car.drives(commanded_m, -3.0, 10.0, speed_mps)) == {""}


def test_command_that_fell_silent_is_not_judged_any_more(car):
    car.drives(2.0, 2.0, 2.0)
    assert set(car.drives(None, 2.0, 0.6)) == {""}
    assert set(car.drives(None, -2.0, 10.0)) == {""}


def test_drive_in_pieces_of_less_than_two_seconds_is_not_judged(car):
    for _ in range(10):
        assert set(car.drives(2.0, 4.0, 2.3)) == {""}
        car.drives(2.0, 4.0, 0.2, speed_mps=0.0)


def test_drive_with_silence_in_between_begins_anew(car):
    for _ in range(10):
        assert set(car.drives(2.0, 4.0, 2.3)) == {""}
        car.now_ns += round(0.6 * S)


def test_drive_forward_and_back_begins_anew(car):
    for _ in range(10):
        assert set(car.drives(2.0, 4.0, 2.3)) == {""}
        assert set(car.drives(2.0, 4.0, 2.3, speed_mps=-1.0)) == {""}


@pytest.mark.parametrize("step_ns", [S // 200, S // 5], ids=["200_reports_a_second", "5_reports_a_second"])
def test_rate_of_the_reports_does_not_matter(car, step_ns):
    car.drives(2.0, 4.0, 3.2, step_ns=step_ns)
    assert "commanded left, 2.0 m, the car went left, 4.0 m" in car.warning
    assert car.judgement.estimated_m == pytest.approx(4.0)


def test_speed_that_wavers_about_the_least_one_is_at_speed_still(car):
    for index in range(40):
        car.drives(2.0, 8.0, 0.1, speed_mps=0.52 if index % 2 else 0.46)
    assert "commanded left" in car.warning


def test_yaw_rate_that_is_off_for_a_moment_is_no_warning(car):
    for _ in range(20):
        assert set(car.drives(2.0, 2.0, 0.9)) == {""}
        assert set(car.drives(2.0, INF, 0.1)) == {""}


# --- how long a warning stays ---


def test_warning_stays_while_the_car_stands_and_while_its_command_is_silent(car):
    car.drives(2.0, 4.0, 3.0)
    warning = car.warning
    assert warning
    car.drives(INF, INF, 5.0, speed_mps=0.0)
    assert car.warning == warning
    car.now_ns += 60 * S
    assert car.warning == warning


def test_warning_goes_when_the_same_side_was_driven_right_over_the_last_two_seconds(car):
    car.drives(2.0, 4.0, 3.0)
    assert all(car.drives(2.0, 2.0, 0.7))
    car.drives(2.0, 2.0, 1.3)
    assert car.warning == ""


def test_warning_stays_while_the_same_side_is_driven_only_just_right(car):
    car.drives(2.0, 3.2, 3.0)
    assert all(car.drives(2.0, 2.9, 5.0))


def test_warning_of_one_side_stays_while_the_other_is_driven_right(car):
    car.drives(2.0, 4.0, 3.0)
    car.drives(-2.0, -2.0, 5.0)
    car.drives(INF, INF, 5.0)
    assert car.warning.startswith("commanded left")


def test_warnings_of_both_sides_are_told_together(car):
    car.drives(2.0, -2.0, 3.0)
    car.drives(-2.0, 2.0, 3.0)
    assert "commanded left, 2.0 m, the car went right" in car.warning
    assert "; commanded right, 2.0 m, the car went left" in car.warning


# --- the configuration ---


@pytest.mark.parametrize("wrong, message", [
    pytest.param({"min_speed_mps": 0.0}, "min_speed_mps is 0.0; accepted: a number above 0", id="no_speed"),
    pytest.param({"off_for_s": NAN}, "off_for_s is nan", id="nan"),
    pytest.param({"straight_m": INF}, "straight_m is inf", id="infinite"),
    pytest.param({"off_ratio": 1.0}, "off_ratio is 1.0; accepted: a ratio below 1", id="all_of_it"),
])
def test_impossible_configuration_is_named(wrong, message):
    with pytest.raises(ConfigError, match=message):
        SteeringCheckConfig(**wrong)


def test_command_is_unknown_after_dropped_messages_until_it_is_heard_again(car):
    car.drives(2.0, 2.0, 1.0)
    car.check.mark_stale()
    assert math.isnan(car.judgement.commanded_m)
    car.drives(2.0, 2.0, 0.1)
    assert car.judgement.commanded_m == 2.0
