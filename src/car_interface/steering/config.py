"""The configuration of the node turn_arb, from its parameters or from a YAML file for it."""
from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from car_interface.common import declared
from car_interface.common.errors import CarInterfaceError, ConfigError, within
from car_interface.common.live_parameters import TuningSettings
from car_interface.common.params import Params
from car_interface.common.yaml_file import load_yaml
from car_interface.steering.arbiter import SteeringArbiterConfig
from car_interface.steering.calibration import SteeringCalibration

LIVE_RANGE = 500  # duty, by default: 0.15 ms of a pulse at 50 Hz, a sixth of a servo's travel


@dataclass(frozen=True)
class TurnArbConfig:
    """The configuration of turn_arb: the servo, the rules of who steers, and how far the servo may be tuned."""

    calibration: SteeringCalibration = declared.group(SteeringCalibration)
    arbiter: SteeringArbiterConfig = declared.group(SteeringArbiterConfig())
    tuning: TuningSettings = declared.group(TuningSettings(LIVE_RANGE))


def load_steering(path: str, text: str | None = None) -> SteeringCalibration:
    """Load the calibration from a YAML file for turn_arb, or check the file's future content ``text``.

    What the node would refuse is refused here, too.

    Raises:
        ConfigError: naming the file, the parameter and what is wrong with it.
    """
    params = Params(load_yaml(path, text))
    with within(path):
        return declared.read_all(params, TurnArbConfig).calibration


def calibration_of(turn_arb: dict[str, Any]) -> SteeringCalibration:
    """Return the calibration that a running turn_arb has, by its parameters on the server.

    Raises:
        CarInterfaceError: it isn't there.
    """
    try:
        return declared.read(Params(turn_arb), SteeringCalibration)
    except ConfigError as error:
        raise CarInterfaceError(f"turn_arb's calibration isn't known: its parameter {error}. Is the car launched, and "
                                "in this namespace (ROS_NAMESPACE)?") from error
