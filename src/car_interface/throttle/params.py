"""Calibration, rules of who drives, and the ESC's kind, from the parameters of the node throttle_arb; and the speed
control, from those of planner_interface.
"""
from __future__ import annotations

from dataclasses import dataclass

from car_interface.common.errors import ConfigError
from car_interface.common.live_parameters import TuningSettings, read_tuning
from car_interface.common.measured_speed import MAX_SPEED_MPS
from car_interface.common.params import Params
from car_interface.common.yaml_file import load_yaml
from car_interface.interlock.motion_interlock import read_interlock
from car_interface.throttle.arbiter import ArbiterConfig
from car_interface.throttle.board_watch import BOARD, read_board
from car_interface.throttle.calibration import ThrottleCalibration, read_calibration
from car_interface.throttle.esc_config import EscConfig, read_esc
from car_interface.throttle.limits import ThrottleLimits, read_limits
from car_interface.throttle.obstacle_stop import HUB, ObstacleConfig, read_obstacle_stop
from car_interface.throttle.speed_control import SpeedControlConfig
from car_interface.throttle.stick import read_stick

# Of the speed control. 0.1 m/s counts as standstill, and no car of this kind holds less than twice that.
MIN_MAX_SPEED_MPS = 0.2
ACCELERATION_MPS2, JERK_MPS3, GAIN = (0.1, 15.0), (0.5, 1000.0), (0.0, 20.0)
LIVE_RANGE = 100  # duty, by default: 6 % of an ESC's range to each side


@dataclass(frozen=True)
class ThrottleConfig:
    """The node's configuration.

    Attributes:
        calibration: the ESC's channel and duties.
        arbiter: the rules of who drives.
        esc: the ESC's kind and times.
        limits: of speed and accelerations.
        obstacles: the sonars that it stops for; ``None`` = for none.
        tuning: how far neutral may be tuned while the car drives, and where it is saved.
    """

    calibration: ThrottleCalibration
    arbiter: ArbiterConfig
    esc: EscConfig
    limits: ThrottleLimits
    obstacles: ObstacleConfig | None
    tuning: TuningSettings


def read_config(params, is_complete: bool = True) -> ThrottleConfig:
    """Read the node's configuration from its parameters, without side effects.

    Args:
        params: the parameters.
        is_complete: false = those of the throttle's file alone, without what the launch files add: no value map and no
            sonar.

    Raises:
        ConfigError: naming the parameter.
    """
    config = ThrottleConfig(tuning=read_tuning(params, LIVE_RANGE), calibration=read_calibration(params),
                            arbiter=read_arbiter(params), esc=read_esc(params), limits=read_limits(params, is_complete),
                            obstacles=read_obstacle_stop(params, is_complete))
    params.finish(ignored_namespaces=(HUB.rstrip("/"), BOARD.rstrip("/")))
    return config


def read_arbiter(params) -> ArbiterConfig:
    """The rules of who drives.

    Raises:
        ConfigError: naming the parameter.
    """
    return ArbiterConfig(stick=read_stick(params), interlock=read_interlock(params),
                         steering_timeout_s=params.timeout("steering_timeout", 0.25),
                         teleop_timeout_s=params.timeout("teleop_timeout", 0.5),
                         mode_timeout_s=params.timeout("mode_timeout", 0.5),
                         command_timeout_s=params.timeout("command_timeout", 0.5),
                         odometry_timeout_s=params.timeout("odometry_timeout", 0.5),
                         board=read_board(params))


def load_throttle(path: str, text: str | None = None) -> ThrottleConfig:
    """Load the configuration from a YAML file for throttle_arb. A file that the node would refuse is refused here too.

    Args:
        path: of the file.
        text: what the file is going to have; ``None`` = it is read.

    Raises:
        ConfigError: naming the file, the parameter and what is wrong with it.
    """
    params = Params(load_yaml(path, text))
    try:
        return read_config(params, is_complete=False)
    except ConfigError as error:
        raise error.within(path) from error


def read_speed_control(params) -> SpeedControlConfig:
    """Limits and gains of the speed control, of the node planner_interface.

    Raises:
        ConfigError: naming the parameter.
    """
    default = SpeedControlConfig()
    return SpeedControlConfig(
        max_speed_mps=params.number("max_speed", default.max_speed_mps, low=MIN_MAX_SPEED_MPS, high=MAX_SPEED_MPS),
        max_acceleration_mps2=params.number("max_acceleration", default.max_acceleration_mps2, *ACCELERATION_MPS2),
        max_braking_mps2=params.number("max_braking", default.max_braking_mps2, *ACCELERATION_MPS2),
        max_jerk_mps3=params.number("max_jerk", default.max_jerk_mps3, *JERK_MPS3),
        speed_p=params.number("speed_p", default.speed_p, *GAIN),
        speed_i=params.number("speed_i", default.speed_i, *GAIN),
        max_correction_mps2=params.number("max_correction", default.max_correction_mps2, low=0, high=10),
        odometry_timeout_s=params.number("odometry_timeout", default.odometry_timeout_s, low=0.05, high=0.5))
