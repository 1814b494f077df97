"""The smoothing spline and the nearest monotone sequence."""
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import sparse

from car_interface.tools.calibration.shared import rising
from car_interface.tools.calibration.steering import fit
from car_interface.tools.calibration.steering.segments import Segments
from car_interface.tools.calibration.steering.smooth import Smooth
from tools.calibration.steering.synthetic import KNOWN, LEFT_STOP, RIGHT_STOP, drive, mixed, true_curvature

pytestmark = pytest.mark.once


def test_smooth_curve_may_bend_a_little_where_it_was_straight_beside_a_sharp_corner():
    curve = Smooth.__new__(Smooth)
    curve.curvatures = np.maximum(0.0, np.arange(400) - 350.0)
    curve._second = sparse.diags([1.0, -2.0, 1.0], [0, 1, 2], shape=(398, 400), format="csr")
    local = curve._local()
    assert local.max() / local.min() < 1.001e5
    assert local.argmax() == pytest.approx(349, abs=1)


def test_curve_of_a_straight_steering_does_not_depend_on_rounding():  # as another version of LAPACK rounds
    drives = [drive(mixed(3700, 6600, 24), speed_mps=speed_mps, seed=seed) for seed, speed_mps in enumerate((0.7, 1.3))]
    found = Segments(drives, KNOWN.delay).observations(0.0)
    curvatures, rng = Smooth(found).curvatures, np.random.default_rng(1)
    for _ in range(3):
        rounded = found.curvature_per_m * (1 + 1e-14 * rng.standard_normal(len(found.duty)))
        assert np.abs(Smooth(found._replace(curvature_per_m=rounded)).curvatures - curvatures).max() < 1e-6


def test_outlying_segments_are_left_out_and_counted():
    good = drive(mixed(count=60))
    yaw = good.yaw_rad.copy()
    for begin in (1055, 4055, 7055):  # the car was pushed
        yaw[begin:begin + 140] += np.linspace(0, 1.5, 140)
        yaw[begin + 140:] += 1.5
    found = fit.fit([good._replace(yaw_rad=yaw)], KNOWN)
    assert found.counts["apart from all others"] >= 2
    inside = (found.duties > LEFT_STOP + 100) & (found.duties < RIGHT_STOP - 100)
    assert np.abs(found.curvatures - true_curvature(found.duties))[inside].max() < 0.02


@given(st.lists(st.tuples(st.floats(-1e3, 1e3), st.floats(1e-3, 1e3)), min_size=1, max_size=40))
def test_nearest_rising_sequence_rises_and_leaves_a_rising_one_alone(pairs):
    values, weights = (np.array(column) for column in zip(*pairs))
    made = rising(values, weights)
    assert len(made) == len(values) and np.all(np.diff(made) >= -1e-9)
    assert np.average(made, weights=weights) == pytest.approx(np.average(values, weights=weights), abs=1e-6)
    assert np.allclose(rising(np.sort(values), weights), np.sort(values))
