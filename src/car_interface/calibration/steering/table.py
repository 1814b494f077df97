"""A steering's curve as a table of duties over turn radii: what turn_arb steers by."""
from __future__ import annotations

import math
from typing import NamedTuple, Sequence

import numpy as np

from car_interface.calibration.steering.fit import BAND, Curve, slope
from car_interface.calibration.steering.segments import COUNT, DEFAULTS, FitConfig

LEFT, RIGHT = "left", "right"
# What a breakpoint's duty rests on.
DRIVEN, END, OLD, UNKNOWN = "driven", "end", "old", "unknown"
WIDE_RADII_M = (5.0, 6.0, 7.0, 8.0, 10.0, 12.0, 15.0, 20.0, 30.0, 50.0, 100.0, 300.0)
NEAR_RATIO = 0.25  # pieces count for a radius when their curvature is so near to its


class Breakpoint(NamedTuple):
    """One radius of a table, one side."""

    radius_m: float
    duty: float
    duty_sigma: float
    radius_sigma_m: float
    pieces: int  # that were driven about as tight
    distance_m: float  # in these
    source: str  # DRIVEN, END: no tighter turn can be had, OLD or UNKNOWN


def axis(curve: Curve) -> list[float]:
    """Radii between which straight lines cost little, from the tightest that was driven on."""
    tightest = 1 / max(curve.left.curvature_per_m, curve.right.curvature_per_m)
    radius, radii = math.floor(tightest * 100) / 100, []
    while radius < 4.9:  # nearer to 5 it would be 5 when it's rounded, or next to it
        radii.append(round(radius, 2))
        radius *= 1.08 if radius < 2 else 1.12
    return [*radii, *WIDE_RADII_M]


def widened(radii_m: Sequence[float], wide_m: float) -> list[float]:
    """Radii, continued to almost straight on if they end before ``wide_m``: beyond the last turn_arb turns as there.

    Not by the widest one alone: on a straight line to it what is half way is nowhere near half as tight.
    """
    if radii_m[-1] >= wide_m:
        return list(radii_m)
    return [*radii_m, *(radius for radius in WIDE_RADII_M if radius > 1.1 * radii_m[-1])]


def breakpoints(curve: Curve, radii_m: Sequence[float], side: str, config: FitConfig = DEFAULTS) -> list[Breakpoint]:
    """The duties for radii on one side, and what they rest on."""
    sign = 1.0 if side == LEFT else -1.0
    end = curve.left if side == LEFT else curve.right
    outwards = 1.0 if (end.duty - curve.duties.mean()) > 0 else -1.0
    driven, ways = sign * curve.pieces.curvature_per_m[curve.kept], curve.pieces.distance_m[curve.kept]
    found = []
    for radius in radii_m:
        k = 1.0 / radius
        duty = float(curve.duty(sign * k))
        duty = min(duty, end.duty) if outwards > 0 else max(duty, end.duty)
        # Only counts can be held: how far it's known what lies between two of them doesn't matter.
        count = round(duty / COUNT) * COUNT
        sigma = float(np.interp(count, curve.duties, curve.sigmas))
        before, behind = curve.curvature(np.array([count - COUNT, count + COUNT]))
        near = np.abs(driven - k) <= max(NEAR_RATIO * k, config.known_per_m)
        half_count = abs(behind - before) / 4
        is_known = BAND * sigma <= max(config.known_ratio * k, config.known_per_m) + half_count
        if k >= end.curvature_per_m * (1 - config.stop_ratio):
            duty, source = end.duty, END if end.is_end and is_known else UNKNOWN
        else:
            source = DRIVEN if is_known and driven.size and driven.min() <= k <= driven.max() else UNKNOWN
        steepness = slope(curve.duties, curve.curvatures, duty)
        found.append(Breakpoint(float(radius), duty, sigma / max(steepness, 1e-9), sigma / k ** 2, int(near.sum()),
                                float(ways[near].sum()), source))
    return found


def completed(points: Sequence[Breakpoint], center: float, old: Sequence[float]) -> list[Breakpoint]:
    """Breakpoints of one side with old duties where nothing was driven.

    Args:
        points: with rising radii.
        center: the duty that goes straight.
        old: a duty for each point. One that doesn't fit between those that were driven gives way to the nearest that
            does, so that from radius to radius duties go to the center and never back.
    """
    driven = [point.duty for point in points if point.source != UNKNOWN]
    towards = math.copysign(1.0, np.mean(driven or old) - center)
    heights = [towards * ((duty if point.source == UNKNOWN else point.duty) - center)
               for point, duty in zip(points, old)]
    is_old = [point.source == UNKNOWN for point in points]
    made, most = [], math.inf
    for index, point in enumerate(points):
        least = max((height for height, doubted in zip(heights[index:], is_old[index:]) if not doubted), default=0.0)
        most = min(most, max(heights[index], least, 0.0) if is_old[index] else max(heights[index], 0.0))
        made.append(point._replace(duty=center + towards * most, source=OLD if is_old[index] else point.source))
    return made
