"""Convert accelerations to an actuator's values, by the value map and limits.

``Converter.convert`` takes a commanded acceleration, and uses odometry's newest velocity. It returns a ``Conversion``:
a value, or cause and reason if there is none. Pure: ``now_ns`` is passed in.
"""
from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

from car_interface.common import causes, declared
from car_interface.common.errors import require, within
from car_interface.common.staleness import TimedInput
from car_interface.throttle.value_map import ALLOW_PLATEAUS, ValueMap, load_value_map

PASSES = "false = accelerations pass through, clamped; no map and no odometry needed"  # of two parameters


@dataclass(frozen=True)
class ConverterConfig:
    """Configure generic_value_converter; without ``value_map`` accelerations pass through, clamped.

    Raises:
        ConfigError: naming the parameter. All values of the map are outside the limits, so that every output would be
            the same.
    """

    min_value: float = declared.number("min_value", -5.0, "the value is clamped to these")
    max_value: float = declared.number("max_value", 3.0, "the value is clamped to these")
    odometry_timeout_s: float = declared.timeout(
        "odometry_timeout", 0.5, "a velocity older than this gives no output")
    converts: bool = declared.flag("convert_value_cmd", True, PASSES)
    uses_map: bool = declared.flag("use_value_ff", True, PASSES)
    map_path: str | None = declared.path(
        "csv_path_value_map", None, "the value map", default_text="`value_map.csv`")
    allow_plateaus: bool = declared.flag("allow_plateaus", False, ALLOW_PLATEAUS)
    value_map: ValueMap | None = None

    def __post_init__(self):
        require(not self.min_value > self.max_value, "min_value", self.min_value, f"at most max_value {self.max_value}")
        if self.value_map is not None:
            values = self.value_map.values
            require(values[0] < self.max_value and values[-1] > self.min_value, "value map", list(values),
                    f"values within min_value {self.min_value} to max_value {self.max_value}, or others for these",
                    f"has values from {values[0]} to {values[-1]}")

    def completed(self, params) -> ConverterConfig:
        """Return the same with the map, if it is used.

        Raises:
            ConfigError: naming the parameter, or the place in the map's file.
        """
        if not (self.converts and self.uses_map):
            return self
        path = self.map_path or params.path("csv_path_value_map")
        value_map = load_value_map(path, self.allow_plateaus)
        with within(path):
            return replace(self, value_map=value_map)


class Conversion(NamedTuple):
    """A value to send, or ``None``, and why."""

    value: float | None
    cause: str  # one of car_interface.common.causes
    reason: str


class Converter:
    """Convert commanded accelerations to values; without a map that needs no odometry.

    Attributes:
        odometry: the newest velocity in m/s, forward positive.
    """

    def __init__(self, config: ConverterConfig):
        self._config, self._map = config, config.value_map
        self.odometry = TimedInput("odometry", config.odometry_timeout_s)

    def convert(self, acceleration: float, now_ns: int) -> Conversion:
        """Return the value for a commanded acceleration in m/s² at the newest velocity."""
        if not math.isfinite(acceleration):
            return Conversion(None, causes.COMMAND_NOT_FINITE, f"the commanded acceleration is {acceleration}")
        if self._map is None:
            return self._clamped(acceleration)
        odometry = self.odometry
        if odometry.is_stale(now_ns):
            return Conversion(None, causes.ODOMETRY_STALE, odometry.stale_reason(now_ns))
        if not math.isfinite(odometry.value):
            return Conversion(None, causes.ODOMETRY_NOT_FINITE, f"the velocity in the odometry is {odometry.value}")
        return self._clamped(self._map.value_at(acceleration, odometry.value))

    def _clamped(self, value):
        value = max(self._config.min_value, min(self._config.max_value, value))
        return Conversion(value, causes.CONVERTING, f"the value is {value:.3f}")
