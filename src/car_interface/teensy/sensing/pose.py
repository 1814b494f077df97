"""Estimates the car's heading, and integrates its pose and its covariance from distances and turns: dead reckoning.

With the heading off by e, a step of d is off by (exp(i e) − 1) d, as a complex number. A covariance that is linear in e
fails when the heading is off by 60°: there half of the way is lost, and a place that was off before is not led back by
a circle. For a normal e of variance v all second moments are known, from E exp(i e) = c = exp(−v / 2),
E exp(2 i e) = c⁴ and E e exp(i e) = i v c, and those of the sum of all steps follow from step to step.

Of a path for which no report came for a while only the counts of pulses are known. The wheels' counts go on while the
port is unplugged, and the reports before and after show:

- without a reversal: the length of the path and its change of heading, but not where on the way the car turned;
- with one: both of its legs likewise;
- with two or more: the last leg, and the sum of the pulses before it. Which of these were forward is unknown.

The likeliest legs are given, and the variances of what else the path can have been, within the bounds of a car and not
of single wheels: both have reversed together, and the heading changes by curvature × distance. Pure.
"""
from __future__ import annotations

import cmath
import math
from itertools import product
from typing import NamedTuple

CURVATURE_WANDER = 3.0  # (1/m)²/s: a servo goes from end to end in a fifth of a second
CURVATURE_VARIANCE = 0.5  # (1/m)², of an unknown curvature: 0.7 1/m, a car's tightest turns, is one sigma
RECENT_M = 0.3  # over which the noise of the curvature is averaged
CURVATURE_NOISE = 0.1  # 1/m: two sigma of the filter's on a straight (``drive`` of test_captures)
USUAL_M = 2.0  # of the last metres, whose curvatures are the usual ones; with 5 a long reboot leaves a third more open
HEADING_VARIANCE = 1e-6  # rad²: the smallest that is claimed, a sigma of 1 mrad
# The commanded curvature weighs as much as a measurement every half second with this ratio and offset as its error.
STEERING_S, STEERING_RATIO, STEERING_PER_M = 0.5, 0.3, 0.05
MAX_CURVATURE_CHANGE = 2.0  # 1/m, from end to end: ±1, a car's tightest turns
PARTS = 6  # of the even distribution: its variance to 3 %
USUAL_NODES = ((0.0, 4 / 9), (math.sqrt(0.6), 5 / 18), (-math.sqrt(0.6), 5 / 18))  # and weights: Gauss-Legendre
# With two reversals a part u of the length E was forward, curved by k, the rest backward, curved by m. u is uniform in
# 0 .. 1; k and m have CURVATURE_VARIANCE each, and c = u k + (1 − u) m is known: the difference of the wheels' counts.
# Over E the car has advanced by (2u − 1) E: a mean of 0, and a variance of E² / 3.
# The heading has changed by q E with q = u k − (1 − u) m. With w = 2u − 1, q has the mean 2 c w / (1 + w²) and the
# variance (1 − w²)² / (2 + 2 w²) · CURVATURE_VARIANCE. Averages over w: 0 and 4 c² (π/8 − 1/4), and (π − 8/3) / 2. Both
# go by w, so that w q averages 2 c (1 − π/4).
# Across, k u² / 2 − k u (1 − u) + m (1 − u)² / 2 times E² has the variance E⁴ / 12 · CURVATURE_VARIANCE.
ALONG, ACROSS = 1 / 3, 1 / 12
HEADING_BY_KNOWN, HEADING_BY_UNKNOWN, ALONG_BY_KNOWN = 0.571, 0.237, 0.429
# One reversal is the simplest explanation of a direction that has changed: w = 1. With three, E would be shorter by up
# to 2 E: that is three sigma, a variance of 4 E² / 9, and 1/3 of the mean square (2 E)² / 3 of all possible ones. Off
# from w = 1 instead of 0, each average of squares and products is that of their ends larger: (w − 1)² by 1.
SEVERAL = 1 / 3


class UnseenPath(NamedTuple):
    """What a car may have driven while nothing was reported."""

    leg: tuple[float, float] = (0.0, 0.0)  # distance (m) and turn (rad) of all but the last one
    along_variance: float = 0.0  # m², along the heading at its start
    across_variance: float = 0.0  # m², across it
    heading_variance: float = 0.0  # rad²
    both_covariance: float = 0.0  # m², of along and across
    heading_covariance: float = 0.0  # m rad, of along and heading


class HeadingFilter:
    """Estimates heading and curvature from the difference of the wheels' positions: heading = (right − left) / track.

    Over the distance between two pulses the curvature hardly changes, so a Kalman filter predicts heading and curvature
    by the distance, and is corrected by the wheels' difference at each pulse of one of them.
    """

    def __init__(self):
        self.yaw_rad = 0.0  # not wrapped, left positive
        self.curvature_per_m = 0.0  # 1 / turn radius, left positive
        self.recent_curvature = self._largest_square = 0.0  # the former: its mean over the last decimetres
        self._variances = (HEADING_VARIANCE, 0.0, CURVATURE_VARIANCE)

    @property
    def curvature_variance(self) -> float:
        """The variance of the curvature, (1/m)²."""
        return self._variances[2]

    @property
    def usual_square(self) -> float:
        """The square of the largest curvature on the last metres, 1/m²; without its noise."""
        return max(0.0, self._largest_square - CURVATURE_NOISE ** 2)

    def predict(self, distance_m: float, elapsed_s: float) -> None:
        """Predict: the car has rolled this distance within this time."""
        self.yaw_rad += self.curvature_per_m * distance_m
        if distance_m:
            rolled_m = abs(distance_m)
            self.recent_curvature += (self.curvature_per_m - self.recent_curvature) * min(1.0, rolled_m / RECENT_M)
            self._largest_square = max(self._largest_square * max(0.0, 1 - rolled_m / USUAL_M),
                                       self.recent_curvature ** 2)
        yy, yc, cc = self._variances
        yy += distance_m * (2 * yc + distance_m * cc)
        yc += distance_m * cc
        if distance_m:
            cc = min(cc + CURVATURE_WANDER * elapsed_s, 2 * CURVATURE_VARIANCE)
        self._variances = (yy, yc, cc)

    def begin(self, yaw_rad: float, variance: float, curvature_variance: float = CURVATURE_VARIANCE) -> None:
        """Set a heading that the wheels have measured; by default the curvature is unknown."""
        self.yaw_rad = yaw_rad
        self._variances = (variance, 0.0, curvature_variance)

    def update(self, yaw_rad: float, variance: float) -> None:
        """Correct by a heading that the wheels have measured."""
        self._correct(yaw_rad - self.yaw_rad, *self._variances[:2], self._variances[0] + variance)

    def update_curvature(self, curvature_per_m: float, elapsed_s: float) -> None:
        """Correct by the commanded curvature, weighted by the time since the last call."""
        if elapsed_s <= 0:
            return
        variance = (STEERING_RATIO * abs(curvature_per_m) + STEERING_PER_M) ** 2 * max(1.0, STEERING_S / elapsed_s)
        self._correct(curvature_per_m - self.curvature_per_m, *self._variances[1:], self._variances[2] + variance)

    def _correct(self, off, by_yaw, by_curvature, total):
        """Correct by a measurement: how far it is off, its covariances with heading and curvature, both variances."""
        yy, yc, cc = self._variances
        self.yaw_rad += by_yaw * (off / total)
        self.curvature_per_m += by_curvature * (off / total)
        self._variances = (yy - by_yaw * by_yaw / total, yc - by_yaw * by_curvature / total,
                           cc - by_curvature * by_curvature / total)


class Pose:
    """The pose of the middle of the rear axle, with its covariance; it begins at 0 (REP-103: x forward, y left).

    Args:
        distance_sigma: of the distance after a metre, m; it grows with the root of the distance.
        heading_sigma: of the heading after a metre, rad.
    """

    def __init__(self, distance_sigma: float, heading_sigma: float):
        self._distance_variance, self._heading_variance = distance_sigma ** 2, heading_sigma ** 2  # per metre
        self.x_m = self.y_m = self.yaw_rad = 0.0  # the yaw isn't wrapped
        self.distance_m = 0.0  # driven, forward and backward
        self._yaw_variance = 0.0  # v, of the heading's error e
        # Of the place's error p, x + i y: E p, E |p|², E p², E p e, and E p exp(±i e).
        self._mean, self._norm, self._square, self._by_yaw = 0j, 0.0, 0j, 0j
        self._turned, self._turned_back = 0j, 0j

    def add_variance(self, along_variance: float, heading_variance: float, across_variance: float = 0.0,
                     both_covariance: float = 0.0) -> None:
        """Add variance: m² along and across the heading and of both, rad² of the heading."""
        self._norm += along_variance + across_variance
        self._square += complex(along_variance - across_variance, 2 * both_covariance) * cmath.exp(2j * self.yaw_rad)
        self._yaw_variance += heading_variance
        shrink = math.exp(-heading_variance / 2)
        self._turned, self._turned_back = self._turned * shrink, self._turned_back * shrink

    def add_path(self, path: UnseenPath) -> None:
        """Add what is uncertain of a path that wasn't reported."""
        self.add_variance(path.along_variance, path.heading_variance, path.across_variance, path.both_covariance)
        step = cmath.rect(path.heading_covariance, self.yaw_rad)
        turned = step * 1j * math.exp(-self._yaw_variance / 2)
        self._by_yaw, self._turned, self._turned_back = (
            self._by_yaw + step, self._turned + turned, self._turned_back - turned)

    def move(self, distance_m: float, turned_rad: float) -> None:
        """Move along an arc: its chord is distance · sin(h) / h long, in the mean heading (h: half the turn)."""
        half_rad = turned_rad / 2
        chord_m = distance_m * (math.sin(half_rad) / half_rad if half_rad else 1.0)
        self.yaw_rad += half_rad
        step = cmath.rect(1.0, self.yaw_rad) * chord_m
        self.x_m += step.real
        self.y_m += step.imag
        self.distance_m += abs(distance_m)
        # The place's error grows by (exp(i e) − 1) · step.
        c = math.exp(-self._yaw_variance / 2)
        c4 = c ** 4
        self._norm += 2 * (step.conjugate() * (self._turned_back - self._mean)).real + (2 - 2 * c) * abs(step) ** 2
        self._square += 2 * step * (self._turned - self._mean) + step * step * (c4 - 2 * c + 1)
        self._mean += step * (c - 1)
        self._by_yaw += step * 1j * self._yaw_variance * c
        self._turned += step * (c4 - c)
        self._turned_back += step * (1 - c)
        self.add_variance(self._distance_variance * abs(distance_m), self._heading_variance * abs(distance_m))
        self.yaw_rad += half_rad

    def covariance(self, place_variance: float, heading_variance: float) -> tuple:
        """Return the 3×3 covariance of x, y, yaw, plus these variances: an error below a pulse doesn't accumulate."""
        xx, yy = (self._norm + self._square.real) / 2, (self._norm - self._square.real) / 2
        xy, xa, ya = self._square.imag / 2, self._by_yaw.real, self._by_yaw.imag
        return ((xx + place_variance, xy, xa), (xy, yy + place_variance, ya),
                (xa, ya, self._yaw_variance + heading_variance))


def curved_path(distance_m: float, turned_rad: float, curvature_per_m: float | None, usual_square: float) -> UnseenPath:
    """Return a path without a reversal, of known length S and change of heading.

    Its curvature changed from k to whatever gives the mean m, after a part of S that is evenly in 0 .. 1 − a: no
    curvature is more than ``MAX_CURVATURE_CHANGE`` from k, so that a = |m − k| / MAX_CURVATURE_CHANGE. Besides, it may
    have been steered to both sides as before: by ±c over half of S each, with c evenly up to the usual curvature. The
    path with the mean part is given, and the mean squares by which the ends of all of these are off its end.

    Args:
        curvature_per_m: at the beginning; ``None``: the car stood.
        usual_square: mean square of the curvature on the metres before, 1/m².
    """
    if not distance_m:
        return UnseenPath()
    change = 0.0 if curvature_per_m is None else turned_rad / distance_m - curvature_per_m
    leg, parts, middle = (0.0, 0.0), [0.0], 0.0
    if abs(change) > CURVATURE_NOISE:
        latest = 1 - min(1.0, abs(change) / MAX_CURVATURE_CHANGE)
        parts, middle = [latest * (index + 0.5) / PARTS for index in range(PARTS)], latest / 2
        leg = (distance_m * middle, curvature_per_m * distance_m * middle)
    elif not usual_square:
        return UnseenPath()
    guess = _end(distance_m, turned_rad, middle, curvature_per_m, 0.0)
    along = across = both = 0.0
    for part, (node, weight) in product(parts, USUAL_NODES):
        off = _end(distance_m, turned_rad, part, curvature_per_m, node * math.sqrt(usual_square)) - guess
        along += weight * off.real ** 2
        across += weight * off.imag ** 2
        both += weight * off.real * off.imag
    return UnseenPath(leg, along / len(parts), across / len(parts), both_covariance=both / len(parts))


def _end(distance_m, turned_rad, part, curvature_per_m, swing_per_m):
    """Return the end of a curved path, x + i y from its start and its heading there."""
    before_rad = (curvature_per_m or 0.0) * part * distance_m
    after_per_m = (turned_rad - before_rad) / (distance_m * (1 - part))
    end, yaw_rad, begin = 0j, 0.0, 0.0
    for until in sorted({part, 0.5, 1.0} - {0.0}):
        curvature = after_per_m if until > part else curvature_per_m
        turn_rad = (curvature + (swing_per_m if until <= 0.5 else -swing_per_m)) * (until - begin) * distance_m
        chord_m = (until - begin) * distance_m * (math.sin(turn_rad / 2) / (turn_rad / 2) if turn_rad else 1.0)
        end += cmath.rect(1.0, yaw_rad + turn_rad / 2) * chord_m
        yaw_rad, begin = yaw_rad + turn_rad, until
    return end


def reversed_path(unsplit_m: float, difference_rad: float, is_odd: bool) -> UnseenPath:
    """Return the path before the last reversal.

    Args:
        unsplit_m: its length, of the mean of both wheels; negative if it began backward.
        difference_rad: the right wheel's length less the left one's, as an angle.
        is_odd: the direction has changed. If it was one reversal, all of the path had the direction before.
    """
    square = unsplit_m ** 2
    part = SEVERAL if is_odd else 1.0
    return UnseenPath(
        (unsplit_m, difference_rad) if is_odd else (0.0, 0.0),
        along_variance=part * (ALONG + is_odd) * square,
        across_variance=part * ACROSS * square ** 2 * CURVATURE_VARIANCE,
        heading_variance=part * ((HEADING_BY_KNOWN + is_odd) * difference_rad ** 2
                                 + HEADING_BY_UNKNOWN * CURVATURE_VARIANCE * square),
        heading_covariance=part * (ALONG_BY_KNOWN + is_odd) * unsplit_m * difference_rad)
