"""Read the configuration of the node throttle_arb from its parameters, or from a YAML file for it."""
from __future__ import annotations

from dataclasses import dataclass, replace

from car_interface.common import declared
from car_interface.common.declared import read_all
from car_interface.common.errors import within
from car_interface.common.live_parameters import TuningSettings
from car_interface.common.params import Params
from car_interface.common.yaml_file import load_yaml
from car_interface.throttle.arbiter import ThrottleArbiterConfig
from car_interface.throttle.calibration import ThrottleCalibration
from car_interface.throttle.esc_config import EscConfig
from car_interface.throttle.limits import ThrottleLimits
from car_interface.throttle.obstacle_stop import ObstacleConfig

LIVE_RANGE = 100  # duty, by default: 6 % of an ESC's range to each side


@dataclass(frozen=True)
class ThrottleConfig:
    """Configure throttle_arb; without ``obstacles`` it doesn't stop for what the sonars see."""

    calibration: ThrottleCalibration = declared.group(ThrottleCalibration)
    arbiter: ThrottleArbiterConfig = declared.group(ThrottleArbiterConfig())
    esc: EscConfig = declared.group(EscConfig())
    limits: ThrottleLimits = declared.group(ThrottleLimits())
    obstacles: ObstacleConfig | None = declared.group(ObstacleConfig())
    tuning: TuningSettings = declared.group(TuningSettings(LIVE_RANGE))

    SHARED = ("sonar_hub", "board")  # files of teensy_sensor_hub and pca9685, of which it reads only some parameters


def load_throttle(path: str, text: str | None = None) -> ThrottleConfig:
    """Load the configuration from a YAML file for throttle_arb, without value map and sonars (files of their own).

    Or check the file's future content ``text``. What the node would refuse is refused here, too.

    Raises:
        ConfigError: naming the file, the parameter and what is wrong with it.
    """
    params = Params(load_yaml(path, text))
    with within(path):
        return replace(read_all(params, ThrottleConfig, is_complete=False), obstacles=None)
