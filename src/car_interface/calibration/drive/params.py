"""Settings of the calibration drive from parameters: its own, and those of turn_arb and throttle_arb."""
from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from car_interface.calibration.drive.config import DriveConfig
from car_interface.common.errors import CarInterfaceError, ConfigError
from car_interface.common.params import Params
from car_interface.steering.calibration import SteeringCalibration
from car_interface.steering.params import read_calibration
from car_interface.throttle.obstacle_stop import ObstacleConfig, read_obstacle_stop


@dataclass(frozen=True)
class CalibrationDriveConfig:
    """The node's own parameters.

    Attributes:
        drive: where and how it drives, without the car's sonars and outline.
        sonars: whether it looks at them.
    """

    drive: DriveConfig
    sonars: bool


def read_config(params: Params) -> CalibrationDriveConfig:
    """The node's configuration, without side effects.

    Raises:
        ConfigError: naming the parameter.
    """
    default = DriveConfig()
    config = CalibrationDriveConfig(
        DriveConfig(radius_m=params.number("radius", default.radius_m),
                    speed_mps=params.number("speed", default.speed_mps),
                    tight_speed_mps=params.number("tight_speed", default.tight_speed_mps),
                    max_time_s=params.number("max_time", default.max_time_s),
                    braking_mps2=params.number("braking", default.braking_mps2)),
        params.flag("sonars", True))
    params.finish()
    return config


def read_obstacles(throttle_arb: dict[str, Any]) -> ObstacleConfig:
    """The car's outline and sonars as throttle_arb has them, whether or not it stops for them itself.

    Raises:
        CarInterfaceError: it doesn't know the sonars.
    """
    try:
        return read_obstacle_stop(Params({**throttle_arb, "obstacle_stop": True}))
    except ConfigError as error:
        raise CarInterfaceError(f"of throttle_arb's parameters {error}: launch the car by its launch files, or drive "
                                "without sonars by _sonars:=false") from error


def read_base(turn_arb: dict[str, Any]) -> SteeringCalibration:
    """The calibration that turn_arb runs with.

    Raises:
        CarInterfaceError: it isn't on the parameter server.
    """
    try:
        return read_calibration(Params(turn_arb))
    except ConfigError as error:
        raise CarInterfaceError(f"turn_arb's calibration isn't known: its parameter {error}. Is the car launched, and "
                                "in this namespace (ROS_NAMESPACE)?") from error
