"""How the car stopped whenever the button was let go, and so with what it surely stops the next time.

What slows it then is its own drag and what its ESC does, which differ by a factor of 20 from car to car; and a slope of
2 % adds or takes 0.2 m/s², by the direction in which it rolls. So every stop counts with its direction: a level
deceleration and a slope are estimated from all of them, and what is certain is what their errors leave. That is hardly
anything after one stop, and nearly what was seen after some in different directions. Only stops without a brake count.
"""
from __future__ import annotations

import math

import numpy as np

from car_interface.common.units import NS_PER_S

REACTION_S = 0.1  # from the button to neutral at least; all that comes later counts as rolled
MIN_BEGIN_MPS, MIN_ROLLED_M = 0.25, 0.12  # a slower or a shorter one shows little
PULSE_M = 0.04  # what odometry may not have seen yet
STANDS_MPS = 0.05
PUSHED_MPS = 0.1  # faster than it was by this
MAX_ROLL_NS = 8 * NS_PER_S
NEUTRAL_NS, SECOND_NS = NS_PER_S // 2, NS_PER_S  # until the ESC is surely in neutral; what then counts by itself
FASTER_MPS = 0.05  # in such a second: by hands
NOISE_RATIO, NOISE_MPS2 = 0.15, 0.03  # of one stop: a standard deviation
SLOPE_MPS2 = 0.12  # along each axis: a standard deviation of where people calibrate
SURE = 2.0  # standard deviations
MIN_MPS2, MAX_MPS2 = 0.1, 0.8  # of all: no floor is so steep that the car hardly gets slower; more would change little
MIN_STOPS = 2  # a hand may have caught it once
UNITS = np.array([(1.0, math.cos(angle), math.sin(angle)) for angle in np.arange(24) * math.pi / 12])


class Stops:
    """The stops of one drive."""

    def __init__(self):
        self._units: list[tuple] = []  # of each stop, with the direction in which it rolled, as UNITS
        self._seen_mps2: list[float] = []  # with what it stopped
        self._sure_mps2 = 0.0
        self._slowest_mps2 = math.inf  # of each second that it rolled
        self._begin: tuple[int, float, float] | None = None  # time, speed and heading as the button was let go
        self._second: tuple[int, float] | None = None  # time and speed as this one began
        self._rolled_m = 0.0  # since then
        self._driven: tuple[float, float] | None = None  # speed and heading while the button is held

    def update(self, moved_m: float, speed_mps: float, yaw_rad: float, is_driven: bool, at_ns: int) -> None:
        """Take an odometry: how far it moved since the last one, its speed, forward positive, and its heading; whether
        the button is held, and when it was measured.
        """
        if is_driven:
            self._end(speed_mps, at_ns)
            self._driven = speed_mps, yaw_rad
        elif self._driven is not None:
            self._begin, self._rolled_m = (at_ns, *self._driven), moved_m
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
                self._slowest_mps2 = min(self._slowest_mps2, slower_mps / ((at_ns - self._second[0]) / NS_PER_S))
            self._second = at_ns, speed_mps

    def _end(self, speed_mps, at_ns):
        """It stands, or is driven again."""
        if self._begin is None:
            return
        (begun_ns, begin_mps, yaw_rad), self._begin = self._begin, None
        rolled_m = max(0.0, self._rolled_m - begin_mps * min(REACTION_S, (at_ns - begun_ns) / NS_PER_S))
        stands = abs(speed_mps) < STANDS_MPS
        if begin_mps < MIN_BEGIN_MPS or not stands and rolled_m < MIN_ROLLED_M:
            return
        lost = begin_mps ** 2 - (0.0 if stands else speed_mps ** 2)
        self._units.append((1.0, math.cos(yaw_rad), math.sin(yaw_rad)))
        self._seen_mps2.append(max(0.0, lost / (2 * (rolled_m + PULSE_M))))
        if len(self._seen_mps2) >= MIN_STOPS:
            self._sure_mps2 = self._estimate()

    @property
    def least_mps2(self) -> float:
        """The least deceleration that was seen, of a whole stop or of a second of it; inf = none was."""
        return max(MIN_MPS2, min(self._slowest_mps2, *self._seen_mps2, math.inf))

    @property
    def sure_mps2(self) -> float:
        """The deceleration that is certain in any direction; 0 = too little was seen."""
        return min(self._sure_mps2, *self._seen_mps2, MAX_MPS2)

    def _estimate(self):
        """Return what is certain in the worst of the directions: least squares, with a slope that isn't steep."""
        units, seen = np.array(self._units), np.minimum(self._seen_mps2, MAX_MPS2)
        weights = (NOISE_RATIO * seen + NOISE_MPS2) ** -2
        slopes = np.diag([0.0, SLOPE_MPS2 ** -2, SLOPE_MPS2 ** -2])
        covariance = np.linalg.inv(units.T @ (units * weights[:, None]) + slopes)
        found = covariance @ (units.T @ (weights * seen))
        sigmas = np.sqrt(np.einsum("ij,jk,ik->i", UNITS, covariance, UNITS))
        return min(MAX_MPS2, max(0.0, float(np.min(UNITS @ found - SURE * sigmas))))
