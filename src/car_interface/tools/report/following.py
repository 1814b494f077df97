"""Compares what a car did with what it was sent: medians of ratios and differences, in bounded memory."""
from __future__ import annotations

import math
from collections import deque
from typing import Any, NamedTuple

# The car is compared with what it was sent at speed, and in a real bend or straight on, a while after the last change.
STEADY_S, MIN_CURVATURE_PER_M, STRAIGHT_PER_M, MIN_SPEED_MPS = 0.7, 0.1, 0.02, 0.3
# Faster in a bend tyres widen it: by an understeer of 0.009, as measured on a 3.5 kg car, 0.028 1/m.
MAX_LATERAL_MPS2 = 1.5
# From, to, a bin; what fits exactly, 1 or 0, is the middle of one. A ratio is never 0: radii have its inverse.
RATIOS, OFFSETS_PER_M, OFFSETS_MPS2 = (0.001, 3.001, 0.002), (-1.0005, 1.0005, 0.001), (-5.005, 5.005, 0.01)
MIN_REQUEST_MPS2 = 0.2  # less holds the speed
REACTION_S, KEPT_S = 0.1, 2.0  # from a request to the acceleration; how long requests are kept


class MedianOf(NamedTuple):
    """The median of how the car did what it was sent."""

    median: float  # NaN without samples
    samples: int


class Bins:
    """Numbers counted in bins, for a median as exact as they are wide; the first and the last take what lies beyond."""

    def __init__(self, low: float, high: float, width: float):
        self._low, self._width = low, width
        self._counts = [0] * round((high - low) / width)

    def add(self, number: float) -> None:
        """Add a finite number."""
        self._counts[min(max(int((number - self._low) / self._width), 0), len(self._counts) - 1)] += 1

    def median(self) -> MedianOf:
        """Return the median: the middle of its bin."""
        total, seen = sum(self._counts), 0
        for index, count in enumerate(self._counts):
            seen += count
            if total and seen * 2 >= total:
                return MedianOf(self._low + (index + 0.5) * self._width, total)
        return MedianOf(math.nan, 0)


class Following:
    """How tightly a car turned against what it was sent.

    Args:
        sender: with ``curvature_per_m`` that is sent now, left positive, ``None`` = unknown, and ``unchanged_since_s``.
        max_lateral_mps2: faster bends don't count; MAX_LATERAL_MPS2 judges a table, which knows no tyres.
    """

    def __init__(self, sender: Any, max_lateral_mps2: float = math.inf):
        self._sender, self._max_lateral_mps2 = sender, max_lateral_mps2
        self._left, self._right, self._straight = Bins(*RATIOS), Bins(*RATIOS), Bins(*OFFSETS_PER_M)

    def add(self, time_s: float, curvature_per_m: float, speed_mps: float) -> None:
        """Compare what the car drives now."""
        sent = self._sender.curvature_per_m
        if (sent is None or not math.isfinite(sent) or abs(speed_mps) <= MIN_SPEED_MPS
                or time_s - self._sender.unchanged_since_s <= STEADY_S):
            return
        if abs(sent) > MIN_CURVATURE_PER_M:
            if speed_mps ** 2 * abs(curvature_per_m) <= self._max_lateral_mps2:
                (self._left if sent > 0 else self._right).add(curvature_per_m / sent)
        elif abs(sent) <= STRAIGHT_PER_M:
            self._straight.add(curvature_per_m - sent)

    def ratios(self) -> tuple[MedianOf, MedianOf]:
        """Return (left, right): the driven curvature as a ratio of the sent one."""
        return self._left.median(), self._right.median()

    def straight_per_m(self) -> MedianOf:
        """Return the driven curvature less the sent one where that was straight on, left positive."""
        return self._straight.median()


class Accelerating:
    """By how much the car's acceleration differed from the one that the planner requested, while the planner drove.

    The value map turns requests into values, so that this is how far the map is off.
    """

    def __init__(self):
        self._requests: deque = deque()  # time, m/s²
        self._driving, self._holding, self._braking = (Bins(*OFFSETS_MPS2) for _ in range(3))

    def request(self, time_s: float, acceleration_mps2: float) -> None:
        """Take the planner's request."""
        if not math.isfinite(acceleration_mps2):
            return
        self._requests.append((time_s, acceleration_mps2))
        while not 0 <= time_s - self._requests[0][0] <= KEPT_S:
            self._requests.popleft()

    def add(self, start_s: float, end_s: float, acceleration_mps2: float, speed_mps: float) -> None:
        """Compare what the car did from ``start_s`` to ``end_s``, while the planner drove, with the mean request."""
        if speed_mps <= MIN_SPEED_MPS or not math.isfinite(acceleration_mps2):
            return
        requested = [wanted for time_s, wanted in self._requests if start_s <= time_s + REACTION_S <= end_s]
        if requested:
            mean_mps2 = sum(requested) / len(requested)
            bins = (self._holding if abs(mean_mps2) <= MIN_REQUEST_MPS2 else
                    self._driving if mean_mps2 > 0 else self._braking)
            bins.add(acceleration_mps2 - mean_mps2)

    def differences_mps2(self) -> tuple[MedianOf, MedianOf, MedianOf]:
        """Return by how much it accelerated more than requested where it was to drive, to hold its speed, to brake."""
        return self._driving.median(), self._holding.median(), self._braking.median()
