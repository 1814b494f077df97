"""Finds how long a sonar's echo pulse really lasted; a report has only 16 bits of its µs.

Consumes reports in order with the Teensy's ticks. The firmware pings the next sonar a fixed wait after an echo, so the
time since the report before shows what the 16 bits lack. Observed on the original firmware (test/data/firmware): a
report comes its echo, the wait (50 ms) and 0.5 to 2.5 ms after the one before; 29.4 ms more for each sonar in between
that does not answer, and as much for a pin that was high already when its sonar was pinged.

Pure: a report's own tick is all the time it needs.
"""
from __future__ import annotations

from collections import deque

from car_interface.common.vehicle_geometry import SONARS
from car_interface.teensy.link.protocol import UINT32

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


class EchoPulses:
    """Follows the reports of one Teensy's sonars."""

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
