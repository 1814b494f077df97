"""Integrates the car's pose and its covariance from distances and turns: dead reckoning.

With the heading off by e, a step of d is off by (exp(i e) − 1) d, as a complex number. A covariance that is linear in e
fails when the heading is off by 60°: there half of the way is lost, and a place that was off before is not led back by
a circle. For a normal e of variance v all second moments are known, from E exp(i e) = c = exp(−v / 2),
E exp(2 i e) = c⁴ and E e exp(i e) = i v c, and those of the sum of all steps follow from step to step. Pure.
"""
from __future__ import annotations

import cmath
import math

from car_interface.teensy.sensing.unseen_path import UnseenPath


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

    def set_yaw(self, yaw_rad: float, variance: float) -> None:
        """Set the heading, which has become known with this variance."""
        self.yaw_rad = yaw_rad
        self.add_variance(0.0, variance)

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
        chord_m = distance_m * (math.sin(half_rad) / half_rad if abs(half_rad) > 1e-6 else 1.0)
        self.yaw_rad += half_rad
        step = cmath.rect(1.0, self.yaw_rad) * chord_m
        self.x_m += step.real
        self.y_m += step.imag
        self.distance_m += abs(distance_m)
        self._add_step(step)
        self.add_variance(self._distance_variance * abs(distance_m), self._heading_variance * abs(distance_m))
        self.yaw_rad += half_rad

    def _add_step(self, step):
        """Add (exp(i e) − 1) · step to the place's error."""
        c = math.exp(-self._yaw_variance / 2)
        c4 = c ** 4
        self._norm += 2 * (step.conjugate() * (self._turned_back - self._mean)).real + (2 - 2 * c) * abs(step) ** 2
        self._square += 2 * step * (self._turned - self._mean) + step * step * (c4 - 2 * c + 1)
        self._mean += step * (c - 1)
        self._by_yaw += step * 1j * self._yaw_variance * c
        self._turned += step * (c4 - c)
        self._turned_back += step * (1 - c)

    def covariance(self, place_variance: float, heading_variance: float) -> tuple:
        """Return the 3×3 covariance of x, y, yaw, plus these variances: an error below a pulse doesn't accumulate."""
        xx, yy = (self._norm + self._square.real) / 2, (self._norm - self._square.real) / 2
        xy, xa, ya = self._square.imag / 2, self._by_yaw.real, self._by_yaw.imag
        return ((xx + place_variance, xy, xa), (xy, yy + place_variance, ya),
                (xa, ya, self._yaw_variance + heading_variance))
