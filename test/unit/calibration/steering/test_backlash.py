"""The linkage's backlash is found."""
from __future__ import annotations

import numpy as np
import pytest

from calibration.steering.synthetic import LEFT_STOP, RIGHT_STOP, drive, mixed, true_curvature
from car_interface.calibration.steering import fit

pytestmark = pytest.mark.once


@pytest.mark.parametrize("backlash", (0.0, 30.0, 60.0))
def test_backlash_is_found_and_the_curve_is_that_of_its_middle(backlash):
    found = fit.fit([drive(mixed(count=60), backlash=backlash, hold_s=2.0)])
    assert found.backlash_duty == pytest.approx(backlash, abs=6)
    inside = (found.duties > LEFT_STOP + 100) & (found.duties < RIGHT_STOP - 100)
    assert np.abs(found.curvatures - true_curvature(found.duties))[inside].max() < 0.01
