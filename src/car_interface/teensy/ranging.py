"""Echo times → ranges.

Consumes microseconds from a sonar's ping to its echo, 0 for none; produces metres, as sensor_msgs/Range wants them.
What is no distance is said as REP-117 has it: nothing in range +inf, too near to be measured −inf. ROS 1's costmap
layer drops infinite ranges and clears only at ``max_range``, so there is a way to have numbers only. Never NaN.

Pure: the temperature of the air is set from outside, whenever it is known.
"""
from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

from car_interface.errors import ConfigError
from car_interface.teensy.protocol import SONARS

INF, MAX_RANGE = "inf", "max_range"
US_PER_S = 1e6
COLDEST_C, HOTTEST_C = -50.0, 60.0
MEDIAN_OF = 5


def _check_temperature(temperature_c):
    if not COLDEST_C <= temperature_c <= HOTTEST_C:  # nor is NaN
        raise ConfigError("temperature", temperature_c, f"{COLDEST_C:g} to {HOTTEST_C:g} °C")


@dataclass(frozen=True)
class RangingConfig:
    """How echoes are taken.

    Attributes:
        temperature_c: of the air, −50 to 60.
        min_range_m: what is nearer is too near to be measured: the sonar itself still rings.
        max_range_m: an echo from farther counts as none.
        no_echo: ``inf``: no echo is +inf, one from too near −inf. ``max_range``: no echo is ``max_range_m``, one from
            too near is ``min_range_m``: something stands there, and a costmap shall keep it.
        median: of each sonar's newest five echoes, not the newest. One or two wrong ones in a row don't show; what is
            new shows with the third report, two reports later than without.

    Raises:
        ConfigError: naming the ROS parameter.
    """

    temperature_c: float = 20.0
    min_range_m: float = 0.02
    max_range_m: float = 2.0
    no_echo: str = INF
    median: bool = False

    def __post_init__(self):
        _check_temperature(self.temperature_c)
        if not 0 <= self.min_range_m < math.inf:
            raise ConfigError("min_range", self.min_range_m, "0 m or more")
        if not self.min_range_m < self.max_range_m < math.inf:
            raise ConfigError("max_range", self.max_range_m, f"more than min_range, {self.min_range_m} m")
        if self.no_echo not in (INF, MAX_RANGE):
            raise ConfigError("no_echo", self.no_echo, f"{INF} or {MAX_RANGE}")


class Ranging:
    """Turns each sonar's echoes into ranges."""

    def __init__(self, config: RangingConfig = RangingConfig()):
        self._config = config
        self._temperature_c = config.temperature_c
        self._nothing_m = math.inf if config.no_echo == INF else config.max_range_m
        self._too_near_m = -math.inf if config.no_echo == INF else config.min_range_m
        self._newest_us = [deque(maxlen=MEDIAN_OF if config.median else 1) for _ in SONARS]

    @property
    def temperature_c(self) -> float:
        """Of the air.

        Raises:
            ConfigError: when it's set to anything but a number from −50 to 60; the one before stays.
        """
        return self._temperature_c

    @temperature_c.setter
    def temperature_c(self, temperature_c: float) -> None:
        _check_temperature(temperature_c)
        self._temperature_c = temperature_c

    def range(self, sensor: int, echo_us: int) -> float:
        """Metres from a sonar to what its echo came from.

        Args:
            sensor: index in ``protocol.SONARS``.
            echo_us: there and back; 0 = no echo.

        Returns:
            ``min_range_m`` to ``max_range_m``; else what ``no_echo`` says. With ``median`` no echo counts as one from
            beyond all others, so that three of the newest five decide; of the first two or four the nearer middle one.
        """
        newest_us = self._newest_us[sensor]
        newest_us.append(echo_us or math.inf)
        median_us = sorted(newest_us)[(len(newest_us) - 1) // 2]
        range_m = median_us / US_PER_S * speed_of_sound_mps(self._temperature_c) / 2
        if range_m > self._config.max_range_m:
            return self._nothing_m
        return range_m if range_m >= self._config.min_range_m else self._too_near_m


def speed_of_sound_mps(temperature_c: float) -> float:
    """In dry air: the tangent at 0 °C of 331.3 √(1 + T / 273.15), 0.23 % above it at 40 °C, less from −20 on."""
    return 331.3 + 0.606 * temperature_c
