"""Finds where the two wheels' magnets stood at the start, relative to each other.

At the start each wheel is anywhere between two of its magnets. The first few pulses show by how much the two wheels
differ, if the curvature stayed the same over these centimetres; until then the heading is 0. Pure: units are pulses.
"""
from __future__ import annotations

from car_interface.teensy.sensing.wheel_filter import WheelFilter

ALIGNING_PULSES, LAST_ALIGNING_PULSES = 6, 24
ALIGNED_PULSES = 0.12  # of the difference after that, one sigma
UNALIGNED_PULSES = 0.41  # the same before: 1 / √6, the difference of two positions anywhere within a pulse
MAX_RATIO = 2.0  # of the wheels' speeds in a turn: 1.35 on a radius of 1 m with a track of 0.3 m


class Alignment:
    """Estimates by how much the two wheels' magnets differ at the start."""

    def __init__(self):
        self.is_done = False  # the difference is settled
        # Of the starting positions, right minus left, in pulses; 0 is the mean of all possible values.
        self.difference = 0.0

    def solve(self, left: WheelFilter, right: WheelFilter) -> bool:
        """Return whether the difference is settled now; after many pulses without an answer it is 0.

        While the ratio of the wheels' distances stays the same, their positions lie on a line, and the start is where
        that line meets the possible positions: each between two magnets.
        """
        few = min(left.updates, right.updates) < ALIGNING_PULSES
        pairs = [] if few else _pairs(left.first_pulses, right.first_pulses)
        if len(pairs) < ALIGNING_PULSES and max(left.updates, right.updates) < LAST_ALIGNING_PULSES:
            return False
        self.skip(left, right)
        slope, at_0 = _line(pairs)
        if not 1 / MAX_RATIO < slope < MAX_RATIO:
            return True
        low, high = max(0.0, -at_0 / slope), min(1.0, (1 - at_0) / slope)
        start = (low + high) / 2
        self.difference = max(-1.0, min(1.0, at_0 + slope * start - start))
        return True

    def skip(self, left: WheelFilter, right: WheelFilter) -> None:
        """Settle for the mean of all possible values."""
        self.is_done = True
        left.first_pulses = right.first_pulses = None


def _pairs(left, right):
    """Return positions (left, right) of both wheels at the same time: at each pulse of one between two of the other."""
    pairs = []
    for pulses, others, is_left in ((left, right, True), (right, left, False)):
        for at_ms, place in pulses:
            for (before_ms, before), (after_ms, after) in zip(others, others[1:]):
                if before_ms <= at_ms <= after_ms and before_ms < after_ms:
                    other = before + (after - before) * (at_ms - before_ms) / (after_ms - before_ms)
                    pairs.append((place, other) if is_left else (other, place))
                    break
    return pairs


def _line(pairs):
    """Return slope and value at 0 by least squares; slope 0 when the points are too few or give none."""
    if len(pairs) < ALIGNING_PULSES:
        return 0.0, 0.0
    mean_x, mean_y = (sum(values) / len(pairs) for values in zip(*pairs))
    spread = sum((x - mean_x) ** 2 for x, _ in pairs)
    slope = sum((x - mean_x) * y for x, y in pairs) / spread if spread > 0 else 0.0
    return slope, mean_y - slope * mean_x
