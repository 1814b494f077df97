"""Requests to an ESC, and whether a negative one means reverse.

A brake and reverse are the same stick to the same side. What a person means is told by the order: pull, center, pull.
"""
from __future__ import annotations

import math
from typing import NamedTuple

# Which way the driver wants to go. AUTO: a stick, whose second pull means reverse.
AUTO, DRIVE, REVERSE_GEAR = "auto", "drive", "reverse"
GEARS = (AUTO, DRIVE, REVERSE_GEAR)


class Request(NamedTuple):
    """What is asked of the ESC.

    Attributes:
        value: −1..1, the fraction between neutral and each end; not finite = stop.
        gear: AUTO for a stick; DRIVE and REVERSE_GEAR for a planner's gear. A held reverse button is REVERSE_GEAR; a
            stick that must never reverse, however often it is pulled, is DRIVE: its pull brakes backward, too.
        is_human: a person asks. For a planner, reverse needs a known speed, and AUTO is DRIVE.
        is_stop: the car has to stop, whatever ``value`` is: no deadman, a lock, a silent source.
        is_centered: the stick is in its dead band.
        is_released: the deadman is known to be released.
        cruise_mps: the speed that a planner wants the car to keep, backward negative; 0 = a stop, or nobody has said.
    """

    value: float = 0.0
    gear: str = AUTO
    is_human: bool = False
    is_stop: bool = False
    is_centered: bool = False
    is_released: bool = False
    cruise_mps: float = 0.0


STOP = Request(is_stop=True)


class Pulls:
    """Counts a person's pulls at the stick.

    A stop, a planner, a gear and a push forward begin anew; so a stick that is held back through a stop means no
    reverse until it was in the center and is pulled again. So does a number that is not finite.

    Args:
        dead_band: a pull begins beyond it. It ends at half of it, or a stick that trembles there would pull twice.

    Attributes:
        began_ns: when the newest pull began.
    """

    def __init__(self, dead_band: float):
        self._dead_band = dead_band
        self._was_one = False  # there was a pull, and the stick came back to the center
        self._in_pull = False
        self._is_second = False
        self.began_ns = 0

    @property
    def means_reverse(self) -> bool:
        """Whether the stick is in a second pull that has not become a brake."""
        return self._in_pull and self._is_second

    def update(self, request: Request, now_ns: int) -> None:
        """The newest request."""
        value = request.value
        is_stick = request.is_human and request.gear == AUTO and not request.is_stop
        if not is_stick or not math.isfinite(value) or value > self._dead_band:
            self._was_one = self._in_pull = False
        elif value <= -self._dead_band:
            if not self._in_pull:
                self._in_pull, self._is_second, self.began_ns = True, self._was_one, now_ns
        elif self._in_pull and value > -self._dead_band / 2:
            self._in_pull, self._was_one = False, True

    def mark_brake(self) -> None:
        """The car rolled forward during this pull: it is a brake, and no reverse until the next pull."""
        self._is_second = False
