"""Fits the steering curve of a car, from servo duty to path curvature, to recorded drives.

1. The servo's delay and lag are estimated, then the linkage's backlash. The curve is that of the middle of the
   backlash.
2. Each segment of a drive in which the wheels hardly moved is one observation: see ``segments``.
3. A smoothing spline goes through the observations (an integrated random walk whose strength is the likeliest), robust
   against outliers (Tukey's biweight), and is then made monotone. Its standard error grows in gaps between the places
   that were driven, where observations scatter more than they should, and where the linkage floated in its backlash.

Duties rise or fall to the left: both are found. Curvatures are in 1/m, left positive; radii in m. Pure numpy and scipy.
"""
from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Sequence

import numpy as np

from car_interface.tools.calibration.shared import NothingToFit, rising
from car_interface.tools.calibration.steering.drive import (
    COUNT,
    KNOT,
    MAX_BACKLASH_DUTY,
    NOTHING_GIVEN,
    CurveFitConfig,
    Delay,
    SteeringDrive,
    estimate_servo_delay,
)
from car_interface.tools.calibration.steering.ends import Side, find_center, find_side
from car_interface.tools.calibration.steering.segments import MIN_SIGMA_PER_M, Observations, Segments
from car_interface.tools.calibration.steering.smooth import BEND_RATIO, Smooth, bends, bounded, unseen
from car_interface.tools.calibration.steering.understeer import Understeer, estimate_understeer, without_understeer

MIN_WEIGHT = 0.05  # an observation with less is an outlier
DISAGREES_SIGMAS, DISAGREES_DUTY = 6.0, 2 * COUNT  # tyres and floors may do less
DISAGREES_COUNTS, DISAGREES_RATIO = 5, 0.25  # at so many counts, and of all where both drove
STEP_DUTY = 2.0
MAX_CONTRADICTION = 6.0  # so much more contradiction than with the best backlash is chance
MIN_SIGMA = 1.0
PRIOR_SCALE_DUTY = 20.0  # before any data the backlash is exponentially distributed with this mean
UNKNOWN_BACKLASH = 0.0, PRIOR_SCALE_DUTY  # and its standard error, where no drive can show it
CORRELATION = 4.0  # segments at one position err alike: likelihoods count for so much less
MAX_SQUARE = 25.0  # what one segment adds to the contradiction at most


@dataclass(frozen=True)
class Curve:
    """A steering curve with K knots, from S observations."""

    duties: np.ndarray  # knots, rising, half a count apart, (K,)
    curvatures: np.ndarray  # at the knots in 1/m, monotone; linear in between, (K,)
    sigmas: np.ndarray  # their standard errors, (K,)
    delay: Delay  # of the servo
    backlash_duty: float  # of the linkage
    backlash_sigma: float  # its standard error
    observations: Observations  # what it rests on, as if driven at a crawl
    understeer: Understeer  # by how much its turns widen with speed
    used: np.ndarray  # which of them count, (S,)
    counts: dict  # how many intervals and segments were left out, by reason
    center: float  # the duty that goes straight; NaN when nothing near it was driven
    center_sigma: float  # its standard error
    left: Side
    right: Side

    @property
    def backlash_is_known(self) -> bool:
        """Whether the drives show it."""
        return self.backlash_sigma < PRIOR_SCALE_DUTY

    def curvature(self, duty):
        """Return the curvature of a duty, a number or an array; that of the ends beyond the knots."""
        return np.interp(duty, self.duties, self.curvatures)

    def duty(self, curvature):
        """Return the duty for a curvature, a number or an array; that of the ends beyond what was driven.

        By straight lines from count to count: half way between two counts lies what is half way between their
        curvatures, so that the board's nearest count is the one whose curvature is nearest. Along the curve itself it
        would be another one where that bends within a count.
        """
        is_count = np.isclose(self.duties % COUNT, 0.0)
        is_count[[0, -1]] = True
        duties, curvatures = self.duties[is_count], self.curvatures[is_count]
        if curvatures[-1] < curvatures[0]:
            duties, curvatures = duties[::-1], curvatures[::-1]
        # np.interp needs strictly rising values; where the curve is level the duty nearest to the center is taken.
        steps = np.arange(len(curvatures)) * 1e-9
        return np.interp(curvature, curvatures + steps, duties)


def fit(drives: Sequence[SteeringDrive], config: CurveFitConfig = NOTHING_GIVEN) -> Curve:
    """Fit the curve.

    Raises:
        NothingToFit: with the reason, as the end of a sentence.
    """
    drives = [drive for drive in drives if len(drive.t_s) > 1 and len(drive.duty)]
    if not drives:
        raise NothingToFit("there is no odometry while the servo had a duty")
    delay = config.delay or estimate_servo_delay(drives)
    segments = Segments(drives, delay)
    if config.backlash_duty is not None:
        return _curve(segments, delay, config.backlash_duty, config.backlash_sigma, config)
    backlash = UNKNOWN_BACKLASH if segments.is_steady else estimate_backlash(segments)
    return _curve(segments, delay, *backlash, config)


def _curve(segments, delay, backlash_duty, backlash_sigma, config):
    """Return the curve for one backlash, with its errors and ends."""
    all_knots, found = segments.knots, segments.observations(backlash_duty)
    smooth = Smooth(found)
    slope_per_m = found.weights @ np.gradient(smooth.curvatures, KNOT)
    understeer = estimate_understeer(found, slope_per_m)
    value = understeer.value if understeer.is_known else config.understeer
    if value:
        found = without_understeer(found, value)
        smooth = Smooth(found)
    used = smooth.weight > MIN_WEIGHT
    sigmas = smooth.standard_errors()
    curvatures = smooth.monotone(sigmas)
    # Where all positions were approached from the same side half of the backlash's error is the position's.
    sigmas = np.hypot(sigmas, np.abs(np.gradient(curvatures, KNOT)) * backlash_sigma / 2)
    sigmas = np.hypot(sigmas, np.maximum(BEND_RATIO * bends(all_knots, found, used), unseen(all_knots, found, used)))
    sigmas = bounded(curvatures, sigmas)
    low, high = found.duty[used].min(), found.duty[used].max()
    inside = (all_knots >= low - KNOT) & (all_knots <= high + KNOT)
    knots, curvatures, sigmas = all_knots[inside], curvatures[inside], sigmas[inside]
    ends = [find_side(knots, curvatures, sigmas, towards, low, high, config.limits, backlash_duty)
            for towards in (-1, 1)]
    left, right = ends[::-1] if curvatures[-1] > curvatures[0] else ends
    center, center_sigma = find_center(knots, curvatures, sigmas)
    counts = {**segments.counts, "apart from all others": int(np.sum(~used))}
    return Curve(knots, curvatures, sigmas, delay, backlash_duty, backlash_sigma,
                 found._replace(weights=found.weights[:, inside]), understeer, used, counts, center, center_sigma, left,
                 right)


def disagreement(one: Curve, other: Curve) -> tuple[float, float] | None:
    """Return how two drives show different steerings; ``None`` if they don't: the median difference in duty where they
    differ, and the curvature (1/m) where that is the least likely.

    Only duties within a count of what both drove are compared: in the gaps of a short drive its curve may be far off.
    A few counts don't make a disagreement: a changed linkage shows at many.
    """
    low, high = max(one.duties[0], other.duties[0]), min(one.duties[-1], other.duties[-1])
    duties = np.arange(math.ceil(low / COUNT) * COUNT, high, COUNT)
    for curve in (one, other):
        driven = curve.observations.duty[curve.used]
        duties = duties[[bool(np.any(np.abs(driven - duty) <= COUNT)) for duty in duties]]
    curvatures = one.curvature(duties)
    sigmas = np.hypot(np.interp(duties, one.duties, one.sigmas), np.interp(duties, other.duties, other.sigmas))
    off = np.abs(curvatures - other.curvature(duties)) / np.maximum(sigmas, 1e-9)
    apart = np.abs(other.duty(curvatures) - duties)
    bad = (off > DISAGREES_SIGMAS) & (apart >= DISAGREES_DUTY)
    if bad.sum() < max(DISAGREES_COUNTS, DISAGREES_RATIO * len(duties)):
        return None
    return float(np.median(apart[bad])), float(curvatures[np.argmax(np.where(bad, off, 0.0))])


# --- the linkage's backlash ---


def estimate_backlash(segments: Segments) -> tuple[float, float]:
    """Return the likeliest backlash and its standard error, both in duty; NothingToFit is raised where no value fits.

    With a wrong backlash positions that were approached from both sides contradict each other: no monotone curve goes
    through them. Of the values that remain the likeliest is taken, all compared by noise and smoothness as known with
    one of them: first by a curve that is equally smooth everywhere, because one that may be sharp in places has its
    places where that value puts them; then, near the truth, by one that may, because the smooth one is too flat where
    the car's is steep.
    """
    candidates = np.arange(0.0, MAX_BACKLASH_DUTY + 1.0, STEP_DUTY)
    contradictions = np.array([_contradiction(segments, candidate) for candidate in candidates])
    candidates = candidates[contradictions <= contradictions.min() + MAX_CONTRADICTION]
    backlash_duty = float(np.median(candidates))
    for adapts in (False, True):
        smooth = Smooth(segments.observations(backlash_duty), adapts)
        costs = np.array([smooth.cost(segments.design(candidate)[0]) for candidate in candidates])
        costs = costs + 2 * candidates / PRIOR_SCALE_DUTY
        if not np.isfinite(costs).any():
            raise NothingToFit("no backlash of the steering fits the places where it was held: drive more of them")
        costs = np.where(np.isfinite(costs), costs, np.inf)
        likelihood = np.exp(-(costs - costs.min()) / 2 / CORRELATION)
        likelihood /= likelihood.sum()
        backlash_duty = float(likelihood @ candidates)
    spread = math.sqrt(float(likelihood @ (candidates - backlash_duty) ** 2))
    return backlash_duty, math.hypot(spread, MIN_SIGMA)


def _contradiction(segments, backlash_duty):
    """Return how far the segments lie off the nearest monotone curve: the sum of bounded squares of standard errors."""
    _, duties = segments.design(backlash_duty)
    curvature, sigma = segments.column("curvature_per_m"), np.hypot(segments.column("sigma_per_m"), 3 * MIN_SIGMA_PER_M)
    order = np.argsort(duties, kind="stable")
    smallest = math.inf
    for sign in (1.0, -1.0):
        y, weight = sign * curvature[order], 1 / sigma[order] ** 2
        smallest = min(smallest, float(np.minimum(weight * (y - rising(y, weight)) ** 2, MAX_SQUARE).sum()))
    return smallest
