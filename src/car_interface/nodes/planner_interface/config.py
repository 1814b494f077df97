"""The configuration of the node planner_interface."""
from __future__ import annotations

from dataclasses import dataclass

from car_interface.common import declared
from car_interface.common.declared import REQUIRED
from car_interface.common.sources import PLANNERS
from car_interface.common.vehicle_geometry import WHEELBASE_M
from car_interface.planner.messages import ANGULAR, RATE
from car_interface.throttle.speed_control import SpeedControlConfig


@dataclass(frozen=True)
class PlannerInterfaceConfig:
    """The source that is obeyed, how its messages are read, and the speed control."""

    source: str = declared.choice("source", REQUIRED, "whose messages are obeyed", choices=PLANNERS)
    cmd_vel_angular: str = declared.choice(
        "cmd_vel_angular", RATE, "what `angular.z` of `cmd_vel` is: rad/s, or rad of the front wheels", choices=ANGULAR)
    wheelbase_m: float = declared.number(
        "wheels/wheelbase", WHEELBASE_M, "turns an angle into a radius; `teensy_sensor_hub.yaml` in the launch files",
        "m", low=0.01, high=10.0)
    # A planner that is silent stops the car within 0.55 s: this, and 0.05 s to the servo and the ESC.
    source_timeout_s: float = declared.number(
        "source_timeout", 0.5, "an older command is no request", "s", low=0.05, high=0.5)
    speed: SpeedControlConfig = declared.group(SpeedControlConfig())

    SHARED = ("wheels",)  # teensy_sensor_hub checks its own
