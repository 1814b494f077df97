"""What is known of a steering by now, by the calibration's own fit, and where least is known.

The only heavy part of the drive, a pure function of what it is given: a node calls it in a second thread. On a desktop
PC a fit of five minutes takes 1 s where delay and backlash are estimated and 0.1 s where they are given; on a Jetson
Nano some five times of that.
"""
from __future__ import annotations

import math
from types import MappingProxyType
from typing import Mapping, NamedTuple, Sequence

import numpy as np

from car_interface.tools.calibration.steering.calibrate import (
    KNOWN_PER_M,
    KNOWN_RATIO,
    SIGNS,
    Breakpoint,
    axis,
    breakpoints,
    find_problems,
)
from car_interface.tools.calibration.steering.drive import COUNT, NOTHING_GIVEN, CurveFitConfig, Delay, SteeringDrive
from car_interface.tools.calibration.steering.fit import fit
from car_interface.tools.calibration.steering.smooth import BAND, unseen

# Where one count changes much the tool allows an error of half of that. But with less of one the nearest count to a
# radius is the best one more often.
NEEDED_RATIO = 0.25
UNSEEN_NEED = 2.0  # so much more a bend is to be found than the tool takes it to be likely


class Knowledge(NamedTuple):
    """What a fit found; the columns are of the board's counts between the curve's ends, (K,), duties rising."""

    reason: str = ""  # why there is no curve yet, the end of a sentence; empty = there is one
    duties: np.ndarray = np.zeros(0)
    curvatures: np.ndarray = np.zeros(0)  # in 1/m, left positive
    errors: np.ndarray = np.zeros(0)  # what isn't known of them, as ratios of what the tool allows: above 1 it refuses
    needs: np.ndarray = np.zeros(0)  # how much it is worth to measure each; as errors, but stricter
    points: Mapping[str, Sequence[Breakpoint]] = MappingProxyType({})  # of the tool's own tables, by side, tight first
    missing: tuple[str, ...] = ()  # what the tool would refuse the drive for, sentences; empty: it would write
    center_duty: float = math.nan  # where it goes straight; NaN: unknown
    center_error: float = math.nan  # two standard errors of that
    given: CurveFitConfig = NOTHING_GIVEN  # to the next fit, with its delay and backlash
    has_understeer: bool = False  # it is known by how much turns widen with speed


# Before the first fit, with a guess of the servo's delay.
NOTHING_KNOWN = Knowledge("no fit was made", missing=("everything; the ends and straight on come first",),
                          given=NOTHING_GIVEN._replace(delay=Delay(0.05, 0.15)))


def assess(drive: SteeringDrive, config: CurveFitConfig) -> Knowledge:
    """Fit what there is; without a delay and a backlash in ``config`` that takes the longest.

    Never raises for what was driven: a drive without a curve is a Knowledge with a reason.
    """
    try:
        curve = fit([drive], config)
    except (ValueError, IndexError) as error:  # NothingToFit, or a handful of samples
        return Knowledge(str(error))
    if curve.curvatures.min() >= 0 or curve.curvatures.max() <= 0:
        return Knowledge("the car turned to one side only so far")
    points = {side: breakpoints(curve, axis(curve), side) for side in SIGNS}
    duties = np.arange(math.ceil(curve.duties[0] / COUNT), math.floor(curve.duties[-1] / COUNT) + 1) * COUNT
    # Errors by the rule of breakpoints(); needs are greater where one count changes much and between places that are
    # far apart.
    allowed_per_m = np.maximum(KNOWN_RATIO * np.abs(curve.curvature(duties)), KNOWN_PER_M)
    half_count = np.abs(curve.curvature(duties + COUNT) - curve.curvature(duties - COUNT)) / 4
    sigmas = np.interp(duties, curve.duties, curve.sigmas)
    greater = np.maximum(sigmas, UNSEEN_NEED * unseen(duties, curve.observations))
    given = config._replace(delay=curve.delay, backlash_duty=curve.backlash_duty, backlash_sigma=curve.backlash_sigma)
    return Knowledge(
        "", duties, curve.curvature(duties), BAND * sigmas / (allowed_per_m + half_count),
        BAND * greater / (allowed_per_m + NEEDED_RATIO * half_count), points, tuple(find_problems(curve, points)),
        curve.center, BAND * curve.center_sigma, given, curve.understeer.is_known)
