"""Drives in pieces of way in which the wheels hardly moved: what a steering's curve is found from.

Where the wheels are in the servo's travel follows from the commands: a delay, a lag, and the linkage's play. A piece in
which the servo had arrived is one observation: the slope of heading over way, in least squares. Its error falls with
the way to the power of 1.5: pieces are as long as they can be.
"""
from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, Sequence

import numpy as np
from scipy import sparse

from car_interface.calibration import delay as delays
from car_interface.calibration.delay import Delay

COUNT = 16.0  # duty of one count of the servo board: it can't stand in between
SLOPE_POINTS = 26  # of a piece, by which its slope is taken
# A slope in least squares is a mean of the curvature along the piece, with the weight of a parabola.
SHARES = (lambda x: x * (1 - x) / np.sum(x * (1 - x)))((np.arange(SLOPE_POINTS - 1) + 0.5) / (SLOPE_POINTS - 1))
INDEPENDENT_M = 0.15  # headings so far apart have errors of their own
KNOT = COUNT / 2  # of the curve, from one to the next
AFTER_GAP_S = 1.0  # what the servo does so soon after a gap comes of commands that nobody heard
CROSSED_DUTY = 40.0  # a servo that moved so far has crossed any usual play
DUTY_SIGMA = 1.0  # how well it's known where the wheels were, in duty, when the linkage lies at one side of its play
LAG_SIGMA_S = 0.015  # of the servo's: when the linkage floats in its play it's the lag that says where
FORGOTTEN_LAGS = 5.0  # after so many it's known where the servo is, wherever it came from
MAX_BACKLASH_DUTY = 80.0


@dataclass(frozen=True)
class FitConfig:
    """What counts, and how much.

    Attributes:
        slowest_mps: slower, heading changes are too few to tell.
        max_sideways_mps2: where tyres may begin to slide.
        settled_duty: the servo has arrived when it is so near to what was commanded, by delay and lag.
        wander_duty: the wheels may move by so much in a piece.
        shortest_m, max_m, shortest_s: of a piece.
        gap_s: between samples of odometry, from which on they don't belong together.
        jump_rad: of the heading between two samples that no car makes.
        heading_sigma_rad: of odometry's heading.
        slack_per_m: what no piece is more exact than: floors and tyres.
        delay: of the servo; ``None`` = estimated.
        backlash_duty: of the linkage; ``None`` = estimated.
        max_backlash_duty: what is tried.
        known_ratio, known_per_m: a breakpoint is supported when the band around its curvature is at most so wide to
            each side, as a share of it or absolutely, beyond half of what the board's next count would change.
        stop_duty: a stop is one when the curve stays level for so long.
        stop_ratio: level is what is so near to the tightest.
        limits: duties beyond which nobody means to steer.
    """

    slowest_mps: float = 0.25
    max_sideways_mps2: float = 4.0
    settled_duty: float = 6.0
    wander_duty: float = 24.0
    shortest_m: float = 0.5
    max_m: float = 8.0
    shortest_s: float = 0.3
    gap_s: float = 0.3
    jump_rad: float = 0.5
    heading_sigma_rad: float = 0.008
    slack_per_m: float = 0.001
    delay: Delay | None = None
    backlash_duty: float | None = None
    max_backlash_duty: float = MAX_BACKLASH_DUTY
    known_ratio: float = 0.08
    known_per_m: float = 0.01
    stop_duty: float = 40.0
    stop_ratio: float = 0.007
    limits: tuple = ()


DEFAULTS = FitConfig()


class Drive(NamedTuple):
    """One recording; the drives of a calibration are all of one car with nothing changed in between."""

    t_s: np.ndarray  # rising
    distance_m: np.ndarray  # signed, backward negative, from anywhere
    yaw_rad: np.ndarray  # unwrapped
    duty_t_s: np.ndarray
    duty: np.ndarray  # of the steering channel, each until the next one; what is no pulse is NaN


class Pieces(NamedTuple):
    """Pieces of way, a row each."""

    t_s: np.ndarray  # their middle
    curvature_per_m: np.ndarray
    sigma_per_m: np.ndarray
    duty: np.ndarray  # where the wheels were, on average
    duty_sigma: np.ndarray
    distance_m: np.ndarray
    weights: sparse.csr_matrix  # of the knots: the curvature is weights @ curve


class NothingToFit(ValueError):
    """Drives that tell nothing of a steering, and why."""


def servo_delay(drives, config):
    """The servo's, of all drives together, one behind the other."""
    cause_s, cause, effect_s, effect, weight = [], [], [], [], []
    begin_s = 0.0
    for drive in drives:
        shift_s = begin_s - drive.t_s[0]
        t_s = np.arange(drive.t_s[0], drive.t_s[-1], delays.STEP_S)
        distance_m, yaw_rad = np.interp(t_s, drive.t_s, drive.distance_m), np.interp(t_s, drive.t_s, drive.yaw_rad)
        half = 3
        if len(t_s) <= 2 * half:
            continue
        step_m, turned = distance_m[2 * half:] - distance_m[:-2 * half], yaw_rad[2 * half:] - yaw_rad[:-2 * half]
        at_s = t_s[half:-half]
        is_fine = np.abs(step_m) > config.slowest_mps * 2 * half * delays.STEP_S
        is_fine &= _since_gap(drive.t_s, at_s, config.gap_s) > AFTER_GAP_S
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


class Wheels:
    """Where one drive's wheels were, on an even scale of time.

    What the servo did before the recording began, and in its gaps, nobody knows: it is known again when a duty was
    recorded and the servo had time to follow, and where in its play the linkage is when it has moved far enough.
    """

    STEP_S = 0.02

    def __init__(self, drive, delay, gap_s):
        self.t_s = np.arange(drive.t_s[0], drive.t_s[-1], self.STEP_S)
        self.distance_m = np.interp(self.t_s, drive.t_s, drive.distance_m)
        self.yaw_rad = np.interp(self.t_s, drive.t_s, drive.yaw_rad)
        self.speed_mps = np.gradient(self.distance_m, self.STEP_S)
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
        # Nobody knows from where it came: from the other end 5 % of the way would be too much to be off.
        settled_s = heard_s + delay.delay_s + FORGOTTEN_LAGS * delay.lag_s
        settled = begin + int(np.searchsorted(self.t_s[begin:end], settled_s))
        self.is_known[begin:settled] = False
        if settled < end:
            servo = self.servo[settled:end]
            moved = np.maximum.accumulate(servo) - np.minimum.accumulate(servo)
            self.is_known[settled:end] &= moved >= CROSSED_DUTY

    def linkage(self, backlash_duty):
        """Where the wheels are, with play: they follow when the servo has crossed it."""
        if backlash_duty <= 0:
            return self.servo
        half, now, out = backlash_duty / 2, float(self.servo[0]), np.empty(len(self.servo))
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


def _since_gap(t_s, at_s, gap_s):
    """How long ago the last gap between samples ended, at each moment; 0 in one."""
    begins = np.flatnonzero(np.diff(t_s) >= gap_s)
    last = np.searchsorted(t_s[begins], at_s, side="right") - 1
    ends_s = np.append(t_s[begins + 1], -math.inf)  # of the last one; −1: there was none
    return np.maximum(at_s - ends_s[last], 0.0)


class Span(NamedTuple):
    """A piece of way before it's known where the wheels were on it."""

    samples: np.ndarray  # indices, in the order of the way
    distance_m: np.ndarray  # there, rising
    middles_m: np.ndarray  # where the duty counts
    middle_s: float
    curvature: float
    sigma: float
    length_m: float


class Cut(NamedTuple):
    """One drive in pieces."""

    wheels: Wheels
    otherwise: list  # where they would have been with other lags
    spans: list
    counts: dict  # stretches left out, by reason
    config: FitConfig


def cut_up(drive: Drive, delay: Delay, config: FitConfig) -> Cut:
    """One drive in pieces."""
    return _cut(Wheels(drive, delay, config.gap_s), _otherwise(drive, delay, config), config)


def _otherwise(drive, delay, config):
    return [Wheels(drive, delay._replace(lag_s=max(0.0, delay.lag_s + off_s)), config.gap_s)
            for off_s in (-LAG_SIGMA_S, LAG_SIGMA_S)]


def _cut(wheels, otherwise, config):
    is_slow = np.abs(wheels.speed_mps) < config.slowest_mps
    turning = np.convolve(np.gradient(wheels.yaw_rad, wheels.STEP_S), np.full(9, 1 / 9), "same")
    slides = np.abs(wheels.speed_mps * turning) > config.max_sideways_mps2
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
    return Cut(wheels, otherwise, [span for span in spans if span is not None], counts, config)


def _split(wheels, begin, end, config):
    """Where the servo wanders, the way gets long, or the car turns round."""
    servo, way, speed = (column[begin:end].tolist() for column in (wheels.servo, wheels.distance_m, wheels.speed_mps))
    first, low, high = 0, servo[0], servo[0]
    for index, duty in enumerate(servo):
        low, high = min(low, duty), max(high, duty)
        too_long = abs(way[index] - way[first]) > config.max_m
        if high - low > config.wander_duty or too_long or speed[index] * speed[first] < 0:
            yield begin + first, begin + index
            first, low, high = index, duty, duty
    yield begin + first, end


def _span(wheels, first, last, config):
    """The slope of heading over way; ``None``: too short."""
    if last - first < max(3, config.shortest_s / wheels.STEP_S):
        return None
    samples = np.arange(first, last)
    length = wheels.distance_m[last - 1] - wheels.distance_m[first]
    if abs(length) < config.shortest_m:
        return None
    if length < 0:
        samples = samples[::-1]
    way = wheels.distance_m[samples]
    # Evenly by way, so that where the car was slow doesn't count for more.
    at = np.linspace(way[0], way[-1], SLOPE_POINTS)
    off = at - at.mean()
    curvature = float(off @ np.interp(at, way, wheels.yaw_rad[samples]) / (off @ off))
    length = abs(length)
    independent = max(2.0, min(SLOPE_POINTS, length / INDEPENDENT_M))
    sigma = math.hypot(config.heading_sigma_rad * math.sqrt(12 / independent) / length, config.slack_per_m)
    return Span(samples, way, (at[1:] + at[:-1]) / 2, (wheels.t_s[first] + wheels.t_s[last - 1]) / 2, curvature, sigma,
                 length)


def pieces(cuts: Sequence[Cut], backlash_duty: float) -> tuple[Pieces, dict]:
    """All drives' pieces, the wheels being where a linkage of this play has them; what was left out, by reason."""
    spans = [span for cut in cuts for span in cut.spans]
    weights, duties = observations(cuts, backlash_duty)
    middle_s, curvature, sigma, length = (np.array([getattr(span, name) for span in spans])
                                          for name in ("middle_s", "curvature", "sigma", "length_m"))
    counts: dict = {}
    for cut in cuts:
        for reason, count in cut.counts.items():
            counts[reason] = counts.get(reason, 0) + count
    sigmas = _duty_sigmas(cuts, backlash_duty, duties)
    return Pieces(middle_s, curvature, sigma, duties, sigmas, length, weights), counts


def _duty_sigmas(cuts, backlash_duty, duties):
    """How well it's known where the wheels were on each piece: elsewhere, had the servo another lag."""
    others = [np.concatenate([_wheel_duties(cut, cut.otherwise[index].linkage(backlash_duty)) for cut in cuts])
              for index in range(len(cuts[0].otherwise))]
    off = np.max([np.abs(other @ SHARES - duties) for other in others], axis=0) if others else 0.0
    return np.hypot(DUTY_SIGMA, off)


def _wheel_duties(cut, linkage):
    """A row for each piece of a drive, along its way."""
    rows = [np.interp(span.middles_m, span.distance_m, linkage[span.samples]) for span in cut.spans]
    return np.array(rows).reshape(-1, SLOPE_POINTS - 1)


def knots_of(cuts):
    """The curve's knots, the same whatever the play."""
    spans = [(span, cut.wheels.servo) for cut in cuts for span in cut.spans]
    if not spans:
        raise NothingToFit("the car never held its steering for half a metre at speed")
    low = min(servo[span.samples].min() for span, servo in spans)
    high = max(servo[span.samples].max() for span, servo in spans)
    if len(spans) < 4 or high - low < 4 * COUNT:
        raise NothingToFit("the steering was held in fewer than four places")
    first, last = math.floor((low - MAX_BACKLASH_DUTY) / KNOT), math.ceil((high + MAX_BACKLASH_DUTY) / KNOT)
    return np.arange(first, last + 1) * KNOT


def observations(cuts, backlash_duty):
    """(how much of each knot is in each piece's curvature, where the wheels were on it on average)."""
    knots = knots_of(cuts)
    duties = np.concatenate([_wheel_duties(cut, cut.wheels.linkage(backlash_duty)) for cut in cuts])
    place = np.clip((duties - knots[0]) / KNOT, 0, len(knots) - 1.001)
    index = place.astype(int)
    share = place - index
    rows = np.tile(np.repeat(np.arange(len(duties)), duties.shape[1]), 2)
    weights = sparse.csr_matrix((np.concatenate([(SHARES * (1 - share)).ravel(), (SHARES * share).ravel()]),
                                 (rows, np.concatenate([index.ravel(), index.ravel() + 1]))),
                                shape=(len(duties), len(knots)))
    return weights, duties @ SHARES
