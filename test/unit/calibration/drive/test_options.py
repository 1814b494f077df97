"""The command line of calibration_drive."""
from __future__ import annotations

from car_interface.calibration.drive.config import DriveConfig
from car_interface.calibration.drive.options import drive_config, parse


def test_options_are_read_and_those_of_the_drive_are_its_settings():
    made = parse([])
    assert (made.output, made.base, made.yes, made.stick, made.no_sonars) == (None, None, False, False, False)
    assert drive_config(made) == DriveConfig()
    made = parse(["-o", "a.yaml", "--base", "b.yaml", "--yes", "--stick", "--no-sonars", "--radius", "4", "--speed",
                  "1", "--tight-speed", "0.8", "--max-time", "60", "--braking", "0.5"])
    assert (made.output, made.base, made.yes, made.stick, made.no_sonars) == ("a.yaml", "b.yaml", True, True, True)
    assert drive_config(made) == DriveConfig(4.0, 1.0, 0.8, 60.0, 0.5)
