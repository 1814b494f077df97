"""The driven turn beside the commanded one. Time is passed in; a car is a line that says what it does."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from car_interface.steering.monitor import SteeringCheck

S = 1_000_000_000
START_NS = 1000 * S
STEP_NS = S // 50  # 20 ms from report to report
INF, NAN = math.inf, math.nan
# How long there is no warning, half a second of it for the servo; in how much more there is one; and what it advises.
OFF = 2.4, 0.3, "Measure which duty drives "
WRONG_SIDE = 0.9, 0.3, "See whether the servo, or the wheels' sensors, are the wrong way round"


class Car:
    """A check that receives a drive: commanded radius, driven radius, speed."""

    def __init__(self):
        self.check = SteeringCheck()
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

    def judge(self, later_s=0.0):
        return self.check.judge(self.now_ns + round(later_s * S))

    @property
    def warning(self):
        return self.judge().warning


@pytest.fixture
def car():
    return Car()


@pytest.mark.parametrize("speed_mps", [1.0, -1.0])
@pytest.mark.parametrize("commanded_m, driven_m", [(2.0, 2.1), (-3.0, -2.9), (INF, INF), (INF, -50.0)])
def test_judgement_has_both_radii_forward_and_in_reverse(car, commanded_m, driven_m, speed_mps):
    car.drives(commanded_m, driven_m, 1.0, speed_mps)
    assert car.judge() == (commanded_m, pytest.approx(driven_m), "")


def test_estimate_is_that_of_the_last_half_second_and_starts_over_when_messages_were_dropped(car):
    assert car.judge() == (pytest.approx(NAN, nan_ok=True), pytest.approx(NAN, nan_ok=True), "")
    car.drives(2.0, 2.0, 2.0)
    car.drives(3.0, 3.0, 0.7)
    assert car.judge().estimated_m == pytest.approx(3.0)
    car.check.mark_stale()
    assert math.isnan(car.judge().estimated_m)
    car.drives(3.0, 3.0, 0.3)
    assert math.isnan(car.judge().estimated_m)
    car.drives(3.0, 3.0, 0.4)
    assert car.judge().estimated_m == pytest.approx(3.0)


@pytest.mark.parametrize("speed_mps, seconds, later_s", [
    (0.49, 1.0, 0.0), (0.0, 1.0, 0.0), (1.0, 1.0, 0.6), (1.0, 0.3, 0.0), (NAN, 1.0, 0.0), (INF, 1.0, 0.0)])
def test_estimate_is_unknown_when_the_car_is_slow_its_wheels_are_silent_or_it_has_only_begun(car, speed_mps, seconds,
                                                                                             later_s):
    car.drives(2.0, 2.0, seconds, speed_mps)
    assert math.isnan(car.judge(later_s).estimated_m)


@pytest.mark.parametrize("commanded_m, later_s", [(NAN, 0.0), (0.0, 0.0), (2.0, 0.6)])
def test_commanded_radius_is_unknown_when_it_is_none_or_silent(car, commanded_m, later_s):
    car.drives(commanded_m, 2.0, 1.0)
    assert math.isnan(car.judge(later_s).commanded_m)
    car.drives(2.0, 2.0, 0.1)
    assert car.judge().commanded_m == 2.0


@pytest.mark.parametrize("speed_mps", [0.5, 1.9, -1.0])
@pytest.mark.parametrize("commanded_m, driven_m", [
    (2.0, 2.9), (2.0, 1.05), (-1.0, -1.4), (15.0, 21.0), (21.0, -21.0), (INF, 21.0), (16.0, INF)])
def test_turn_that_is_near_enough_is_no_warning(car, commanded_m, driven_m, speed_mps):
    assert set(car.drives(commanded_m, driven_m, 6.0, speed_mps)) == {""}


def test_drive_through_all_turns_is_no_warning_while_the_servo_is_on_its_way(car):
    for radius_m in (2.0, -2.0, 1.0, INF, -5.0, 2.0) * 3:
        late = car.judge().estimated_m
        assert set(car.drives(radius_m, INF if math.isnan(late) else late, 0.45)) == {""}
        assert set(car.drives(radius_m, radius_m, 4.0)) == {""}


def test_steering_that_never_rests_is_judged_by_all_that_it_commanded(car):
    swings_m = [2.0 + math.sin(index / 10) for index in range(400)]
    for radius_m in swings_m:
        assert set(car.drives(radius_m, 2.0, 0.04)) == {""}
    for radius_m in swings_m:
        car.drives(radius_m, 9.0, 0.04)
    assert "commanded left" in car.warning


@pytest.mark.once
@given(st.lists(st.tuples(st.sampled_from([1.5, -2.0, 4.0, INF, -12.0]), st.floats(0.1, 4.0),
                          st.sampled_from([-1.5, -0.6, 0.0, 0.3, 0.45, 0.6, 1.5])), max_size=8))
def test_car_that_does_what_it_is_told_is_never_warned_of(drives):
    car = Car()
    for radius_m, seconds, speed_mps in drives:
        assert set(car.drives(radius_m, radius_m, seconds, speed_mps)) <= {""}


@pytest.mark.parametrize("speed_mps", [0.6, 1.4, -1.0])
@pytest.mark.parametrize("commanded_m, driven_m, words, times_and_advice", [
    (2.0, 3.2, "commanded left, 2.0 m, the car went left, 3.2 m", OFF),
    (-2.0, -3.2, "commanded right, 2.0 m, the car went right, 3.2 m", OFF),
    (3.0, 1.4, "commanded left, 3.0 m, the car went left, 1.4 m", OFF),
    (2.0, INF, "commanded left, 2.0 m, the car went straight on", OFF),
    (INF, -7.0, "commanded straight on, the car went right, 7.0 m", OFF),
    (20.0, -7.0, "commanded left, 20.0 m, the car went right, 7.0 m", OFF),
    (2.0, -2.0, "commanded left, 2.0 m, the car went right, 2.0 m", WRONG_SIDE),
    (-2.0, 3.0, "commanded right, 2.0 m, the car went left, 3.0 m", WRONG_SIDE),
])
def test_turn_off_by_more_than_half_or_to_the_other_side_is_a_warning_after_a_while(
        car, commanded_m, driven_m, words, times_and_advice, speed_mps):
    quiet_s, then_s, advice = times_and_advice
    assert set(car.drives(commanded_m, driven_m, quiet_s, speed_mps)) == {""}
    car.drives(commanded_m, driven_m, then_s, speed_mps)
    assert car.warning.startswith(f"{words}: steering calibration? {advice}")
    car.drives(commanded_m, driven_m, 5.0, speed_mps)
    assert advice in car.warning


@pytest.mark.parametrize("commanded_m, words", [
    (10.0, "commanded left, 10.0 m, the car went right, 10.0 m"),
    (-10.0, "commanded right, 10.0 m, the car went left, 10.0 m")])
def test_wide_turn_to_the_other_side_takes_longer_to_tell_from_straight_on(car, commanded_m, words):
    assert set(car.drives(commanded_m, -commanded_m, 1.5)) == {""}
    car.drives(commanded_m, -commanded_m, 1.5)
    assert words in car.warning


def test_all_commands_between_two_reports_count(car):
    for _ in range(200):
        car.check.update_command(INF, car.now_ns)
        assert car.drives(2.0, INF, 0.02) == [""]


@pytest.mark.parametrize("commanded_m, speed_mps", [(2.0, 0.45), (1.0, 2.5), (NAN, 1.0), (None, 1.0)])
def test_turn_is_not_judged_when_the_car_is_slow_or_too_fast_for_its_tyres_or_nothing_is_commanded(car, commanded_m,
                                                                                                  speed_mps):
    assert set(car.drives(commanded_m, -3.0, 10.0, speed_mps)) == {""}


@pytest.mark.parametrize("between", [
    lambda car: car.drives(2.0, 4.0, 0.2, speed_mps=0.0),
    lambda car: setattr(car, "now_ns", car.now_ns + round(0.6 * S)),
    lambda car: car.drives(2.0, 4.0, 2.3, speed_mps=-1.0),
], ids=["standstill", "silence", "reverse"])
def test_drive_in_parts_of_less_than_two_seconds_is_not_judged(car, between):
    for _ in range(5):
        assert set(car.drives(2.0, 4.0, 2.3)) == {""}
        between(car)
    assert car.warning == ""


@pytest.mark.parametrize("step_ns", [S // 200, S // 5])
def test_rate_of_the_reports_does_not_matter(car, step_ns):
    car.drives(2.0, 4.0, 3.2, step_ns=step_ns)
    assert "commanded left, 2.0 m, the car went left, 4.0 m" in car.warning
    assert car.judge().estimated_m == pytest.approx(4.0)


def test_half_a_second_of_reports_ten_times_a_second_is_enough_for_an_estimate(car):
    car.drives(2.0, 2.0, 0.7, step_ns=S // 10)  # the first two begin it
    assert car.judge().estimated_m == pytest.approx(2.0)


def test_speed_that_wavers_about_the_least_one_is_at_speed_still(car):
    for index in range(40):
        car.drives(2.0, 8.0, 0.1, speed_mps=0.52 if index % 2 else 0.46)
    assert "commanded left" in car.warning


def test_warning_stays_until_the_same_side_was_driven_right_over_the_last_two_seconds(car):
    car.drives(2.0, 4.0, 3.0)
    warning = car.warning
    assert warning.startswith("commanded left")
    car.drives(INF, INF, 5.0, speed_mps=0.0)
    car.now_ns += 60 * S
    car.drives(-2.0, -2.0, 5.0)
    car.drives(INF, INF, 5.0)
    assert car.warning == warning
    assert all(car.drives(2.0, 2.0, 2.3))
    car.drives(2.0, 2.0, 0.4)
    assert car.warning == ""


def test_warning_stays_while_the_same_side_is_driven_only_just_right(car):
    car.drives(2.0, 3.2, 3.0)
    assert all(car.drives(2.0, 2.9, 5.0))


@pytest.mark.parametrize("driven_m, is_right", [(-15.0, False), (-17.5, True)])
def test_warning_of_straight_on_ends_at_0_8_of_the_tolerance(car, driven_m, is_right):
    """At 1 m/s that is 0.8 · (1/20 + 0.05/2) = 0.06 1/m, or 16.7 m."""
    car.drives(INF, -7.0, 3.0)
    car.drives(INF, driven_m, 5.0)
    assert (car.warning == "") == is_right


def test_warnings_of_both_sides_are_reported_together(car):
    car.drives(2.0, -2.0, 3.0)
    car.drives(-2.0, 2.0, 3.0)
    assert "commanded left, 2.0 m, the car went right" in car.warning
    assert "; commanded right, 2.0 m, the car went left" in car.warning


def test_wrong_side_estimate_and_settling_take_half_a_second_each():
    """Each report comes after a tenth of a second."""
    car = Car()
    warnings = car.drives(2.0, -2.0, 1.3, step_ns=S // 10)
    # Its own half second, and half a second for the servo, from the second report on.
    assert [bool(each) for each in warnings].index(True) == 11
    car = Car()
    estimates = []
    for _ in range(8):
        car.drives(2.0, 2.0, 0.1, step_ns=S // 10)
        estimates.append(car.judge().estimated_m)
    assert [math.isnan(each) for each in estimates] == [True] * 6 + [False] * 2


@pytest.mark.parametrize("radius_m, text", [(1500.0, "straight on"), (-999.0, "right, 999.0 m")])
def test_turn_that_is_wider_than_a_kilometre_is_straight_on_in_words(car, radius_m, text):
    assert f"the car went {text}:" in car.drives(1.0, radius_m, 3.0)[-1]
