"""The inverse of the table by which generic_value_converter drives the ESC: from duties to values."""
from __future__ import annotations

from typing import NamedTuple

import numpy as np

from car_interface.common.errors import ConfigError
from car_interface.common.lookup_table import LookupTable
from car_interface.common.params import Params
from car_interface.common.servo_channels import CHANNELS, MAX_DUTY
from car_interface.common.yaml_file import load_yaml

COUNT = 16  # duty of one count of the servo board
DEFAULT_CHANNEL = 1  # of the ESC, as in config/throttle.yaml


class ThrottleTable(NamedTuple):
    """The values that an ESC's duties stand for."""

    value_of_duty: LookupTable
    neutral: float  # value
    path: str
    channel: int  # of the servo board

    def values(self, duty: np.ndarray) -> np.ndarray:
        """The value of each duty (N,); NaN for one that no value makes, by more than the board's rounding."""
        duties = self.value_of_duty.axis
        is_inside = (duty >= duties[0] - COUNT) & (duty <= duties[-1] + COUNT)
        return np.where(is_inside, np.interp(duty, duties, self.value_of_duty.values), np.nan)


def load_throttle(path: str) -> ThrottleTable:
    """Invert the table in a file with the converter's parameters.

    Raises:
        ConfigError: naming the file, and what in it is no table, or none that can be inverted.
    """
    params = Params(load_yaml(path))
    try:
        duties = params.numbers("servo/duty_table", low=0, high=MAX_DUTY)
        values = LookupTable(params.numbers("servo/value_axis"), duties, "servo/value_axis", "servo/duty_table").axis
        neutral = params.integer("servo/neutral", low=0, high=MAX_DUTY)
        channel = params.integer("servo/channel", DEFAULT_CHANNEL, low=0, high=CHANNELS - 1)
        steps = np.diff(duties)
        if not (np.all(steps > 0) or np.all(steps < 0)):
            raise ConfigError("servo/duty_table", duties, "duties that only rise, or only fall: each is a value's")
        if not min(duties) <= neutral <= max(duties):
            raise ConfigError("servo/neutral", neutral, "a duty within the range of servo/duty_table")
    except ConfigError as error:
        raise error.within(path) from error
    value_of_duty = LookupTable(*zip(*sorted(zip(duties, values))))
    return ThrottleTable(value_of_duty, value_of_duty(neutral), path, channel)
