"""Estimates the car's heading and curvature from the difference of its wheels' positions.

Heading = (right − left) / track. Over the distance between two pulses the curvature hardly changes, so a Kalman filter
predicts heading and curvature by the distance, and is corrected by the wheels' difference at each pulse of one of them.
Pure: metres, radians and seconds.
"""
from __future__ import annotations

CURVATURE_WANDER = 3.0  # (1/m)²/s: a servo goes from end to end in a fifth of a second
CURVATURE_VARIANCE = 0.5  # (1/m)², of an unknown curvature: 0.7 1/m, a car's tightest turns, is one sigma
RECENT_M = 0.3  # over which the noise of the curvature is averaged
CURVATURE_NOISE = 0.1  # 1/m: two sigma of the filter's on a straight (``drive`` of test_captures)
USUAL_M = 2.0  # of the last metres, whose curvatures are the usual ones; with 5 a long reboot leaves a third more open
HEADING_VARIANCE = 1e-6  # rad²: the smallest that is claimed, a sigma of 1 mrad
# The commanded curvature weighs as much as a measurement every half second with this ratio and offset as its error.
STEERING_S, STEERING_RATIO, STEERING_PER_M = 0.5, 0.3, 0.05


class HeadingFilter:
    """A Kalman filter of heading and curvature, over the distance that the car rolls."""

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
