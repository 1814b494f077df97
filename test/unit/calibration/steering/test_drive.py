"""The input of a steering fit and its settings."""
from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from car_interface.calibration.delay import Delay
from car_interface.calibration.steering.drive import (
    COUNT,
    DEFAULTS,
    KNOT,
    MAX_BACKLASH_DUTY,
    Drive,
    FitConfig,
    NothingToFit,
)


def test_count_is_that_of_a_12_bit_board_in_16_bit_duty():
    assert COUNT == 65536 / 4096
    assert KNOT * 2 == COUNT


def test_drive_has_odometry_and_duty_with_times_of_their_own():
    drive = Drive(np.arange(3.0), np.zeros(3), np.zeros(3), np.array([0.5]), np.array([5200.0]))
    assert drive._fields == ("t_s", "distance_m", "yaw_rad", "duty_t_s", "duty")
    assert len(drive.t_s) == len(drive.distance_m) == len(drive.yaw_rad) == 3
    assert len(drive.duty_t_s) == len(drive.duty) == 1


def test_servo_delay_and_backlash_are_estimated_by_default():
    assert FitConfig() == DEFAULTS
    assert DEFAULTS.delay is None and DEFAULTS.backlash_duty is None
    assert DEFAULTS.max_backlash_duty == MAX_BACKLASH_DUTY
    assert DEFAULTS.limits == ()


def test_servo_delay_and_backlash_can_be_given():
    config = FitConfig(delay=Delay(0.1, 0.2, 1.0), backlash_duty=0.0, limits=(3277, 6554))
    assert config.delay.settled_s == pytest.approx(0.7)  # the delay and three lags
    assert config.backlash_duty == 0.0 and config.limits == (3277, 6554)


def test_segment_has_a_shortest_and_a_longest_length():
    assert 0 < DEFAULTS.min_length_m < DEFAULTS.max_length_m


def test_settings_cannot_be_changed():
    with pytest.raises(dataclasses.FrozenInstanceError):
        DEFAULTS.min_speed_mps = 0.0


def test_nothing_to_fit_is_a_value_error_with_the_reason():
    error = NothingToFit("the car never moved")
    assert isinstance(error, ValueError) and str(error) == "the car never moved"
