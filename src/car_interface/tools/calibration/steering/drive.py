"""One drive as the fit of a steering curve takes it, with the distance that it travelled, and the fit's settings."""
from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from car_interface.pca9685.registers import DUTY_PER_COUNT
from car_interface.tools.calibration.delay import Delay
from car_interface.tools.recordings.series import Odom

COUNT = float(DUTY_PER_COUNT)  # the board can't output anything in between
KNOT = COUNT / 2  # duty from one knot of the curve to the next
MAX_BACKLASH_DUTY = 80.0
BIN_S, MIN_BIN_M, MAX_BIN_GAP_S, MAX_BIN_RAD = 1.0, 0.4, 0.3, 2.0  # in which distances are compared
MIN_BINS = 5


@dataclass(frozen=True)
class CurveFitConfig:
    """Which driving counts, and how much.

    Attributes:
        min_speed_mps: at lower speeds the heading changes too little.
        max_lateral_mps2: above this tyres may begin to slide.
        settled_duty: the servo has arrived when it is this near to its command, by delay and lag.
        max_wander_duty: how far the wheels may move within a segment.
        min_length_m, max_length_m, min_duration_s: of a segment.
        max_gap_s: between samples of odometry that belong together.
        max_jump_rad: of the heading from sample to sample.
        heading_sigma_rad: standard error of odometry's heading, at most: where a drive shows that it is better, that
            counts.
        min_heading_sigma_rad: the same, at least.
        min_sigma_per_m: no segment's curvature is known better: floors are uneven, tyres flex.
        delay: of the servo; ``None`` = estimated.
        backlash_duty: of the linkage; ``None`` = estimated.
        backlash_sigma: the standard error of the one that is given.
        max_backlash_duty: the upper bound of that estimate.
        known_ratio, known_per_m: a breakpoint is supported when its curvature is known to this ratio or to this
            magnitude, to either side, beyond half of what the board's next count would change.
        stop_duty: a mechanical stop is one when the curve stays level over this duty.
        stop_ratio: level is a curvature that differs from the tightest by at most this ratio.
        understeer: by how much turns widen with speed where a drive doesn't show it.
        limits: duties beyond which nobody means to steer.
    """

    min_speed_mps: float = 0.25
    max_lateral_mps2: float = 4.0
    settled_duty: float = 6.0
    max_wander_duty: float = 24.0
    min_length_m: float = 0.5
    max_length_m: float = 8.0
    min_duration_s: float = 0.3
    max_gap_s: float = 0.3
    max_jump_rad: float = 0.5
    heading_sigma_rad: float = 0.008
    min_heading_sigma_rad: float = 0.003
    min_sigma_per_m: float = 0.001
    delay: Delay | None = None
    backlash_duty: float | None = None
    backlash_sigma: float = 0.0
    max_backlash_duty: float = MAX_BACKLASH_DUTY
    known_ratio: float = 0.08
    known_per_m: float = 0.01
    stop_duty: float = 40.0
    stop_ratio: float = 0.007
    understeer: float = 0.0
    limits: tuple = ()


DEFAULTS = CurveFitConfig()


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
