"""The source and how its messages are read, from parameters; and the speed control beside them."""
from pathlib import Path

import yaml

from car_interface.common.declared import read_all
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
