"""The steering's parameters, from the parameter server or from a YAML file."""
from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from car_interface.common.errors import ConfigError
from car_interface.common.params import Params
from car_interface.common.yaml_file import load_yaml
from car_interface.steering.arbiter import ArbiterConfig
from car_interface.steering.params import load_steering, read_arbiter, read_calibration
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
    path.write_text(shipped + "live_range: far\n", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"turn_arb\.yaml, live_range is 'far'"):
        load_steering(str(path))


def test_calibration_comes_from_the_original_names():
    assert read_calibration(Params(PARAMETERS)) == SLASH


@pytest.mark.parametrize("name", PARAMETERS)
def test_each_original_name_is_required_and_searched_for_in_the_parents(name):
    private = {other: value for other, value in PARAMETERS.items() if other != name}
    with pytest.raises(ConfigError, match=f"{name} is missing"):
        read_calibration(Params(private))
    assert read_calibration(Params(private, PARAMETERS.get)) == SLASH


def test_input_timeout_is_the_default_of_the_other_timeouts():
    rules = read_arbiter(Params({"input_timeout": 2.0, "planner_timeout": 3.0}))
    assert (rules.interlock.human_timeout_s, rules.teleop_timeout_s, rules.planner_timeout_s) == (2.0, 2.0, 3.0)
    assert read_arbiter(Params({})) == ArbiterConfig()


@pytest.mark.parametrize("content, message", [
    pytest.param("a: [", "is no YAML", id="broken"),
    pytest.param("- 1", "has no such lines; accepted: YAML lines", id="list"),
    pytest.param("", "has no such lines; accepted: YAML lines", id="empty"),
])
def test_file_that_is_no_mapping_is_refused(tmp_path, content, message):
    path = tmp_path / "a.yaml"
    path.write_text(content, encoding="utf-8")
    with pytest.raises(ConfigError, match=message):
        load_yaml(str(path))


def test_text_that_will_be_a_file_is_checked_before_there_is_one(tmp_path):
    path = tmp_path / "mine.yaml"
    with pytest.raises(ConfigError, match=f"^{path}, servo_left is missing"):
        load_steering(str(path), "servo_channel: 0\n")
    assert load_steering(str(path), CONFIG_FILE.read_text(encoding="utf-8")) == load_steering(str(CONFIG_FILE))
    assert list(tmp_path.iterdir()) == []


def test_fault_of_the_file_itself_names_the_file_once(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("a: 1\na: 2\n", encoding="utf-8")
    with pytest.raises(ConfigError, match=f"^{path}, lines 1 and 2 both give a; accepted: each name once$"):
        load_steering(str(path))


def test_absent_file_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="can't be read"):
        load_yaml(str(tmp_path / "absent.yaml"))
