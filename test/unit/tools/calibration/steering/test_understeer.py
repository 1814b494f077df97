"""By how much a car's turns widen with speed, from drives of a car whose steering is known."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from car_interface.tools.calibration.steering import fit
from tools.calibration.steering.synthetic import KNOWN, drive, mixed, true_curvature

pytestmark = pytest.mark.once

PLACES = mixed(3700, 6600, 24)


def widened(understeer, speed_mps):
    """The curve that a car drives at a speed: κ₀ = κ + q κ² v⁴."""
    loss = understeer * speed_mps ** 4

    def curve(duty):
        slow = np.abs(true_curvature(duty))
        driven = 2 * slow / (1 + np.sqrt(1 + 4 * loss * slow))
        return np.copysign(driven, true_curvature(duty))
    return curve


def drives(understeer, speeds_mps=(0.7, 1.3, 1.9)):
    return [drive(PLACES, curve=widened(understeer, speed_mps), speed_mps=speed_mps, seed=seed, start_s=1000.0 * seed)
            for seed, speed_mps in enumerate(speeds_mps)]


def test_it_is_found_where_the_same_turns_were_driven_at_several_speeds_and_the_curve_is_that_of_a_crawl():
    found = fit.fit(drives(0.0078), KNOWN)
    assert found.understeer.is_known
    assert found.understeer.value == pytest.approx(0.0078, abs=3 * found.understeer.sigma)
    assert found.understeer.value == pytest.approx(0.0078, rel=0.15)
    inside = (found.duties > 4000) & (found.duties < 6300)
    assert np.abs(found.curvatures - true_curvature(found.duties))[inside].max() < 0.02


def test_a_car_that_has_none_gets_none():
    found = fit.fit(drives(0.0), KNOWN)
    assert found.understeer.is_known and found.understeer.value == 0.0


def test_at_one_speed_it_is_not_known_and_the_calibration_s_own_is_taken():
    (one,) = drives(0.0078, (1.9,))
    for given, is_near in ((0.0078, True), (0.0, False)):
        found = fit.fit([one], replace(KNOWN, understeer=given))
        assert not found.understeer.is_known
        inside = (found.duties > 4000) & (found.duties < 6300)
        assert (np.abs(found.curvatures - true_curvature(found.duties))[inside].max() < 0.02) is np.bool_(is_near)
