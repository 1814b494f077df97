"""Which duty of the steering servo makes the car turn how tight, from a drive.

Consumes heading and way of drives and the servo's duty meanwhile; produces a monotone curve from duty to curvature,
each of its values with how well it is known, and a table of duties over turn radii.

- Where the wheels are in the servo's travel follows from the commands: a delay, a lag, and the linkage's play, which
  are estimated first. The curve is that of the middle of the play.
- A piece of way in which the wheels hardly moved, and the servo had arrived, is one observation: the slope of heading
  over way, in least squares. Its error falls with the way to the power of 1.5: pieces are as long as they can be.
- The curve is a smoothing spline through these observations (an integrated random walk whose strength is the
  likeliest), robust against pieces that don't belong (Tukey's biweight), and then made monotone. What it says of its
  own error grows in gaps, and where observations lie farther off than they should.

Duties rise or fall to the left: both ways round are found. Curvatures are in 1/m, left positive; radii in m. Pure numpy
and scipy: numbers in, numbers out.
"""
from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, Sequence

import numpy as np
from scipy import sparse
from scipy.linalg import cho_solve_banded, cholesky_banded

from car_interface.calibration import delay as delays
from car_interface.calibration.delay import Delay

COUNT = 16.0  # duty of one count of the servo board: it can't stand in between
LEFT, RIGHT = "left", "right"
# What a breakpoint's duty rests on.
DRIVEN, END, OLD, UNKNOWN = "driven", "end", "old", "unknown"
# Standard errors on either side. If errors were independent and Gaussian they would hold the truth 19 times of 20; on
# virtual cars it was 9 times of 10, and fewer where the recording has gaps: see test/steering_calibration.py.
BAND = 1.96
SLOPE_POINTS = 26  # of a piece, by which its slope is taken
# A slope in least squares is a mean of the curvature along the piece, with the weight of a parabola.
SHARES = (lambda x: x * (1 - x) / np.sum(x * (1 - x)))((np.arange(SLOPE_POINTS - 1) + 0.5) / (SLOPE_POINTS - 1))
NEAR_SHARE = 0.25  # pieces count for a radius when their curvature is so near to its
INDEPENDENT_M = 0.15  # headings so far apart have errors of their own
KNOT = COUNT / 2  # of the curve, from one to the next
CROSSED_DUTY = 40.0  # a servo that moved so far has crossed any usual play
DUTY_SIGMA = 1.0  # how well it's known where the wheels were, in duty
NEIGHBOURS, CONTRADICTION_PER_M = 5, 0.03
MOST_PLAY_DUTY = 80.0
CONTRADICTIONS = 6.0  # so much more than with the best play is chance
LEAST_PLAY_SIGMA = 1.0
PLAY_SCALE_DUTY = 20.0  # before any data a play is so large, exponentially distributed
PLAY_DOUBT = 4.0  # pieces of one position err alike: likelihoods count for so much less


@dataclass(frozen=True)
class FitConfig:
    """What counts, and how much.

    Attributes:
        slowest_mps: slower, heading changes are too few to tell.
        most_sideways_mps2: where tyres may begin to slide.
        settled_duty: the servo has arrived when it is so near to what was commanded, by delay and lag.
        wander_duty: the wheels may move by so much in a piece.
        shortest_m, longest_m, shortest_s: of a piece.
        gap_s: between samples of odometry, from which on they don't belong together.
        jump_rad: of the heading between two samples that no car makes.
        heading_sigma_rad: of odometry's heading.
        slack_per_m: what no piece is more exact than: floors and tyres.
        delay: of the servo; ``None`` = estimated.
        play_duty: of the linkage; ``None`` = estimated.
        most_play_duty: what is tried.
        known_share, known_per_m: a breakpoint is supported when the band around its curvature is at most so wide to
            each side, as a share of it, or absolutely, or half of what the board's next count would change.
        stop_duty: a stop is one when the curve stays level for so long.
        stop_share: level is what is so near to the tightest.
        limits: duties beyond which nobody means to steer.
    """

    slowest_mps: float = 0.25
    most_sideways_mps2: float = 4.0
    settled_duty: float = 6.0
    wander_duty: float = 24.0
    shortest_m: float = 0.5
    longest_m: float = 8.0
    shortest_s: float = 0.3
    gap_s: float = 0.3
    jump_rad: float = 0.5
    heading_sigma_rad: float = 0.008
    slack_per_m: float = 0.001
    delay: Delay | None = None
    play_duty: float | None = None
    most_play_duty: float = MOST_PLAY_DUTY
    known_share: float = 0.15
    known_per_m: float = 0.02
    stop_duty: float = 40.0
    stop_share: float = 0.007
    limits: tuple = ()


class Drive(NamedTuple):
    """One recording; the drives of a calibration are all of one car with nothing changed in between."""

    t_s: np.ndarray  # rising
    way_m: np.ndarray  # signed, backward negative, from anywhere
    yaw_rad: np.ndarray  # unwrapped
    duty_t_s: np.ndarray
    duty: np.ndarray  # of the steering channel, each until the next one; what is no pulse is NaN


class Pieces(NamedTuple):
    """Pieces of way, a row each."""

    t_s: np.ndarray  # their middle
    curvature_per_m: np.ndarray
    sigma_per_m: np.ndarray
    duty: np.ndarray  # where the wheels were, on average
    way_m: np.ndarray
    weights: sparse.csr_matrix  # of the knots: the curvature is weights @ curve


@dataclass(frozen=True)
class Curve:
    """What was found.

    Attributes:
        duties: knots, rising, half a count apart.
        curvatures: there, monotone; linear in between.
        sigmas: their standard errors.
        first_knot: which of the pieces' weights belongs to the first of them.
        delay: of the servo.
        play_duty: of its linkage.
        play_sigma: its standard error.
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
    play_duty: float
    play_sigma: float
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
        """That makes curvatures; the ends' beyond what was driven."""
        rising = self.curvatures[-1] > self.curvatures[0]
        curvatures, duties = (self.curvatures, self.duties) if rising else (self.curvatures[::-1], self.duties[::-1])
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


class Breakpoint(NamedTuple):
    """One radius of a table, one side."""

    radius_m: float
    duty: float
    duty_sigma: float
    radius_sigma_m: float
    pieces: int  # that were driven about as tight
    way_m: float  # in these
    source: str  # DRIVEN, END: no tighter turn can be had, OLD or UNKNOWN


class NothingToFit(ValueError):
    """Drives that tell nothing of a steering, and why."""


def fit(drives: Sequence[Drive], config: FitConfig = FitConfig()) -> Curve:
    """Find the curve.

    Raises:
        NothingToFit: saying why, as the end of a sentence.
    """
    drives = [drive for drive in drives if len(drive.t_s) > 1 and len(drive.duty)]
    if not drives:
        raise NothingToFit("there is no odometry while the servo had a duty")
    delay = config.delay or _delay(drives, config)
    wheels = [_Wheels(drive, delay, config.gap_s) for drive in drives]
    cuts = [_cut(one, config) for one in wheels]
    play_duty, play_sigma = (config.play_duty, 0.0) if config.play_duty is not None else _play(cuts, config)
    return _attempt(cuts, play_duty).curve(delay, play_sigma, config)


def _play(cuts, config):
    """(the likeliest play, its standard error).

    With a wrong play positions that were come to from both sides contradict each other: no monotone curve goes through
    them. Among the plays that are left the likeliest is taken, all compared by what is known of noise and smoothness
    with one of them; and that of a curve that is as smooth everywhere, for one that may be sharp in places would say
    where these are.
    """
    plays = np.arange(0.0, config.most_play_duty + 1.0, 2.0)
    contradictions = np.array([_contradictions(cuts, play) for play in plays])
    plays = plays[contradictions <= contradictions.min() + CONTRADICTIONS]
    play_duty = float(np.median(plays))
    for _ in range(2):
        like = _Smooth(_attempt(cuts, play_duty).pieces, adapts=False)
        costs = np.array([like.cost(*_observations(cuts, play)) for play in plays]) + 2 * plays / PLAY_SCALE_DUTY
        if not np.isfinite(costs).any():
            raise NothingToFit("no play of the steering fits the places where it was held: drive more of them")
        costs = np.where(np.isfinite(costs), costs, np.inf)
        likely = np.exp(-(costs - costs.min()) / 2 / PLAY_DOUBT)
        likely /= likely.sum()
        play_duty = float(likely @ plays)
    return play_duty, math.hypot(math.sqrt(float(likely @ (plays - play_duty) ** 2)), LEAST_PLAY_SIGMA)


def _contradictions(cuts, play_duty):
    """How far pieces lie off the nearest monotone curve, in squares of their standard errors, each within a bound."""
    _, duties = _observations(cuts, play_duty)
    spans = [span for cut in cuts for span in cut.spans]
    curvature = np.array([span.curvature for span in spans])
    sigma = np.hypot([span.sigma for span in spans], 3 * cuts[0].config.slack_per_m)
    order = np.argsort(duties, kind="stable")
    least = math.inf
    for sign in (1.0, -1.0):
        y, weight = sign * curvature[order], 1 / sigma[order] ** 2
        least = min(least, float(np.minimum(weight * (y - rising(y, weight)) ** 2, 25.0).sum()))
    return least


def _delay(drives, config):
    """Of all drives together, one behind the other."""
    cause_s, cause, effect_s, effect, weight = [], [], [], [], []
    begin_s = 0.0
    for drive in drives:
        shift_s = begin_s - drive.t_s[0]
        t_s = np.arange(drive.t_s[0], drive.t_s[-1], delays.STEP_S)
        way_m, yaw_rad = np.interp(t_s, drive.t_s, drive.way_m), np.interp(t_s, drive.t_s, drive.yaw_rad)
        half = 3
        if len(t_s) <= 2 * half:
            continue
        step_m, turned = way_m[2 * half:] - way_m[:-2 * half], yaw_rad[2 * half:] - yaw_rad[:-2 * half]
        at_s = t_s[half:-half]
        is_fine = np.abs(step_m) > config.slowest_mps * 2 * half * delays.STEP_S
        is_fine &= _gap_after(drive.t_s, at_s) < config.gap_s
        effect.append(turned / np.where(is_fine, step_m, 1.0))
        weight.append(np.where(is_fine, step_m ** 2, 0.0))
        effect_s.append(at_s + shift_s)
        known = np.isfinite(drive.duty)
        cause_s.append(drive.duty_t_s[known] + shift_s)
        cause.append(drive.duty[known])
        begin_s += drive.t_s[-1] - drive.t_s[0] + 10.0
    if not effect:
        raise NothingToFit("the recordings are shorter than a second")
    found = delays.estimate(*(np.concatenate(column) for column in (cause_s, cause, effect_s, effect, weight)))
    if found is None:
        raise NothingToFit("the heading doesn't follow the steering's duty (is it the right channel? did the car "
                           "drive?)")
    return found


class _Wheels:
    """Where one drive's wheels were, on an even scale of time.

    What the servo did before the recording began, and in its gaps, nobody knows: it is known again when a duty was
    recorded and the servo had time to follow, and where in its play the linkage is when it has moved far enough.
    """

    STEP_S = 0.02

    def __init__(self, drive, delay, gap_s):
        self.t_s = np.arange(drive.t_s[0], drive.t_s[-1], self.STEP_S)
        self.way_m = np.interp(self.t_s, drive.t_s, drive.way_m)
        self.yaw_rad = np.interp(self.t_s, drive.t_s, drive.yaw_rad)
        self.speed_mps = np.gradient(self.way_m, self.STEP_S)
        commanded = delays.held(drive.duty_t_s, drive.duty, self.t_s - delay.delay_s)
        self.is_known = np.isfinite(commanded) & (self.t_s - delay.delay_s >= drive.duty_t_s[0])
        # Without a pulse a servo stays where it is.
        last = np.maximum.accumulate(np.where(np.isfinite(commanded), np.arange(len(commanded)), 0))
        commanded = np.nan_to_num(commanded[last], nan=0.0)
        self.servo = np.empty(len(commanded))
        ends_s = drive.t_s[1:][np.diff(drive.t_s) > gap_s]
        self._begins = np.unique(np.concatenate([[0], np.searchsorted(self.t_s, ends_s)]))
        for begin, end in zip(self._begins, [*self._begins[1:], len(self.t_s)]):
            self._follow(drive, delay, commanded, begin, end)
        self.off = np.abs(commanded - self.servo)
        jumps = np.abs(np.diff(np.interp(self.t_s, drive.t_s, drive.yaw_rad), prepend=drive.yaw_rad[0]))
        self.gap_s, self.jump_rad = _gap_after(drive.t_s, self.t_s), jumps

    def _follow(self, drive, delay, commanded, begin, end):
        """From one gap to the next."""
        if begin >= end:
            return
        after = np.searchsorted(drive.duty_t_s, self.t_s[begin]) if begin else 0
        heard_s = drive.duty_t_s[after] if after < len(drive.duty_t_s) else math.inf
        heard = min(begin + int(np.searchsorted(self.t_s[begin:end], heard_s + delay.delay_s)), end - 1)
        self.servo[begin:heard] = commanded[heard]
        self.servo[heard:end] = delays.lagged(commanded[heard:end], self.STEP_S, delay.lag_s)
        settled = begin + int(np.searchsorted(self.t_s[begin:end], heard_s + delay.settled_s))
        self.is_known[begin:settled] = False
        if settled < end:
            servo = self.servo[settled:end]
            moved = np.maximum.accumulate(servo) - np.minimum.accumulate(servo)
            self.is_known[settled:end] &= moved >= CROSSED_DUTY

    def linkage(self, play_duty):
        """Where the wheels are, with play: they follow when the servo has crossed it."""
        if play_duty <= 0:
            return self.servo
        half, now, out = play_duty / 2, float(self.servo[0]), np.empty(len(self.servo))
        begins = set(self._begins.tolist())
        for index, servo in enumerate(self.servo.tolist()):
            if index in begins:
                now = servo
            if servo - half > now:
                now = servo - half
            elif servo + half < now:
                now = servo + half
            out[index] = now
        return out


def _gap_after(t_s, at_s):
    """How long the gap between samples is that each moment lies in."""
    index = np.clip(np.searchsorted(t_s, at_s, side="right"), 1, len(t_s) - 1)
    return t_s[index] - t_s[index - 1]


class _Attempt:
    """The observations for one play, and the smooth curve through them."""

    def __init__(self, play_duty, knots, pieces, counts):
        self.play_duty, self.knots, self.pieces, self.counts = play_duty, knots, pieces, counts
        self.smooth = _Smooth(pieces)

    def curve(self, delay, play_sigma, config):
        """With bounds, errors and ends."""
        smooth, pieces = self.smooth, self.pieces
        near = smooth.weight > 0.05
        sigmas = smooth.standard_errors()
        curvatures = smooth.monotone(sigmas)
        # Where all came from the same side half of the play is as unknown as the play itself.
        sigmas = np.hypot(sigmas, np.abs(np.gradient(curvatures, KNOT)) * play_sigma / 2)
        sigmas = _bounded(curvatures, sigmas)
        low, high = pieces.duty[near].min(), pieces.duty[near].max()
        inside = (self.knots >= low - KNOT) & (self.knots <= high + KNOT)
        knots, curvatures, sigmas = self.knots[inside], curvatures[inside], sigmas[inside]
        rising = curvatures[-1] > curvatures[0]
        ends = [_side(knots, curvatures, sigmas, towards, low, high, config) for towards in (-1, 1)]
        left, right = ends[::-1] if rising else ends
        center, center_sigma = _center(knots, curvatures, sigmas)
        counts = {**self.counts, "apart from all others": int(np.sum(~near))}
        return Curve(knots, curvatures, sigmas, int(np.argmax(inside)), delay, self.play_duty, play_sigma, pieces, near,
                     counts, smooth.scatter, center, center_sigma, left, right)


def _attempt(cuts, play_duty):
    spans = [span for cut in cuts for span in cut.spans]
    weights, duties = _observations(cuts, play_duty)
    middle_s, curvature, sigma, length = (np.array([getattr(span, name) for span in spans])
                                          for name in ("middle_s", "curvature", "sigma", "length_m"))
    counts: dict = {}
    for cut in cuts:
        for reason, count in cut.counts.items():
            counts[reason] = counts.get(reason, 0) + count
    return _Attempt(play_duty, _knots(cuts), Pieces(middle_s, curvature, sigma, duties, length, weights), counts)


def _knots(cuts):
    """The same whatever the play."""
    spans = [(span, cut.wheels.servo) for cut in cuts for span in cut.spans]
    if not spans:
        raise NothingToFit("the car never held its steering for half a metre at speed")
    low = min(servo[span.samples].min() for span, servo in spans)
    high = max(servo[span.samples].max() for span, servo in spans)
    if len(spans) < 4 or high - low < 4 * COUNT:
        raise NothingToFit("the steering was held in fewer than four places")
    return np.arange(math.floor((low - MOST_PLAY_DUTY) / KNOT), math.ceil((high + MOST_PLAY_DUTY) / KNOT) + 1) * KNOT


def _observations(cuts, play_duty):
    """(how much of each knot is in each piece's curvature, where the wheels were on it on average)."""
    knots = _knots(cuts)
    duties = np.array([np.interp(span.middles_m, span.way_m, linkage[span.samples])
                       for cut in cuts for linkage in [cut.wheels.linkage(play_duty)] for span in cut.spans])
    place = np.clip((duties - knots[0]) / KNOT, 0, len(knots) - 1.001)
    index = place.astype(int)
    share = place - index
    rows = np.tile(np.repeat(np.arange(len(duties)), duties.shape[1]), 2)
    weights = sparse.csr_matrix((np.concatenate([(SHARES * (1 - share)).ravel(), (SHARES * share).ravel()]),
                                 (rows, np.concatenate([index.ravel(), index.ravel() + 1]))),
                                shape=(len(duties), len(knots)))
    return weights, duties @ SHARES


class _Span(NamedTuple):
    """A piece of way before it's known where the wheels were on it."""

    samples: np.ndarray  # indices, in the order of the way
    way_m: np.ndarray  # there, rising
    middles_m: np.ndarray  # where the duty counts
    middle_s: float
    curvature: float
    sigma: float
    length_m: float


class _Cut(NamedTuple):
    """One drive in pieces."""

    wheels: _Wheels
    spans: list
    counts: dict  # stretches left out, by reason
    config: FitConfig


def _cut(wheels, config):
    is_slow = np.abs(wheels.speed_mps) < config.slowest_mps
    turning = np.convolve(np.gradient(wheels.yaw_rad, wheels.STEP_S), np.full(9, 1 / 9), "same")
    slides = np.abs(wheels.speed_mps * turning) > config.most_sideways_mps2
    unknown = ~wheels.is_known | (wheels.gap_s > config.gap_s) | (wheels.jump_rad > config.jump_rad)
    usable, counts = np.ones(len(is_slow), bool), {}
    for reason, flags in (("slow or standing", is_slow), ("gaps in odometry or duty", unknown),
                          ("fast in a bend: tyres may slide", slides),
                          ("servo on its way", wheels.off > config.settled_duty)):
        counts[reason] = int(np.sum(np.diff((flags & usable).astype(int), prepend=0) > 0))
        usable &= ~flags
    edges = np.flatnonzero(np.diff(np.concatenate([[0], usable.astype(int), [0]])))
    spans = [_span(wheels, first, last, config) for begin, end in zip(edges[::2], edges[1::2])
             for first, last in _split(wheels, begin, end, config)]
    counts["shorter than a piece must be"] = sum(span is None for span in spans)
    return _Cut(wheels, [span for span in spans if span is not None], counts, config)


def _split(wheels, begin, end, config):
    """Where the servo wanders, the way gets long, or the car turns round."""
    servo, way, speed = (column[begin:end].tolist() for column in (wheels.servo, wheels.way_m, wheels.speed_mps))
    first, low, high = 0, servo[0], servo[0]
    for index, duty in enumerate(servo):
        low, high = min(low, duty), max(high, duty)
        too_long = abs(way[index] - way[first]) > config.longest_m
        if high - low > config.wander_duty or too_long or speed[index] * speed[first] < 0:
            yield begin + first, begin + index
            first, low, high = index, duty, duty
    yield begin + first, end


def _span(wheels, first, last, config):
    """The slope of heading over way; ``None``: too short."""
    if last - first < max(3, config.shortest_s / wheels.STEP_S):
        return None
    samples = np.arange(first, last)
    length = wheels.way_m[last - 1] - wheels.way_m[first]
    if abs(length) < config.shortest_m:
        return None
    if length < 0:
        samples = samples[::-1]
    way = wheels.way_m[samples]
    # Evenly by way, so that where the car was slow doesn't count for more.
    at = np.linspace(way[0], way[-1], SLOPE_POINTS)
    off = at - at.mean()
    curvature = float(off @ np.interp(at, way, wheels.yaw_rad[samples]) / (off @ off))
    length = abs(length)
    independent = max(2.0, min(SLOPE_POINTS, length / INDEPENDENT_M))
    sigma = math.hypot(config.heading_sigma_rad * math.sqrt(12 / independent) / length, config.slack_per_m)
    return _Span(samples, way, (at[1:] + at[:-1]) / 2, (wheels.t_s[first] + wheels.t_s[last - 1]) / 2, curvature, sigma,
                 length)


class _Smooth:
    """An integrated random walk through pieces, its strength the likeliest; robust.

    Attributes:
        curvatures: at the knots.
        weight: of each piece, 0..1: 0 doesn't belong.
        scatter: of the pieces, in their own standard errors.
    """

    # Variance of a second difference of the curve from knot to knot, (1/m)².
    STRENGTHS = np.exp(np.linspace(math.log(1e-13), math.log(1e-3), 30))
    SMOOTHING, ROBUST = 3, 4  # passes without and with doubt in pieces
    TUKEY = 5.0
    WIDEST_SPAN = 1e-8
    AROUND = 13  # knots by which the strength is smoothed

    def __init__(self, pieces, adapts=True):
        self._h, self._y, self._stated = pieces.weights, pieces.curvature_per_m, pieces.sigma_per_m
        knots = self._h.shape[1]
        self._second = sparse.diags([1.0, -2.0, 1.0], [0, 1, 2], shape=(knots - 2, knots), format="csr")
        self.weight = np.where(_contradicted(pieces.duty, self._y, self._stated), 0.0, 1.0)
        self.scatter = 1.0
        self._sigma = self._stated
        local = np.ones(knots - 2)
        for step in range(self.SMOOTHING + self.ROBUST):
            self._solve(local)
            self._sigma = np.hypot(self._stated, DUTY_SIGMA * np.abs(self._h @ np.gradient(self.curvatures, KNOT)))
            off = np.abs(self._y - self._h @ self.curvatures) / self._sigma
            self.scatter = max(1.0, 1.4826 * float(np.median(off)))
            if step >= self.SMOOTHING:
                self.weight = (1 - np.minimum(off / (self.scatter * self.TUKEY), 1.0) ** 2) ** 2
            if adapts:
                local = self._local()
        self._solve(local)

    def cost(self, weights, _duties):
        """Of other observations of the same pieces: twice their negative log likelihood, but for a constant."""
        normal, right = self._normal_equations(weights)
        return self._cost(_banded(normal + self._penalty), right)[0]

    def standard_errors(self):
        """At the knots."""
        inverse = cho_solve_banded((self._factor, True), np.eye(self._factor.shape[1]))
        return np.sqrt(np.maximum(np.diag(inverse), 0.0))

    def monotone(self, sigmas):
        """The curve, never falling (or rising, as the pieces do): the nearest one, by the standard errors."""
        places = self._h @ np.arange(self._h.shape[1])
        sign = 1.0 if np.polyfit(places, self._y, 1)[0] > 0 else -1.0
        return sign * rising(sign * self.curvatures, 1 / np.maximum(sigmas, 1e-9) ** 2)

    def _local(self):
        """The strength differs along the duty: great where the curve bends, as at a stop, small where it doesn't."""
        bend = (self._second @ self.curvatures) ** 2
        kernel = np.hanning(self.AROUND + 2)[1:-1]
        smoothed = np.convolve(np.pad(bend, self.AROUND // 2, "edge"), kernel / kernel.sum(), "valid")
        smoothed = smoothed + 0.1 * np.median(smoothed) + 1e-18
        # Beyond such a span of strengths the equations can't be solved in floating point.
        smoothed = np.maximum(smoothed, smoothed.max() * self.WIDEST_SPAN)
        return smoothed / np.exp(np.mean(np.log(smoothed)))

    def _solve(self, local):
        penalty = self._second.T @ sparse.diags(1 / local) @ self._second
        normal, right = self._normal_equations(self._h)
        # Bands of both, as wide as the wider.
        both = _banded(normal + penalty)
        normal_band = _banded(normal, len(both))
        penalty_band = both - normal_band
        rank = self._second.shape[0]
        best = (math.inf, 1.0, None, None)
        for strength in self.STRENGTHS:
            cost, curvatures, factor = self._cost(normal_band + penalty_band / strength, right)
            cost += rank * math.log(strength)
            if cost < best[0]:
                best = cost, strength, curvatures, factor
        if best[2] is None:
            raise NothingToFit("no curve through the places where the steering was held can be computed: drive more of "
                               "them")
        _, strength, self.curvatures, self._factor = best
        self._penalty = penalty / strength

    def _normal_equations(self, h):
        weighted = h.multiply((self.weight / (self.scatter * self._sigma) ** 2)[:, None]).tocsr()
        return weighted.T @ h, weighted.T @ self._y

    def _cost(self, band, right):
        """(restricted likelihood but for constants, curve, factor) of normal equations in band form."""
        try:
            factor = cholesky_banded(band, lower=True)
        except np.linalg.LinAlgError:
            return math.inf, None, None
        curvatures = cho_solve_banded((factor, True), right)
        squares = (self.weight / (self.scatter * self._sigma) ** 2) @ self._y ** 2
        return float(2 * np.sum(np.log(factor[0])) + squares - right @ curvatures), curvatures, factor


def _contradicted(duty, curvature, sigma):
    """Which pieces no monotone curve can have beside most of their neighbours on one side."""
    order = np.argsort(duty, kind="stable")
    y, slack = curvature[order], 4 * sigma[order] + CONTRADICTION_PER_M
    if np.median(np.sign(y[len(y) // 2:])) > np.median(np.sign(y[:len(y) // 2])):
        y = -y  # falling with the duty from here on
    contradictions = np.zeros((2, len(y)), int)
    for apart in range(1, NEIGHBOURS + 1):
        rises = y[apart:] - y[:-apart] > np.maximum(slack[apart:], slack[:-apart])
        contradictions[0, apart:] += rises
        contradictions[1, :-apart] += rises
    found = np.zeros(len(y), bool)
    found[order] = contradictions.max(axis=0) > NEIGHBOURS / 2
    return found


def rising(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """The nearest sequence in weighted least squares that never falls: neighbours that fall are pooled."""
    pools: list = []  # (mean, weight, how many), means rising
    for value, weight in zip(np.asarray(values).tolist(), np.asarray(weights).tolist()):
        pool = (value, weight, 1)
        while pools and pools[-1][0] >= pool[0]:
            mean, before, count = pools.pop()
            total = before + pool[1]
            pool = ((mean * before + pool[0] * pool[1]) / total, total, count + pool[2])
        pools.append(pool)
    return np.repeat([mean for mean, _, _ in pools], [count for _, _, count in pools])


def _banded(matrix, height=None):
    matrix = matrix.tocoo()
    below = matrix.row - matrix.col
    dense = np.zeros((height or int(below.max()) + 1, matrix.shape[0]))
    lower = below >= 0
    np.add.at(dense, (below[lower], matrix.col[lower]), matrix.data[lower])
    return dense


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
    is_level = curvature >= tightest * (1 - config.stop_share) - min(2 * sigma[-1], 2 * config.stop_share * tightest)
    begin = len(is_level) - int(np.argmin(is_level[::-1])) if not is_level.all() else 0
    begin_duty = _corner(duty, curvature, tightest, begin)
    is_stop = (farthest - duty[begin]) * towards >= config.stop_duty and tightest > 5 * sigma[-1]
    is_end = is_stop or any((farthest - limit) * towards >= -COUNT for limit in config.limits
                            if (limit - np.mean(knots)) * towards > 0)
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
    slope = _slope(knots, rising, center)
    return center, float(np.interp(center, knots, sigmas) / max(slope, 1e-9))


def _slope(knots, curvatures, duty):
    """Of the curve around a duty, over two counts to each side."""
    low, high = max(knots[0], duty - 2 * COUNT), min(knots[-1], duty + 2 * COUNT)
    return abs(float(np.interp(high, knots, curvatures) - np.interp(low, knots, curvatures))) / max(high - low, 1.0)


def axis(curve: Curve) -> list[float]:
    """Radii between which straight lines cost little, from the tightest that was driven on."""
    tightest = 1 / max(curve.left.curvature_per_m, curve.right.curvature_per_m)
    radius, radii = math.floor(tightest * 100) / 100, []
    while radius < 5:
        radii.append(round(radius, 2))
        radius *= 1.08 if radius < 2 else 1.12
    return [*radii, 5.0, 6.0, 7.0, 8.0, 10.0, 12.0, 15.0, 20.0, 30.0, 50.0, 100.0, 300.0]


def breakpoints(curve: Curve, radii_m: Sequence[float], side: str, config: FitConfig = FitConfig()) -> list[Breakpoint]:
    """The duties for radii on one side, and what they rest on."""
    sign = 1.0 if side == LEFT else -1.0
    end = curve.left if side == LEFT else curve.right
    outwards = 1.0 if (end.duty - curve.duties.mean()) > 0 else -1.0
    driven, ways = sign * curve.pieces.curvature_per_m[curve.kept], curve.pieces.way_m[curve.kept]
    found = []
    for radius in radii_m:
        k = 1.0 / radius
        duty = float(curve.duty(sign * k))
        duty = min(duty, end.duty) if outwards > 0 else max(duty, end.duty)
        # Only counts can be held: how far it's known what lies between two of them doesn't matter.
        count = round(duty / COUNT) * COUNT
        sigma = float(np.interp(count, curve.duties, curve.sigmas))
        before, behind = curve.curvature(np.array([count - COUNT, count + COUNT]))
        near = np.abs(driven - k) <= max(NEAR_SHARE * k, config.known_per_m)
        is_known = BAND * sigma <= max(config.known_share * k, config.known_per_m, abs(behind - before) / 4)
        if k >= end.curvature_per_m * (1 - config.stop_share):
            duty, source = end.duty, END if end.is_end and is_known else UNKNOWN
        else:
            source = DRIVEN if is_known and driven.size and driven.min() <= k <= driven.max() else UNKNOWN
        slope = _slope(curve.duties, curve.curvatures, duty)
        found.append(Breakpoint(float(radius), duty, sigma / max(slope, 1e-9), sigma / k ** 2, int(near.sum()),
                                float(ways[near].sum()), source))
    return found


def completed(points: Sequence[Breakpoint], center: float, old: Sequence[float]) -> list[Breakpoint]:
    """Breakpoints of one side with old duties where nothing was driven.

    Args:
        points: with rising radii.
        center: the duty that goes straight.
        old: a duty for each point. One that doesn't fit between those that were driven gives way to the nearest that
            does, so that from radius to radius duties go to the center and never back.
    """
    driven = [point.duty for point in points if point.source != UNKNOWN]
    towards = math.copysign(1.0, np.mean(driven or old) - center)
    heights = [towards * ((duty if point.source == UNKNOWN else point.duty) - center)
               for point, duty in zip(points, old)]
    is_old = [point.source == UNKNOWN for point in points]
    made, most = [], math.inf
    for index, point in enumerate(points):
        least = max((height for height, doubted in zip(heights[index:], is_old[index:]) if not doubted), default=0.0)
        most = min(most, max(heights[index], least, 0.0) if is_old[index] else max(heights[index], 0.0))
        made.append(point._replace(duty=center + towards * most, source=OLD if is_old[index] else point.source))
    return made
