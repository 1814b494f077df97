"""How the car stopped whenever the button was let go: the least deceleration that was seen.

What slows it then is its own drag and what its ESC does, which differ by a factor of 20 from car to car; and a slope of
2 % adds or takes 0.2 m/s², by the direction in which it rolls. Only stops without a brake count.
"""
from __future__ import annotations

import math

from car_interface.common.units import NS_PER_S

REACTION_S = 0.1  # from the button to neutral at least; all that comes later counts as rolled
MIN_BEGIN_MPS, MIN_ROLLED_M = 0.25, 0.12  # a slower or a shorter one shows little
PULSE_M = 0.04  # what odometry may not have seen yet
STANDS_MPS = 0.05
PUSHED_MPS = 0.1  # faster than it was by this
MAX_ROLL_NS = 8 * NS_PER_S
NEUTRAL_NS, SECOND_NS = NS_PER_S // 2, NS_PER_S  # until the ESC is surely in neutral; what then counts by itself
FASTER_MPS = 0.05  # in such a second: by hands
MIN_MPS2 = 0.1  # no floor is so steep that the car hardly gets slower


class Stops:
    """The stops of one drive."""

    def __init__(self):
        self.least_mps2 = math.inf  # of whole stops, and of each second that it rolled; inf = none was seen
        self._begin: tuple[int, float] | None = None  # time and speed as the button was let go
        self._second: tuple[int, float] | None = None  # time and speed as this one began
        self._rolled_m = 0.0  # since then
        self._driven: float | None = None  # speed while the button is held

    def update(self, moved_m: float, speed_mps: float, is_driven: bool, at_ns: int) -> None:
        """Take an odometry: how far it moved since the last one, and its speed, forward positive; whether the button is
        held, and when it was measured.
        """
        if is_driven:
            self._end(speed_mps, at_ns)
            self._driven = speed_mps
        elif self._driven is not None:
            self._begin, self._rolled_m = (at_ns, self._driven), moved_m
            self._driven = self._second = None
        elif self._begin is not None:
            self._rolled_m += moved_m
            if speed_mps > self._begin[1] + PUSHED_MPS or speed_mps < -STANDS_MPS:
                self.discard()
            elif abs(speed_mps) < STANDS_MPS or at_ns - self._begin[0] > MAX_ROLL_NS:
                self._end(speed_mps, at_ns)
            else:
                self._roll(speed_mps, at_ns)

    def discard(self) -> None:
        """Discard the stop that is under way: hands move the car, or a person drives it."""
        self._begin = None

    def _roll(self, speed_mps, at_ns):
        """It rolls on: some cars brake at first, and hardly any more then."""
        if at_ns - self._begin[0] < NEUTRAL_NS or speed_mps < MIN_BEGIN_MPS:
            return
        if self._second is None:
            self._second = at_ns, speed_mps
        elif at_ns - self._second[0] >= SECOND_NS:
            slower_mps = self._second[1] - speed_mps
            if slower_mps > -FASTER_MPS:
                self._note(slower_mps / ((at_ns - self._second[0]) / NS_PER_S))
            self._second = at_ns, speed_mps

    def _end(self, speed_mps, at_ns):
        """It stands, or is driven again."""
        if self._begin is None:
            return
        (begun_ns, begin_mps), self._begin = self._begin, None
        rolled_m = max(0.0, self._rolled_m - begin_mps * min(REACTION_S, (at_ns - begun_ns) / NS_PER_S))
        stands = abs(speed_mps) < STANDS_MPS
        if begin_mps < MIN_BEGIN_MPS or not stands and rolled_m < MIN_ROLLED_M:
            return
        lost = begin_mps ** 2 - (0.0 if stands else speed_mps ** 2)
        self._note(lost / (2 * (rolled_m + PULSE_M)))

    def _note(self, mps2):
        self.least_mps2 = max(MIN_MPS2, min(self.least_mps2, mps2))
