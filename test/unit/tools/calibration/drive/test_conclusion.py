"""The end of a drive: the tool's own table and report, or its refusal."""
import os
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import yaml

from car_interface.common.errors import CarInterfaceError
from car_interface.common.package_files import package_file
from car_interface.steering.config import load_steering
from car_interface.tools.calibration.drive.conclusion import board_center, conclude, find_table_file
from car_interface.tools.calibration.drive.survey import Samples
from tools.calibration.drive.light_car import base
from tools.calibration.steering.synthetic import drive, mixed, true_curvature

pytestmark = pytest.mark.once
STOCK = package_file("config/turn_arb.yaml")
STOCK_TEXT = STOCK.read_text(encoding="utf-8")


def recorded(whole):
    return SimpleNamespace(drive=lambda: whole, duration_s=float(whole.t_s[-1]))


def test_enough_gives_the_file_with_center_and_ends_unless_its_base_cannot_be_edited():
    whole = recorded(drive(mixed(3900, 6400)))
    found = conclude(whole, base(), STOCK_TEXT, "drive.bag")
    assert found.refusal == "" and found.center_duty == pytest.approx(5200, abs=10)
    values = yaml.safe_load(found.yaml_text)
    assert values["servo_center"] == found.center_duty and values["input_timeout"] == 0.5
    radii, duties = values["m_turnrad_axis_servo"], values["k_pwmcmd_left_table_servo"]
    inside = [(radius, duty) for radius, duty in zip(radii, duties) if 1.3 < radius < 6]
    assert np.allclose([true_curvature(duty) for _, duty in inside], [1 / radius for radius, _ in inside], rtol=0.03)
    assert found.report[0].startswith("steering by drive.bag: 120 s")
    assert len(found.report) < 20 < len([line for line in found.yaml_text.splitlines() if line.startswith("#")])
    found = conclude(whole, base(), "[]", "drive.bag")
    assert found.yaml_text == "" and found.refusal


@pytest.mark.parametrize("samples, said", [
    (recorded(drive(mixed(5200, 6400))), "left turns"),
    (Samples(), "drive.bag: no steering can be told from this"),
    (recorded(drive(mixed(3900, 6400), curve=lambda duty: -true_curvature(duty))), "exchange servo_left and"),
], ids=["too_little", "nothing", "exchanged_ends"])
def test_what_gives_no_table_is_refused_in_the_tool_s_words(samples, said):
    found = conclude(samples, base(), STOCK_TEXT, "drive.bag")
    assert found.yaml_text == "" and said in found.refusal
    assert found.center_duty == 0 and bool(found.report) == (said != "drive.bag: no steering can be told from this")
    assert "; ".join(found.missing) == (found.refusal if said == "left turns" else "")


RUNNING = load_steering(str(STOCK))


@pytest.fixture
def car(tmp_path):
    (tmp_path / "turn_arb.yaml").write_text(STOCK_TEXT.replace("input_timeout: 0.5", "input_timeout: 0.4"))
    return tmp_path / "turn_arb.yaml"


def test_file_that_turn_arb_was_launched_with_is_the_default(car, monkeypatch):
    table = find_table_file(None, None, str(car), RUNNING)
    assert table.path == car
    assert "input_timeout: 0.4" in table.base_text
    monkeypatch.chdir(car.parent)
    monkeypatch.setenv("HOME", str(car.parent))
    for typed in ("turn_arb.yaml", "~/turn_arb.yaml"):  # from the folder and the home of who types it
        assert find_table_file(typed, None, None, RUNNING).path == car


def test_named_file_keeps_its_other_parameters_or_gets_those_of_turn_arb_or_of_the_base(car, tmp_path):
    base, other, new = tmp_path / "base.yaml", tmp_path / "other.yaml", str(tmp_path / "new.yaml")
    base.write_text(STOCK_TEXT.replace("input_timeout: 0.5", "input_timeout: 0.2"))
    other.write_text(STOCK_TEXT.replace("input_timeout: 0.5", "input_timeout: 0.3"))
    assert "input_timeout: 0.3" in find_table_file(str(other), None, str(car), RUNNING).base_text
    assert "input_timeout: 0.4" in find_table_file(new, None, str(car), RUNNING).base_text
    assert "input_timeout: 0.2" in find_table_file(new, str(base), str(car), RUNNING).base_text
    assert find_table_file(new, None, None, RUNNING).base_text == STOCK_TEXT


@pytest.mark.parametrize("launched_with", [None, str(STOCK)])
def test_car_on_the_package_s_own_files_needs_a_name(launched_with):
    with pytest.raises(CarInterfaceError, match="the car runs on the package's own files, which are not to be changed: "
                                                r"copy them \(cp -r .*, launch with config:=.*, or name .* by -o"):
        find_table_file(None, None, launched_with, RUNNING)


def test_folder_that_is_not_there_and_a_file_of_another_channel_are_refused_before_the_drive(tmp_path, car):
    with pytest.raises(CarInterfaceError, match=r"there is no folder .*/nowhere"):
        find_table_file(str(tmp_path / "nowhere" / "a.yaml"), None, None, RUNNING)
    with pytest.raises(CarInterfaceError, match="has servo_channel 0, and turn_arb steers channel 3"):
        find_table_file(str(car), None, None, replace(RUNNING, servo_channel=3))


def test_table_that_turn_arb_would_refuse_is_not_written(car):
    old = car.read_text()
    with pytest.raises(CarInterfaceError, match=r"nothing is written, turn_arb would refuse it: .*servo_left"):
        find_table_file(str(car), None, None, RUNNING).write(STOCK_TEXT.replace("servo_left: 3800", "servo_left: x"),
                                                             replaces=True)
    assert (car.read_text(), os.listdir(car.parent)) == (old, ["turn_arb.yaml"])


@pytest.mark.parametrize(("board", "text"), [
    (5100, "the servo board centers the steering by the same file (duty 4983): it needs nothing more"),
    (None, "the servo board doesn't read this file: give its driver the new center, too, 4983"),
    (4900, "pca9685 has another center than turn_arb had, 4900 in place of 5100: launch it with this folder, too")])
def test_servo_board_is_to_have_the_same_center(board, text):
    assert board_center(4983, 5100, board).startswith(text)
