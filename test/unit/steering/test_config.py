"""The steering's parameters, from the parameter server or from a YAML file."""

import ast
import math
import re
from pathlib import Path

import pytest

from car_interface.common.declared import read
from car_interface.common.errors import CarInterfaceError, ConfigError
from car_interface.common.params import Params
from car_interface.common.yaml_file import load_yaml
from car_interface.steering.arbiter import SteeringArbiterConfig
from car_interface.steering.calibration import SteeringCalibration
from car_interface.steering.config import calibration_of, load_steering
from slash import PARAMETERS, SLASH

CONFIG_FILE = Path(__file__).resolve().parents[3] / "config" / "turn_arb.yaml"


def test_shipped_config_holds_the_slash_4x4_calibration():
    text = CONFIG_FILE.read_text(encoding="utf-8")
    shipped = {name: ast.literal_eval(value) for name, value in re.findall(r"(?m)^(\w+): *(\[[^]]*\]|[\d.]+)", text)}
    assert {name: shipped.get(name) for name in PARAMETERS} == PARAMETERS
    assert (shipped["tele_steer_neutral"], shipped["tele_steer_deadband"]) == (0.0, 0.001)
    assert shipped["input_timeout"] == 0.5


def test_file_of_turn_arb_may_say_how_far_it_may_be_tuned(tmp_path):
    shipped = CONFIG_FILE.read_text(encoding="utf-8")
    path = tmp_path / "turn_arb.yaml"
    path.write_text(shipped + "live_range: 300\n", encoding="utf-8")
    assert load_steering(str(path)).servo_center == 5100
    for line, message in (("live_range: far", "live_range is 'far'"), ("stear: 1", "unknown parameter stear")):
        with pytest.raises(ConfigError, match=rf"turn_arb\.yaml, {message}"):
            load_steering(str(path), f"{shipped}{line}\n")


def test_calibration_comes_from_the_original_names():
    assert read(Params(PARAMETERS), SteeringCalibration) == SLASH
    lowest = {**PARAMETERS, "servo_left": 0, "servo_center": 0, "servo_right": 1, "servo_channel": 15, "understeer": 1,
              "k_pwmcmd_left_table_servo": [0] * 15, "k_pwmcmd_right_table_servo": [0] * 15}
    assert read(Params(lowest), SteeringCalibration) == SteeringCalibration(*lowest.values())


@pytest.mark.parametrize("radii_m, message", [
    ([0.001, 1_000_000], ""), ([0, 1], r"\[0\] is 0;"), ([0.0009, 1], r"\[0\] is 0.0009;"),
    ([1, 1_000_001], r"\[1\] is 1000001;")])
def test_radius_with_which_nothing_can_be_computed_is_refused(radii_m, message):
    parameters = {**PARAMETERS, "m_turnrad_axis_servo": radii_m, "understeer": 1,
                  "k_pwmcmd_left_table_servo": [4000, 5000], "k_pwmcmd_right_table_servo": [6000, 5200]}
    if message:
        with pytest.raises(ConfigError, match=rf"axis_servo{message} accepted: a number from 0.001 to 1000000"):
            read(Params(parameters), SteeringCalibration)
        return
    calibration = read(Params(parameters), SteeringCalibration)
    for speed_mps in (0.0, 0.1, 14.0, 100.0):
        driven_m = [abs(calibration.turn_radius_m(duty, speed_mps)) for duty in (4000, 4500, 4999, 6000)]
        assert all(0.0009 < radius_m < math.inf for radius_m in driven_m), (speed_mps, driven_m)
        assert 4000 <= calibration.planner_duty(driven_m[1], speed_mps) <= 5000


@pytest.mark.parametrize("name", PARAMETERS)
def test_each_original_name_is_required_and_searched_for_in_the_parents(name):
    private = {other: value for other, value in PARAMETERS.items() if other != name}
    with pytest.raises(ConfigError, match=f"{name} is missing"):
        read(Params(private), SteeringCalibration)
    assert read(Params(private, PARAMETERS.get), SteeringCalibration) == SLASH


def test_input_timeout_is_the_default_of_the_other_timeouts():
    rules = read(Params({"input_timeout": 2.0, "planner_timeout": 3.0}), SteeringArbiterConfig)
    assert (rules.interlock.human_timeout_s, rules.teleop_timeout_s, rules.planner_timeout_s) == (2.0, 2.0, 3.0)
    assert read(Params({}), SteeringArbiterConfig) == SteeringArbiterConfig()


def test_text_that_will_be_a_file_is_checked_before_there_is_one(tmp_path):
    path = tmp_path / "mine.yaml"
    with pytest.raises(ConfigError, match=f"^{path}, servo_left is missing"):
        load_steering(str(path), "servo_channel: 0\n")
    assert load_steering(str(path), CONFIG_FILE.read_text(encoding="utf-8")) == load_steering(str(CONFIG_FILE))
    assert list(tmp_path.iterdir()) == []


def test_calibration_is_the_one_that_turn_arb_runs_with():
    assert calibration_of(load_yaml(str(CONFIG_FILE))) == load_steering(str(CONFIG_FILE))
    with pytest.raises(CarInterfaceError, match=r"turn_arb's calibration isn't known: its parameter servo_left is "
                                                r"missing.*Is the car launched, and in this namespace"):
        calibration_of({})
