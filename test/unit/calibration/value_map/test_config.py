"""The settings of a value map's fit."""
from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from car_interface.calibration.value_map.acceleration import WindowConfig
from car_interface.calibration.value_map.config import DEFAULTS, ROUGHNESS, FitConfig


def test_defaults_are_those_of_a_config_without_arguments():
    assert FitConfig() == DEFAULTS
    assert DEFAULTS.window == WindowConfig() and DEFAULTS.roughness == ROUGHNESS


def test_delay_is_estimated_and_wheels_measure_by_default():
    assert DEFAULTS.delay_s is None and DEFAULTS.from_imu is False


def test_roughness_over_values_is_near_that_of_a_throttle_curve():
    # The second derivative of 6·u^1.5, 4.5/√u, averaged over 0..1, is the first derivative at 1: 9.
    u = (np.arange(100_000) + 0.5) / 100_000
    assert ROUGHNESS[0] == pytest.approx(np.mean(4.5 / np.sqrt(u)), rel=0.15)


def test_two_manoeuvres_support_a_node():
    assert DEFAULTS.support_manoeuvres == 2
    # No window is known better than min_sigma_mps2: a bound below it could hardly be met.
    assert DEFAULTS.support_sigma_mps2 > DEFAULTS.min_sigma_mps2 > 0


def test_one_setting_changes_alone():
    changed = dataclasses.replace(DEFAULTS, neutral=4915.0, delay_s=0.08)
    assert (changed.neutral, changed.delay_s) == (4915.0, 0.08)
    assert dataclasses.replace(changed, neutral=0.0, delay_s=None) == DEFAULTS


def test_settings_cannot_be_changed():
    with pytest.raises(dataclasses.FrozenInstanceError):
        DEFAULTS.neutral = 1.0
