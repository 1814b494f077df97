"""The source and how its messages are read, from parameters; and the speed control beside them."""
from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from car_interface.common.declared import read_all
from car_interface.common.errors import ConfigError
from car_interface.common.params import Params
from car_interface.nodes.planner_interface.config import PlannerInterfaceConfig
from car_interface.throttle.speed_control import SpeedControlConfig

CONFIG = Path(__file__).resolve().parents[4] / "config"


def read(**values):
    return read_all(Params(values), PlannerInterfaceConfig)


def test_shipped_files_are_the_defaults():
    planner, wheels = (yaml.safe_load((CONFIG / name).read_text(encoding="utf-8"))
                       for name in ("planner_interface.yaml", "teensy_sensor_hub.yaml"))
    assert read(source="drive", wheels=wheels, **planner) == read(source="drive")
    assert read(source="drive") == PlannerInterfaceConfig("drive", speed=SpeedControlConfig())


def test_everything_can_be_set():
    made = read(source="cmd_vel", cmd_vel_angular="angle", wheels={"wheelbase": 0.25}, source_timeout=0.2,
                          max_speed=5, max_acceleration=1, max_braking=4, max_jerk=10, speed_p=2, speed_i=0,
                          max_correction=1, odometry_timeout=0.3)
    assert made == PlannerInterfaceConfig("cmd_vel", "angle", 0.25, 0.2, SpeedControlConfig(5, 1, 4, 10, 2, 0, 1, 0.3))


@pytest.mark.parametrize("name, value, accepted", [
    ("source", None, "one of drive, cmd_vel, autoware, speed"),
    ("source", "joystick", "one of drive, cmd_vel, autoware, speed"),
    ("cmd_vel_angular", "curvature", "one of rate, angle"),
    ("wheels/wheelbase", 0, "a number from 0.01 to 10.0"),
    ("source_timeout", 0, "a number from 0.05 to 0.5"),
    ("source_timeout", 0.6, "a number from 0.05 to 0.5"),
    ("max_speed", 0.1, "a number from 0.2 to 100.0"),
    ("max_acceleration", 0, "a number from 0.1 to 15.0"),
    ("max_braking", -3.0, "a number from 0.1 to 15.0"),
    ("max_jerk", 0, "a number from 0.5 to 1000.0"),
    ("speed_p", -1, "a number from 0.0 to 20.0"),
    ("speed_i", 21, "a number from 0.0 to 20.0"),
    ("max_correction", -1, "a number from 0 to 10"),
    ("odometry_timeout", 0.6, "a number from 0.05 to 0.5"),
])
def test_what_cannot_be_is_refused_with_its_name_and_what_is_accepted(name, value, accepted):
    with pytest.raises(ConfigError) as refused:
        read(**{"source": "drive", name: value})
    found = "is missing" if value is None else f"is {value!r}"
    assert str(refused.value) == f"{name} {found}; accepted: {accepted}"
