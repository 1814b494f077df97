"""The distance that a car travelled, by its odometry. It reads no recording, so that a car's own node can use it."""
from __future__ import annotations

import numpy as np

from car_interface.tools.recordings.series import Odom

BIN_S, MIN_BIN_M, MAX_BIN_GAP_S, MAX_BIN_RAD = 1.0, 0.4, 0.3, 2.0
MIN_BINS = 5


def distance_m(odom: Odom) -> np.ndarray:
    """The distance travelled at each row of odometry (N,), backward negative.

    It is the integral of the speed, scaled to the distances between positions: speeds show small steps and their
    direction better, positions long distances.
    """
    dx, dy = np.diff(odom.x_m), np.diff(odom.y_m)
    if np.any(odom.speed_mps):
        steps_m = np.diff(odom.t_s) * (odom.speed_mps[1:] + odom.speed_mps[:-1]) / 2
    else:
        steps_m = np.hypot(dx, dy) * np.sign(dx * np.cos(odom.yaw_rad[:-1]) + dy * np.sin(odom.yaw_rad[:-1]))
    by_speed_m = np.concatenate([[0.0], np.cumsum(steps_m)])
    return by_speed_m * _distance_ratio(odom, by_speed_m)


def _distance_ratio(odom, by_speed_m):
    """The ratio of distances between positions to those by speed, over all seconds in which the car drove."""
    at_s = np.arange(odom.t_s[0], odom.t_s[-1], BIN_S)
    x_m, y_m, yaw_rad, speed_m = (np.diff(np.interp(at_s, odom.t_s, column))
                                  for column in (odom.x_m, odom.y_m, odom.yaw_rad, by_speed_m))
    half_rad = np.clip(np.abs(yaw_rad) / 2, 1e-6, 1.5)
    arc_m = np.hypot(x_m, y_m) * half_rad / np.sin(half_rad)  # from the chord
    drove = (np.abs(speed_m) > MIN_BIN_M) & (np.abs(yaw_rad) < MAX_BIN_RAD) & ~_has_gap(odom.t_s, at_s)
    if drove.sum() < MIN_BINS:
        return 1.0
    ratios = arc_m[drove] / np.abs(speed_m[drove])
    usual = np.median(ratios)
    inliers = np.abs(ratios - usual) < 0.1 * usual
    if not inliers.any():
        return 1.0
    ratio = float(arc_m[drove][inliers].sum() / np.abs(speed_m[drove][inliers]).sum())
    return ratio if 0.5 < ratio < 2.0 else 1.0


def _has_gap(t_s, at_s):
    """Which of the bins between consecutive times ``at_s`` (M,) contain a gap between samples ``t_s``: (M−1,)."""
    before = np.flatnonzero(np.diff(t_s) > MAX_BIN_GAP_S)
    begun = np.searchsorted(t_s[before], at_s[1:])  # gaps that began before a bin's end
    ended = np.searchsorted(t_s[before + 1], at_s[:-1], side="right")  # gaps that ended before its begin
    return begun > ended
