"""The source and how its messages are read, from the parameters of the node planner_interface."""
from __future__ import annotations

from dataclasses import dataclass

from car_interface.common.errors import ConfigError
from car_interface.planner.messages import ANGULAR, RATE
from car_interface.planner.source_arbiter import SOURCES

# A planner that is silent stops the car within 0.55 s: this, and 0.05 s to the servo and the ESC.
TIMEOUT_S = (0.05, 0.5)
WHEELBASE_M = (0.01, 10.0)
# Of the file for teensy_sensor_hub, which the launch files load, so that the wheelbase stands in one place.
WHEELS = "wheels"


@dataclass(frozen=True)
class PlannerConfig:
    """What is obeyed, named as the ROS parameters.

    Attributes:
        source: one of SOURCES.
        cmd_vel_angular: what a twist's angular.z is: RATE or ANGLE.
        wheelbase_m: between the axles.
        source_timeout_s: a command older than this is no request any more.
    """

    source: str
    cmd_vel_angular: str = RATE
    wheelbase_m: float = 0.324
    source_timeout_s: float = 0.5


def read_planner(params) -> PlannerConfig:
    """The configuration from ~source, ~cmd_vel_angular, ~wheels/wheelbase and ~source_timeout.

    Raises:
        ConfigError: naming the parameter.
    """
    source = params.choice("source", None, SOURCES)
    if source is None:
        raise ConfigError("source", None, "one of " + ", ".join(SOURCES))
    low_m, high_m = WHEELBASE_M
    return PlannerConfig(
        source=source, cmd_vel_angular=params.choice("cmd_vel_angular", RATE, ANGULAR),
        wheelbase_m=params.number(f"{WHEELS}/wheelbase", PlannerConfig.wheelbase_m, low=low_m, high=high_m),
        source_timeout_s=params.number("source_timeout", PlannerConfig.source_timeout_s, *TIMEOUT_S))
