"""Compares what a car did with what it was sent: medians of ratios and differences, in bounded memory."""
from __future__ import annotations

import math
from bisect import bisect_left
from collections import deque
from itertools import accumulate
from typing import Any

# The car is compared with what it was sent at speed, and in a real bend or straight on, a while after the last change.
STEADY_S, MIN_CURVATURE_PER_M, STRAIGHT_PER_M, MIN_SPEED_MPS = 0.7, 0.1, 0.02, 0.3
# Faster in a bend tyres widen it: by an understeer of 0.009, as measured on a 3.5 kg car, 0.028 1/m.
MAX_LATERAL_MPS2 = 1.5
# From, to, a bin; what fits exactly, 1 or 0, is the middle of one. A ratio is never 0: radii have its inverse.
RATIOS, OFFSETS_PER_M, OFFSETS_MPS2 = (0.001, 3.001, 0.002), (-1.0005, 1.0005, 0.001), (-5.005, 5.005, 0.01)
MIN_SAMPLES = 30  # for a median
MIN_REQUEST_MPS2 = 0.2  # less holds the speed
REACTION_S, KEPT_S = 0.1, 2.0  # from a request to the acceleration; how long requests are kept


class Bins:
    """Numbers counted in bins, for a median as exact as they are wide; the first and the last take what lies beyond."""

    def __init__(self, low: float, high: float, width: float):
        self._low, self._width = low, width
        self._counts = [0] * round((high - low) / width)

    def add(self, number: float) -> None:
        """Add a finite number."""
        self._counts[min(max(int((number - self._low) / self._width), 0), len(self._counts) - 1)] += 1

    @property
    def samples(self) -> int:
        """Return how many numbers there are."""
        return sum(self._counts)

    def median(self) -> float | None:
        """Return the median, the middle of its bin; ``None`` with fewer than MIN_SAMPLES."""
        seen = list(accumulate(self._counts))
        if seen[-1] < MIN_SAMPLES:
            return None
        return self._low + (bisect_left(seen, seen[-1] / 2) + 0.5) * self._width


class Following:
    """How tightly a car turned against what it was sent.

    Args:
        sender: with ``curvature_per_m`` that is sent now, left positive, ``None`` = unknown, and ``unchanged_since_s``.
        max_lateral_mps2: faster bends don't count; MAX_LATERAL_MPS2 judges a table, which knows no tyres.
    """

    def __init__(self, sender: Any, max_lateral_mps2: float = math.inf):
        self._sender, self._max_lateral_mps2 = sender, max_lateral_mps2
        self.left, self.right = Bins(*RATIOS), Bins(*RATIOS)  # the driven curvature as a ratio of the sent one
        self.straight_per_m = Bins(*OFFSETS_PER_M)  # the driven less the sent one where that was straight on

    def add(self, time_s: float, curvature_per_m: float, speed_mps: float) -> None:
        """Compare what the car drives now."""
        sent = self._sender.curvature_per_m
        if (sent is None or not math.isfinite(sent) or abs(speed_mps) <= MIN_SPEED_MPS
                or time_s - self._sender.unchanged_since_s <= STEADY_S):
            return
        if abs(sent) > MIN_CURVATURE_PER_M:
            if speed_mps ** 2 * abs(curvature_per_m) <= self._max_lateral_mps2:
                (self.left if sent > 0 else self.right).add(curvature_per_m / sent)
        elif abs(sent) <= STRAIGHT_PER_M:
            self.straight_per_m.add(curvature_per_m - sent)


class Accelerating:
    """By how much the car's acceleration differed from the one that the planner requested, while the planner drove.

    The value map turns requests into values, so that this is how far the map is off.
    """

    def __init__(self):
        self._requests: deque = deque()  # time, m/s²
        # By how much it accelerated more than requested where it was to drive, to hold its speed, to brake; in m/s².
        self.driving, self.holding, self.braking = (Bins(*OFFSETS_MPS2) for _ in range(3))

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
            bins = (self.holding if abs(mean_mps2) <= MIN_REQUEST_MPS2 else
                    self.driving if mean_mps2 > 0 else self.braking)
            bins.add(acceleration_mps2 - mean_mps2)
