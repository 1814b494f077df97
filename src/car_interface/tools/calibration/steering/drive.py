"""One drive as the fit of a steering curve takes it: the distance that it travelled, and where the steered wheels were:
the servo's commands, delayed, lagged, and less the linkage's backlash.

Positions are in duty: the duty at which a servo without delay, lag and backlash would hold the wheels there.
"""
from __future__ import annotations

import math
from typing import NamedTuple, Sequence

import numpy as np

from car_interface.pca9685.registers import DUTY_PER_COUNT
from car_interface.tools.calibration.shared import NothingToFit, has_gap, held, integral, interval_s
from car_interface.tools.recordings.columns import Odom

COUNT = float(DUTY_PER_COUNT)  # the board can't output anything in between
KNOT = COUNT / 2  # duty from one knot of the curve to the next
MAX_BACKLASH_DUTY = 80.0
MIN_SPEED_MPS = 0.25  # at lower speeds the heading changes too little
MAX_GAP_S = 0.3  # between samples of odometry that belong together
MAX_JUMP_RAD = 0.5  # of the heading from sample to sample
BIN_S, MIN_BIN_M, MAX_BIN_RAD = 1.0, 0.4, 2.0  # in which distances are compared
MIN_BINS = 5
AFTER_GAP_S = 1.0  # so soon after a gap the servo may still follow commands that weren't recorded
CROSSED_DUTY = 40.0  # a servo that has moved this far has crossed any usual backlash
FORGOTTEN_LAGS = 5.0  # after this many lags the servo's position doesn't depend on where it started
HALF_SPAN = 3  # samples to either side over which curvature is differenced for the delay
BETWEEN_DRIVES_S = 10.0
STEP_S = 0.02  # of the time scale of the wheels, and of that on which delays are tried
MAX_S, COARSE_S, FINE_S = 0.4, 0.04, 0.01  # of delays and lags that are tried
BINS, MIN_SAMPLES = 60, 200
MIN_EXPLAINED = 0.1  # of the effect's variance: a cause that explains less has no effect


class Delay(NamedTuple):
    """How an effect follows its cause."""

    delay_s: float  # the time until a change begins
    lag_s: float  # the time from then until 63 % of it are done


UNKNOWN_DELAY = Delay(MAX_S, MAX_S)  # where the duty never changed while the car drove: as slow as is looked for


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
    by_speed_m = integral(odom.t_s, odom.speed_mps)
    if not np.any(odom.speed_mps):
        dx, dy = np.diff(odom.x_m), np.diff(odom.y_m)
        steps_m = np.hypot(dx, dy) * np.sign(dx * np.cos(odom.yaw_rad[:-1]) + dy * np.sin(odom.yaw_rad[:-1]))
        by_speed_m = np.append(0.0, np.cumsum(steps_m))
    return by_speed_m * _distance_ratio(odom, by_speed_m)


def _distance_ratio(odom, by_speed_m):
    """Return the ratio of distances between positions to those by speed, over all seconds in which the car drove."""
    at_s = np.arange(odom.t_s[0], odom.t_s[-1], BIN_S)
    x_m, y_m, yaw_rad, speed_m = (np.diff(np.interp(at_s, odom.t_s, column))
                                  for column in (odom.x_m, odom.y_m, odom.yaw_rad, by_speed_m))
    half_rad = np.clip(np.abs(yaw_rad) / 2, 1e-6, 1.5)
    arc_m = np.hypot(x_m, y_m) * half_rad / np.sin(half_rad)  # from the chord
    drove = ((np.abs(speed_m) > MIN_BIN_M) & (np.abs(yaw_rad) < MAX_BIN_RAD)
             & ~has_gap(odom.t_s, at_s[:-1], at_s[1:], MAX_GAP_S))
    if drove.sum() < MIN_BINS:
        return 1.0
    arc_m, speed_m = arc_m[drove], np.abs(speed_m[drove])
    usual = np.median(arc_m / speed_m)
    inliers = np.abs(arc_m / speed_m - usual) < 0.1 * usual
    ratio = float(arc_m[inliers].sum() / max(speed_m[inliers].sum(), 1e-9))
    return ratio if 0.5 < ratio < 2.0 else 1.0


# --- the servo's delay ---


def estimate_servo_delay(drives: Sequence[SteeringDrive]) -> Delay:
    """Delay and lag from duty to curvature, of all drives together, one behind the other on the time scale.

    UNKNOWN_DELAY where all of them are steady: a duty that never changes is followed at any delay.

    Raises:
        NothingToFit: the drives are too short, or the heading doesn't follow the duty.
    """
    changing = [drive for drive in drives if not is_steady(drive)]
    if not changing:
        return UNKNOWN_DELAY
    columns, begin_s = [], 0.0
    for drive in changing:
        shift_s = begin_s - drive.t_s[0]
        t_s = np.arange(drive.t_s[0], drive.t_s[-1], STEP_S)
        if len(t_s) <= 2 * HALF_SPAN:
            continue
        step_m, step_rad = (column[2 * HALF_SPAN:] - column[:-2 * HALF_SPAN] for column in (
            np.interp(t_s, drive.t_s, drive.distance_m), np.interp(t_s, drive.t_s, drive.yaw_rad)))
        at_s = t_s[HALF_SPAN:-HALF_SPAN]
        is_usable = ((np.abs(step_m) > MIN_SPEED_MPS * 2 * HALF_SPAN * STEP_S)
                     & ~has_gap(drive.t_s, at_s - AFTER_GAP_S, at_s, MAX_GAP_S))
        has_pulse = np.isfinite(drive.duty)
        columns.append((drive.duty_t_s[has_pulse] + shift_s, drive.duty[has_pulse], at_s + shift_s,
                        step_rad / np.where(is_usable, step_m, 1.0), np.where(is_usable, step_m ** 2, 0.0)))
        begin_s += drive.t_s[-1] - drive.t_s[0] + BETWEEN_DRIVES_S
    if not columns:
        raise NothingToFit("the recordings are shorter than a second")
    found = estimate_delay(*map(np.concatenate, zip(*columns)))
    if found is None:
        raise NothingToFit("the heading doesn't follow the steering's duty (is it the right channel? did the car "
                           "drive?)")
    return found


def lagged(value: np.ndarray, step_s: float, lag_s: float) -> np.ndarray:
    """Return an evenly sampled signal (N,) after a first-order lag: (N,)."""
    if lag_s < step_s / 10:
        return np.asarray(value, float)
    decay = float(np.exp(-step_s / lag_s))
    out, now = [], float(value[0])
    for wanted in value.tolist():
        now = wanted + (now - wanted) * decay
        out.append(now)
    return np.array(out)


def estimate_delay(cause_s: np.ndarray, cause: np.ndarray, effect_s: np.ndarray, effect: np.ndarray,
                   weight: np.ndarray) -> Delay | None:
    """Find the delay and the first-order lag from a cause to its effect, at most MAX_S each.

    The effect depends on the cause by an unknown curve. No model of that is needed: with the right delay and lag equal
    values of the (delayed, lagged) cause have equal effects.

    Args:
        cause_s, cause: the cause, (N,) each, held until the next sample.
        effect_s, effect: samples of the effect at rising times, (M,) each; noise and gaps don't matter.
        weight: of each sample of the effect, (M,); 0 = not used.

    Returns:
        ``None`` where there are too few samples, or where the cause explains next to nothing.
    """
    used = (weight > 0) & np.isfinite(effect) & (effect_s >= cause_s[0]) if len(cause_s) else np.zeros(0, bool)
    if used.sum() < MIN_SAMPLES or np.ptp(cause) == 0:
        return None
    at_s, y, w = effect_s[used], effect[used], weight[used]
    grid_s = np.arange(cause_s[0], at_s[-1] + STEP_S, STEP_S)
    commanded = held(cause_s, cause, grid_s)
    mean = np.average(y, weights=w)
    total = np.sum(w * (y - mean) ** 2)

    def best(delays_s, lags_s):
        """Return the least that remains unexplained, and by which delay and lag."""
        followed = [(lag_s, lagged(commanded, STEP_S, lag_s)) for lag_s in lags_s]
        return min((_scatter(np.interp(at_s - delay_s, grid_s, value), y, w), delay_s, lag_s)
                   for delay_s in delays_s for lag_s, value in followed)

    _, delay_s, lag_s = best(*[_steps(0.0, MAX_S, COARSE_S)] * 2)
    smallest, delay_s, lag_s = best(*(_steps(max(0.0, near_s - COARSE_S), near_s + COARSE_S, FINE_S)
                                      for near_s in (delay_s, lag_s)))
    explained = 1 - smallest / total if total > 0 else 0.0
    return Delay(delay_s, lag_s) if explained > MIN_EXPLAINED else None


def _steps(low, high, step):
    return [round(low + step * index, 4) for index in range(round((high - low) / step) + 1)]


def _scatter(x, y, w):
    """Return the weighted sum of squares of ``y`` around straight lines over ``x``, one in each of BINS equal bins."""
    order = np.argsort(x, kind="stable")
    x, y, w = x[order], y[order], w[order]
    starts = np.unique(np.linspace(0, len(x), BINS + 1).astype(int)[:-1])
    sum_w, sum_x, sum_y = (np.add.reduceat(column, starts) for column in (w, w * x, w * y))
    counts = np.diff(np.append(starts, len(x)))
    dx, dy = x - np.repeat(sum_x / sum_w, counts), y - np.repeat(sum_y / sum_w, counts)
    xx, xy, yy = (np.add.reduceat(column, starts) for column in (w * dx * dx, w * dx * dy, w * dy * dy))
    return float(np.sum(yy - np.where(xx > 1e-12, xy * xy / np.maximum(xx, 1e-12), 0.0)))


# --- the wheels ---


def is_steady(drive: SteeringDrive) -> bool:
    """Return whether the servo, while the car drove, never moved so far that it crossed any usual backlash."""
    drives = np.abs(np.gradient(drive.distance_m, drive.t_s)) >= MIN_SPEED_MPS
    duty = held(drive.duty_t_s, drive.duty, drive.t_s[drives])
    duty = duty[np.isfinite(duty)]
    return duty.size > 0 and float(np.ptp(duty)) < CROSSED_DUTY


class WheelPosition:
    """The steering of one drive, sampled every STEP_S.

    The servo's position before the recording and in its gaps is unknown until a duty was recorded and the servo had
    time to follow it; the linkage's position within its backlash is unknown until the servo has moved far enough. In a
    steady drive it never is: the wheels count as in the middle, and that is uncertain.

    Attributes (arrays of the shape (N,)):
        t_s, distance_m, yaw_rad, speed_mps: the drive, interpolated.
        servo: the servo's position in duty.
        off: how far the servo is from its command, in duty.
        is_known: whether servo and linkage are known, and odometry is without a gap and its heading without a jump.
        is_steady: the linkage may be anywhere in its backlash.
    """

    def __init__(self, drive: SteeringDrive, delay: Delay):
        self.t_s = np.arange(drive.t_s[0], drive.t_s[-1], STEP_S)
        self.distance_m = np.interp(self.t_s, drive.t_s, drive.distance_m)
        self.yaw_rad = np.interp(self.t_s, drive.t_s, drive.yaw_rad)
        self.speed_mps = np.gradient(self.distance_m, STEP_S)
        commanded = held(drive.duty_t_s, drive.duty, self.t_s - delay.delay_s)
        self.is_steady = is_steady(drive)
        self.is_known = np.isfinite(commanded) & (self.t_s - delay.delay_s >= drive.duty_t_s[0])
        # Without a pulse a servo stays where it is.
        last = np.maximum.accumulate(np.where(np.isfinite(commanded), np.arange(len(commanded)), 0))
        commanded = np.nan_to_num(commanded[last], nan=0.0)
        self.servo = np.empty(len(commanded))
        gap_ends_s = drive.t_s[1:][np.diff(drive.t_s) > MAX_GAP_S]
        self._starts = np.unique(np.concatenate([[0], np.searchsorted(self.t_s, gap_ends_s)]))
        for start, end in zip(self._starts, [*self._starts[1:], len(self.t_s)]):
            self._follow(drive, delay, commanded, start, end)
        self._falls = np.diff(self.servo, prepend=self.servo[:1]) < 0
        turns = np.flatnonzero(self._falls[1:] != self._falls[:-1]) + 1
        self._runs = np.union1d(np.append(self._starts, len(self.servo)), turns).tolist()
        self.off = np.abs(commanded - self.servo)
        jump_rad = np.abs(np.diff(self.yaw_rad, prepend=drive.yaw_rad[0]))
        self.is_known &= (interval_s(drive.t_s, self.t_s) <= MAX_GAP_S) & (jump_rad <= MAX_JUMP_RAD)

    def _follow(self, drive, delay, commanded, start, end):
        """Let the servo follow its commands from one gap to the next."""
        if start >= end:
            return
        first = np.searchsorted(drive.duty_t_s, self.t_s[start]) if start else 0
        first_s = drive.duty_t_s[first] if first < len(drive.duty_t_s) else math.inf
        follows = min(start + int(np.searchsorted(self.t_s[start:end], first_s + delay.delay_s)), end - 1)
        self.servo[start:follows] = commanded[follows]
        self.servo[follows:end] = lagged(commanded[follows:end], STEP_S, delay.lag_s)
        # It may have come from the other end: 3 lags, after which 5 % of the distance are left, are not enough.
        settled_s = first_s + delay.delay_s + FORGOTTEN_LAGS * delay.lag_s
        settled = start + int(np.searchsorted(self.t_s[start:end], settled_s))
        self.is_known[start:settled] = False
        if settled < end and not self.is_steady:
            servo = self.servo[settled:end]
            span = np.maximum.accumulate(servo) - np.minimum.accumulate(servo)
            self.is_known[settled:end] &= span >= CROSSED_DUTY

    def linkage(self, backlash_duty: float) -> np.ndarray:
        """Return the wheels' position (N,), which follows the servo once that has crossed the backlash."""
        if backlash_duty <= 0 or self.is_steady:
            return self.servo
        half, now, out, starts = backlash_duty / 2, 0.0, np.empty(len(self.servo)), set(self._starts.tolist())
        for start, end in zip(self._runs, self._runs[1:]):  # in each the servo never turns back
            servo = self.servo[start:end]
            now = servo[0] if start in starts else now
            out[start:end] = np.minimum(now, servo + half) if self._falls[start] else np.maximum(now, servo - half)
            now = out[end - 1]
        return out
