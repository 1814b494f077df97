"""Divides drives into segments in which the wheels hardly moved: each is one observation of the steering curve.

The curvature of a segment is the slope of heading over distance, in least squares. Its error falls with the distance to
the power of 1.5, so that segments are as long as they can be.
"""
from __future__ import annotations

import math
from collections import Counter
from typing import NamedTuple, Sequence

import numpy as np
from scipy import sparse

from car_interface.tools.calibration.shared import NothingToFit, runs
from car_interface.tools.calibration.steering.drive import (
    COUNT,
    KNOT,
    MAX_BACKLASH_DUTY,
    MIN_SPEED_MPS,
    STEP_S,
    Delay,
    SteeringDrive,
    WheelPosition,
)

MAX_LATERAL_MPS2 = 4.0  # above this tyres may begin to slide
SETTLED_DUTY = 6.0  # the servo has arrived when it is this near to its command, by delay and lag
MAX_WANDER_DUTY = 24.0  # how far the wheels may move within a segment
MIN_LENGTH_M, MAX_LENGTH_M, MIN_DURATION_S = 0.5, 8.0, 0.3  # of a segment
# Standard errors of odometry's heading: at most the second; where a drive shows that it is better, that counts.
MIN_HEADING_SIGMA_RAD, HEADING_SIGMA_RAD = 0.003, 0.008
MIN_SIGMA_PER_M = 0.001  # no segment's curvature is known better: floors are uneven, tyres flex
SLOPE_POINTS = 26  # of a segment, from which its slope is taken
# A slope in least squares is a mean of the curvature along the segment with the weights of a parabola, (25,).
SLOPE_WEIGHTS = (lambda x: x * (1 - x) / np.sum(x * (1 - x)))(
    (np.arange(SLOPE_POINTS - 1) + 0.5) / (SLOPE_POINTS - 1))
INDEPENDENT_M = 0.15  # headings this far apart have independent errors
DUTY_SIGMA = 1.0  # of the wheels' position, in duty, when the linkage lies at one side of its backlash
LAG_SIGMA_S = 0.015  # of the servo's lag, by which the position is known when the linkage floats in its backlash
MIN_SEGMENTS, MIN_COUNTS = 4, 4
MOST_PERCENT = 90  # of the segments: as far as the heading is off their slopes in so many, so uncertain is it


class Segment(NamedTuple):
    """A segment of K samples, whatever the backlash."""

    samples: np.ndarray  # (K,), indices into the drive, in the order of rising distance
    distance_m: np.ndarray  # (K,), rising
    middles_m: np.ndarray  # (25,), distances at which the duty is averaged with SLOPE_WEIGHTS
    curvature_per_m: float
    length_m: float
    speed_mps: float  # the mean of its fourth power, as turns widen by that
    wander_rad: float  # how far the heading is off its slope, root mean square
    sigma_per_m: float = math.nan  # by the whole drive's heading


class Observations(NamedTuple):
    """The segments of all drives for one backlash, S rows; the curve has K knots."""

    curvature_per_m: np.ndarray  # (S,)
    sigma_per_m: np.ndarray  # (S,), standard error of that
    duty: np.ndarray  # (S,), mean position of the wheels
    duty_sigma: np.ndarray  # (S,), standard error of that
    distance_m: np.ndarray  # (S,), length
    speed_mps: np.ndarray  # (S,), without its sign
    weights: sparse.csr_matrix  # (S, K): the curvatures are weights @ curve

    def those(self, which: np.ndarray) -> Observations:
        """Return some of them, by a flag for each, (S,)."""
        return Observations(*(column[which] for column in self))


class Segments:
    """The segments of all drives, one drive after the other: the rows of all arrays (S,).

    Attributes:
        knots: the curve's, in duty, the same for each backlash, (K,).
        counts: how many intervals were left out, by reason; none without one.
        is_steady: no drive shows where the linkage is in its backlash.

    Raises:
        NothingToFit: there are too few segments, or they are all at nearly the same duty.
    """

    def __init__(self, drives: Sequence[SteeringDrive], delay: Delay):
        self._drives = []  # the segments of each, and where its wheels were, also if the servo's lag were another one
        self.counts: Counter = Counter()
        for drive in drives:
            wheels = [WheelPosition(drive, delay._replace(lag_s=max(0.0, delay.lag_s + off_s)))
                      for off_s in (0.0, -LAG_SIGMA_S, LAG_SIGMA_S)]
            segments, counts = _segments(wheels[0])
            self._drives.append((segments, wheels))
            self.counts += counts
        self.is_steady = all(wheels[0].is_steady for _, wheels in self._drives)
        servo = [wheels[0].servo[segment.samples] for segments, wheels in self._drives for segment in segments]
        if not servo:
            left_out = ", ".join(f"{count} {reason}" for reason, count in self.counts.items())
            raise NothingToFit("the car never held its steering for half a metre at speed"
                               + (f"; intervals that don't count: {left_out}" if left_out else ""))
        low, high = min(duties.min() for duties in servo), max(duties.max() for duties in servo)
        if len(servo) < MIN_SEGMENTS or high - low < MIN_COUNTS * COUNT:
            raise NothingToFit("the steering was held in fewer than four places")
        first, last = math.floor((low - MAX_BACKLASH_DUTY) / KNOT), math.ceil((high + MAX_BACKLASH_DUTY) / KNOT)
        self.knots = np.arange(first, last + 1) * KNOT

    def column(self, name: str) -> np.ndarray:
        """Return a number of each segment, (S,)."""
        return np.array([getattr(segment, name) for segments, _ in self._drives for segment in segments])

    def observations(self, backlash_duty: float) -> Observations:
        """Return all of them, the wheels being where a linkage with this backlash has them."""
        weights, duty = self.design(backlash_duty)
        curvature, sigma, length, speed = map(self.column, ("curvature_per_m", "sigma_per_m", "length_m", "speed_mps"))
        # Where they would be if the servo had another lag.
        off = np.max([np.abs(self._duties(backlash_duty, other) @ SLOPE_WEIGHTS - duty) for other in (1, 2)], axis=0)
        # In a steady drive the linkage is anywhere in its backlash, as likely here as there.
        floats = np.repeat([float(wheels[0].is_steady) for _, wheels in self._drives],
                           [len(segments) for segments, _ in self._drives])
        duty_sigma = np.hypot(np.hypot(DUTY_SIGMA, off), floats * backlash_duty / math.sqrt(12))
        return Observations(curvature, sigma, duty, duty_sigma, length, speed, weights)

    def design(self, backlash_duty: float) -> tuple[sparse.csr_matrix, np.ndarray]:
        """Return the knots' weights in each segment's curvature (S, K), and the wheels' mean positions in duty (S,)."""
        duties = self._duties(backlash_duty)
        place = np.clip((duties - self.knots[0]) / KNOT, 0, len(self.knots) - 1.001)
        index = place.astype(int)
        ratio = place - index
        rows = np.tile(np.repeat(np.arange(len(duties)), duties.shape[1]), 2)
        weights = sparse.csr_matrix(
            (np.concatenate([(SLOPE_WEIGHTS * (1 - ratio)).ravel(), (SLOPE_WEIGHTS * ratio).ravel()]),
             (rows, np.concatenate([index.ravel(), index.ravel() + 1]))), shape=(len(duties), len(self.knots)))
        return weights, duties @ SLOPE_WEIGHTS

    def _duties(self, backlash_duty, lag=0):
        """Return the wheels' positions along each segment (S, 25)."""
        found = []
        for segments, wheels in self._drives:
            linkage = wheels[lag].linkage(backlash_duty)
            found += [np.interp(segment.middles_m, segment.distance_m, linkage[segment.samples])
                      for segment in segments]
        return np.array(found)


def _segments(wheels):
    """Return (one drive's segments, how many intervals were left out, by reason)."""
    usable, counts = _usable(wheels)
    segments = [_segment(wheels, first, end) for begin, stop in runs(usable)
                for first, end in _split(wheels, begin, stop)]
    counts["shorter than a segment must be"] = sum(segment is None for segment in segments)
    found, heading_sigma_rad = [segment for segment in segments if segment is not None], HEADING_SIGMA_RAD
    if len(found) >= MIN_SEGMENTS:
        seen_rad = np.percentile([segment.wander_rad for segment in found], MOST_PERCENT)
        heading_sigma_rad = float(np.clip(seen_rad, MIN_HEADING_SIGMA_RAD, HEADING_SIGMA_RAD))
    return [one._replace(sigma_per_m=_slope_sigma_per_m(one.length_m, heading_sigma_rad)) for one in found], counts


def _slope_sigma_per_m(length_m, heading_sigma_rad):
    """Return the standard error of a slope of the heading over a way of that length, in 1/m."""
    independent = max(2.0, min(SLOPE_POINTS, length_m / INDEPENDENT_M))
    return math.hypot(heading_sigma_rad * math.sqrt(12 / independent) / length_m, MIN_SIGMA_PER_M)


def _usable(wheels):
    """Return (which samples can be in a segment (N,), how many intervals can't by reason)."""
    is_slow = np.abs(wheels.speed_mps) < MIN_SPEED_MPS
    yaw_rate_radps = np.convolve(np.gradient(wheels.yaw_rad, STEP_S), np.full(9, 1 / 9), "same")
    slides = np.abs(wheels.speed_mps * yaw_rate_radps) > MAX_LATERAL_MPS2
    usable, counts = np.ones(len(is_slow), bool), Counter()
    for reason, flags in (("slow or standing", is_slow), ("gaps in odometry or duty", ~wheels.is_known),
                          ("fast in a bend: tyres may slide", slides),
                          ("servo on its way", wheels.off > SETTLED_DUTY)):
        counts[reason] = int(np.sum(np.diff((flags & usable).astype(int), prepend=0) > 0))
        usable &= ~flags
    return usable, counts


def _split(wheels, begin, end):
    """Split an interval where the servo wanders, the distance gets long, or the car changes its direction."""
    servo, distance_m, speed = (column[begin:end].tolist()
                                for column in (wheels.servo, wheels.distance_m, wheels.speed_mps))
    first, low, high = 0, servo[0], servo[0]
    for index, duty in enumerate(servo):
        low, high = min(low, duty), max(high, duty)
        too_long = abs(distance_m[index] - distance_m[first]) > MAX_LENGTH_M
        if high - low > MAX_WANDER_DUTY or too_long or speed[index] * speed[first] < 0:
            yield begin + first, begin + index
            first, low, high = index, duty, duty
    yield begin + first, end


def _segment(wheels, first, end):
    """Return the segment of the samples from ``first`` up to before ``end``; ``None``: too short."""
    length = wheels.distance_m[end - 1] - wheels.distance_m[first]
    if end - first < max(3, MIN_DURATION_S / STEP_S) or abs(length) < MIN_LENGTH_M:
        return None
    samples = np.arange(first, end)[::1 if length > 0 else -1]
    distance_m, length = wheels.distance_m[samples], abs(length)
    # Evenly by distance, so that where the car was slow doesn't count for more.
    at = np.linspace(distance_m[0], distance_m[-1], SLOPE_POINTS)
    off = at - at.mean()
    yaw_rad = np.interp(at, distance_m, wheels.yaw_rad[samples])
    curvature = float(off @ yaw_rad / (off @ off))
    beside_rad = yaw_rad - yaw_rad.mean() - off * curvature
    wander_rad = math.sqrt(float(beside_rad @ beside_rad) / (SLOPE_POINTS - 2))
    return Segment(samples, distance_m, (at[1:] + at[:-1]) / 2, curvature, length,
                   float(np.mean(wheels.speed_mps[samples] ** 4)) ** 0.25, wander_rad)


def place_numbers(duty: np.ndarray) -> np.ndarray:
    """Return the number of each duty's place, rising with the duties: (S,). Within half a count they are one place."""
    numbers, number, begin = np.zeros(len(duty), int), -1, -math.inf
    for index in np.argsort(duty, kind="stable"):
        if duty[index] > begin + COUNT / 2:
            number, begin = number + 1, duty[index]
        numbers[index] = number
    return numbers
