"""Settings of the drive: what is impossible is named as the parameter."""
from __future__ import annotations

import math

import pytest

from car_interface.calibration.drive.config import DEFAULTS, DriveConfig
from car_interface.common.errors import ConfigError


@pytest.mark.parametrize("field, value, parameter", [
    ("radius_m", 1.0, "radius"), ("speed_mps", 0.0, "speed"), ("tight_speed_mps", 5.0, "tight_speed"),
    ("max_time_s", 0.0, "max_time"), ("braking_mps2", 0.0, "braking"), ("radius_m", math.nan, "radius"),
])
def test_an_impossible_number_is_refused_by_its_parameters_name(field, value, parameter):
    with pytest.raises(ConfigError, match=rf"^{parameter}\b.*a number from"):
        DriveConfig(**{field: value})


def test_the_default_is_six_metres_and_five_minutes():
    assert (2 * DEFAULTS.radius_m, DEFAULTS.max_time_s, DEFAULTS.obstacles) == (6.0, 300.0, None)
