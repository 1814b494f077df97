"""The command line of calibration_drive."""
from __future__ import annotations

import pytest

from car_interface.calibration.drive.options import parse


def test_defaults():
    made = parse([])
    assert (made.output, made.base, made.yes, made.stick) == (None, None, False, False)


def test_all_of_them():
    made = parse(["-o", "a.yaml", "--base", "b.yaml", "--yes", "--stick"])
    assert (made.output, made.base, made.yes, made.stick) == ("a.yaml", "b.yaml", True, True)


def test_help_says_what_happens_and_what_it_takes(capsys):
    with pytest.raises(SystemExit) as raised:
        parse(["--help"])
    shown = capsys.readouterr().out
    assert raised.value.code == 0
    for words in ("while you hold the autonomous deadman", "throttle:=true planner:=speed", "Let go, and it stops",
                  "6 x 6 m", "--stick", "_radius 3.0"):
        assert words in shown


def test_unknown_option_ends_with_code_2(capsys):
    with pytest.raises(SystemExit) as raised:
        parse(["--stik", "x"])
    assert raised.value.code == 2
