"""The command line of calibration_drive, and the drive's settings: what is impossible is named as the parameter."""
from __future__ import annotations

import math

import pytest

from car_interface.common.errors import ConfigError
from car_interface.tools.calibration.drive.config import DriveConfig
from car_interface.tools.calibration.drive.options import drive_config, parse


def test_options_are_read_and_those_of_the_drive_are_its_settings():
    made = parse([])
    assert (made.output, made.base, made.yes, made.stick, made.no_sonars) == (None, None, False, False, False)
    assert drive_config(made) == DriveConfig()
    made = parse(["-o", "a.yaml", "--base", "b.yaml", "--yes", "--stick", "--no-sonars", "--radius", "4", "--speed",
                  "1", "--tight-speed", "0.8", "--max-time", "60", "--braking", "0.5"])
    assert (made.output, made.base, made.yes, made.stick, made.no_sonars) == ("a.yaml", "b.yaml", True, True, True)
    assert drive_config(made) == DriveConfig(4.0, 1.0, 0.8, 60.0, 0.5)


@pytest.mark.parametrize("field, value, parameter", [
    ("radius_m", 1.0, "radius"), ("speed_mps", 0.0, "speed"), ("tight_speed_mps", 5.0, "tight_speed"),
    ("max_time_s", 0.0, "max_time"), ("braking_mps2", 0.0, "braking"), ("radius_m", math.nan, "radius"),
])
def test_an_impossible_number_is_refused_by_its_parameters_name(field, value, parameter):
    with pytest.raises(ConfigError, match=rf"^{parameter}\b.*a number from"):
        DriveConfig(**{field: value})
