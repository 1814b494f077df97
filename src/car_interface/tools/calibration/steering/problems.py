"""What is missing in the drives for a table: which turns to drive."""
from __future__ import annotations

import math
from itertools import groupby
from typing import Iterator, Mapping, Sequence

import numpy as np

from car_interface.tools.calibration.steering.drive import FitConfig
from car_interface.tools.calibration.steering.errors import BAND
from car_interface.tools.calibration.steering.fit import Curve
from car_interface.tools.calibration.steering.table import LEFT, RIGHT, UNKNOWN, Breakpoint


def find_problems(curve: Curve, points: Mapping[str, Sequence[Breakpoint]]) -> Iterator[str]:
    """Yield a sentence for each unknown part of the tables, with what to drive.

    Args:
        curve: the fitted curve.
        points: the breakpoints by side.
    """
    if math.isnan(curve.center):
        yield "the car never went straight, nor to both sides: drive straight on for some seconds, three times"
    elif BAND * float(np.interp(curve.center, curve.duties, curve.sigmas)) > FitConfig().known_per_m:
        yield (f"where the car goes straight is known to ±{BAND * curve.center_sigma:.0f} duty only: drive "
               "straight on for some seconds, three times")
    for side in (LEFT, RIGHT):
        table, index = points[side], 0
        for is_unknown, run in groupby(table, key=lambda point: point.source == UNKNOWN):
            first, index = index, index + len(list(run))
            if is_unknown:
                yield _gap(curve, side, table, first, index - 1)


def radius_text(curvature_per_m: float) -> str:
    """A curvature's radius, such as ``1.23 m``."""
    return f"{1 / curvature_per_m:.2f} m" if curvature_per_m > 1e-6 else "none"


def _gap(curve, side, table, first, last):
    """What to drive for the unknown breakpoints from ``first`` to ``last``."""
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
