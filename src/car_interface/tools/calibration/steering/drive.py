"""One drive as the fit of a steering curve takes it, the distance that it travelled, and what is given of the car."""
from __future__ import annotations

from typing import NamedTuple

import numpy as np

from car_interface.pca9685.registers import DUTY_PER_COUNT
from car_interface.tools.calibration.delay import Delay
from car_interface.tools.recordings.columns import Odom

COUNT = float(DUTY_PER_COUNT)  # the board can't output anything in between
KNOT = COUNT / 2  # duty from one knot of the curve to the next
MAX_BACKLASH_DUTY = 80.0
MIN_SPEED_MPS = 0.25  # at lower speeds the heading changes too little
MAX_GAP_S = 0.3  # between samples of odometry that belong together
BIN_S, MIN_BIN_M, MAX_BIN_GAP_S, MAX_BIN_RAD = 1.0, 0.4, 0.3, 2.0  # in which distances are compared
MIN_BINS = 5


class CurveFitConfig(NamedTuple):
    """What is given of a car, and needn't be shown by its drives."""

    delay: Delay | None = None  # of the servo; None = estimated
    backlash_duty: float | None = None  # of the linkage; None = estimated
    backlash_sigma: float = 0.0  # the standard error of the one that is given
    understeer: float = 0.0  # by how much turns widen with speed, where a drive doesn't show it
    limits: tuple = ()  # duties beyond which nobody means to steer


NOTHING_GIVEN = CurveFitConfig()


class SteeringDrive(NamedTuple):
    """One recording: N samples of odometry, M of the servo's duty.

    The drives of a calibration are all of one car, with nothing changed in between.
    """

    t_s: np.ndarray  # (N,), rising
    distance_m: np.ndarray  # (N,), travelled since any moment, backward negative
    yaw_rad: np.ndarray  # (N,), unwrapped
    duty_t_s: np.ndarray  # (M,), rising
    duty: np.ndarray  # (M,), of the steering channel, each until the next; NaN where there is no pulse


def distance_m(odom: Odom) -> np.ndarray:
    """Return the distance travelled at each row of odometry (N,), backward negative.

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
    """Return the ratio of distances between positions to those by speed, over all seconds in which the car drove."""
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
    """Return which bins between the times ``at_s`` (M,) contain a gap between samples ``t_s``: (M−1,)."""
    before = np.flatnonzero(np.diff(t_s) > MAX_BIN_GAP_S)
    begun = np.searchsorted(t_s[before], at_s[1:])  # gaps that began before a bin's end
    ended = np.searchsorted(t_s[before + 1], at_s[:-1], side="right")  # gaps that ended before its begin
    return begun > ended
