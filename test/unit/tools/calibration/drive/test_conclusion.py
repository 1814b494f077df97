"""The end of a drive: the tool's own table and report, or its refusal."""
from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml

from car_interface.tools.calibration.drive.conclusion import conclude
from car_interface.tools.calibration.drive.samples import Samples
from tools.calibration.drive.light_car import base
from tools.calibration.steering.synthetic import drive, mixed, true_curvature

pytestmark = pytest.mark.once
BASE_TEXT = (Path(__file__).resolve().parents[5] / "config/turn_arb.yaml").read_text(encoding="utf-8")


def recorded(whole):
    """The samples of a synthetic drive."""
    return SimpleNamespace(drive=lambda: whole, duration_s=float(whole.t_s[-1]))


def test_enough_gives_the_file_with_center_and_ends_unless_its_base_cannot_be_edited():
    whole = recorded(drive(mixed(3900, 6400)))
    found = conclude(whole, base(), BASE_TEXT, "drive.bag")
    assert found.refusal == "" and found.center_duty == pytest.approx(5200, abs=10)
    assert found.ends_duty == pytest.approx((3900, 6400), abs=20)
    values = yaml.safe_load(found.yaml_text)
    assert values["servo_center"] == found.center_duty and values["input_timeout"] == 0.5
    radii, duties = values["m_turnrad_axis_servo"], values["k_pwmcmd_left_table_servo"]
    inside = [(radius, duty) for radius, duty in zip(radii, duties) if 1.3 < radius < 6]
    assert np.allclose([true_curvature(duty) for _, duty in inside], [1 / radius for radius, _ in inside], rtol=0.03)
    assert found.report[0].startswith("steering by drive.bag: 120 s")
    assert len(found.report) < 20 < len([line for line in found.yaml_text.splitlines() if line.startswith("#")])
    found = conclude(whole, base(), "[]", "drive.bag")
    assert found.yaml_text == "" and found.refusal


def test_too_little_is_refused_in_the_tools_words():
    found = conclude(recorded(drive(mixed(5200, 6400))), base(), BASE_TEXT, "drive.bag")
    assert found.yaml_text == "" and "left turns" in found.refusal and found.center_duty == 0
    assert "; ".join(found.missing) == found.refusal


def test_without_samples_it_says_so():
    found = conclude(Samples(), base(), BASE_TEXT, "drive.bag")
    assert found.refusal.startswith("drive.bag: no steering can be told from this") and found.report == ()


def test_exchanged_ends_are_refused():
    whole = drive(mixed(3900, 6400), curve=lambda duty: -true_curvature(duty))
    found = conclude(recorded(whole), base(), BASE_TEXT, "drive.bag")
    assert found.yaml_text == "" and "exchange servo_left and servo_right" in found.refusal and found.missing == ()
