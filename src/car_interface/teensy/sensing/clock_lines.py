"""Finds the lines of host time over the Teensy's time that pings and pongs allow.

Tick k means that the Teensy's clock was somewhere in [k, k + 1) ms. Over a minute crystals run evenly, so that host
time is a line over the Teensy's time, which is bounded:

- the Teensy answers a ping after its last byte has come: line(k + 1) ≥ sent + the ping's time on the wire;
- it reads its clock before the first byte of a frame leaves: line(k) ≤ received − the frame's time on the wire.

The lines that no bound forbids are a convex polygon in the plane of offset and skew: each bound cuts off a half-plane.
The polygon's corners give the earliest and the latest time of any tick. These are strict bounds, not statistics: they
hold for any time that a frame waits in a buffer.

Nothing but pings goes to the Teensy, so the lower bounds are tight to the tick, while the answers queue up. So the
line is chosen that lies lowest over the middle of the pings, where the sum of the delays is smallest: a linear program,
whose optimum is a corner of the polygon (S. Moon, P. Skelly, D. Towsley, "Estimation and removal of clock skew from
network delay measurements", INFOCOM 1999). The truth lies above it: the line is moved towards the centre of the
polygon by the delay that is to be expected with this number of pings, and never beyond the centre.

Temperature bends the line: a bound of age τ is loosened by ½ wander τ², the largest distance between the truth and the
line that is right now. So old bounds fade by themselves, and times far from the last pings are uncertain.

Pure: ticks and monotonic nanoseconds in.
"""
from __future__ import annotations

import math
from typing import NamedTuple

from car_interface.common.units import NS_PER_MS

MAX_SKEW_PPM = 500.0  # the largest difference of the clocks' rates; crystals have up to 100 each
WANDER_PPM_PER_H = 100.0  # the largest change of that in an hour; a car that warms up makes 20
BEND = 0.5 * 1e-6 / 3600 * 1e-6 * 1e9 * WANDER_PPM_PER_H  # of ½ wander τ² in ns, τ in ms


class Bound(NamedTuple):
    """The line was at ``tick`` not before, or not after ``ns``."""

    tick: int
    ns: int


class PongBounds(NamedTuple):
    """The bounds of a pong."""

    earliest: Bound
    latest: Bound


class ClockLines:
    """All lines from ticks to host time that no bound forbids.

    x ms after the reference a line is at the reference + 10**6 x + offset + skew x: 1 ns per ms is 1 ppm. The corners
    (offset, skew) of the polygon go around it.
    """

    def __init__(self, pong: PongBounds):
        self._tick, self._ns = pong.latest
        min_ns = pong.earliest.ns - self._ns - 2 * NS_PER_MS  # below the pong's own bound at any skew
        self._corners = [(min_ns, -MAX_SKEW_PPM), (0.0, -MAX_SKEW_PPM), (0.0, MAX_SKEW_PPM), (min_ns, MAX_SKEW_PPM)]
        self._middle = 0.0
        self._gap_ns = 0.0
        self._chosen = None
        self.admit(*pong)

    def admit(self, earliest: Bound | None, latest: Bound | None) -> bool:
        """Clip the lines that these bounds forbid; if none would be left, change nothing and return False."""
        corners = self._corners
        if earliest:
            corners = _clip(corners, *self._place(earliest, -1), 1)
        if latest:
            corners = _clip(corners, *self._place(latest, 1), -1)
        if not corners:
            return False
        if corners is not self._corners:
            self._corners = corners
            self._chosen = None
        return True

    def choose(self, middle_tick: float, gap_ns: float) -> None:
        """Choose the line that is lowest at this tick, raised by the gap towards the centre, and not beyond it."""
        self._middle = middle_tick - self._tick
        self._gap_ns = gap_ns
        self._chosen = None

    @property
    def slope(self) -> float:
        """The chosen line's slope, ns per ms."""
        return NS_PER_MS + self._line()[1]

    def skew_ppm(self) -> float:
        """Return how much faster the Teensy's clock runs, by the chosen line."""
        return 1e6 * (NS_PER_MS / self.slope - 1)

    def offset_ns(self) -> int:
        """Return when the Teensy's clock is at 0, by the chosen line."""
        offset, skew = self._line()
        return self._ns - self._tick * NS_PER_MS + round(offset - skew * self._tick)

    def tick_at(self, host_ns: int) -> float:
        """Return the Teensy's clock, ms, by the inverse of the chosen line."""
        offset, skew = self._line()
        return self._tick + (host_ns - self._ns - offset) / (NS_PER_MS + skew)

    def translate(self, tick: int) -> tuple[int, int, int]:
        """Return the middle of a tick by the chosen line, and its earliest beginning and latest end by all lines."""
        offset, skew = self._line()
        x = tick - self._tick
        base_ns = self._ns + x * NS_PER_MS
        low = min([offset + skew * x for offset, skew in self._corners])
        high = max([offset + skew * (x + 1) for offset, skew in self._corners])
        bend_ns = BEND * (abs(x) + 1) ** 2
        return (base_ns + NS_PER_MS // 2 + round(offset + skew * (x + 0.5)), base_ns + math.floor(low - bend_ns),
                base_ns + NS_PER_MS + math.ceil(high + bend_ns))

    def _line(self):
        if self._chosen is None:
            middle = self._middle
            lowest = min(self._corners, key=lambda line: line[0] + line[1] * middle)
            center = _center(self._corners)
            rise_ns = center[0] - lowest[0] + (center[1] - lowest[1]) * middle
            ratio = min(1.0, self._gap_ns / rise_ns) if rise_ns > 0 else 0.0
            self._chosen = tuple(low + ratio * (high - low) for low, high in zip(lowest, center))
        return self._chosen

    def _place(self, bound, side):
        """Return a bound relative to the reference, loosened up (1) or down (-1) by the largest bend of the truth."""
        x = bound.tick - self._tick
        return x, bound.ns - self._ns - x * NS_PER_MS + side * BEND * x * x


def rise_ns(before: Bound, after: Bound, slope: float) -> float:
    """Return how far one bound lies over the line of this slope through another."""
    return after.ns - before.ns - slope * (after.tick - before.tick)


def _clip(corners, x, y, side):
    """Clip a convex polygon: the part of the lines (offset, skew) that at x pass above y (side 1) or below (-1)."""
    heights = [side * (offset + skew * x - y) for offset, skew in corners]
    if not heights or min(heights) >= 0:
        return corners
    left = []
    before, height_before = corners[-1], heights[-1]
    for corner, height in zip(corners, heights):
        if (height < 0) != (height_before < 0):
            ratio = height_before / (height_before - height)
            left.append((before[0] + ratio * (corner[0] - before[0]), before[1] + ratio * (corner[1] - before[1])))
        if height >= 0:
            left.append(corner)
        before, height_before = corner, height
    return left


def _center(corners):
    """Return the centre of a polygon's area."""
    first_offset, first_skew = corners[0]
    area = offset = skew = 0.0
    for before, after in zip(corners[1:], corners[2:]):
        # The triangle of these two and the first corner.
        u, v = before[0] - first_offset, before[1] - first_skew
        w, z = after[0] - first_offset, after[1] - first_skew
        double = u * z - v * w
        area += double
        offset += double * (u + w)
        skew += double * (v + z)
    if not area:
        return tuple(sum(ends) / len(corners) for ends in zip(*corners))
    return first_offset + offset / (3 * area), first_skew + skew / (3 * area)
