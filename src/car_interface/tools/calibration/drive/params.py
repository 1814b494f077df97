"""What a calibration drive takes from the parameters of turn_arb and throttle_arb."""
from __future__ import annotations

from typing import Any

from car_interface.common.errors import CarInterfaceError, ConfigError
from car_interface.common.params import Params
from car_interface.steering.calibration import SteeringCalibration
from car_interface.steering.params import read_calibration
from car_interface.throttle.obstacle_stop import ObstacleConfig, read_obstacle_stop


def read_obstacles(throttle_arb: dict[str, Any]) -> ObstacleConfig:
    """The car's outline and sonars as throttle_arb has them, whether or not it stops for them itself.

    Raises:
        CarInterfaceError: it doesn't know the sonars.
    """
    try:
        return read_obstacle_stop(Params({**throttle_arb, "obstacle_stop": True}))
    except ConfigError as error:
        raise CarInterfaceError(f"of throttle_arb's parameters {error}: launch the car by its launch files, or drive "
                                "without sonars by --no-sonars") from error


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
