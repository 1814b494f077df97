"""Fits the steering curve of a car, from servo duty to path curvature, to recorded drives.

1. The servo's delay and lag are estimated, then the linkage's backlash. The curve is that of the middle of the
   backlash.
2. Each segment of a drive in which the wheels hardly moved is one observation: see ``segments``.
3. A smoothing spline goes through the observations (an integrated random walk whose strength is the likeliest), robust
   against outliers (Tukey's biweight), and is then made monotone. Its standard error grows in gaps between the places
   that were driven, where observations scatter more than they should, and where the linkage floated in its backlash.
4. Segments at the same place of the wheels have the same curvature at a crawl: what each of them lost by its speed (see
   ``steering.calibration.lost_per_m``) differs, and shows the one number by which the car's turns widen with speed. It
   is known where enough places were driven at speeds that differ enough; else the one that the calibration has stays.

Duties rise or fall to the left: both are found. Curvatures are in 1/m, left positive; radii in m. Pure numpy and scipy.
"""
from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, Sequence

import numpy as np

from car_interface.steering.calibration import lost_per_m
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
from car_interface.tools.calibration.steering.segments import MIN_SIGMA_PER_M, Observations, Segments, place_numbers
from car_interface.tools.calibration.steering.smooth import BAND, BEND_RATIO, Smooth, bends, bounded, unseen

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
STOP_DUTY = 40.0  # a mechanical stop is one when the curve stays level over this duty
STOP_RATIO = 0.007  # level is a curvature that differs from the tightest by at most this ratio
RISE_LOW, RISE_HIGH = 0.90, 0.97  # of the tightest curvature: between them lies the rise to a stop
MIN_PLACES = 2
MIN_PART = 0.02  # of all that is known of it: a place with less doesn't count
# Standard error at least, as a ratio. By a² alone the two sides of the one car that was measured showed 0.0077 and
# 0.0099: they agree within two standard errors of their difference from 0.09 on.
MIN_SIGMA_RATIO = 0.1
MAX_ERROR_RATIO = 0.2  # two standard errors, of the number
USUAL = 0.009  # that car's left-hand circles show it: a smaller number may be as uncertain as this one
SEEN_SIGMAS = 3.0  # less than that is none
MAX_UNDERSTEER = 0.1
HUBER = 2.0  # standard errors, beyond which an observation pulls no harder
MAX_PASSES, CONVERGED = 100, 1e-9


class Side(NamedTuple):
    """One end of the steering."""

    duty: float  # where the radius stops shrinking, or else the farthest that was driven
    curvature_per_m: float  # magnitude there
    is_stop: bool  # the wheels turned no farther though the servo did
    is_end: bool  # that, or the servo isn't meant to turn farther
    farthest_duty: float  # that was driven


class Understeer(NamedTuple):
    """What a drive shows of it."""

    value: float  # 1/m for each (m/s²)²
    sigma: float  # its standard error; inf: the drive doesn't show it
    places: int  # that were driven at several speeds

    @property
    def is_known(self) -> bool:
        """Whether the drive has the speeds for it."""
        return self.places >= MIN_PLACES and BAND * self.sigma <= MAX_ERROR_RATIO * max(self.value, USUAL)


UNKNOWN_UNDERSTEER = Understeer(0.0, math.inf, 0)


@dataclass(frozen=True)
class Curve:
    """A steering curve with K knots, from S observations, without those that are apart from all others."""

    duties: np.ndarray  # knots, rising, half a count apart, (K,)
    curvatures: np.ndarray  # at the knots in 1/m, monotone; linear in between, (K,)
    sigmas: np.ndarray  # their standard errors, (K,)
    delay: Delay  # of the servo
    backlash_duty: float  # of the linkage
    backlash_sigma: float  # its standard error
    observations: Observations  # what it rests on, as if driven at a crawl
    understeer: Understeer  # by how much its turns widen with speed
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
    backlash_duty, backlash_sigma = (
        (config.backlash_duty, config.backlash_sigma) if config.backlash_duty is not None else
        UNKNOWN_BACKLASH if segments.is_steady else estimate_backlash(segments))
    all_knots, found = segments.knots, segments.observations(backlash_duty)
    smooth = Smooth(found)
    slope_per_m = found.weights @ np.gradient(smooth.curvatures, KNOT)
    understeer = estimate_understeer(found, slope_per_m)
    value = understeer.value if understeer.is_known else config.understeer
    if value:
        lost = lost_per_m(found.curvature_per_m, found.speed_mps, value)
        found = found._replace(curvature_per_m=found.curvature_per_m + lost)  # as if driven at a crawl
        smooth = Smooth(found)
    used = smooth.weight > MIN_WEIGHT
    found = found.those(used)
    sigmas = smooth.standard_errors()
    curvatures = smooth.monotone(sigmas)
    # Where all positions were approached from the same side half of the backlash's error is the position's.
    sigmas = np.hypot(sigmas, np.abs(np.gradient(curvatures, KNOT)) * backlash_sigma / 2)
    sigmas = np.hypot(sigmas, np.maximum(BEND_RATIO * bends(all_knots, found), unseen(all_knots, found)))
    sigmas = bounded(curvatures, sigmas)
    low, high = found.duty.min(), found.duty.max()
    inside = (all_knots >= low - KNOT) & (all_knots <= high + KNOT)
    knots, curvatures, sigmas = all_knots[inside], curvatures[inside], sigmas[inside]
    ends = [find_side(knots, curvatures, sigmas, towards, low, high, config.limits, backlash_duty)
            for towards in (-1, 1)]
    left, right = ends[::-1] if curvatures[-1] > curvatures[0] else ends
    counts = {**segments.counts, "apart from all others": int(np.sum(~used))}
    return Curve(knots, curvatures, sigmas, delay, backlash_duty, backlash_sigma,
                 found._replace(weights=found.weights[:, inside]), understeer, counts,
                 *find_center(knots, curvatures, sigmas), left, right)


def disagreement(one: Curve, other: Curve) -> tuple[float, float] | None:
    """Return how two drives show different steerings; ``None`` if they don't: the median difference in duty where they
    differ, and the curvature (1/m) where that is the least likely.

    Only duties within a count of what both drove are compared: in the gaps of a short drive its curve may be far off.
    A few counts don't make a disagreement: a changed linkage shows at many.
    """
    low, high = max(one.duties[0], other.duties[0]), min(one.duties[-1], other.duties[-1])
    duties = np.arange(math.ceil(low / COUNT) * COUNT, high, COUNT)
    for curve in (one, other):
        duties = duties[[bool(np.any(np.abs(curve.observations.duty - duty) <= COUNT)) for duty in duties]]
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
        likelihood = np.exp(-(costs - costs.min()) / 2 / CORRELATION)
        likelihood /= likelihood.sum()
        backlash_duty = float(likelihood @ candidates)
    spread = math.sqrt(float(likelihood @ (candidates - backlash_duty) ** 2))
    return backlash_duty, math.hypot(spread, MIN_SIGMA)


def _contradiction(segments, backlash_duty):
    """Return how far the segments lie off the nearest monotone curve: the sum of bounded squares of standard errors."""
    _, duties = segments.design(backlash_duty)
    order = np.argsort(duties, kind="stable")
    weight = 1 / np.hypot(segments.column("sigma_per_m"), 3 * MIN_SIGMA_PER_M)[order] ** 2
    y = segments.column("curvature_per_m")[order]
    return min(float(np.minimum(weight * (y - sign * rising(sign * y, weight)) ** 2, MAX_SQUARE).sum())
               for sign in (1.0, -1.0))


# --- the ends and the center ---


def find_side(knots: np.ndarray, curvatures: np.ndarray, sigmas: np.ndarray, towards: int, low: float, high: float,
              limits: Sequence[float] = (), backlash_duty: float = 0.0) -> Side:
    """Return the end of a curve, (K,) each, towards lower duties (−1) or higher ones (1).

    Args:
        low, high: the outermost duties that were driven.
        limits: duties beyond which nobody means to steer.
        backlash_duty: of the linkage: where the servo is at its limit the wheels stay behind it by half of that.
    """
    farthest = float(low if towards < 0 else high)
    ordered = slice(None, None, towards)
    curvature, duty, sigma = curvatures[ordered], knots[ordered], sigmas[ordered]
    inside = (duty - farthest) * towards <= 0
    curvature, duty, sigma = curvature[inside] * np.sign(curvature[inside][-1]), duty[inside], sigma[inside]
    tightest = float(curvature[-1])
    # The tightest curvature is as uncertain as those beside it.
    is_level = curvature >= tightest * (1 - STOP_RATIO) - min(2 * sigma[-1], 2 * STOP_RATIO * tightest)
    begin = len(is_level) - int(np.argmin(is_level[::-1])) if not is_level.all() else 0
    is_stop = (farthest - duty[begin]) * towards >= STOP_DUTY and tightest > 5 * sigma[-1]
    is_end = is_stop or any((farthest - limit) * towards >= -COUNT - backlash_duty / 2 for limit in limits
                            if (limit - np.mean(knots)) * towards > 0)
    end_duty = farthest if not is_stop else _count_at_stop(
        duty, curvature, tightest, _corner(duty, curvature, tightest, begin))
    return Side(end_duty, tightest, bool(is_stop), bool(is_end), farthest)


def find_center(knots: np.ndarray, curvatures: np.ndarray, sigmas: np.ndarray) -> tuple[float, float]:
    """Return (the duty that goes straight, its standard error) of a curve (K,); NaN where it never does."""
    if curvatures.min() > 0 or curvatures.max() < 0:
        return math.nan, math.nan
    sign = 1.0 if curvatures[-1] > curvatures[0] else -1.0
    up = sign * curvatures
    level = knots[np.abs(up) < 1e-9]
    center = float(level.mean() if len(level) else np.interp(0.0, up, knots))  # where it is level at 0: its middle
    return center, float(np.interp(center, knots, sigmas) / max(slope(knots, up, center), 1e-9))


def slope(knots: np.ndarray, curvatures: np.ndarray, duty: float) -> float:
    """Return the magnitude of the curve's slope around a duty, over two counts to each side: 1/m per duty."""
    low, high = max(knots[0], duty - 2 * COUNT), min(knots[-1], duty + 2 * COUNT)
    return abs(float(np.interp(high, knots, curvatures) - np.interp(low, knots, curvatures))) / max(high - low, 1.0)


def _corner(duty, curvature, tightest, begin):
    """Return where the rise would meet the level of the stop: the fitted curve is smooth, a stop isn't."""
    outward = math.copysign(2 * COUNT, duty[-1] - duty[0])
    is_rise = ((curvature >= RISE_LOW * tightest) & (curvature <= RISE_HIGH * tightest)
               & (np.arange(len(duty)) < begin))
    rise = np.flatnonzero(is_rise)
    if len(rise) < 2 or np.ptp(curvature[rise]) < 0.02 * tightest:
        return float(duty[begin])
    gradient, offset = np.polyfit(curvature[rise], duty[rise], 1)
    corner = gradient * tightest + offset
    low, high = sorted((duty[rise[-1]], duty[begin] + outward))
    return float(min(max(corner, low), high))


def _count_at_stop(duty, curvature, tightest, corner):
    """Return the first count from a stop's corner on that turns as tight: the board may round a duty back across it."""
    inward = math.copysign(1.0, duty[0] - duty[-1])
    counts = np.arange(round(corner / COUNT) * COUNT, duty[-1] - inward, -inward * COUNT)
    order = np.argsort(duty)
    is_level = np.interp(counts, duty[order], curvature[order]) >= tightest * (1 - STOP_RATIO)
    return float(counts[np.argmax(is_level)]) if is_level.any() else corner


# --- understeer ---


def estimate_understeer(found: Observations, slope_per_m: np.ndarray) -> Understeer:
    """Estimate it in least squares, each place with a curvature of its own. Outliers count less, but none is left out
    (Huber's weights): where places differ, that has to show in the standard error. ``slope_per_m``: of the curve at
    each observation, in 1/m for each duty, (S,): what a difference in duty is worth.
    """
    place = place_numbers(found.duty)
    repeated = np.bincount(place)[place] > 1
    if not repeated.any():
        return UNKNOWN_UNDERSTEER
    place, slope_per_m = place[repeated], slope_per_m[repeated]
    found = found.those(repeated)
    sigma = np.hypot(found.sigma_per_m, found.duty_sigma * slope_per_m)
    weight, value = 1 / sigma ** 2, math.inf
    for _ in range(MAX_PASSES):
        lost = _less_mean(lost_per_m(found.curvature_per_m, found.speed_mps, 1.0), place, weight)
        widened = _less_mean(found.curvature_per_m, place, weight)
        widened = widened - slope_per_m * _less_mean(found.duty, place, weight)
        information = np.bincount(place, weight * lost ** 2)
        total = float(information.sum())
        if total <= 0.0:
            return UNKNOWN_UNDERSTEER
        before, value = value, -float(np.sum(weight * lost * widened)) / total
        off = np.abs(widened + value * lost) / sigma
        scatter = max(1.0, 1.4826 * float(np.median(off)))
        if abs(value - before) <= CONVERGED:
            break
        weight = 1 / np.maximum(1.0, off / (scatter * HUBER)) / sigma ** 2
    places = int(np.sum(information >= MIN_PART * total))
    # By how much each place alone would move the sum, as clusters of observations whose errors aren't independent.
    moved = np.bincount(place, weight * lost * (widened + value * lost))
    between = math.sqrt(float(moved @ moved) * places / max(1, places - 1)) / total
    error = max(between, scatter / math.sqrt(total))
    if value < SEEN_SIGMAS * error:
        return Understeer(0.0, error, places)
    return Understeer(min(value, MAX_UNDERSTEER), max(error, MIN_SIGMA_RATIO * value), places)


def _less_mean(values, place, weight):
    """Return the values (S,) less the weighted mean of those at the same place, (S,)."""
    mean = np.bincount(place, weight * values) / np.maximum(np.bincount(place, weight), 1e-30)
    return values - mean[place]
