"""Judges the ticks of the Teensy's clock that pongs and sonars carry. Pure."""
from __future__ import annotations

from car_interface.teensy.link.protocol import ahead
from car_interface.teensy.link.reboot import MAX_LAG_MS
from car_interface.teensy.sensing.verdicts import (
    AFTER_GAP,
    CLOCK_RESTARTED,
    FINE,
    FIRST,
    PREVIOUS_WRONG,
    TICK_AHEAD,
    TICK_BACK,
    Verdict,
)

CONSISTENT = 3  # ticks in a row that agree with each other end a contradiction
# Answers overtake sonar reports in the Teensy's buffers, which hold 0.2 s of the line.
OVERTAKEN_MS = 250
YOUNG_MS = 2_000  # a Teensy with a shorter uptime may have just rebooted


class TickGate:
    """Judges ticks, which come nearly in order: ``max_gap_ms`` lies between two of a line that is whole."""

    def __init__(self, max_gap_ms: float):
        self._max_gap_ms = max_gap_ms
        self.newest: int | None = None  # accepted tick
        self.restarts = 0  # of the clock
        self._before = None  # the newest before that
        self._candidates: list = []

    def restart(self, tick: int) -> None:
        """Begin with a tick of the new clock: the Teensy rebooted."""
        self.restarts += 1
        self._before, self.newest = None, tick
        self._candidates.clear()

    def is_young_again(self, tick: int) -> bool:
        """Return whether a tick can come from a Teensy that has just rebooted."""
        return self.newest is not None and tick < YOUNG_MS and ahead(tick, self.newest) < -OVERTAKEN_MS

    def judge(self, tick: int, reached: int | None = None) -> Verdict:
        """Judge the next tick, ms modulo 2**32.

        Args:
            reached: the clock has passed this tick, unless it restarted; ``None`` = unknown.
        """
        if self.newest is None:
            self.newest = tick
            return Verdict(True, FIRST, restarted=True)
        if reached is not None and ahead(reached, tick) > MAX_LAG_MS:
            self._before, self.newest = None, reached
        fault = self._fault(self.newest, tick)
        if not fault:
            if ahead(tick, self.newest) > 0:
                self._before, self.newest = self.newest, tick
            self._candidates.clear()
            return FINE
        if self._before is not None and not self._fault(self._before, tick):
            self.newest = tick
            self._candidates.clear()
            return Verdict(True, PREVIOUS_WRONG)
        if self._candidates and self._fault(self._candidates[-1], tick):
            self._candidates.clear()
        self._candidates.append(tick)
        return self._accept_chain() if len(self._candidates) == CONSISTENT else Verdict(False, fault)

    def _fault(self, before, tick):
        gap_ms = ahead(tick, before)
        if gap_ms < -OVERTAKEN_MS:
            return TICK_BACK
        return TICK_AHEAD if gap_ms > self._max_gap_ms else ""

    def _accept_chain(self):
        rebooted = ahead(self._candidates[0], self.newest) < 0
        newest = self._candidates[-1]
        self.restart(newest)
        self.restarts -= not rebooted
        return Verdict(True, CLOCK_RESTARTED if rebooted else AFTER_GAP, restarted=rebooted)
