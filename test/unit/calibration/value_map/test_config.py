"""The settings of a value map's fit."""
from __future__ import annotations

import numpy as np
import pytest

from car_interface.calibration.value_map.config import ROUGHNESS


def test_roughness_over_values_is_near_that_of_a_throttle_curve():
    # The second derivative of 6·u^1.5, 4.5/√u, averaged over 0..1, is the first derivative at 1: 9.
    u = (np.arange(100_000) + 0.5) / 100_000
    assert ROUGHNESS[0] == pytest.approx(np.mean(4.5 / np.sqrt(u)), rel=0.15)
