"""Calibration and rules of the steering from parameters: those of the node turn_arb, or a YAML file for it."""
from __future__ import annotations

from car_interface.common.errors import ConfigError
from car_interface.common.live_parameters import read_tuning
from car_interface.common.params import Params
from car_interface.common.units import CHANNELS, MAX_DUTY
from car_interface.common.yaml_file import load_yaml
from car_interface.interlock.motion_interlock import read_interlock
from car_interface.steering.arbiter import ArbiterConfig
from car_interface.steering.calibration import SteeringCalibration
from car_interface.steering.limits import read_limits

MAX_SLEW_LIMIT = 1e9  # duty per second: from end to end within a timer period, many times over


def read_calibration(params) -> SteeringCalibration:
    """The calibration from the seven parameters of the original node, which are also searched for in parents.

    Raises:
        ConfigError: naming the parameter.
    """
    return SteeringCalibration(
        servo_left=params.integer("servo_left", low=0, high=MAX_DUTY, search_parents=True),
        servo_center=params.integer("servo_center", low=0, high=MAX_DUTY, search_parents=True),
        servo_right=params.integer("servo_right", low=0, high=MAX_DUTY, search_parents=True),
        servo_channel=params.integer("servo_channel", low=0, high=CHANNELS - 1, search_parents=True),
        radius_axis_m=params.numbers("m_turnrad_axis_servo", search_parents=True),
        left_duties=params.numbers("k_pwmcmd_left_table_servo", low=0, high=MAX_DUTY, search_parents=True),
        right_duties=params.numbers("k_pwmcmd_right_table_servo", low=0, high=MAX_DUTY, search_parents=True),
        understeer=params.number("understeer", 0.0, low=0, high=1))


def read_arbiter(params) -> ArbiterConfig:
    """The rules of who steers.

    Raises:
        ConfigError: naming the parameter.
    """
    timeout_s = params.timeout("input_timeout", 0.5)
    return ArbiterConfig(
        tele_steer_neutral=params.number("tele_steer_neutral", 0.0, low=-1, high=1),
        tele_steer_deadband=params.number("tele_steer_deadband", 0.001, low=0, high=1),
        slew_limit=params.number("slew_limit", 0.0, low=0, high=MAX_SLEW_LIMIT),
        interlock=read_interlock(params, timeout_s),
        limits=read_limits(params),
        teleop_timeout_s=params.timeout("teleop_timeout", timeout_s),
        planner_timeout_s=params.timeout("planner_timeout", timeout_s))


def load_steering(path: str, text: str | None = None) -> SteeringCalibration:
    """Load the calibration from a YAML file for turn_arb. A file that the node would refuse is refused here too.

    Args:
        path: of the file.
        text: what the file is going to have; ``None`` = it is read.

    Raises:
        ConfigError: naming the file, the parameter and what is wrong with it.
    """
    params = Params(load_yaml(path, text))
    try:
        read_tuning(params, 0)
        calibration = read_calibration(params)
        read_arbiter(params)
        params.finish()
        return calibration
    except ConfigError as error:
        raise error.within(path) from error
