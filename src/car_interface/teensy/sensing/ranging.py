"""Finds how long the sonars' echoes took, and converts that to ranges.

Consumes the firmware's reports: microseconds from a sonar's ping to its echo, modulo 2**16; produces metres, as
sensor_msgs/Range wants them. By REP-117 nothing in range is +inf, and too near to be measured −inf. ROS 1's costmap
layer drops infinite ranges and clears only at ``max_range``, so an option gives finite numbers only. Never NaN.

The firmware's reports (observed on the original one, see test/data/firmware):

- 13 µs less than the echo took: they are added.
- The length of the sensor's own pulse. Without an echo an HC-SR04 ends its pulse after 38 ms. There are clones that
  hold it for 200 ms; a loose echo wire makes one of seconds. ``EchoPulses`` tells them from echoes.
- 0 for a pin that never fell, and around a wrap of micros(): this is no measurement. Around the wrap, every
  71.6 minutes of the Teensy's uptime, several pings fail or fire together: none of these reports is used.

Pure: a report's own tick is all the time it needs; the temperature of the air is set from outside.
"""
from __future__ import annotations

import math
from collections import Counter, deque
from dataclasses import dataclass
from typing import Sequence

from car_interface.common import declared
from car_interface.common.errors import require
from car_interface.common.vehicle_geometry import SONARS
from car_interface.teensy.link.protocol import UINT32

INF, MAX_RANGE = "inf", "max_range"
US_PER_S = 1e6
COLDEST_C, HOTTEST_C = -50.0, 60.0
MEDIAN_OF = 5
FIRMWARE_OFFSET_US = 13  # by the firmware, of each echo
LONGEST_ECHO_US = 65_000  # 11 m: no sonar's echo takes longer
USUAL_TIMEOUT_MS, MAX_TIMEOUT_MS = 38.0, 1000.0
TIMEOUT_RATIO = 0.95  # an echo of at least this part of the time-out is none
# A clone is found by so many long pulses in a row that differ by no more than this: those of a loose wire differ. After
# a lost report a pulse may look longer, up to 104 ms: 38 ms and a wrap.
CLONE_PULSES, CLONE_RATIO, SHORTEST_CLONE_US = 3, 1.02, 110_000
# Around a wrap of micros(): a ping that begins in the last 29 ms before it fails, and the sonars that fire then report
# a little later. The first report after power-up comes at 300 ms.
BEFORE_WRAP_US, AFTER_WRAP_US = 50_000, 250_000
UINT16 = 2 ** 16
FIRMWARE_WAIT_MS = 50  # between an echo and the next ping, at power-up
BOOT_MS = 300  # the tick at which a boot ends: counts and pings begin
OVERHEAD_MS = 1.0
FAILED_PING_MS = 29.443  # 18,000 + 11,428 + 15 µs
WRAP_MS = UINT16 / 1000
TOLERANCE_MS = 3.0  # ticks are whole ms; two grids of 29.4 and 65.5 ms come no nearer than 6.6 ms
# No wrap is as short. Two failed pings are shorter, and so is most times a lost report of a wall within 2 m.
SHORTEST_WRAP_MS = WRAP_MS - 2.5
USUAL_OF = 8  # reports, more than a round
MAX_OVERTAKEN_MS = 1000  # on a busy line a report may leave after the next one

# Why an echo makes no range.
STUCK = "an echo of 0: the pin was high all the time"
MICROS_WRAP = "an echo around the wrap of the Teensy's micros()"
DISTRUSTED = "an echo right after SONAR_START"
HELD = "a pin that was high for longer than any echo"
UNKNOWN = "an echo of unknown length: the report before it is missing"


@dataclass(frozen=True)
class RangingConfig:
    """The rules by which echoes become ranges.

    ``no_echo``: with ``inf`` no echo is +inf, one from too near −inf. With ``max_range`` no echo is ``max_range_m``,
    one from too near is ``min_range_m``: something stands there, and a costmap shall keep it.
    """

    temperature_c: float = declared.number(
        "temperature", 20.0, "of the air, until the topic `temperature` arrives", "°C", low=COLDEST_C, high=HOTTEST_C)
    min_range_m: float = declared.number(
        "min_range", 0.02, "what is nearer is too near to be measured: the sonar itself still rings", "m", low=0.0,
        high=100)
    max_range_m: float = declared.number(
        "max_range", 2.0, "an echo from farther counts as none", "m", above=0.0, high=100)
    no_echo: str = declared.choice(
        "no_echo", INF, "the range without an echo: `inf` (REP-117), or `max_range`, which ROS 1's costmap range layer "
                        "needs to clear", choices=(INF, MAX_RANGE))
    median: bool = declared.flag(
        "median", False, "true = median of a sonar's newest five echoes; a change shows two echoes later, about 0.7 s")
    timeouts_ms: Sequence[float] = declared.number(
        "no_echo_timeouts/", (USUAL_TIMEOUT_MS,) * len(SONARS),
        "when a sensor without an echo ends its pulse by itself; some clones take 200", "ms", family=SONARS, above=0.0,
        high=MAX_TIMEOUT_MS)

    def __post_init__(self):
        require(self.min_range_m < self.max_range_m, "max_range", self.max_range_m,
                f"more than min_range, {self.min_range_m} m")


class Ranging:
    """Turns each sonar's echoes into ranges."""

    def __init__(self, config: RangingConfig = RangingConfig()):
        self._config = config
        self._temperature_c = config.temperature_c
        self._nothing_m = math.inf if config.no_echo == INF else config.max_range_m
        self._too_near_m = -math.inf if config.no_echo == INF else config.min_range_m
        self.counts: Counter = Counter()  # echoes that made no range, by reason
        self._timeouts_us = [round(1000 * timeout_ms) for timeout_ms in config.timeouts_ms]
        self.clones: dict[int, float] = {}  # the time-outs that were found, ms by sensor; nobody configured them
        self.blinks: set[int] = set()  # whose pin was high for longer than any clone's; the owner takes them out
        self._held_us = [deque(maxlen=CLONE_PULSES) for _ in SONARS]
        self._newest_us = [deque(maxlen=MEDIAN_OF if config.median else 1) for _ in SONARS]

    def set_temperature(self, temperature_c: float) -> None:
        """Take the temperature of the air.

        Raises:
            ConfigError: it isn't a number from −50 to 60; the one before stays.
        """
        require(COLDEST_C <= temperature_c <= HOTTEST_C, "temperature", temperature_c,
                f"{COLDEST_C:g} to {HOTTEST_C:g} °C")
        self._temperature_c = temperature_c

    def range(self, sensor: int, echo_us: int | None, tick: int, is_trusted: bool = True) -> float | None:
        """Return the metres from a sonar to the origin of its echo.

        Args:
            sensor: index in ``SONARS``.
            echo_us: as the firmware reports it, of full length; ``None`` = unknown.
            tick: the Teensy's clock then, ms.
            is_trusted: False within two reports of a SONAR_START: the firmware fires two sonars at once.

        Returns:
            ``min_range_m`` to ``max_range_m``; else by ``no_echo``; ``None``: the report has no distance. With
            ``median`` no echo is farther than any other, so that three of the newest five decide; of the first two or
            four the nearer middle one.
        """
        pulse_us, doubt = None, UNKNOWN
        if is_near_micros_wrap(tick):
            doubt = MICROS_WRAP
        elif echo_us == 0:
            doubt = STUCK
        elif not is_trusted:
            doubt = DISTRUSTED
        elif echo_us is not None:
            pulse_us, doubt = self._pulse_us(sensor, echo_us + FIRMWARE_OFFSET_US), HELD
        if pulse_us is None:
            self.counts[doubt] += 1
            return None
        newest_us = self._newest_us[sensor]
        newest_us.append(pulse_us)
        median_us = sorted(newest_us)[(len(newest_us) - 1) // 2]
        range_m = median_us / US_PER_S * speed_of_sound_mps(self._temperature_c) / 2
        if range_m > self._config.max_range_m:
            return self._nothing_m
        return range_m if range_m >= self._config.min_range_m else self._too_near_m

    def _pulse_us(self, sensor, pulse_us):
        """Return a pulse that is an echo's; infinite when there was no echo, ``None`` when the pin was held high."""
        if pulse_us > LONGEST_ECHO_US and not self._is_timeout(sensor, pulse_us):
            self._find_clone(sensor, pulse_us)
            self.blinks.update([sensor] if pulse_us > 1000 * MAX_TIMEOUT_MS else ())
            return math.inf if self._is_timeout(sensor, pulse_us) else None
        self._held_us[sensor].clear()
        if pulse_us < TIMEOUT_RATIO * self._timeouts_us[sensor]:
            return pulse_us
        if pulse_us <= LONGEST_ECHO_US:
            self.clones.pop(sensor, None)  # it was replaced
        return math.inf

    def _is_timeout(self, sensor, pulse_us):
        found_us = 1000 * self.clones.get(sensor, math.inf)
        return any(TIMEOUT_RATIO <= pulse_us / timeout_us <= 1 / TIMEOUT_RATIO
                   for timeout_us in (self._timeouts_us[sensor], found_us))

    def _find_clone(self, sensor, pulse_us):
        """Take it for a clone whose long pulses are all alike."""
        held_us = self._held_us[sensor]
        held_us.append(pulse_us)
        shortest_us, longest_us = min(held_us), max(held_us)
        if (len(held_us) == CLONE_PULSES and shortest_us >= SHORTEST_CLONE_US
                and longest_us <= min(CLONE_RATIO * shortest_us, 1000 * MAX_TIMEOUT_MS)):
            self.clones[sensor] = pulse_us / 1000


class EchoPulses:
    """Finds how long echo pulses really lasted, by the reports of one Teensy's sonars in order.

    The firmware pings the next sonar a fixed wait after an echo, so the time since the report before shows what the 16
    bits lack. Observed on the original firmware (test/data/firmware): a report comes its echo, the wait (50 ms) and 0.5
    to 2.5 ms after the one before; 29.4 ms more for each sonar in between that does not answer, and as much for a pin
    that was high already when its sonar was pinged.
    """

    def __init__(self):
        self._rests_ms: deque = deque(maxlen=USUAL_OF)
        self.restart()

    def restart(self) -> None:
        """Begin with a Teensy that boots."""
        self._newest: int | None = None
        self._rests_ms.clear()

    def unwrap_us(self, echo_us: int, tick: int, wait_ms: int) -> int | None:
        """Return the echo's full length.

        Args:
            echo_us: as the firmware reports it; 0 stays 0.
            tick: the report's, in ms.
            wait_ms: SONAR_WAIT as last commanded. Another one, by which the Teensy goes, is noticed after a round.

        Returns:
            ``None``: unknown, as the report before it was lost, or is the first of a Teensy that runs already.
        """
        if self._newest is None:
            self._newest = tick
            return echo_us if tick < BOOT_MS + WRAP_MS else None
        gap_ms = (tick - self._newest) % UINT32
        if gap_ms >= UINT32 - MAX_OVERTAKEN_MS:
            return echo_us
        self._newest = tick
        rest_ms = gap_ms - echo_us / 1000
        self._rests_ms.append(rest_ms)
        excess_ms = rest_ms - self._usual_rest_ms(wait_ms)
        if not echo_us or excess_ms < SHORTEST_WRAP_MS:
            return echo_us
        for failed in range(len(SONARS)):
            wraps, off_ms = divmod(excess_ms - failed * FAILED_PING_MS + TOLERANCE_MS, WRAP_MS)
            if wraps >= 0 and off_ms <= 2 * TOLERANCE_MS:
                return echo_us + int(wraps) * UINT16
        return None

    def _usual_rest_ms(self, wait_ms):
        """Return the time between a report and the next one's ping."""
        usual_ms = wait_ms + OVERHEAD_MS
        if len(self._rests_ms) < USUAL_OF:
            return usual_ms
        shortest_ms = sorted(self._rests_ms)[1]  # one may be from before a SONAR_WAIT
        wraps, off_ms = divmod(shortest_ms - usual_ms + TOLERANCE_MS, WRAP_MS)
        all_wrap = wraps > 0 and off_ms <= 2 * TOLERANCE_MS
        return usual_ms if all_wrap else shortest_ms


def is_near_micros_wrap(tick: int) -> bool:
    """Return whether the Teensy's 32 bits of µs wrap near this tick of its 32 bits of ms; both begin at power-up."""
    since_us = 1000 * tick % UINT32  # 2**32 ms are 1000 wraps
    return since_us >= UINT32 - BEFORE_WRAP_US or since_us <= AFTER_WRAP_US


def speed_of_sound_mps(temperature_c: float) -> float:
    """Return the speed in dry air: the tangent at 0 °C of 331.3 √(1 + T / 273.15), at most 0.23 % above it to 40 °C."""
    return 331.3 + 0.606 * temperature_c
