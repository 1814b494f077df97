"""Stops and limits at the ends of a curve."""
import numpy as np
import pytest

from car_interface.tools.calibration.steering import fit
from car_interface.tools.calibration.steering.drive import CurveFitConfig
from car_interface.tools.calibration.steering.ends import find_side
from car_interface.tools.calibration.steering.table import END, RIGHT, breakpoints
from tools.calibration.steering.synthetic import KNOWN_DELAY, drive, mixed

pytestmark = pytest.mark.once


def test_limit_of_the_stick_is_an_end_too():
    found = fit.fit([drive(mixed(low=3700, high=6000))], CurveFitConfig(limits=(3800, 6000), delay=KNOWN_DELAY))
    assert found.right.is_end and not found.right.is_stop
    assert breakpoints(found, [1.0], RIGHT)[0].source == END


@pytest.mark.parametrize("backlash_duty, is_end", [(0.0, False), (20.0, False), (32.0, True), (60.0, True)])
def test_end_that_the_wheels_miss_by_half_of_the_backlash_counts_as_driven(backlash_duty, is_end):
    low, high, limit = 4000.0, 6000.0, 6032.0  # two counts beyond what the wheels did
    knots = np.arange(low, high + 1, 8.0)
    side = find_side(knots, (5000.0 - knots) / 1000, np.full(len(knots), 0.001), 1, low, high,
                     (3000.0, limit), backlash_duty)
    assert (side.is_end, side.is_stop, side.duty) == (is_end, False, high)
