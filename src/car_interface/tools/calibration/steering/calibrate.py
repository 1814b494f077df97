"""A steering calibration from recorded drives: the curve as turn_arb's tables of duties over turn radii, what is
unsupported of them, and the report.
"""
from __future__ import annotations

import math
from itertools import combinations, groupby
from pathlib import Path
from typing import Iterator, Mapping, NamedTuple, Sequence

import numpy as np

from car_interface.common.errors import CarInterfaceError
from car_interface.common.yaml_edit import rewritten
from car_interface.steering.calibration import WIDE_M, SteeringCalibration
from car_interface.tools.calibration.shared import NothingToFit, RecordedDrive, names_of
from car_interface.tools.calibration.steering import fit as fitting
from car_interface.tools.calibration.steering.drive import COUNT, CurveFitConfig
from car_interface.tools.calibration.steering.fit import STOP_RATIO, USUAL, Curve, Understeer, slope
from car_interface.tools.calibration.steering.smooth import BAND

LEFT, RIGHT = "left", "right"  # as a Curve's ends are called
SIGNS = {LEFT: 1.0, RIGHT: -1.0}  # of curvatures
# What a breakpoint's duty rests on.
DRIVEN, END, OLD, UNKNOWN = "driven", "end", "old", "unknown"
WIDE_RADII_M = (5.0, 6.0, 7.0, 8.0, 10.0, 12.0, 15.0, 20.0, 30.0, 50.0, 100.0, 300.0)
# A breakpoint is supported when its curvature is known to this ratio or to this magnitude, to either side, beyond half
# of what the board's next count would change.
KNOWN_RATIO, KNOWN_PER_M = 0.08, 0.01
NEAR_RATIO = 0.25  # segments count for a radius when their curvature differs from its by at most this
STRAIGHT_PER_M = 0.02  # a curvature that is called straight on
SHORT_ROWS = 8
TABLE_HEAD = "  radius"
HEAD = ("Written by calibrate_steering; turn_arb loads it. Duties are 0..65535 of the PWM period.", "")


class Breakpoint(NamedTuple):
    """One radius of a table, to one side."""

    radius_m: float
    duty: float
    duty_sigma: float
    radius_sigma_m: float
    segments: int  # that were driven about as tight
    distance_m: float  # in these
    source: str  # DRIVEN, END: no tighter turn can be had, OLD or UNKNOWN

    @property
    def radius_error(self) -> float:
        """Two standard errors of the radius, as a ratio of it."""
        return BAND * self.radius_sigma_m / self.radius_m

    @property
    def is_known(self) -> bool:
        """Whether it may be written."""
        return self.source != UNKNOWN


class SteeringResult(NamedTuple):
    """A steering calibration."""

    curve: Curve
    center: float  # duty
    ends: dict  # duty by side
    points: dict  # a list of Breakpoint by side
    problems: list[str]  # what is missing; empty = the drives support the table
    disagreement: str  # between recordings; empty = none


def calibrate(recorded: Sequence[RecordedDrive], base: SteeringCalibration, axis_m: Sequence[float] | None = None,
              accept_disagreement: bool = False) -> SteeringResult:
    """Calibrate by recorded drives.

    Args:
        base: the calibration before: its duties fill in where nothing was driven.
        axis_m: radii for the tables; ``None`` = chosen by what was driven.

    Raises:
        CarInterfaceError: there is nothing to fit, or drives contradict each other, or none was on the axis.
    """
    config = CurveFitConfig(understeer=base.understeer, limits=(base.servo_left, base.servo_right))
    disagreement = _disagreement(recorded, config)
    if disagreement and not accept_disagreement:
        raise CarInterfaceError(f"no calibration is written: {disagreement}? Give those that belong together")
    try:
        curve = fitting.fit([one.drive for one in recorded], config)
    except NothingToFit as error:
        raise CarInterfaceError(f"{names_of(recorded)}: no steering can be told from this: {error}") from error
    tightest_per_m = max(curve.left.curvature_per_m, curve.right.curvature_per_m)
    if axis_m and 1 / axis_m[-1] >= tightest_per_m:
        raise CarInterfaceError(f"--axis {axis_m[0]:g} to {axis_m[-1]:g} m lies outside of what was driven: the "
                                f"tightest circle was one of {radius_text(tightest_per_m)}")
    radii_m = widened(axis_m) if axis_m else axis(curve)
    points = {side: breakpoints(curve, radii_m, side) for side in SIGNS}
    problems = list(find_problems(curve, points))
    center = base.servo_center if math.isnan(curve.center) else curve.center
    ends = {}
    for side, sign in SIGNS.items():
        points[side] = completed(points[side], center, [base.planner_duty(sign * radius_m) for radius_m in radii_m])
        end, tightest, old_end = getattr(curve, side), points[side][0], base.teleop_duty(sign)
        # An end that is a limit, not a stop, stays: the wheels stay behind it by half of the backlash, and each
        # calibration would make the range smaller by that.
        is_limit = end.is_end and not end.is_stop and (end.duty - center) * (old_end - center) > 0
        keeps_end = tightest.source == OLD or is_limit
        ends[side] = max(tightest.duty, old_end, key=lambda duty: abs(duty - center)) if keeps_end else end.duty
    return SteeringResult(curve, center, ends, points, problems, disagreement)


def yaml_text(calibrated: SteeringResult, base_text: str, report: Sequence[str]) -> str:
    """Return the text of turn_arb's file: the base with the calibration's values, and the report as its head."""
    values = {
        "servo_left": round(calibrated.ends[LEFT]), "servo_center": round(calibrated.center),
        "servo_right": round(calibrated.ends[RIGHT]),
        "m_turnrad_axis_servo": [point.radius_m for point in calibrated.points[LEFT]],
        "k_pwmcmd_left_table_servo": [round(point.duty) for point in calibrated.points[LEFT]],
        "k_pwmcmd_right_table_servo": [round(point.duty) for point in calibrated.points[RIGHT]]}
    if calibrated.curve.understeer.is_known:
        values["understeer"] = round(calibrated.curve.understeer.value, 5)
    return rewritten(base_text, values, [*HEAD, *report])


def _disagreement(recorded, config):
    """Return how the first two recordings that can't be of the same steering differ; empty if there are none."""
    curves = []
    for one in recorded if len(recorded) > 1 else ():
        try:
            curves.append((one.path, fitting.fit([one.drive], config)))
        except NothingToFit:
            continue  # together with the others it may be useful all the same
    for (path, curve), (other_path, other) in combinations(curves, 2):
        found = fitting.disagreement(curve, other)
        if found is not None:
            duty, k = found
            place = (f"{LEFT if k > 0 else RIGHT} turns of {1 / abs(k):.2g} m" if abs(k) > STRAIGHT_PER_M else
                     "straight on")
            return (f"{path} and {other_path} disagree by {duty:.0f} duty about {place}: was the linkage changed "
                    "between them")
    return ""


# --- the tables ---


def axis(curve: Curve) -> list[float]:
    """Radii in m between which linear interpolation is nearly exact, from the tightest that was driven to 300 m."""
    tightest = 1 / max(curve.left.curvature_per_m, curve.right.curvature_per_m)
    radius, radii = math.floor(tightest * 100) / 100, []
    while radius < 4.9:  # 4.9 and more could round to 5
        radii.append(round(radius, 2))
        radius *= 1.08 if radius < 2 else 1.12
    return [*radii, *WIDE_RADII_M]


def widened(radii_m: Sequence[float]) -> list[float]:
    """Radii in m, continued to almost straight on if they end before WIDE_M.

    Beyond its last radius turn_arb holds that radius' duty. A single very wide radius would not do: linear
    interpolation over the radius is far from linear in the curvature.
    """
    return [*radii_m, *(radius for radius in WIDE_RADII_M if radius > 1.1 * radii_m[-1] and radii_m[-1] < WIDE_M)]


def side_curvatures(curve: Curve, side: str) -> np.ndarray:
    """Return the curvatures that were driven (N,), 1/m, positive to this side."""
    return SIGNS[side] * curve.observations.curvature_per_m


def breakpoints(curve: Curve, radii_m: Sequence[float], side: str) -> list[Breakpoint]:
    """Return the duties for radii (R,) to one side, and what they rest on."""
    sign, end = SIGNS[side], getattr(curve, side)
    outward = 1.0 if (end.duty - curve.duties.mean()) > 0 else -1.0
    driven = side_curvatures(curve, side)
    is_driven = driven.size > 0 and driven.max() > 0
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
                                float(curve.observations.distance_m[near].sum()), source))
    return found


def completed(points: Sequence[Breakpoint], center: float, old: Sequence[float]) -> list[Breakpoint]:
    """Return the breakpoints of one side, radii rising (R,), with old duties (R,) where nothing was driven.

    An old duty that doesn't fit between driven ones is replaced by the nearest that does, so that duties approach the
    center monotonically as radii rise.
    """
    driven = [point.duty for point in points if point.is_known]
    towards = math.copysign(1.0, np.mean(driven or old) - center)
    made, upper = [], math.inf
    for index, (point, duty) in enumerate(zip(points, old)):
        wanted, source = [point.duty], point.source
        if not point.is_known:
            wanted, source = [duty, *(later.duty for later in points[index:] if later.is_known)], OLD
        upper = min(upper, max(0.0, *(towards * (one - center) for one in wanted)))
        made.append(point._replace(duty=center + towards * upper, source=source))
    return made


def find_problems(curve: Curve, points: Mapping[str, Sequence[Breakpoint]]) -> Iterator[str]:
    """Yield a sentence for each unknown part of the tables, by side, with what to drive."""
    if math.isnan(curve.center):
        yield "the car never went straight, nor to both sides: drive straight on for some seconds, three times"
    elif BAND * float(np.interp(curve.center, curve.duties, curve.sigmas)) > KNOWN_PER_M:
        yield (f"where the car goes straight is known to ±{BAND * curve.center_sigma:.0f} duty only: drive "
               "straight on for some seconds, three times")
    for side in SIGNS:
        table, index = points[side], 0
        for is_known, run in groupby(table, key=lambda point: point.is_known):
            first, index = index, index + len(list(run))
            if not is_known:
                yield _gap(curve, side, table, first, index - 1)


def radius_text(curvature_per_m: float) -> str:
    """Return a curvature's radius, such as ``1.23 m``."""
    return f"{1 / curvature_per_m:.2f} m" if curvature_per_m > 1e-6 else "none"


def _gap(curve, side, table, first, last):
    """Return what to drive for the unknown breakpoints from ``first`` to ``last``."""
    end = getattr(curve, side)
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


# --- the report ---


def report(calibrated: SteeringResult, recorded: Sequence[RecordedDrive],
           axis_m: Sequence[float] | None) -> list[str]:
    """Return the report's lines, which head the file, too; ``axis_m`` are the radii that were asked for, if they were.
    """
    curve, points = calibrated.curve, calibrated.points
    left_out = ", ".join(f"{count} {reason}" for reason, count in curve.counts.items() if count)
    off = np.abs(curve.observations.curvature_per_m - curve.observations.weights @ curve.curvatures)
    added = [point.radius_m for point in points[LEFT] if axis_m and point.radius_m > axis_m[-1]]
    return [
        _first_line(curve, recorded), *(f"  {one.path}: {note}" for one in recorded for note in one.notes),
        f"  left out (intervals): {left_out or 'none'}", _servo_line(curve), _understeer_line(curve.understeer),
        f"  segments lie off the curve by {np.median(off):.4f} 1/m (median), {np.percentile(off, 95):.4f} (95 %)",
        *_center_and_end_lines(curve),
        *([(f"  --axis ends at {axis_m[-1]:g} m: {added[0]:g} to {added[-1]:g} m are added, or turn_arb would turn as "
            "tight as there when asked for straight on")] if added else []),
        f"{TABLE_HEAD}         left  ±duty   ±radius segments    m        right  ±duty   ±radius segments    m",
        *(f"  {left.radius_m:6g} m  {_cells(left)}   {_cells(right)}"
          for left, right in zip(points[LEFT], points[RIGHT])),
        "  (±: two standard errors; segments: driven about as tight; e: the end, no tighter turn can be had;",
        "  *: nothing was driven)", *(f"  missing: {problem}" for problem in calibrated.problems),
        *([f"  {calibrated.disagreement}?"] if calibrated.disagreement else [])]


def short_report(calibrated: SteeringResult, recorded: Sequence[RecordedDrive]) -> list[str]:
    """Return the most important of it, for a terminal: a table of few radii that fits 80 columns, and no problems."""
    curve, rows = calibrated.curve, list(zip(calibrated.points[LEFT], calibrated.points[RIGHT]))
    shown = min(len(rows), SHORT_ROWS)
    few = [rows[round(index * (len(rows) - 1) / max(1, shown - 1))] for index in range(shown)]
    has_old = any(one.source == OLD for row in rows for one in row)
    return [
        _first_line(curve, recorded), _servo_line(curve), *_center_and_end_lines(curve),
        f"{TABLE_HEAD}         left  ±duty   ±radius        right  ±duty   ±radius",
        *(f"  {left.radius_m:6g} m  {_few_cells(left)}   {_few_cells(right)}" for left, right in few),
        (f"  ({shown} of {len(rows)} radii; ±: two standard errors; e: the end, the tightest turn"
         f"{'; *: nothing was driven' if has_old else ''})")]


def _first_line(curve, recorded):
    length_m = curve.observations.distance_m
    return (f"steering by {', '.join(Path(one.path).name for one in recorded)}: "
            f"{sum(one.duration_s for one in recorded):.0f} s, {length_m.size} segments of steady steering, "
            f"{length_m.sum():.0f} m in them"
            + (", heading by the IMU" if all(one.uses_imu for one in recorded) else ""))


def _servo_line(curve):
    if not curve.backlash_is_known:
        return ("  how fast the servo follows, and the backlash of the steering, aren't known: the duty never changed "
                "within a recording")
    return (f"  the servo follows after {curve.delay.delay_s:.2f} s, with a lag of {curve.delay.lag_s:.2f} s; backlash "
            f"of the steering: {curve.backlash_duty:.0f} ± {BAND * curve.backlash_sigma:.0f} duty")


def _center_and_end_lines(curve):
    if not math.isnan(curve.center):
        yield f"  straight on: duty {curve.center:.0f} ± {BAND * curve.center_sigma:.0f}"
    for side in SIGNS:
        end = getattr(curve, side)
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
    driven = "" if point.source == OLD else f" {point.segments:7d} {point.distance_m:6.0f}"
    return f"{_few_cells(point)}{driven:15}"


def _few_cells(point: Breakpoint):
    if point.source == OLD:
        return f"{point.duty:8.0f} *{'old':>14}"
    mark = " " if point.source == DRIVEN else "e"
    return f"{point.duty:8.0f}{mark} {min(9999, BAND * point.duty_sigma):5.0f} {min(9.99, point.radius_error):8.1%}"
