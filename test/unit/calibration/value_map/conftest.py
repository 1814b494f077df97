"""A fit that several tests look at."""
from __future__ import annotations

import pytest

from calibration.value_map.synthetic import drive
from car_interface.calibration.value_map.fit import fit


@pytest.fixture(scope="session")
def mixed():
    return fit([drive(uphill=(0.012, -0.016), sag=0.1)], None, None)
