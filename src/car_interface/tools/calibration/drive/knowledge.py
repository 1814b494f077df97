"""What is known of a steering by now, by the calibration's own fit, and where least is known.

The only heavy part of the drive, a pure function of what it is given: a node calls it in a second thread. On a desktop
PC a fit of five minutes takes 1 s where delay and backlash are estimated and 0.1 s where they are given; on a Jetson
Nano some five times of that.
"""
from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from car_interface.steering.calibration import SteeringCalibration
from car_interface.tools.calibration.delay import Delay
from car_interface.tools.calibration.drive.step import RadiusRow
from car_interface.tools.calibration.shared import NothingToFit
from car_interface.tools.calibration.steering.drive import COUNT, CurveFitConfig, SteeringDrive
from car_interface.tools.calibration.steering.errors import BAND, unseen
from car_interface.tools.calibration.steering.fit import Curve, fit
from car_interface.tools.calibration.steering.table import (
    KNOWN_PER_M,
    KNOWN_RATIO,
    LEFT,
    RIGHT,
    UNKNOWN,
    axis,
    breakpoints,
    find_problems,
)

# Where one count changes much the tool allows an error of half of that. But with less of one the nearest count to a
# radius is the best one more often.
NEEDED_RATIO = 0.25
UNSEEN_NEED = 2.0  # so much more a bend is to be found than the tool takes it to be likely


class FitTask(NamedTuple):
    """What to fit."""

    drive: SteeringDrive  # the samples by now
    base: SteeringCalibration  # the calibration before
    delay: Delay | None  # by the newest full fit; ``None`` = estimate them, which takes most of the time
    backlash_duty: float | None
    number: int  # tasks rise; the answer to an older one is left out
    backlash_sigma: float = 0.0  # the standard error of the backlash that is given


class Knowledge(NamedTuple):
    """What a fit found."""

    number: int  # of the task
    reason: str  # why there is no curve yet, the end of a sentence; empty = there is one
    # the curve at the board's counts between its ends, duties rising; curvatures in 1/m, left positive
    duties: tuple[float, ...] = ()
    curvatures: tuple[float, ...] = ()
    # at each, what isn't known of the curvature, as a ratio of what the tool allows: above 1 it refuses
    errors: tuple[float, ...] = ()
    rows: tuple[RadiusRow, ...] = ()  # as in Progress
    missing: tuple[str, ...] = ()  # as in Progress
    # of the fit; ``None`` and NaN where unknown
    delay: Delay | None = None
    backlash_duty: float | None = None
    backlash_sigma: float = 0.0
    center_duty: float = math.nan
    center_error: float = math.nan
    has_understeer: bool = False  # it is known by how much turns widen with speed
    needs: tuple[float, ...] = ()  # at each of the duties, how much it is worth to measure it: see ``needs``


def assess(task: FitTask) -> Knowledge:
    """Fit what there is. Never raises for what was driven: a drive without a curve is a Knowledge with a reason."""
    base = task.base
    try:
        curve = fit([task.drive], CurveFitConfig(task.delay, task.backlash_duty, task.backlash_sigma, base.understeer,
                                                 (base.servo_left, base.servo_right)))
    except (NothingToFit, ValueError, IndexError) as error:  # the last two: a handful of samples
        return Knowledge(task.number, str(error))
    if curve.curvatures.min() >= 0 or curve.curvatures.max() <= 0:
        return Knowledge(task.number, "the car turned to one side only so far")
    points = {side: breakpoints(curve, axis(curve), side) for side in (LEFT, RIGHT)}
    duties = np.arange(math.ceil(curve.duties[0] / COUNT), math.floor(curve.duties[-1] / COUNT) + 1) * COUNT
    rows = tuple(RadiusRow(side, point.radius_m, point.duty,
                           BAND * point.radius_sigma_m / point.radius_m, point.source != UNKNOWN)
                 for side in (LEFT, RIGHT) for point in points[side])
    return Knowledge(task.number, "", tuple(duties.tolist()), tuple(curve.curvature(duties).tolist()),
                     tuple(error_ratios(curve, duties).tolist()), rows, tuple(find_problems(curve, points)),
                     curve.delay, curve.backlash_duty, curve.backlash_sigma, curve.center, BAND * curve.center_sigma,
                     curve.understeer.is_known, tuple(needs(curve, duties).tolist()))


def error_ratios(curve: Curve, duties: np.ndarray) -> np.ndarray:
    """Return what isn't known of the curvature at the board's counts (N,), as ratios of what the tool allows there:
    (N,).

    By the rule of ``table.breakpoints``.
    """
    return BAND * np.interp(duties, curve.duties, curve.sigmas) / _allowed_per_m(curve, duties)


def needs(curve: Curve, duties: np.ndarray) -> np.ndarray:
    """Return how much it is worth to measure the board's counts (N,): (N,). As ``error_ratios``, but stricter where one
    count changes much and between places that are far apart.
    """
    unseen_per_m = UNSEEN_NEED * unseen(duties, curve.observations, curve.used)
    sigmas = np.maximum(np.interp(duties, curve.duties, curve.sigmas), unseen_per_m)
    return BAND * sigmas / _allowed_per_m(curve, duties, NEEDED_RATIO)


def _allowed_per_m(curve, duties, count_ratio=1.0):
    """Return what the tool allows, with so much of what it does for the board's counts."""
    allowed = np.maximum(KNOWN_RATIO * np.abs(curve.curvature(duties)), KNOWN_PER_M)
    half_count = np.abs(curve.curvature(duties + COUNT) - curve.curvature(duties - COUNT)) / 4
    return allowed + count_ratio * half_count
