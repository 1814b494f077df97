"""A car's steering calibration from parameters: those of turn_arb, or those in a YAML file that turn_arb would load."""
from __future__ import annotations

from typing import Any

from car_interface.common.errors import ConfigError
from car_interface.common.live_parameters import read_tuning
from car_interface.common.params import Params
from car_interface.common.servo_channels import CHANNELS, MAX_DUTY
from car_interface.interlock.motion_interlock import read_interlock
from car_interface.steering.arbiter import SteeringArbiter
from car_interface.steering.calibration import SteeringConfig

FASTEST_SLEW = 1e9  # duty per second: from end to end within a heartbeat, many times over


def read_config(params) -> SteeringConfig:
    """The steering's configuration from the node's parameters, the last of which these are.

    Raises:
        ConfigError: naming the parameter.
    """
    timeout_s = params.timeout("input_timeout", 0.5)
    config = SteeringConfig(
        servo_left=params.integer("servo_left", low=0, high=MAX_DUTY, search_parents=True),
        servo_center=params.integer("servo_center", low=0, high=MAX_DUTY, search_parents=True),
        servo_right=params.integer("servo_right", low=0, high=MAX_DUTY, search_parents=True),
        servo_channel=params.integer("servo_channel", low=0, high=CHANNELS - 1, search_parents=True),
        radius_axis_m=params.numbers("m_turnrad_axis_servo", search_parents=True),
        left_duties=params.numbers("k_pwmcmd_left_table_servo", low=0, high=MAX_DUTY, search_parents=True),
        right_duties=params.numbers("k_pwmcmd_right_table_servo", low=0, high=MAX_DUTY, search_parents=True),
        tele_steer_neutral=params.number("tele_steer_neutral", 0.0, low=-1, high=1),
        tele_steer_deadband=params.number("tele_steer_deadband", 0.001, low=0, high=1),
        slew_limit=params.number("slew_limit", 0.0, low=0, high=FASTEST_SLEW),
        interlock=read_interlock(params, timeout_s),
        teleop_timeout_s=params.timeout("teleop_timeout", timeout_s),
        planner_timeout_s=params.timeout("planner_timeout", timeout_s),
    )
    params.finish()
    SteeringArbiter(config)  # its tables are checked when it's made
    return config


def load_steering(path: str) -> SteeringConfig:
    """turn_arb's configuration from a YAML file, by the rules by which the node itself accepts or refuses it.

    Raises:
        ConfigError: naming the file, the parameter and what is wrong with it.
    """
    params = Params(load_yaml(path))
    try:
        read_tuning(params, 0)  # the node's, beside the calibration
        return read_config(params)
    except ConfigError as error:
        raise error.within(path) from error


def load_yaml(path: str) -> dict[str, Any]:
    """The parameters in a YAML file, as ROS would load them.

    Raises:
        ConfigError: naming the file.
    """
    import yaml  # for tools: a node gets its parameters from ROS
    try:
        with open(path, encoding="utf-8-sig") as file:
            values = yaml.safe_load(file)
    except OSError as error:
        raise ConfigError(path, path, "a file that can be read", f"can't be read ({error.strerror})") from error
    except (UnicodeDecodeError, ValueError, yaml.YAMLError) as error:
        raise ConfigError(path, None, "parameters in YAML", f"is no YAML: {' '.join(str(error).split())}") from error
    if not isinstance(values, dict):
        raise ConfigError(path, values, "YAML lines of a parameter's name, a colon and its value")
    return values
