"""Which duty of the steering servo makes the car turn how tight, from a drive.

Consumes heading and way of drives and the servo's duty meanwhile; produces a monotone curve from duty to curvature,
each of its values with how well it is known, and a table of duties over turn radii.

- Where the wheels are in the servo's travel follows from the commands: a delay, a lag, and the linkage's play, which
  are estimated first. The curve is that of the middle of the play.
- A piece of way in which the wheels hardly moved, and the servo had arrived, is one observation: the slope of heading
  over way, in least squares. Its error falls with the way to the power of 1.5: pieces are as long as they can be.
- The curve is a smoothing spline through these observations (an integrated random walk whose strength is the
  likeliest), robust against pieces that don't belong (Tukey's biweight), and then made monotone. What it says of its
  own error grows in gaps, where it may bend between two places unseen, where observations lie farther off than they
  should, and where the linkage floated in its play.
- Duties are read off by straight lines between the counts that the board can hold.

Duties rise or fall to the left: both ways round are found. Curvatures are in 1/m, left positive; radii in m. Pure numpy
and scipy: numbers in, numbers out.
"""
from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, Sequence

import numpy as np

from car_interface.calibration.delay import Delay
from car_interface.calibration.steering.segments import (
    COUNT,
    DEFAULTS,
    KNOT,
    Drive,
    FitConfig,
    NothingToFit,
    Pieces,
    cut_up,
    knots_of,
    observations,
    pieces,
    servo_delay,
)
from car_interface.calibration.steering.smooth import Smooth, rising

# Standard errors on either side. On virtual cars they hold the truth more often than 19 times of 20, also where the
# recording has gaps: see test/accuracy/steering_calibration.py.
BAND = 1.96
CONTRADICTIONS = 6.0  # so much more than with the best play is chance
MIN_BACKLASH_SIGMA = 1.0
BACKLASH_SCALE_DUTY = 20.0  # before any data a play is so large, exponentially distributed
BEND_RATIO = 1 / math.sqrt(12)  # of how far the curve may bend away is a standard error, if any of it is as likely
DISAGREES, DISAGREES_DUTY = 6.0, 2 * COUNT  # standard errors, and duty: less than this tyres and floors may do
DISAGREES_PLACES, DISAGREES_RATIO = 5, 0.25  # at so many counts, and of all where both drove
BACKLASH_DOUBT = 4.0  # pieces of one position err alike: likelihoods count for so much less


@dataclass(frozen=True)
class Curve:
    """What was found.

    Attributes:
        duties: knots, rising, half a count apart.
        curvatures: there, monotone; linear in between.
        sigmas: their standard errors.
        first_knot: which of the pieces' weights belongs to the first of them.
        delay: of the servo.
        backlash_duty: of its linkage.
        backlash_sigma: its standard error.
        pieces: what it rests on.
        kept: which pieces do.
        counts: how many pieces were left out, by reason.
        scatter: how far pieces lie off, in their own standard errors.
        center: the duty that goes straight; NaN when nothing near it was driven.
        center_sigma: its standard error.
        left, right: each side's end.
    """

    duties: np.ndarray
    curvatures: np.ndarray
    sigmas: np.ndarray
    first_knot: int
    delay: Delay
    backlash_duty: float
    backlash_sigma: float
    pieces: Pieces
    kept: np.ndarray
    counts: dict
    scatter: float
    center: float
    center_sigma: float
    left: Side
    right: Side

    def curvature(self, duty):
        """At duties within the knots; the ends' beyond."""
        return np.interp(duty, self.duties, self.curvatures)

    def duty(self, curvature):
        """That makes curvatures; the ends' beyond what was driven.

        By straight lines from count to count: half way between two of them lies what is half way between their
        curvatures, and so the board's nearest count is the one that turns nearest to what is asked for. Along the
        curve itself it would be another one where that bends within a count.
        """
        is_count = np.isclose(self.duties % COUNT, 0.0)
        is_count[[0, -1]] = True
        duties, curvatures = self.duties[is_count], self.curvatures[is_count]
        if curvatures[-1] < curvatures[0]:
            duties, curvatures = duties[::-1], curvatures[::-1]
        # Where it is level the duty nearest to the center does: np.interp needs strictly rising values.
        steps = np.arange(len(curvatures)) * 1e-9
        return np.interp(curvature, curvatures + steps, duties)


class Side(NamedTuple):
    """One end of the steering."""

    duty: float  # where the radius stops shrinking, or the farthest that was driven
    curvature_per_m: float  # magnitude there
    sigma_per_m: float
    is_stop: bool  # the wheels turned no farther though the servo did
    is_end: bool  # that, or the servo isn't meant to turn farther
    farthest_duty: float  # that was driven


def fit(drives: Sequence[Drive], config: FitConfig = DEFAULTS) -> Curve:
    """Find the curve.

    Raises:
        NothingToFit: saying why, as the end of a sentence.
    """
    drives = [drive for drive in drives if len(drive.t_s) > 1 and len(drive.duty)]
    if not drives:
        raise NothingToFit("there is no odometry while the servo had a duty")
    delay = config.delay or servo_delay(drives, config)
    cuts = [cut_up(drive, delay, config) for drive in drives]
    given = config.backlash_duty is not None
    backlash_duty, backlash_sigma = (config.backlash_duty, 0.0) if given else _play(cuts, config)
    return _attempt(cuts, backlash_duty).curve(delay, backlash_sigma, config)


class Disagreement(NamedTuple):
    """What of two curves can't be of the same steering."""

    duty: float  # by which they differ, where they do
    curvature_per_m: float  # where that is least likely


def disagreement(one: Curve, other: Curve) -> Disagreement | None:
    """By how much two drives tell of different steerings; ``None`` if they don't.

    Only where both were driven, within a count: in the gaps of a short drive its curve may be far off. And not by
    single places: a changed linkage shows in many.
    """
    low, high = max(one.duties[0], other.duties[0]), min(one.duties[-1], other.duties[-1])
    duties = np.arange(math.ceil(low / COUNT) * COUNT, high, COUNT)
    for curve in (one, other):
        driven = curve.pieces.duty[curve.kept]
        duties = duties[[bool(np.any(np.abs(driven - duty) <= COUNT)) for duty in duties]]
    curvatures = one.curvature(duties)
    sigmas = np.hypot(np.interp(duties, one.duties, one.sigmas), np.interp(duties, other.duties, other.sigmas))
    off = np.abs(curvatures - other.curvature(duties)) / np.maximum(sigmas, 1e-9)
    apart = np.abs(other.duty(curvatures) - duties)
    bad = (off > DISAGREES) & (apart >= DISAGREES_DUTY)
    if bad.sum() < max(DISAGREES_PLACES, DISAGREES_RATIO * len(duties)):
        return None
    return Disagreement(float(np.median(apart[bad])), float(curvatures[np.argmax(np.where(bad, off, 0.0))]))


def _play(cuts, config):
    """(the likeliest play, its standard error).

    With a wrong play positions that were come to from both sides contradict each other: no monotone curve goes through
    them. Among the plays that are left the likeliest is taken, all compared by what is known of noise and smoothness
    with one of them: first that of a curve that is as smooth everywhere, for one that may be sharp in places says where
    these are; and then, near the truth, of one that may, for the smooth one is too flat where the car's is steep.
    """
    plays = np.arange(0.0, config.max_backlash_duty + 1.0, 2.0)
    contradictions = np.array([_contradictions(cuts, play) for play in plays])
    plays = plays[contradictions <= contradictions.min() + CONTRADICTIONS]
    backlash_duty = float(np.median(plays))
    for adapts in (False, True):
        like = Smooth(_attempt(cuts, backlash_duty).pieces, adapts)
        costs = np.array([like.cost(*observations(cuts, play)) for play in plays]) + 2 * plays / BACKLASH_SCALE_DUTY
        if not np.isfinite(costs).any():
            raise NothingToFit("no play of the steering fits the places where it was held: drive more of them")
        costs = np.where(np.isfinite(costs), costs, np.inf)
        likely = np.exp(-(costs - costs.min()) / 2 / BACKLASH_DOUBT)
        likely /= likely.sum()
        backlash_duty = float(likely @ plays)
    return backlash_duty, math.hypot(math.sqrt(float(likely @ (plays - backlash_duty) ** 2)), MIN_BACKLASH_SIGMA)


def _contradictions(cuts, backlash_duty):
    """How far pieces lie off the nearest monotone curve, in squares of their standard errors, each within a bound."""
    _, duties = observations(cuts, backlash_duty)
    spans = [span for cut in cuts for span in cut.spans]
    curvature = np.array([span.curvature for span in spans])
    sigma = np.hypot([span.sigma for span in spans], 3 * cuts[0].config.slack_per_m)
    order = np.argsort(duties, kind="stable")
    least = math.inf
    for sign in (1.0, -1.0):
        y, weight = sign * curvature[order], 1 / sigma[order] ** 2
        least = min(least, float(np.minimum(weight * (y - rising(y, weight)) ** 2, 25.0).sum()))
    return least


class _Attempt:
    """The observations for one play, and the smooth curve through them."""

    def __init__(self, backlash_duty, knots, pieces, counts):
        self.backlash_duty, self.knots, self.pieces, self.counts = backlash_duty, knots, pieces, counts
        self.smooth = Smooth(pieces)

    def curve(self, delay, backlash_sigma, config):
        """With bounds, errors and ends."""
        smooth, pieces = self.smooth, self.pieces
        near = smooth.weight > 0.05
        sigmas = smooth.standard_errors()
        curvatures = smooth.monotone(sigmas)
        # Where all came from the same side half of the play is as unknown as the play itself.
        sigmas = np.hypot(sigmas, np.abs(np.gradient(curvatures, KNOT)) * backlash_sigma / 2)
        sigmas = np.hypot(sigmas, BEND_RATIO * _bends(self.knots, pieces, near))
        sigmas = _bounded(curvatures, sigmas)
        low, high = pieces.duty[near].min(), pieces.duty[near].max()
        inside = (self.knots >= low - KNOT) & (self.knots <= high + KNOT)
        knots, curvatures, sigmas = self.knots[inside], curvatures[inside], sigmas[inside]
        rising = curvatures[-1] > curvatures[0]
        ends = [_side(knots, curvatures, sigmas, towards, low, high, config) for towards in (-1, 1)]
        left, right = ends[::-1] if rising else ends
        center, center_sigma = _center(knots, curvatures, sigmas)
        counts = {**self.counts, "apart from all others": int(np.sum(~near))}
        return Curve(knots, curvatures, sigmas, int(np.argmax(inside)), delay, self.backlash_duty, backlash_sigma,
                     pieces, near, counts, smooth.scatter, center, center_sigma, left, right)


def _attempt(cuts, backlash_duty):
    found, counts = pieces(cuts, backlash_duty)
    return _Attempt(backlash_duty, knots_of(cuts), found, counts)


def _bends(knots, pieces, kept):
    """How far off the straight line between the places where it was driven the curve may be, at each knot.

    From place to place it may go on as steeply as it came there, and bend but in between, as at a stop: no piece says.
    """
    duty, curvature, sigma = _places(pieces, kept)
    if len(duty) < 3:
        return np.zeros(len(knots))
    width = np.diff(duty)
    steep, steep_sigma = np.diff(curvature) / width, np.hypot(sigma[1:], sigma[:-1]) / width
    # Outermost it may have been level before, as at a stop.
    before, behind = np.append(0.0, steep[:-1]), np.append(steep[1:], 0.0)
    before_sigma, behind_sigma = np.append(0.0, steep_sigma[:-1]), np.append(steep_sigma[1:], 0.0)
    begins = _beyond_noise(steep - before, np.hypot(steep_sigma, before_sigma))
    ends = _beyond_noise(behind - steep, np.hypot(steep_sigma, behind_sigma))
    at = np.clip(np.searchsorted(duty, knots) - 1, 0, len(width) - 1)
    from_begin, to_end = np.clip(knots - duty[at], 0, None), np.clip(duty[at + 1] - knots, 0, None)
    return np.minimum(begins[at] * from_begin, ends[at] * to_end)


def _beyond_noise(difference, sigma):
    """A difference's magnitude, the less of it the more it may be noise."""
    squared = difference ** 2
    return np.abs(difference) * squared / np.maximum(squared + sigma ** 2, 1e-30)


def _places(pieces, kept):
    """(duty, curvature, its standard error) of pieces, duties rising; those within half a count are one place."""
    order = np.flatnonzero(kept)[np.argsort(pieces.duty[kept], kind="stable")]
    duty, weight = pieces.duty[order], 1 / pieces.sigma_per_m[order] ** 2
    begins, begin = [0], duty[0]
    for index, at in enumerate(duty):
        if at > begin + COUNT / 2:
            begins.append(index)
            begin = at
    total = np.add.reduceat(weight, begins)
    return (np.add.reduceat(weight * duty, begins) / total,
            np.add.reduceat(weight * pieces.curvature_per_m[order], begins) / total, 1 / np.sqrt(total))


def _bounded(curvatures, sigmas):
    """Standard errors of a monotone curve: between two well-known places it can't be beyond either."""
    rising = curvatures if curvatures[-1] >= curvatures[0] else -curvatures
    most = np.minimum.accumulate((rising + BAND * sigmas)[::-1])[::-1]
    least = np.maximum.accumulate(rising - BAND * sigmas)
    return np.minimum(sigmas, np.maximum(np.maximum(most - rising, rising - least), 0.0) / BAND)


def _side(knots, curvatures, sigmas, towards, low, high, config):
    """The end towards lower (−1) or higher duties."""
    farthest = float(low if towards < 0 else high)
    ordered = slice(None, None, towards)
    curvature, duty, sigma = curvatures[ordered], knots[ordered], sigmas[ordered]
    inside = (duty - farthest) * towards <= 0
    curvature, duty, sigma = curvature[inside] * np.sign(curvature[inside][-1]), duty[inside], sigma[inside]
    tightest = float(curvature[-1])
    # The tightest is as uncertain as what lies beside it.
    is_level = curvature >= tightest * (1 - config.stop_ratio) - min(2 * sigma[-1], 2 * config.stop_ratio * tightest)
    begin = len(is_level) - int(np.argmin(is_level[::-1])) if not is_level.all() else 0
    begin_duty = _corner(duty, curvature, tightest, begin)
    is_stop = (farthest - duty[begin]) * towards >= config.stop_duty and tightest > 5 * sigma[-1]
    is_end = is_stop or any((farthest - limit) * towards >= -COUNT for limit in config.limits
                            if (limit - np.mean(knots)) * towards > 0)
    if is_stop:
        begin_duty = _held_stop(duty, curvature, tightest, begin_duty, config.stop_ratio)
    return Side(begin_duty if is_stop else farthest, tightest, float(sigma[begin if is_stop else -1]),
                bool(is_stop), bool(is_end), farthest)


def _corner(duty, curvature, tightest, begin):
    """Where the rise to a level stretch would meet it: the curve is smooth, a stop isn't."""
    outwards = math.copysign(2 * COUNT, duty[-1] - duty[0])
    is_rise = (curvature >= 0.90 * tightest) & (curvature <= 0.97 * tightest) & (np.arange(len(duty)) < begin)
    rise = np.flatnonzero(is_rise)
    if len(rise) < 2 or np.ptp(curvature[rise]) < 0.02 * tightest:
        return float(duty[begin])
    slope, offset = np.polyfit(curvature[rise], duty[rise], 1)
    corner = slope * tightest + offset
    low, high = sorted((duty[rise[-1]], duty[begin] + outwards))
    return float(min(max(corner, low), high))


def _held_stop(duty, curvature, tightest, corner, share):
    """The first count from a stop's corner on that turns as tight: the board may round a duty back across it."""
    inwards = math.copysign(1.0, duty[0] - duty[-1])
    counts = np.arange(round(corner / COUNT) * COUNT, duty[-1] - inwards, -inwards * COUNT)
    order = np.argsort(duty)
    is_level = np.interp(counts, duty[order], curvature[order]) >= tightest * (1 - share)
    return float(counts[np.argmax(is_level)]) if is_level.any() else corner


def _center(knots, curvatures, sigmas):
    """(duty that goes straight, its standard error)."""
    if curvatures.min() > 0 or curvatures.max() < 0:
        return math.nan, math.nan
    sign = 1.0 if curvatures[-1] > curvatures[0] else -1.0
    rising = sign * curvatures
    at = int(np.clip(np.searchsorted(rising, 0.0), 1, len(knots) - 1))
    # A stretch that is level at 0 has its middle.
    level = np.flatnonzero(np.abs(rising) < 1e-9)
    if len(level):
        center = float(knots[level].mean())
    else:
        low, high = rising[at - 1], rising[at]
        center = float(knots[at - 1] + (0 - low) / (high - low) * (knots[at] - knots[at - 1]))
    steepness = slope(knots, rising, center)
    return center, float(np.interp(center, knots, sigmas) / max(steepness, 1e-9))


def slope(knots, curvatures, duty):
    """Of the curve around a duty, over two counts to each side."""
    low, high = max(knots[0], duty - 2 * COUNT), min(knots[-1], duty + 2 * COUNT)
    return abs(float(np.interp(high, knots, curvatures) - np.interp(low, knots, curvatures))) / max(high - low, 1.0)
