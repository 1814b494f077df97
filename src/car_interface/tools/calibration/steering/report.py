"""The report on a steering calibration, as lines of text: they are printed, and head the file that turn_arb loads."""
from __future__ import annotations

import math
from pathlib import Path
from typing import Iterator, Sequence

import numpy as np

from car_interface.tools.calibration.shared import RecordedDrive
from car_interface.tools.calibration.steering.calibrate import SteeringResult
from car_interface.tools.calibration.steering.errors import BAND
from car_interface.tools.calibration.steering.fit import Curve
from car_interface.tools.calibration.steering.table import (
    DRIVEN,
    LEFT,
    OLD,
    RIGHT,
    Breakpoint,
    radius_text,
    side_curvatures,
)
from car_interface.tools.calibration.steering.understeer import USUAL, Understeer

SHORT_ROWS = 8
TABLE_HEAD = "  radius"


def report(calibrated: SteeringResult, recorded: Sequence[RecordedDrive],
           axis_m: Sequence[float] | None) -> Iterator[str]:
    """Yield the lines.

    Args:
        axis_m: the radii that were asked for, if they were.
    """
    points = calibrated.points
    yield _first_line(calibrated.curve, recorded)
    for one in recorded:
        yield from (f"  {one.path}: {note}" for note in one.notes)
    yield from _curve_lines(calibrated.curve)
    added = [point.radius_m for point in points[LEFT] if axis_m and point.radius_m > axis_m[-1]]
    if added:
        yield (f"  --axis ends at {axis_m[-1]:g} m: {added[0]:g} to {added[-1]:g} m are added, or turn_arb would "
               "turn as tight as there when asked for straight on")
    yield f"{TABLE_HEAD}         left  ±duty   ±radius segments    m        right  ±duty   ±radius segments    m"
    for left, right in zip(points[LEFT], points[RIGHT]):
        yield f"  {left.radius_m:6g} m  {_cells(left)}   {_cells(right)}"
    yield "  (±: two standard errors; segments: driven about as tight; e: the end, no tighter turn can be had;"
    yield "  *: nothing was driven)"
    yield from (f"  missing: {problem}" for problem in calibrated.problems)
    if calibrated.disagreement:
        yield f"  {calibrated.disagreement}?"


def short_report(calibrated: SteeringResult, recorded: Sequence[RecordedDrive]) -> Iterator[str]:
    """Yield the most important of it, for a terminal: a table of few radii that fits 80 columns, and no problems."""
    curve, points = calibrated.curve, calibrated.points
    yield _first_line(curve, recorded)
    yield _servo_line(curve)
    yield from _center_and_end_lines(curve)
    yield f"{TABLE_HEAD}         left  ±duty   ±radius        right  ±duty   ±radius"
    rows = list(zip(points[LEFT], points[RIGHT]))
    shown = min(len(rows), SHORT_ROWS)
    for index in range(shown):
        left, right = rows[round(index * (len(rows) - 1) / max(1, shown - 1))]
        yield f"  {left.radius_m:6g} m  {_few_cells(left)}   {_few_cells(right)}"
    yield (f"  ({shown} of {len(rows)} radii; ±: two standard errors; e: the end, the tightest turn"
           + ("; *: nothing was driven" if any(one.source == OLD for row in rows for one in row) else "") + ")")


def _first_line(curve, recorded):
    length_m = curve.observations.distance_m[curve.used].sum()
    return (f"steering by {', '.join(Path(one.path).name for one in recorded)}: "
            f"{sum(one.duration_s for one in recorded):.0f} s, {curve.used.sum()} segments of steady steering, "
            f"{length_m:.0f} m in them"
            + (", heading by the IMU" if all(one.uses_imu for one in recorded) else ""))


def _curve_lines(curve: Curve):
    left_out = ", ".join(f"{count} {reason}" for reason, count in curve.counts.items() if count)
    yield f"  left out (intervals): {left_out or 'none'}"
    yield _servo_line(curve)
    yield _understeer_line(curve.understeer)
    all_knots = np.zeros(curve.observations.weights.shape[1])  # 0 beyond what was driven
    all_knots[curve.first_knot:curve.first_knot + len(curve.curvatures)] = curve.curvatures
    off = np.abs(curve.observations.curvature_per_m - curve.observations.weights @ all_knots)[curve.used]
    yield f"  segments lie off the curve by {np.median(off):.4f} 1/m (median), {np.percentile(off, 95):.4f} (95 %)"
    yield from _center_and_end_lines(curve)


def _servo_line(curve):
    if not curve.backlash_is_known:
        return ("  how fast the servo follows, and the backlash of the steering, aren't known: the duty never changed "
                "within a recording")
    return (f"  the servo follows after {curve.delay.delay_s:.2f} s, with a lag of {curve.delay.lag_s:.2f} s; backlash "
            f"of the steering: {curve.backlash_duty:.0f} ± {BAND * curve.backlash_sigma:.0f} duty")


def _center_and_end_lines(curve):
    if not math.isnan(curve.center):
        yield f"  straight on: duty {curve.center:.0f} ± {BAND * curve.center_sigma:.0f}"
    for side, end in ((LEFT, curve.left), (RIGHT, curve.right)):
        if not (side_curvatures(curve, side) > 0).any():
            continue
        why = ("the radius shrinks no more" if end.is_stop else "the end that was allowed" if end.is_end else
               "the farthest that was driven; the end was not reached")
        yield f"  {side}: duty {end.duty:.0f}, radius {radius_text(end.curvature_per_m)}: {why}"


def _understeer_line(understeer: Understeer):
    number = (f"{understeer.value:.4f} ± {BAND * understeer.sigma:.4f} 1/m for each (m/s²)², from {understeer.places} "
              "positions at several speeds")
    if understeer.is_known:
        return f"  understeer: {number}"
    # Circles of almost the same speed have any number, with an error to match.
    known = f"known well enough ({number})" if understeer.places and understeer.sigma < USUAL else "known"
    return (f"  by how much turns widen with speed isn't {known}, and understeer stays as it was: drive some circles "
            "at other speeds, too, up to 4 m/s² sideways")


def _cells(point: Breakpoint):
    if point.source == OLD:
        return f"{point.duty:8.0f} *{'old':>26}{'':8}"
    return f"{_few_cells(point)} {point.segments:7d} {point.distance_m:6.0f}"


def _few_cells(point: Breakpoint):
    if point.source == OLD:
        return f"{point.duty:8.0f} *{'old':>14}"
    mark = " " if point.source == DRIVEN else "e"
    ratio = min(9.99, BAND * point.radius_sigma_m / point.radius_m)
    return f"{point.duty:8.0f}{mark} {min(9999, BAND * point.duty_sigma):5.0f} {ratio:8.1%}"
