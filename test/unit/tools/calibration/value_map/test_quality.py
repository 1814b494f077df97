"""How well a map is known: standard errors, held-out driving, supported nodes."""
from __future__ import annotations

import numpy as np
import pytest

from car_interface.tools.calibration.value_map.acceleration import Drive, Series
from car_interface.tools.calibration.value_map.config import FitConfig
from car_interface.tools.calibration.value_map.fit import fit
from tools.calibration.value_map.synthetic import DELAY_S, acceleration, drive, fitted_mixed

pytestmark = pytest.mark.once


def test_error_is_of_the_size_that_the_standard_errors_say():
    mixed = fitted_mixed()
    truth = acceleration(mixed.values[:, None], mixed.velocities[None, :])
    ratios = (np.abs(mixed.accelerations - truth) / mixed.sigma_mps2)[mixed.supported]
    assert np.mean(ratios < 2) > 0.8


def test_held_out_manoeuvres_are_predicted_nearly_as_well_as_the_others():
    mixed = fitted_mixed()
    assert mixed.held_out_windows > 50
    assert mixed.held_out_mps2 < 1.5 * mixed.residual_mps2 + 0.01


def test_velocities_never_driven_are_not_supported():
    found = fit([drive(seconds=120.0)], np.array([-3.0, 0.0, 2.0]), np.array([0.0, 1.0, 3.0, 5.0, 12.0, 14.0]),
                FitConfig(delay_s=DELAY_S))
    assert not found.supported[:, 4:].any() and found.supported[:, 2].all()
    assert (list(found.values), list(found.velocities)) == ([-3.0, 0.0, 2.0], [0.0, 1.0, 3.0, 5.0, 12.0, 14.0])


def test_a_drive_of_one_value_supports_no_other():
    one = drive(seconds=60.0)
    lonely = Drive("a", Series(one.value.t_s, np.full(one.value.y.size, 1.0)), one.speed, one.yaw, one.wheels)
    found = fit([lonely], np.array([-1.0, 0.0, 1.0, 2.0]), None, FitConfig(delay_s=0.0))
    assert not found.supported[[0, 1, 3]].any()
