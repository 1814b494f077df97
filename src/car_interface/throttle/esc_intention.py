"""Define requests to an ESC, and find out whether a person's pull means reverse.

Brake and reverse are the same stick to the same side. The order shows which of them a person means: only the second
pull, after the stick was centered, means reverse (``Pulls.means_reverse``).
"""
from __future__ import annotations

import math
from typing import NamedTuple

# The direction in which the driver wants to go. AUTO: a stick, whose second pull means reverse.
AUTO, DRIVE, REVERSE_GEAR = "auto", "drive", "reverse"


class Request(NamedTuple):
    """One request to the ESC.

    Attributes:
        value: −1..1, the fraction between neutral and each end; not finite = stop.
        gear: AUTO for a stick; DRIVE and REVERSE_GEAR for a planner's gear. A stick that must never reverse, however
            often it is pulled, has DRIVE; its pull also brakes a car that rolls backward.
        is_human: a person requests it. For a planner, reverse needs a known speed, and AUTO is DRIVE.
        is_stop: the car has to stop, whatever ``value`` is: no deadman, e-stop, a stale source.
        is_centered: the stick is within its dead band.
        is_released: the deadman is known to be released.
        cruise_mps: the speed that a planner wants the car to keep, backward negative; 0 = a stop, or unknown.
    """

    value: float = 0.0
    gear: str = AUTO
    is_human: bool = False
    is_stop: bool = False
    is_centered: bool = False
    is_released: bool = False
    cruise_mps: float = 0.0


class Pulls:
    """Count a person's pulls at the stick.

    The count starts over at a stop, a planner's request, a gear, a push, and a value that isn't finite. So a stick that
    stays pulled through a stop doesn't mean reverse.

    Args:
        dead_band_forward: the ESC drives from there on.
        dead_band_reverse: a pull begins there, and ends within half of it: a trembling stick doesn't pull twice. A push
            begins at half of it, too: the person wants no reverse, though the car may not drive yet.

    Attributes:
        began_ns: when the newest pull began.
    """

    def __init__(self, dead_band_forward: float, dead_band_reverse: float):
        self._push, self._dead_band = min(dead_band_forward, dead_band_reverse / 2), dead_band_reverse
        self._was_one = False  # there was a pull, and the stick has returned to the center
        self._in_pull = False
        self._is_second = False
        self.began_ns = 0

    @property
    def means_reverse(self) -> bool:
        """Return whether the stick is in a second pull that has not become a brake."""
        return self._in_pull and self._is_second

    def update(self, request: Request, now_ns: int) -> None:
        """Take the newest request."""
        value = request.value
        is_stick = request.is_human and request.gear == AUTO and not request.is_stop
        if not is_stick or not math.isfinite(value) or value >= self._push:
            self._was_one = self._in_pull = False
        elif value <= -self._dead_band:
            if not self._in_pull:
                self._in_pull, self._is_second, self.began_ns = True, self._was_one, now_ns
        elif self._in_pull and value > -self._dead_band / 2:
            self._in_pull, self._was_one = False, True

    def mark_brake(self) -> None:
        """Make this pull a brake, since the car rolled forward during it: no reverse before the next pull."""
        self._is_second = False
