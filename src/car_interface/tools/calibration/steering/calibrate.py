"""A steering calibration from recorded drives: the curve, the tables, and what of them is unsupported."""
from __future__ import annotations

import math
from typing import NamedTuple, Sequence

from car_interface.common.errors import CarInterfaceError
from car_interface.common.lookup_table import LookupTable
from car_interface.common.yaml_edit import rewritten
from car_interface.steering.calibration import WIDE_M, SteeringCalibration
from car_interface.tools.calibration.shared import NothingToFit, RecordedDrive, names_of
from car_interface.tools.calibration.steering import fit as fitting
from car_interface.tools.calibration.steering.drive import CurveFitConfig
from car_interface.tools.calibration.steering.fit import Curve
from car_interface.tools.calibration.steering.table import (
    LEFT,
    OLD,
    RIGHT,
    axis,
    breakpoints,
    completed,
    find_problems,
    radius_text,
    widened,
)

STRAIGHT_PER_M = 0.02  # a curvature that is called straight on
AXIS, LEFT_TABLE, RIGHT_TABLE = "m_turnrad_axis_servo", "k_pwmcmd_left_table_servo", "k_pwmcmd_right_table_servo"
NOT_LOADED = "no calibration is written, turn_arb would refuse it"
HEAD = ("Written by calibrate_steering; turn_arb loads it. Duties are 0..65535 of the PWM period.", "")


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
    radii_m = widened(axis_m, WIDE_M) if axis_m else axis(curve)
    points = {side: breakpoints(curve, radii_m, side) for side in (LEFT, RIGHT)}
    problems = list(find_problems(curve, points))
    center = base.servo_center if math.isnan(curve.center) else curve.center
    ends = {}
    for side, end, old_duties, old_end in ((LEFT, curve.left, base.left_duties, base.servo_left),
                                           (RIGHT, curve.right, base.right_duties, base.servo_right)):
        old = LookupTable(base.radius_axis_m, old_duties)
        points[side] = completed(points[side], center, [old(radius_m) for radius_m in radii_m])
        tightest = points[side][0]
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
        AXIS: [point.radius_m for point in calibrated.points[LEFT]],
        **{table: [round(point.duty) for point in calibrated.points[side]]
           for side, table in ((LEFT, LEFT_TABLE), (RIGHT, RIGHT_TABLE))}}
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
    for index, (path, curve) in enumerate(curves):
        for other_path, other in curves[:index]:
            found = fitting.disagreement(other, curve)
            if found is not None:
                duty, k = found
                place = (f"{LEFT if k > 0 else RIGHT} turns of {1 / abs(k):.2g} m" if abs(k) > STRAIGHT_PER_M else
                         "straight on")
                return (f"{other_path} and {path} disagree by {duty:.0f} duty about {place}: was the linkage "
                        "changed between them")
    return ""
