"""The windows of drives: their accelerations, by regression, and which count for the fit of a value map, or why not.

A regression over samples y(t_k) of a window is a sum of w_k·y(t_k). Where the w_k annihilate straight lines, that sum
is, for any motion, exactly the mean of y'' under a bump φ(t) = sum of w_k·max(0, t_k − t) (Peano's kernel; the same one
order lower gives y' from speeds). So a window needs no steady value and no steady speed: whatever is compared with its
acceleration is averaged under the same φ.

All drives' windows are gathered into columns, gravity is subtracted where a pitch is known, and the value under a delay
is sampled along each window. Pure numpy and scipy; seconds, metres, radians; x forward, y left, left turns positive
(REP-103). W windows of P points each, of D drives.
"""
from __future__ import annotations

from typing import NamedTuple, Sequence

import numpy as np
from scipy import sparse

from car_interface.tools.calibration.shared import Series, held
from car_interface.tools.calibration.value_map.recorded import BY_IMU, DEFAULTS, MapConfig, MapDrive
from car_interface.tools.calibration.value_map.surface import Grid

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
GRAVITY_MPS2 = 9.81
MAX_PITCH_RAD = 0.15  # beyond it a window doesn't count
MIN_SIGMA_MPS2 = 0.03  # no window's acceleration is known better: floors are uneven, tyres flex
MIN_SPREAD = 0.1  # of headings: the part of a constant that cos and sin of yaw can't explain; 1 for all round
MIN_TURN = 5  # windows in a row
VALUE_JUMP = 0.05  # of the range of values: more begins another manoeuvre
MANOEUVRE_S = 5.0

# How a window was measured, or why it doesn't count.
(MEASURED, NOT_MEASURED, STANDING, BACKWARD, GEAR_CHANGE, STEERING, SLIPPING, NO_VALUE, NOT_DRIVEN, BEYOND, STEEP,
 OUTLYING, TURNING) = range(13)  # the last one: steering, but good enough to show the slope
RULES = {
    BACKWARD: "rolling backward",
    STANDING: "a stop, or slower than the slowest speed",
    GEAR_CHANGE: "a gear change: the car had just rolled backward",
    NOT_MEASURED: "too few pulses or speeds",
    STEERING: "steering: a tight turn, or tyres at work",
    SLIPPING: "wheel slip: more than tyres hold, or wheels that disagree",
    NO_VALUE: "no value, or one that had timed out",
    NOT_DRIVEN: "the value didn't reach the actuator",
    BEYOND: "beyond the map's axes",
    STEEP: "ground steeper than the steepest pitch",
    OUTLYING: "fits nothing else that the car did",
}


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
    part: np.ndarray  # the time from its drive's middle, as a ratio of the drive, −0.5..0.5, (W,)
    hop_s: np.ndarray  # how much driving a window stands for, (W,)


@np.errstate(invalid="ignore")  # NaN, for what wasn't measured, compares as false
def windows(drive: MapDrive, config: MapConfig = DEFAULTS, window_s: float = WINDOW_S) -> Windows:
    """Divide a drive into windows of that length and measure each."""
    begin_s, end_s = drive.speed.t_s[[0, -1]]
    if drive.wheels:
        speed, order, sources, min_samples = speed_of_wheels(drive.wheels), 2, drive.wheels, MIN_PULSES
    else:
        speed, order, sources, min_samples = drive.speed, 1, (drive.speed,), MIN_SPEEDS
    hop_s = max(HOP_S, (end_s - begin_s) / MAX_WINDOWS)
    middles = np.arange(begin_s + window_s / 2, end_s - window_s / 2, hop_s)
    # Windows in step with the grid of φ, or with commands in step with that, would show a delay in whole steps only.
    middles = middles + (np.arange(middles.size) * GOLDEN % 1.0 - 0.5) * GRID_S
    steps = round(window_s / GRID_S)
    t_s = middles[:, None] + (np.arange(steps) + 0.5) * GRID_S - window_s / 2
    weight = np.full(t_s.shape, 1.0 / steps)
    speeds = _at(speed, t_s)
    measured, sigma, apart = np.full(middles.size, np.nan), np.full(middles.size, np.nan), np.zeros(middles.size)
    for index, middle in enumerate(middles):
        found = [_regress(source, middle, window_s, order, t_s[index], min_samples) for source in sources]
        if any(one is None for one in found):
            continue
        values, kernels, gains_squared, scatters = zip(*found)
        measured[index] = sum(values) / len(found)
        apart[index] = max(values) - min(values)
        weight[index] = sum(kernels) / len(found)
        # By the pulses' ticks, or by the one source's scatter.
        noise = TICK_SIGMA_S * np.abs(speeds[index]).mean() if order == 2 else scatters[0]
        sigma[index] = noise * sum(gains_squared) ** 0.5 / len(found)

    def mean(y):
        return (y * weight).sum(axis=1)
    yaw = _at(drive.yaw, t_s)
    force, force_sigma = _forces(drive.imu, t_s, weight)
    found = Windows(middles, measured, sigma, np.zeros(middles.size, int), t_s, weight, speeds, mean(np.cos(yaw)),
                    mean(np.sin(yaw)), mean(_at(drive.pitch, t_s)), force, force_sigma,
                    (middles - (begin_s + end_s) / 2) / max(end_s - begin_s, 1.0), np.full(middles.size, hop_s))
    return found._replace(state=_states(found, yaw, apart, speed, window_s, config))


def speed_of_wheels(wheels: Sequence[Series]) -> Series:
    """Return the speed of the axle's middle in m/s: the mean of the wheels', each over SPEED_SPAN_S around its time."""
    t_s = np.arange(max(wheel.t_s[0] for wheel in wheels), min(wheel.t_s[-1] for wheel in wheels), GRID_S)
    speeds = [(_at(wheel, t_s + SPEED_SPAN_S / 2) - _at(wheel, t_s - SPEED_SPAN_S / 2)) / SPEED_SPAN_S
              for wheel in wheels]
    return Series(t_s, sum(speeds) / len(speeds))


def _regress(series, middle_s, window_s, order, t_s, min_samples):
    """Return (the derivative of an order by a polynomial of that order, its kernel at ``t_s`` with a sum of 1, what the
    variance of one sample becomes, the samples' scatter around the polynomial); ``None`` where samples are too few.
    """
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
    return gains @ y, later / later.sum(), gains @ gains, scatter


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
    """Linear between samples, the end values beyond them; NaN without a series, or where it has none."""
    return np.interp(t_s, series.t_s, series.y) if series and series.t_s.size else np.full(np.shape(t_s), np.nan)


# --- all drives together ---


class Data:
    """All windows of all drives; which of them count by everything but the value, or by that, too.

    Attributes:
        windows: their acceleration that on level ground; their state also TURNING, STEEP.
        drive: each window's drive, (W,).
        slope: gravity per slope of each drive's ground along x and y, (W, 2·D).
        sees_slope: whether a drive shows its slope, (D,).
        pitch_offset: of each drive's sensor in rad; NaN without.
    """

    def __init__(self, drives: Sequence[MapDrive], config: MapConfig):
        self.config, self._drives = config, drives
        periods_s = [float(np.median(np.diff(drive.speed.t_s))) for drive in drives
                     if not drive.wheels and drive.speed.t_s.size > 1]
        window_s = max([WINDOW_S, *(SPEEDS * period_s for period_s in periods_s)])  # of all: each has as many points
        found, sees_slope, self.pitch_offset = zip(*(_gather(drive, config, window_s) for drive in drives))
        self.windows, self.sees_slope = Windows(*map(np.concatenate, zip(*found))), np.array(sees_slope)
        self.drive = number = np.repeat(np.arange(len(drives)), [one.middle_s.size for one in found])
        self.slope, at = np.zeros((number.size, 2 * len(drives))), np.arange(number.size)
        self.slope[at, 2 * number] = -GRAVITY_MPS2 * self.windows.cos_yaw
        self.slope[at, 2 * number + 1] = -GRAVITY_MPS2 * self.windows.sin_yaw

    def sample(self, delay_s: float, grid: Grid | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Return (the values ``delay_s`` earlier along each window (W, P), the windows' states by them, too (W,)); with
        a grid those windows are left out that lie beyond it.
        """
        values, state = np.zeros(self.windows.t_s.shape), self.windows.state.copy()
        for index, drive in enumerate(self._drives):
            own = self.drive == index
            t_s = self.windows.t_s[own] - delay_s
            value, age_s = held(*drive.value, t_s), t_s - held(drive.value.t_s, drive.value.t_s, t_s)
            is_known = np.isfinite(value) & (age_s >= 0)
            values[own] = np.where(is_known, value, 0.0)
            lacks = (~is_known | (age_s > self.config.value_timeout_s)).any(axis=1)
            state[own] = _left_out(state[own], lacks, NO_VALUE)
            if drive.driven is not None:
                drives = (held(*drive.driven, t_s) >= 0.5) & (t_s >= drive.driven.t_s[0])
                state[own] = _left_out(state[own], ~drives.all(axis=1), NOT_DRIVEN)
        if grid is not None:
            state = _left_out(state, ~grid.has(values, np.nan_to_num(self.windows.speed_mps)).all(axis=1), BEYOND)
        return values, state

    def manoeuvres(self, value: np.ndarray, state: np.ndarray, grid: Grid) -> np.ndarray:
        """Return the number of each window's manoeuvre (W,), −1 for windows that don't count.

        A new one begins where the value jumps, after windows that don't count, and after MANOEUVRE_S.
        """
        mean = value.mean(axis=1)
        jump = VALUE_JUMP * np.ptp(grid.rows)
        number, numbers = -1, np.full(state.size, -1)
        begun, before, middle = 0.0, None, self.windows.middle_s
        for index in np.flatnonzero(state == MEASURED):
            goes_on = (before == index - 1 and self.drive[index] == self.drive[before]
                       and abs(mean[index] - mean[before]) <= jump and middle[index] - begun <= MANOEUVRE_S)
            if not goes_on:
                number, begun = number + 1, middle[index]
            numbers[index] = number
            before = index
        return numbers


def _gather(drive, config, window_s):
    """Return (one drive's windows, whether it shows its slope, its pitch's offset)."""
    one = windows(drive, config, window_s)
    state = one.state.copy()
    counted = state == MEASURED
    turning = ((state == STEERING) & np.isfinite(one.acceleration_mps2 + one.sigma_mps2)
               & (np.abs(one.acceleration_mps2) < MAX_MPS2))
    spreads = _spread(one.cos_yaw, one.sin_yaw, counted, turning) >= MIN_SPREAD
    acceleration, sigma, offset = one.acceleration_mps2, one.sigma_mps2, float("nan")
    if config.measured_by == BY_IMU:
        acceleration, sigma = one.force_mps2 - _bias(one, counted | turning, spreads), one.force_sigma_mps2
        spreads = False  # an accelerometer measures what the car would do on level ground
    elif drive.pitch is not None and np.isfinite(one.pitch_rad).all() and counted.any():
        # The part of the pitch that doesn't turn with the heading: a plane ground's would.
        offset = _constant_part(one.pitch_rad, one, counted | turning) if spreads else 0.0
        pitch = one.pitch_rad - offset
        state[counted & (np.abs(pitch) > MAX_PITCH_RAD)] = STEEP
        acceleration = acceleration - GRAVITY_MPS2 * np.sin(np.nan_to_num(pitch))
        spreads = False  # gravity is subtracted already
    if spreads:
        state[turning] = TURNING
    state[(state == MEASURED) & ~np.isfinite(acceleration)] = NOT_MEASURED
    return one._replace(acceleration_mps2=acceleration, state=state,
                        sigma_mps2=np.hypot(np.nan_to_num(sigma), MIN_SIGMA_MPS2)), spreads, offset


def _spread(cos, sin, counted, turning):
    """Return how much headings spread; see MIN_SPREAD."""
    if counted.sum() < 10:
        return 0.0
    within = within_turns(turning, np.zeros(turning.size, int))
    shows = counted | within.diagonal().astype(bool) & turning
    columns = (within @ np.stack((cos, sin), axis=1))[shows]
    constant = counted[shows].astype(float)
    apart = constant - columns @ np.linalg.lstsq(columns, constant, rcond=1e-6)[0]
    return float(apart @ apart / constant.sum())


def within_turns(turning: np.ndarray, drive: np.ndarray) -> sparse.csr_matrix:
    """Return a matrix (W, W) that subtracts its mean from each turn, clears short turns, and leaves the rest alone, by
    whether each window is in a turn and by its drive, (W,) both.
    """
    begins = turning & np.append(True, ~turning[:-1] | (np.diff(drive) > 0))
    number = np.maximum(np.cumsum(begins) - 1, 0)  # of a window's turn
    size = np.bincount(number[turning], minlength=1)[number]
    is_long = turning & (size >= MIN_TURN)
    long = np.flatnonzero(is_long)
    member = sparse.csr_matrix((size[long] ** -0.5, (number[long], long)), shape=(turning.size, turning.size))
    return (sparse.diags(np.where(turning & ~is_long, 0.0, 1.0)) - member.T @ member).tocsr()


def _bias(one, counted, spreads):
    """Return the IMU's bias against the wheels: the part of the difference that isn't the ground's."""
    known = counted & np.isfinite(one.force_mps2)
    if not known.any():
        return 0.0
    apart = one.force_mps2 - one.acceleration_mps2
    return _constant_part(apart, one, known) if spreads else float(np.median(apart[known]))


def _constant_part(y, one, counted):
    columns = np.stack((np.ones(counted.sum()), one.cos_yaw[counted], one.sin_yaw[counted]), axis=1)
    return float(np.linalg.lstsq(columns, y[counted], rcond=None)[0][0])


def _left_out(state, which, reason):
    """Return the states (W,) without those windows: they don't count for a reason, nor do they show the slope."""
    state = np.where(which & (state == MEASURED), reason, state)
    return np.where(which & (state == TURNING), STEERING, state)


def by_rule(state: np.ndarray) -> dict[str, int]:
    """Return how many windows count, and how many don't for each reason."""
    state = np.where(state == TURNING, STEERING, state)
    return {text: int((state == rule).sum()) for rule, text in ((MEASURED, "counted"), *RULES.items())}


def why_nothing(state: np.ndarray) -> str:
    """Return the reasons for which most windows don't count, as text."""
    counts = sorted(((number, text) for text, number in by_rule(state).items() if number), reverse=True)
    return "; ".join(f"{number} × {text}" for number, text in counts[:3]) or "the drive is shorter than a window"
