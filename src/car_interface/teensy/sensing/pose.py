"""Integrates the car's pose and its covariance from distances and turns: dead reckoning.

With the heading off by e, a step of d is off by d sin(e) across it, and by d (cos(e) − 1) along it. The former is
taken as d e, a linear covariance; the latter is not linear, but a heading that is off by 60° takes away half of the
way. For a normal e its moments are known, and those of the sum of all steps follow from step to step. Pure.
"""
from __future__ import annotations

import math


class Pose:
    """The pose of the middle of the rear axle, with its covariance; it begins at 0 (REP-103: x forward, y left).

    Args:
        distance_sigma: of the distance after a metre, m; it grows with the root of the distance.
        heading_sigma: of the heading after a metre, rad.

    Attributes:
        x_m, y_m, yaw_rad: the pose; the yaw isn't wrapped.
        distance_m: driven, forward and backward.
    """

    def __init__(self, distance_sigma: float, heading_sigma: float):
        self._distance_variance, self._heading_variance = distance_sigma ** 2, heading_sigma ** 2  # per metre
        self.x_m = self.y_m = self.yaw_rad = self.distance_m = 0.0
        self._variances = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)  # xx, xy, xa, yy, ya, aa
        # Of the sum of all d (cos(e) − 1): its mean (x, y), mean square (xx, xy, yy), and mean product with cos(e) − 1.
        self._lost, self._lost_square, self._lost_product = (0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0)

    def set_yaw(self, yaw_rad: float, variance: float) -> None:
        """Set the heading, which has become known with this variance."""
        self.yaw_rad = yaw_rad
        self.add_variance(0.0, variance)

    def add_variance(self, along_variance: float, heading_variance: float, across_variance: float = 0.0) -> None:
        """Add variance: m² along and across the heading, rad² of the heading."""
        cos, sin = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        xx, xy, xa, yy, ya, aa = self._variances
        self._variances = (xx + along_variance * cos * cos + across_variance * sin * sin,
                           xy + (along_variance - across_variance) * cos * sin, xa,
                           yy + along_variance * sin * sin + across_variance * cos * cos, ya, aa + heading_variance)
        self._turn_lost(heading_variance)

    def move(self, distance_m: float, turned_rad: float) -> None:
        """Move along an arc: its chord is distance · sin(h) / h long, in the mean heading (h: half the turn)."""
        half_rad = turned_rad / 2
        chord_m = distance_m * (math.sin(half_rad) / half_rad if abs(half_rad) > 1e-6 else 1.0)
        cos, sin = math.cos(self.yaw_rad + half_rad), math.sin(self.yaw_rad + half_rad)
        dx_m, dy_m = chord_m * cos, chord_m * sin
        self.x_m += dx_m
        self.y_m += dy_m
        self.yaw_rad += turned_rad
        self.distance_m += abs(distance_m)
        xx, xy, xa, yy, ya, aa = self._variances
        xa_, ya_ = xa - dy_m * aa, ya + dx_m * aa
        along, turn = self._distance_variance * abs(distance_m), self._heading_variance * abs(distance_m)
        self._lose(dx_m, dy_m, aa)
        self._turn_lost(turn)
        self._variances = (
            xx - dy_m * (xa + xa_) + along * cos * cos, xy + dx_m * xa - dy_m * ya_ + along * cos * sin, xa_,
            yy + dx_m * (ya + ya_) + along * sin * sin, ya_, aa + turn)

    def covariance(self, place_variance: float, heading_variance: float) -> tuple:
        """Return the 3×3 covariance of x, y, yaw, plus these variances: an error below a pulse doesn't accumulate."""
        xx, xy, xa, yy, ya, aa = self._variances
        lost_xx, lost_xy, lost_yy = self._lost_square
        return ((xx + lost_xx + place_variance, xy + lost_xy, xa), (xy + lost_xy, yy + lost_yy + place_variance, ya),
                (xa, ya, aa + heading_variance))

    def _lose(self, dx_m, dy_m, heading_variance):
        """Add a step's d (cos(e) − 1): for a normal e, cos(e) has the mean c = exp(−v / 2), its square (1 + c⁴) / 2."""
        cos = math.exp(-heading_variance / 2)
        mean, square = cos - 1, (1 + cos ** 4) / 2 - 2 * cos + 1
        (x, y), (xx, xy, yy), (xc, yc) = self._lost, self._lost_square, self._lost_product
        self._lost = (x + mean * dx_m, y + mean * dy_m)
        self._lost_square = (xx + dx_m * (2 * xc + square * dx_m), xy + dx_m * yc + dy_m * xc + square * dx_m * dy_m,
                             yy + dy_m * (2 * yc + square * dy_m))
        self._lost_product = (xc + square * dx_m, yc + square * dy_m)

    def _turn_lost(self, variance):
        """Let the error of the heading grow by an independent one of this variance."""
        cos = math.exp(-variance / 2)
        (x, y), (xc, yc) = self._lost, self._lost_product
        self._lost_product = (cos * xc + (cos - 1) * x, cos * yc + (cos - 1) * y)
