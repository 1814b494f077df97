"""Detects a reboot of the Teensy by its own clock, which pongs and sonar reports carry."""
from __future__ import annotations

from car_interface.common.units import NS_PER_MS
from car_interface.teensy.link.protocol import UINT32, ahead

# Sonar reports wait behind pongs in the Teensy's queues, so ticks come a little out of order: 0.2 s at most.
LATEST_TICK_MS = 500
# The Teensy's crystal and the host's differ by 2e-4 at most (their data sheets: 100 ppm each); this leaves room.
DRIFT_RATIO = 0.001
# A pong whose tick lags by more shows a reboot of a Teensy that had been up for so long. If it lags by less, the tick
# of the pong before may have been corrupt: one that is ahead by up to this is accepted.
MAX_LAG_MS = 2_000
DAY_MS = 86_400_000  # the longest gap in which a tick that is ahead is not a reboot


def reached_tick(tick: int, received_ns: int, sent_ns: int) -> int:
    """Return the tick, ms modulo 2**32, that a clock which goes on has passed when a later ping is sent.

    Args:
        tick: of an earlier pong, which was received at ``received_ns``.
        sent_ns: when the later ping was sent.
    """
    return int(tick + (sent_ns - received_ns) / NS_PER_MS * (1 - DRIFT_RATIO)) % UINT32


class RebootDetector:
    """Follows the Teensy's clock: does it go on, or did it restart at 0?

    A wheel's ``when`` can't be used: the last pulse may be long ago. A tick that doesn't fit must be followed by one
    that fits *it*, since the checksum lets 1 in 255 corrupt frames past. A wrap of the 32 bits fits.

    A tick may lag, since bytes can wait to be read; but a pong's is younger than its ping. So pongs also show a reboot
    that nobody saw, after which the clock has been on for as long as before.
    """

    def __init__(self):
        self._last: tuple | None = None  # (tick, when it was received)
        self._doubtful: tuple | None = None
        self._answered: tuple | None = None  # likewise of the newest pong

    def update(self, tick: int, now_ns: int, sent_ns: int | None = None) -> str | None:
        """Take the next tick, ms modulo 2**32; return a description of the reboot that it reveals, or ``None``.

        Args:
            sent_ns: when the ping was sent that this tick's pong answers; ``None`` for a sonar's tick.
        """
        if sent_ns is not None and self._answered is not None:
            reached = reached_tick(*self._answered, sent_ns)
            if ahead(reached, tick) > MAX_LAG_MS:
                self._last = (reached, sent_ns)
        description = self._judge(tick, now_ns)
        if sent_ns is not None and self._last == (tick, now_ns):
            self._answered = self._last
        return description

    def _judge(self, tick, now_ns):
        last = self._last
        if last is None or _fits(last, tick, now_ns):
            self._last, self._doubtful = (tick, now_ns), None
            return None
        if self._doubtful is None or not _fits(self._doubtful, tick, now_ns):
            self._doubtful = (tick, now_ns)
            return None
        self._last, self._doubtful = (tick, now_ns), None
        if tick >= last[0] or 0 < ahead(tick, last[0]) <= DAY_MS:
            return None  # it's ahead: this computer was suspended or kept from reading, and perhaps over a wrap
        self._answered = None
        return f"its clock went from {last[0] / 1000:.1f} s back to {tick / 1000:.1f} s"


def _fits(before, tick, now_ns):
    """Return whether a clock that was at ``before`` can be at ``tick`` now, or less: bytes can wait to be read."""
    elapsed_ms = (now_ns - before[1]) / NS_PER_MS
    return -LATEST_TICK_MS <= ahead(tick, before[0]) <= elapsed_ms * (1 + DRIFT_RATIO) + LATEST_TICK_MS
