"""The command line of calibration_drive."""
from __future__ import annotations

import pytest

from car_interface.calibration.drive.config import DriveConfig
from car_interface.calibration.drive.options import drive_config, parse
from car_interface.common.errors import ConfigError


def test_options_are_read_and_those_of_the_drive_are_its_settings():
    made = parse([])
    assert (made.output, made.base, made.yes, made.stick, made.no_sonars) == (None, None, False, False, False)
    assert drive_config(made) == DriveConfig()
    made = parse(["-o", "a.yaml", "--base", "b.yaml", "--yes", "--stick", "--no-sonars", "--radius", "4", "--speed",
                  "1", "--tight-speed", "0.8", "--max-time", "60", "--braking", "0.5"])
    assert (made.output, made.base, made.yes, made.stick, made.no_sonars) == ("a.yaml", "b.yaml", True, True, True)
    assert drive_config(made) == DriveConfig(4.0, 1.0, 0.8, 60.0, 0.5)


@pytest.mark.parametrize(("given", "begin"), [
    (["--radius", "1"], "radius is 1.0; accepted: a number from 2.5 to 100"),
    (["--max-time", "5"], "max_time is 5.0; accepted: a number from 30 to 3600"),
    (["--speed", "nan"], "speed is nan; accepted: a number from ")])
def test_setting_out_of_range_is_named(given, begin):
    with pytest.raises(ConfigError) as raised:
        drive_config(parse(given))
    assert str(raised.value).startswith(begin)


def test_help_says_what_happens_and_what_it_takes(capsys):
    with pytest.raises(SystemExit) as raised:
        parse(["--help"])
    shown = capsys.readouterr().out
    assert raised.value.code == 0
    for words in ("autonomous deadman and watch", "throttle:=true planner:=speed", "Let go, and it stops",
                  "6 x 6 m", "--stick", "--radius M", "(default: 3)"):
        assert words in shown
