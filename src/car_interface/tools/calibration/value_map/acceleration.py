"""Measures the accelerations of a drive by regression over short windows.

A regression over samples y(t_k) of a window is a sum of w_k·y(t_k). Where the w_k annihilate straight lines, that sum
is, for any motion, exactly the mean of y'' under a bump φ(t) = sum of w_k·max(0, t_k − t) (Peano's kernel; the same one
order lower gives y' from speeds). So a window needs no steady value and no steady speed: whatever is compared with its
acceleration is averaged under the same φ.

Pure numpy; seconds, metres, radians; x forward, y left, left turns positive (REP-103). W windows of P points each.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Sequence

import numpy as np

TICK_SIGMA_S = 1e-3 / 12**0.5  # a pulse's time is truncated to the millisecond
WINDOW_S, HOP_S = 0.4, 0.2  # a window's length, and the time from one to the next
GEAR_CHANGE_S = 0.5  # for this long after rolling backward the ESC may still be changing its direction
MAX_MPS2 = 10.0  # tyres don't hold more: the wheels slip
MAX_DIFFERENCE_MPS2 = 3.0  # nor can the accelerations of the two wheels, or those of wheels and IMU, differ by more
GRID_S = 0.01  # of φ; an ESC gets a pulse every 20 ms
GOLDEN = 0.6180339887498949  # its multiples, modulo 1, are evenly spread
SPEED_SPAN_S = 0.1  # a speed is the distance over this time
MAX_WINDOWS = 20_000  # of a drive: more than an hour; in longer drives windows lie farther apart
MIN_PULSES, MIN_SPEEDS = 6, 5
SPEEDS = 8  # in a window: with slow odometry windows are longer
MIN_COVERED = 0.7  # of a window, by its samples

# How a window was measured, or why it was not.
MEASURED, NOT_MEASURED, STANDING, BACKWARD, GEAR_CHANGE, STEERING, SLIPPING = range(7)


class MapFitConfig(NamedTuple):
    """Which driving counts, and what a map is fitted by."""

    min_speed_mps: float = 0.3  # a window with a lower speed is a stop, in which an ESC holds, reverses or waits
    max_curvature_per_m: float = 0.6  # tyres in a turn brake
    max_lateral_mps2: float = 2.5  # the same
    neutral: float = 0.0  # the value at which the actuator neither drives nor brakes; the map may bend there
    value_timeout_s: float = 0.5  # a value counts for no longer than this
    delay_s: float | None = None  # from value to acceleration; None = estimated
    from_imu: bool = False  # accelerations are the IMU's; the wheels' only give its bias


DEFAULTS = MapFitConfig()


class Series(NamedTuple):
    """Samples of one quantity at rising times; both of the shape (N,)."""

    t_s: np.ndarray
    y: np.ndarray


@dataclass(frozen=True)
class MapDrive:
    """One recording, on one scale of seconds."""

    value: Series  # the actuator's commanded value, each sample until the next one
    speed: Series  # m/s, backward negative
    yaw: Series  # rad, unwrapped
    # signed distance of each wheel in m at its pulses; empty = unknown, then the speed is differentiated
    wheels: Sequence[Series] = ()
    # forward specific force in m/s², with gravity's part on a slope, as accelerometers measure it
    imu: Series | None = None
    pitch: Series | None = None  # rad, nose down positive (REP-103)
    # 1 where the value reached the actuator, each sample until the next; ``None`` = always
    driven: Series | None = None


class Windows(NamedTuple):
    """W windows of one drive, or of several, one after the other; each has P points."""

    middle_s: np.ndarray  # (W,)
    acceleration_mps2: np.ndarray  # mean under φ, (W,); NaN where it was not measured
    sigma_mps2: np.ndarray  # standard error by ticks, or by the samples' scatter around the regression, (W,)
    state: np.ndarray  # MEASURED, or why not, (W,)
    t_s: np.ndarray  # φ's times, (W, P)
    weight: np.ndarray  # its weights, (W, P); each row's sum is 1
    speed_mps: np.ndarray  # (W, P)
    cos_yaw: np.ndarray  # mean under φ, (W,), as is the next one
    sin_yaw: np.ndarray
    pitch_rad: np.ndarray  # mean under φ, (W,); NaN without a sensor
    force_mps2: np.ndarray  # the IMU's mean under φ, (W,); NaN without an IMU
    force_sigma_mps2: np.ndarray  # its standard error


@np.errstate(invalid="ignore")  # NaN, for what wasn't measured, compares as false
def windows(drive: MapDrive, config: MapFitConfig = DEFAULTS) -> Windows:
    """Divide a drive into windows and measure each."""
    speed = speed_of_wheels(drive.wheels) if drive.wheels else drive.speed
    begins, ends = drive.speed.t_s[[0, -1]] if drive.speed.t_s.size else (0.0, 0.0)
    window_s = WINDOW_S
    if not drive.wheels and drive.speed.t_s.size > 1:
        window_s = max(window_s, SPEEDS * float(np.median(np.diff(drive.speed.t_s))))
    middles = np.arange(begins + window_s / 2, ends - window_s / 2, max(HOP_S, (ends - begins) / MAX_WINDOWS))
    # Windows in step with the grid of φ, or with commands in step with that, would show a delay in whole steps only.
    middles = middles + (np.arange(middles.size) * GOLDEN % 1.0 - 0.5) * GRID_S
    steps = round(window_s / GRID_S)
    offsets = (np.arange(steps) + 0.5) * GRID_S - window_s / 2
    t_s = middles[:, None] + offsets
    weight = np.full(t_s.shape, 1.0 / steps)
    speeds = _at(speed, t_s)
    measured, sigma = np.full(middles.size, np.nan), np.full(middles.size, np.nan)
    apart = np.zeros(middles.size)
    order, sources, min_samples = (2, drive.wheels, MIN_PULSES) if drive.wheels else (1, (drive.speed,), MIN_SPEEDS)
    for index, middle in enumerate(middles):
        found = [_regress(source, middle, window_s, order, t_s[index], min_samples) for source in sources]
        if any(one is None for one in found):
            continue
        values = [one.value for one in found]
        measured[index] = sum(values) / len(found)
        apart[index] = max(values) - min(values)
        weight[index] = sum(one.kernel for one in found) / len(found)
        if order == 2:
            tick_m = TICK_SIGMA_S * np.abs(speeds[index]).mean()
            sigma[index] = tick_m * sum(one.gain_squared for one in found) ** 0.5 / len(found)
        else:
            sigma[index] = found[0].scatter * found[0].gain_squared ** 0.5
    yaw = _at(drive.yaw, t_s)
    force, force_sigma = _forces(drive.imu, t_s, weight)
    pitch = (_at(drive.pitch, t_s) * weight).sum(axis=1) if drive.pitch else np.full(middles.size, np.nan)
    found = Windows(middles, measured, sigma, np.zeros(middles.size, int), t_s, weight, speeds,
                  (np.cos(yaw) * weight).sum(axis=1), (np.sin(yaw) * weight).sum(axis=1), pitch, force,
                  force_sigma)
    return found._replace(state=_states(found, yaw, apart, speed, window_s, config))


def speed_of_wheels(wheels: Sequence[Series]) -> Series:
    """Return the speed of the axle's middle in m/s: the mean of the wheels', each over SPEED_SPAN_S around its time."""
    usable = [wheel for wheel in wheels if wheel.t_s.size > 1]
    if not usable:
        return Series(np.zeros(0), np.zeros(0))
    begins, ends = max(wheel.t_s[0] for wheel in usable), min(wheel.t_s[-1] for wheel in usable)
    t_s = np.arange(begins, ends, GRID_S)
    speeds = [(_at(wheel, t_s + SPEED_SPAN_S / 2) - _at(wheel, t_s - SPEED_SPAN_S / 2)) / SPEED_SPAN_S
              for wheel in usable]
    return Series(t_s, sum(speeds) / len(usable))


class _Regressed(NamedTuple):
    value: float
    kernel: np.ndarray  # sums up to 1
    gain_squared: float  # what the variance of one sample becomes
    scatter: float  # of the samples around the regression


def _regress(series, middle_s, window_s, order, t_s, min_samples):
    """Return the derivative of ``order`` by a polynomial of that order; ``None`` where samples are too few."""
    first, last = np.searchsorted(series.t_s, (middle_s - window_s / 2, middle_s + window_s / 2))
    if last - first < min_samples:
        return None
    x, y = series.t_s[first:last] - middle_s, series.y[first:last]
    if x[-1] - x[0] < MIN_COVERED * window_s:
        return None
    y = y - y[0]
    scale = window_s / 2
    powers = np.vander(x / scale, order + 1, increasing=True)
    try:
        inverse = np.linalg.inv(powers.T @ powers)
    except np.linalg.LinAlgError:
        return None
    factor = (2.0 if order == 2 else 1.0) / scale**order
    gains = factor * (powers @ inverse[:, order])
    residual = y - powers @ (inverse @ (powers.T @ y))
    scatter = (residual @ residual / max(1, x.size - order - 1)) ** 0.5
    above = np.searchsorted(x, t_s - middle_s, side="right")
    later = np.append(np.cumsum(gains[::-1])[::-1], 0.0)[above]
    if order == 2:
        later = np.append(np.cumsum((gains * x)[::-1])[::-1], 0.0)[above] - (t_s - middle_s) * later
    return _Regressed(gains @ y, later / later.sum(), gains @ gains, scatter)


def _forces(imu, t_s, weight):
    """Return (an IMU's means under φ (W,), their standard errors (W,)); NaN where it has gaps."""
    if imu is None or imu.t_s.size < 2:
        return np.full(len(t_s), np.nan), np.full(len(t_s), np.nan)
    # The noise is by how much neighbours differ; an average over many samples reduces it.
    noise = np.median(np.abs(np.diff(imu.y))) / 0.6745 / 2**0.5
    period_s = np.median(np.diff(imu.t_s))
    begin, end = np.searchsorted(imu.t_s, t_s[:, 0]), np.searchsorted(imu.t_s, t_s[:, -1])
    enough = (end - begin) * period_s >= MIN_COVERED * (t_s[:, -1] - t_s[:, 0])
    sigma = noise * np.sqrt((weight**2).sum(axis=1) * max(1.0, period_s / GRID_S))
    return np.where(enough, (_at(imu, t_s) * weight).sum(axis=1), np.nan), sigma


def _states(found, yaw, apart, speed, window_s, config):
    """Return the state of each window (W,): why it doesn't count."""
    state = np.full(found.middle_s.size, MEASURED)
    slowest, fastest = found.speed_mps.min(axis=1), found.speed_mps.max(axis=1)
    half = window_s / 2
    backward_s = np.append(-np.inf, speed.t_s[speed.y < -config.min_speed_mps / 2])
    since_s = found.middle_s - half - backward_s[np.searchsorted(backward_s, found.middle_s + half) - 1]
    distance_m = np.maximum((found.speed_mps * GRID_S).sum(axis=1), 1e-3)
    curvature_per_m = np.abs(yaw[:, -1] - yaw[:, 0]) / distance_m
    lateral_mps2 = curvature_per_m * fastest**2
    force_apart = np.nan_to_num(np.abs(found.force_mps2 - found.acceleration_mps2))
    slipping = ((np.abs(found.acceleration_mps2) > MAX_MPS2) | (apart > MAX_DIFFERENCE_MPS2)
                | (force_apart > MAX_DIFFERENCE_MPS2))
    for reason, holds in (
        (SLIPPING, slipping),
        (STEERING, (curvature_per_m > config.max_curvature_per_m) | (lateral_mps2 > config.max_lateral_mps2)),
        (NOT_MEASURED, ~np.isfinite(found.acceleration_mps2 + found.sigma_mps2) | ~np.isfinite(slowest + fastest)),
        (GEAR_CHANGE, since_s < GEAR_CHANGE_S),
        (STANDING, slowest < config.min_speed_mps),
        (BACKWARD, fastest < -config.min_speed_mps),
    ):
        state[np.nan_to_num(holds).astype(bool)] = reason
    return state


def _at(series, t_s):
    """Linear between samples, the end values beyond them; NaN without samples."""
    return np.interp(t_s, series.t_s, series.y) if series.t_s.size else np.full(np.shape(t_s), np.nan)
