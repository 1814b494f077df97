"""By how much a car's turns widen with speed, from drives of a car whose steering is known."""
import numpy as np
import pytest

from car_interface.steering.calibration import driven_radius_m
from car_interface.tools.calibration.steering import fit
from slash import SKIDPAD
from tools.calibration.steering.synthetic import KNOWN, drive, mixed, true_curvature

pytestmark = pytest.mark.once

PLACES = mixed(3700, 6600, 24)
TRUE_RATIO = 0.96  # of that car's speed to the one that was asked for


def widened(understeer, speed_mps):
    """The curve that a car drives at a speed: κ₀ = κ + q (3.5 a + a³ / 3.5) / 2, a = v² κ."""
    driven = np.linspace(-1.1, 1.1, 20001)
    lateral_mps2 = speed_mps ** 2 * driven
    slow = driven + understeer * (3.5 * lateral_mps2 + lateral_mps2 ** 3 / 3.5) / 2
    return lambda duty: np.interp(true_curvature(duty), slow, driven)


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


def circles(speeds_mps=(0.48, 0.96, 1.44), ratios=()):
    """Steady circles of a real car at three positions, a recording each; true speeds are 4 % below those asked for.

    Args:
        ratios: by which the car's radii at each of the speeds are multiplied; empty = as they are.
    """
    return [drive([5200 - 2000 * angle], curve=lambda duty, radius_m=radius_m: np.full(len(duty), 1 / radius_m),
                  speed_mps=speed_mps, hold_s=20 / speed_mps, seed=index, start_s=1000.0 * index)
            for angle, rows in SKIDPAD.items()
            for index, (speed_mps, radius_m) in enumerate(
                (speed_mps, rows[round(speed_mps / TRUE_RATIO, 1)] * ratio)
                for speed_mps, ratio in zip(speeds_mps, ratios or [1.0] * len(speeds_mps)))]


def test_circles_of_a_real_car_up_to_1_5_mps_tell_its_radii_at_2_and_2_5_mps():
    found = fit.fit(circles())
    assert found.understeer.is_known and found.understeer.places == 3
    for angle, rows in SKIDPAD.items():
        crawl_m = 1 / found.curvature(5200 - 2000 * angle)
        for asked_mps in (2.0, 2.5):
            predicted_m = driven_radius_m(crawl_m, TRUE_RATIO * asked_mps, found.understeer.value)
            assert predicted_m == pytest.approx(rows[asked_mps], rel=0.025)


def test_standard_error_is_a_tenth_at_least_as_sides_differ_and_that_between_places_where_they_differ_more():
    slow, all_speeds = (fit.fit(circles(speeds_mps)).understeer for speeds_mps in (
        (0.48, 0.96, 1.44), (0.48, 0.96, 1.44, 1.92, 2.4)))
    assert (slow.sigma, all_speeds.sigma) == pytest.approx((slow.value / 10, all_speeds.value / 10))
    assert abs(slow.value - all_speeds.value) < 2 * all_speeds.sigma, "the form holds"
    one = fit.fit(circles()[:6] + circles(ratios=(1.0, 1.02, 1.06))[6:]).understeer
    assert one.sigma > one.value / 10 and not one.is_known


def test_a_car_that_has_none_gets_none():
    found = fit.fit(drives(0.0), KNOWN)
    assert found.understeer.is_known and found.understeer.value == 0.0


def test_at_one_speed_it_is_not_known_and_the_calibration_s_own_is_taken():
    (one,) = drives(0.0078, (1.9,))
    for given, is_near in ((0.0078, True), (0.0, False)):
        found = fit.fit([one], KNOWN._replace(understeer=given))
        assert not found.understeer.is_known
        inside = (found.duties > 4000) & (found.duties < 6300)
        assert (np.abs(found.curvatures - true_curvature(found.duties))[inside].max() < 0.02) is np.bool_(is_near)
