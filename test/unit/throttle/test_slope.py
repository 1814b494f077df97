"""By how much less than configured a car slows down, as its wheels show it."""
from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from car_interface.throttle.esc_config import EscConfig
from car_interface.throttle.slope import Slope

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
def test_on_level_ground_nothing_is_lacking_whatever_the_motor_s_lag(lag_s, late_ms):
    car = Car(lag_s=lag_s, late_ms=late_ms)
    assert not car.slope.is_known(False)
    car.run(0.5, 0.4, 2.3)
    slope = car.run(1.0)
    assert slope.is_known(False)
    assert slope.lacks_mps2(False) == slope.brake_lacks_mps2(False) == 0.0


@pytest.mark.parametrize("downhill_mps2", [0.2, 0.49])
@pytest.mark.parametrize("lag_s", [0.02, 0.15])
def test_downhill_the_drag_lacks_what_gravity_pulls_and_a_little_more(downhill_mps2, lag_s):
    car = Car(downhill_mps2=downhill_mps2, lag_s=lag_s)
    car.run(0.5, 0.4, 2.3)
    slope = car.run(1.2)
    assert downhill_mps2 - 0.01 <= slope.lacks_mps2(False) <= downhill_mps2 + 0.1
    assert slope.brake_lacks_mps2(False) == slope.lacks_mps2(False)


def test_what_the_motor_still_pushes_is_not_taken_for_a_slope():
    car = Car(lag_s=0.15)
    car.run(0.6, 1.0, 5.0)
    for _ in range(60):
        assert car.run(0.02).lacks_mps2(False) == 0.0


def test_where_drag_is_as_strong_as_configured_it_is_known_before_the_motor_has_let_go():
    car = Car(speed_mps=0.3)
    car.run(0.2, 0.25, 1.0, drag_mps2=0.45)
    assert car.run(0.4, drag_mps2=0.45).is_known(False)


def test_uphill_nothing_is_gained():
    slope = Car(speed_mps=2.0, downhill_mps2=-0.4).run(1.0)
    assert slope.is_known(False) and slope.lacks_mps2(False) == 0.0


def test_forward_and_backward_are_measured_each_for_itself():
    car = Car(speed_mps=-1.0, downhill_mps2=-0.25)  # downhill is backward here
    slope = car.run(1.2)
    assert slope.is_known(True) and not slope.is_known(False)
    assert slope.lacks_mps2(True) == pytest.approx(0.29, abs=0.05)
    assert slope.lacks_mps2(False) == 0.0


def test_a_weak_brake_lacks_what_it_lacks_and_says_nothing_about_drag():
    car = Car(speed_mps=3.0)
    slope = car.run(1.2, -0.5, -0.7)
    assert slope.brake_lacks_mps2(False) == pytest.approx(1.5 - 1.0 + 0.04, abs=0.03)
    assert slope.lacks_mps2(False) == 0.0 and not slope.is_known(False)
    assert Car(speed_mps=3.0).run(0.8, -0.5, -2.0).brake_lacks_mps2(False) == 0.0


@pytest.mark.parametrize(("speed_mps", "brakes_s"), [(1.6, 0.36), (0.62, 0.3)], ids=["it_rolls_on", "it_stands_soon"])
def test_what_is_left_of_a_brake_is_not_taken_for_drag(speed_mps, brakes_s):
    car = Car(speed_mps=speed_mps, lag_s=0.15, downhill_mps2=0.25)
    car.run(brakes_s, -0.5, -2.0)
    for _ in range(20):
        assert not car.run(0.02).is_known(False)
    assert speed_mps < 1.0 or car.run(1.0).lacks_mps2(False) == pytest.approx(0.25, abs=0.1)


def test_what_was_lacking_is_given_back_slowly_by_later_measurements():
    car = Car(downhill_mps2=0.2, speed_mps=2.0)
    before_mps2 = car.run(1.0).lacks_mps2(False)
    car.downhill_mps2 = 0.0
    car.run(2.0, 0.2, 0.3)
    assert car.run(1.0).lacks_mps2(False) == pytest.approx(before_mps2 - 0.1, abs=0.03)


def test_it_takes_more_than_a_glance_to_find_that_less_is_lacking():
    car = Car(speed_mps=2.0, downhill_mps2=0.2)
    car.run(1.0)
    car.downhill_mps2 = 0.0
    car.run(3.5, 0.1, 0.3)
    assert car.run(0.4).lacks_mps2(False) > 0.2 > car.run(0.6).lacks_mps2(False) + 0.1


def test_a_shortfall_is_known_for_three_seconds_and_a_level_drive_for_as_long_as_it_lasts():
    level, downhill = Car(speed_mps=2.0), Car(speed_mps=2.0, downhill_mps2=0.3)
    for car in (level, downhill):
        car.run(1.0)
        assert car.slope.is_known(False)
        car.run(3.5, 0.2, 0.3 - car.downhill_mps2)
    assert level.slope.is_known(False) and not downhill.slope.is_known(False)
    assert downhill.run(0.8).is_known(False)


def test_a_car_that_has_stood_for_long_or_has_turned_before_it_stood_has_to_be_measured_again():
    stood, turned, straight = Car(), Car(), Car()
    turned.curvature_per_m = 1.0
    for car in (stood, turned, straight):
        car.run(1.0)
        car.run(2.0, 0.2, 0.3)
        assert car.slope.is_known(False)
        car.run(1.0, -0.5, -3.0, drag_mps2=0.0)
        car.speed_mps = 0.0
        car.force_mps2 = 0.0
        car.run(0.5)
    assert straight.slope.is_known(False) and not turned.slope.is_known(False)
    assert not stood.run(3.5).is_known(False)


def test_what_stands_in_neutral_has_a_little_drag_left():
    car = Car(downhill_mps2=0.45)
    assert car.run(1.5).lacks_mps2(False) > 0.3
    car.speed_mps = car.downhill_mps2 = 0.0
    slope = car.run(1.5)
    # It may roll more freely than it stands.
    assert slope.lacks_mps2(False) == pytest.approx(0.18) and not slope.is_known(False)


def test_a_car_that_stops_in_neutral_before_it_could_be_measured_slows_down_well():
    car = Car(speed_mps=0.3)
    car.run(0.1, 0.2, 0.3)
    assert car.run(0.5, drag_mps2=2.0).is_known(False)


def test_the_present_acceleration_is_that_of_the_magnitude():
    assert Car(speed_mps=1.0).run(0.5, 0.5, 1.3).acceleration_mps2 == pytest.approx(1.0, abs=0.05)
    assert Car(speed_mps=-1.0).run(0.5, -0.5, -1.3).acceleration_mps2 == pytest.approx(1.0, abs=0.05)
    assert Slope(ESC).acceleration_mps2 == 0.0


@settings(max_examples=40)
@given(speeds=st.lists(st.one_of(st.floats(-5.0, 5.0), st.just(math.nan), st.just(math.inf)), max_size=80),
       fraction=st.sampled_from([0.0, 0.4, -0.5]))
def test_whatever_it_is_told_it_only_ever_takes_away(speeds, fraction):
    slope = Slope(ESC)
    slope.update_esc(fraction, 10 * S)
    for index, speed_mps in enumerate(speeds):
        slope.update_speed(speed_mps, 10 * S + index * 20 * MS, 0.5)
        for is_backward in (False, True):
            assert 0.0 <= slope.lacks_mps2(is_backward) <= slope.brake_lacks_mps2(False) or is_backward
            assert math.isfinite(slope.lacks_mps2(is_backward)) and math.isfinite(slope.acceleration_mps2)


def test_one_that_comes_to_stand_before_it_is_measured_lacks_what_it_lacked_on_the_whole():
    car = Car(speed_mps=0.2, downhill_mps2=0.1)
    car.run(0.06, 0.2, 0.2)
    slope = car.run(0.62)
    assert slope.is_known(False)
    assert 0.05 <= slope.lacks_mps2(False) <= 0.2


def test_what_climbs_is_expected_to_go_down_after_a_turn_and_has_a_little_drag_left_to_find_out():
    car = Car(speed_mps=2.0, downhill_mps2=-0.4)
    slope = car.run(1.0)
    assert slope.lacks_mps2(False, 0.0) == slope.lacks_mps2(False, 0.2) == 0.0
    for expected_mps2 in (slope.lacks_mps2(False, 2.0), slope.lacks_mps2(False, -2.0), slope.lacks_mps2(True)):
        assert expected_mps2 == pytest.approx(0.18)
    car.curvature_per_m, car.downhill_mps2 = 2.0, 0.0
    car.run(1.2, 0.2, 0.3)  # about 150° round
    assert not slope.is_known(False) and slope.lacks_mps2(False) == pytest.approx(0.18)
    car.curvature_per_m = 0.0
    car.run(0.8)  # it is level there: that was drag
    assert slope.is_known(False) and slope.lacks_mps2(False) == 0.0
