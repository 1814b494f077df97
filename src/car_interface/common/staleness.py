"""How long ago something was heard, and when that's too long.

Freshness goes by arrival on the monotonic clock: stamps in messages can lie, and clocks get set.
"""
from __future__ import annotations

import math

from car_interface.common.units import NS_PER_S

DROPPED = "messages were dropped"  # before a node took them: one of them may have said what counts


class TimedInput:
    """The newest value of one input and its age.

    Args:
        name: what the input is called in a reason.
        timeout_s: silence longer than this is a loss; 0 = never. What was never heard is silent whatever this is.
    """

    def __init__(self, name: str, timeout_s: float):
        self.name = name
        self.value = None
        self._timeout_ns = round(timeout_s * NS_PER_S) if timeout_s else math.inf
        self._at_ns = None
        self.is_marked_stale = False

    def update(self, value, now_ns: int) -> None:
        """Take ``value`` as the newest, arrived at ``now_ns``."""
        self.value = value
        self._at_ns = now_ns
        self.is_marked_stale = False

    def mark_stale(self) -> None:
        """Messages were dropped, and its newest may be one of them: it is silent, whatever its timeout, until heard."""
        self.is_marked_stale = self.was_received

    @property
    def was_received(self) -> bool:
        """Whether anything ever arrived."""
        return self._at_ns is not None

    def is_stale(self, now_ns: int) -> bool:
        """Whether it was never heard, not for longer than its timeout, or not since it was marked stale."""
        return self._at_ns is None or self.is_marked_stale or now_ns - self._at_ns > self._timeout_ns

    def age_s(self, now_ns: int) -> float:
        """Seconds since it was heard; inf = never."""
        return math.inf if self._at_ns is None else max(0, now_ns - self._at_ns) / NS_PER_S

    def stale_reason(self, now_ns: int) -> str:
        """Its silence in words, for a reason: ``human_in_loop silent for 0.52 s``."""
        if not self.was_received:
            return f"{self.name} was never heard"
        if self.is_marked_stale:
            return f"{self.name} was not heard since {DROPPED}"
        return f"{self.name} silent for {self.age_s(now_ns):.2f} s"
