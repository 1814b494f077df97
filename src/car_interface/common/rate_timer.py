"""A periodic timer that is polled with the current time."""
from __future__ import annotations

from car_interface.common.units import NS_PER_S


class RateTimer:
    """Ticks at a fixed rate. After a stall it continues from now; missed ticks are not repeated.

    Args:
        rate_hz: ticks per second, above 0.
        now_ns: when the first tick is due.

    Attributes:
        ticks: how many there were.
    """

    def __init__(self, rate_hz: float, now_ns: int):
        self.period_ns = round(NS_PER_S / rate_hz)
        self.due_ns = now_ns
        self.ticks = 0

    def is_due(self, now_ns: int) -> bool:
        """Return whether a tick is due. If so, the next one is due a period later."""
        if now_ns < self.due_ns:
            return False
        self.ticks += 1
        self.due_ns += self.period_ns
        if self.due_ns <= now_ns:
            self.due_ns = now_ns + self.period_ns
        return True
