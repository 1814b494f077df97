"""A steering curve as a table of duties over turn radii, as turn_arb takes it."""
from __future__ import annotations

import math
from itertools import groupby
from typing import Iterator, Mapping, NamedTuple, Sequence

import numpy as np

from car_interface.tools.calibration.steering.drive import COUNT
from car_interface.tools.calibration.steering.ends import STOP_RATIO, slope
from car_interface.tools.calibration.steering.fit import Curve
from car_interface.tools.calibration.steering.smooth import BAND

LEFT, RIGHT = "left", "right"
# What a breakpoint's duty rests on.
DRIVEN, END, OLD, UNKNOWN = "driven", "end", "old", "unknown"
WIDE_RADII_M = (5.0, 6.0, 7.0, 8.0, 10.0, 12.0, 15.0, 20.0, 30.0, 50.0, 100.0, 300.0)
# A breakpoint is supported when its curvature is known to this ratio or to this magnitude, to either side, beyond half
# of what the board's next count would change.
KNOWN_RATIO, KNOWN_PER_M = 0.08, 0.01
NEAR_RATIO = 0.25  # segments count for a radius when their curvature differs from its by at most this


class Breakpoint(NamedTuple):
    """One radius of a table, to one side."""

    radius_m: float
    duty: float
    duty_sigma: float
    radius_sigma_m: float
    segments: int  # that were driven about as tight
    distance_m: float  # in these
    source: str  # DRIVEN, END: no tighter turn can be had, OLD or UNKNOWN


def axis(curve: Curve) -> list[float]:
    """Radii in m between which linear interpolation is nearly exact, from the tightest that was driven to 300 m."""
    tightest = 1 / max(curve.left.curvature_per_m, curve.right.curvature_per_m)
    radius, radii = math.floor(tightest * 100) / 100, []
    while radius < 4.9:  # 4.9 and more could round to 5
        radii.append(round(radius, 2))
        radius *= 1.08 if radius < 2 else 1.12
    return [*radii, *WIDE_RADII_M]


def widened(radii_m: Sequence[float], wide_m: float) -> list[float]:
    """Radii in m, continued to almost straight on if they end before ``wide_m``.

    Beyond its last radius turn_arb holds that radius' duty. A single very wide radius would not do: linear
    interpolation over the radius is far from linear in the curvature.
    """
    if radii_m[-1] >= wide_m:
        return list(radii_m)
    return [*radii_m, *(radius for radius in WIDE_RADII_M if radius > 1.1 * radii_m[-1])]


def side_curvatures(curve: Curve, side: str) -> np.ndarray:
    """Return the curvatures that were driven (N,), 1/m, positive to this side."""
    return (1.0 if side == LEFT else -1.0) * curve.observations.curvature_per_m[curve.used]


def breakpoints(curve: Curve, radii_m: Sequence[float], side: str) -> list[Breakpoint]:
    """Return the duties for radii (R,) to one side, and what they rest on."""
    sign = 1.0 if side == LEFT else -1.0
    end = curve.left if side == LEFT else curve.right
    outward = 1.0 if (end.duty - curve.duties.mean()) > 0 else -1.0
    driven = side_curvatures(curve, side)
    is_driven = driven.size > 0 and driven.max() > 0
    lengths_m = curve.observations.distance_m[curve.used]
    found = []
    for radius in radii_m:
        k = 1.0 / radius
        duty = float(curve.duty(sign * k))
        duty = min(duty, end.duty) if outward > 0 else max(duty, end.duty)
        # The board only outputs counts: what lies between two of them needn't be known.
        count = round(duty / COUNT) * COUNT
        sigma = float(np.interp(count, curve.duties, curve.sigmas))
        before, behind = curve.curvature(np.array([count - COUNT, count + COUNT]))
        near = np.abs(driven - k) <= max(NEAR_RATIO * k, KNOWN_PER_M)
        half_count = abs(behind - before) / 4
        is_known = BAND * sigma <= max(KNOWN_RATIO * k, KNOWN_PER_M) + half_count
        if k >= end.curvature_per_m * (1 - STOP_RATIO):
            duty, source = end.duty, END if end.is_end and is_known and is_driven else UNKNOWN
        else:
            source = DRIVEN if is_known and is_driven and driven.min() <= k <= driven.max() else UNKNOWN
        steepness = slope(curve.duties, curve.curvatures, duty)
        found.append(Breakpoint(float(radius), duty, sigma / max(steepness, 1e-9), sigma / k ** 2, int(near.sum()),
                                float(lengths_m[near].sum()), source))
    return found


def completed(points: Sequence[Breakpoint], center: float, old: Sequence[float]) -> list[Breakpoint]:
    """Return the breakpoints of one side, radii rising (R,), with old duties (R,) where nothing was driven.

    An old duty that doesn't fit between driven ones is replaced by the nearest that does, so that duties approach the
    center monotonically as radii rise.
    """
    driven = [point.duty for point in points if point.source != UNKNOWN]
    towards = math.copysign(1.0, np.mean(driven or old) - center)
    heights = [towards * ((duty if point.source == UNKNOWN else point.duty) - center)
               for point, duty in zip(points, old)]
    is_old = [point.source == UNKNOWN for point in points]
    made, upper = [], math.inf
    for index, point in enumerate(points):
        lower = max((height for height, doubted in zip(heights[index:], is_old[index:]) if not doubted), default=0.0)
        upper = min(upper, max(heights[index], lower, 0.0) if is_old[index] else max(heights[index], 0.0))
        made.append(point._replace(duty=center + towards * upper, source=OLD if is_old[index] else point.source))
    return made


def find_problems(curve: Curve, points: Mapping[str, Sequence[Breakpoint]]) -> Iterator[str]:
    """Yield a sentence for each unknown part of the tables, by side, with what to drive."""
    if math.isnan(curve.center):
        yield "the car never went straight, nor to both sides: drive straight on for some seconds, three times"
    elif BAND * float(np.interp(curve.center, curve.duties, curve.sigmas)) > KNOWN_PER_M:
        yield (f"where the car goes straight is known to ±{BAND * curve.center_sigma:.0f} duty only: drive "
               "straight on for some seconds, three times")
    for side in (LEFT, RIGHT):
        table, index = points[side], 0
        for is_unknown, run in groupby(table, key=lambda point: point.source == UNKNOWN):
            first, index = index, index + len(list(run))
            if is_unknown:
                yield _gap(curve, side, table, first, index - 1)


def radius_text(curvature_per_m: float) -> str:
    """Return a curvature's radius, such as ``1.23 m``."""
    return f"{1 / curvature_per_m:.2f} m" if curvature_per_m > 1e-6 else "none"


def _gap(curve, side, table, first, last):
    """Return what to drive for the unknown breakpoints from ``first`` to ``last``."""
    end = curve.left if side == LEFT else curve.right
    if first == 0 and last == len(table) - 1:
        return f"no data for {side} turns: drive slow {side} circles at ten positions of the stick, up to its end"
    if first == 0:
        tightest_m = max(table[last + 1].radius_m, table[last].radius_m)
        if end.curvature_per_m * table[0].radius_m < 1:
            tightest_m = 1 / end.curvature_per_m
        beyond = "beyond" if not end.is_stop else "around"
        about_m = float(f"{tightest_m:.2g}")
        return (f"no data for {side} turns tighter than {about_m:g} m: drive three slow {side} circles with duties "
                f"{beyond} {end.farthest_duty:.0f}, up to the end of the stick")
    wide = (" and wider" if last == len(table) - 1 else "" if first == last else f" to {table[last].radius_m:.3g} m")
    duties = sorted((table[first - 1].duty, table[min(last + 1, len(table) - 1)].duty))
    return (f"too little data for {side} turns of {table[first].radius_m:.3g} m{wide}: drive three slow ones with "
            f"duties from {duties[0]:.0f} to {duties[1]:.0f}, come to from both sides")
