"""Standard errors hold the truth, also between the places that were driven."""
from types import SimpleNamespace

import numpy as np
import pytest

from car_interface.tools.calibration.steering import fit
from car_interface.tools.calibration.steering.smooth import BAND, UNSEEN_RATIO, bends, unseen
from tools.calibration.steering.synthetic import KNOWN, drive, fitted_steep, steep_ends, true_curvature

pytestmark = pytest.mark.once


def test_bands_hold_the_truth_where_a_steering_is_steep_and_where_it_is_nearly_level():
    found = fitted_steep()
    off = np.abs(found.curvatures - steep_ends(found.duties))
    assert np.mean(off <= BAND * found.sigmas) > 0.95
    assert found.backlash_duty == pytest.approx(6.0, abs=0.3)


def test_between_places_that_differ_the_band_holds_a_stop_that_nobody_drove_at():
    duties = np.concatenate([[3500, 3600, 3700], np.arange(3984, 6700, 48)])
    found = fit.fit([drive(np.random.default_rng(1).permutation(16 * np.round(duties / 16)), hold_s=2.0)], KNOWN)
    inside = (found.duties > 3700) & (found.duties < 3984)
    off = np.abs(found.curvatures - true_curvature(found.duties))[inside]
    assert np.all(off <= BAND * found.sigmas[inside])
    bend = bends(found.duties, found.observations)[inside]
    assert bend.max() > 0.03 and BAND * found.sigmas[inside].max() > bend.max() / 2


def s_shaped(duty):
    """As steep on both sides of 4600 to 4850, flatter and then steeper within."""
    return np.interp(duty, (4000, 4600, 4750, 4850, 5600), (0.4, 0.16, 0.108, 0.06, -0.24))


def test_the_band_holds_a_bend_in_a_gap_whose_two_sides_are_as_steep_as_each_other():
    duties = np.concatenate([np.arange(4000, 4601, 40), np.arange(4850, 5600, 40)])
    found = fit.fit([drive(np.random.default_rng(2).permutation(duties), curve=s_shaped, hold_s=2.0)],
                    KNOWN)
    inside = (found.duties > 4600) & (found.duties < 4850)
    off = np.abs(found.curvatures - s_shaped(found.duties))[inside]
    assert off.max() > 0.005
    assert np.all(off <= BAND * found.sigmas[inside])


def observations_at(duty, curvature):
    return SimpleNamespace(duty=np.array(duty, float), curvature_per_m=np.array(curvature), sigma_per_m=np.full(
        len(duty), 1e-4))


def test_curve_may_bend_between_two_places_as_far_as_both_neighbours_lead():
    stop = observations_at([0, 100, 400, 500], [0.0, 0.0, 0.1, 0.2])  # level up to a corner at 300
    knots = np.array([100.0, 200.0, 300.0, 350.0, 400.0])
    bend = bends(knots, stop)
    assert bend == pytest.approx([0.0, 0.1 / 3, 0.2 / 3, 0.1 / 3, 0.0], abs=1e-3)
    straight = observations_at([0, 100, 400, 500], [0.0, 0.1, 0.4, 0.5])
    assert bends(knots, straight) == pytest.approx(np.zeros(5), abs=1e-9)


def test_unseen_bends_are_likelier_where_the_curve_changes_more_and_none_is_at_a_place_or_beyond_all():
    straight = observations_at([0, 100, 400, 800], [0.0, 0.1, 0.4, 0.4])
    duties = np.array([-50.0, 0.0, 50.0, 100.0, 175.0, 250.0, 400.0, 600.0, 900.0])
    assert unseen(duties, straight) == pytest.approx(
        UNSEEN_RATIO * np.array([0.0, 0.0, 0.1, 0.0, 0.225, 0.3, 0.0, 0.0, 0.0]))
    assert unseen(np.array([200.0]), observations_at([0, 400], [0.0, 0.4])) == pytest.approx([UNSEEN_RATIO * 0.4])
    assert unseen(duties[:2], observations_at([0], [0.1])) == pytest.approx([0.0, 0.0])
