"""Calibration, rules of who drives, and the ESC's kind, from the parameters of the node throttle_arb."""
from __future__ import annotations

from dataclasses import dataclass

from car_interface.common.live_parameters import TuningSettings, read_tuning
from car_interface.interlock.motion_interlock import read_interlock
from car_interface.throttle.arbiter import ArbiterConfig
from car_interface.throttle.calibration import ThrottleCalibration, read_calibration
from car_interface.throttle.esc_config import EscConfig, read_esc
from car_interface.throttle.limits import ThrottleLimits, read_limits
from car_interface.throttle.obstacle_stop import HUB, ObstacleConfig, read_obstacle_stop
from car_interface.throttle.stick import read_stick

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


def read_config(params) -> ThrottleConfig:
    """Read the node's configuration from its parameters, without side effects.

    Raises:
        ConfigError: naming the parameter.
    """
    config = ThrottleConfig(tuning=read_tuning(params, LIVE_RANGE), calibration=read_calibration(params),
                            arbiter=read_arbiter(params), esc=read_esc(params), limits=read_limits(params),
                            obstacles=read_obstacle_stop(params))
    params.finish(ignored_namespaces=(HUB.rstrip("/"),))
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
                         odometry_timeout_s=params.timeout("odometry_timeout", 0.5))
