"""The linkage's backlash is found."""
from __future__ import annotations

import numpy as np
import pytest

from calibration.steering.synthetic import LEFT_STOP, RIGHT_STOP, drive, mixed, true_curvature
from car_interface.calibration.steering import fit

pytestmark = pytest.mark.once


@pytest.mark.parametrize("backlash", (0.0, 12.0, 30.0, 60.0))
def test_backlash_is_found_and_the_curve_is_that_of_its_middle(backlash):
    duties = np.concatenate([mixed(), mixed(seed=4)])
    found = fit.fit([drive(duties, backlash=backlash)])
    assert found.backlash_duty == pytest.approx(backlash, abs=6)
    inside = (found.duties > LEFT_STOP + 100) & (found.duties < RIGHT_STOP - 100)
    assert np.abs(found.curvatures - true_curvature(found.duties))[inside].max() < 0.01
