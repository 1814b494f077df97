"""The windows of all drives as the fit of a value map takes them: which count, and for which reason others don't.

Gathers every drive's windows into columns, subtracts gravity where a pitch is known, and samples the value under a
delay along each window. W windows of P points each, of D drives.
"""
from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple, Sequence

import numpy as np
from scipy import sparse

from car_interface.tools.calibration.value_map import acceleration as windowing
from car_interface.tools.calibration.value_map.acceleration import MapDrive, WindowConfig, Windows, windows
from car_interface.tools.calibration.value_map.surface import Grid, Roughness

# Rows: a throttle curve's (6·u^1.5 has 9 on the average, over a value axis taken as 1). Columns, per (m/s)²: a motor's
# that has half its thrust at 9 m/s.
ROUGHNESS = Roughness(8.0, 0.15)
GRAVITY_MPS2 = 9.81
MIN_SPREAD = 0.1  # of headings: the part of a constant that cos and sin of yaw can't explain; 1 for all round
MIN_TURN = 5  # windows in a row
VALUE_JUMP = 0.05  # of the range of values: more begins another manoeuvre
MANOEUVRE_S = 5.0
# Why a window doesn't count.
RULES = {
    windowing.BACKWARD: "rolling backward",
    windowing.STANDING: "a stop, or slower than the slowest speed",
    windowing.GEAR_CHANGE: "a gear change: the car had just rolled backward",
    windowing.NOT_MEASURED: "too few pulses or speeds",
    windowing.STEERING: "steering: a tight turn, or tyres at work",
    windowing.SLIPPING: "wheel slip: more than tyres hold, or wheels that disagree",
}
NO_VALUE, NOT_DRIVEN, BEYOND, STEEP, OUTLYING = range(10, 15)
TURNING = 15  # steering, but good enough to show the slope


@dataclass(frozen=True)
class MapFitConfig:
    """How a map is fitted, and what supports one.

    Attributes:
        window: how drives are divided into windows.
        neutral: the value at which the actuator neither drives nor brakes; the map may bend there.
        value_timeout_s: a value counts for no longer than this.
        max_pitch_rad: beyond it a window doesn't count.
        roughness: the expected second derivatives of the map.
        min_sigma_mps2: no window's acceleration is known better: floors are uneven, tyres flex.
        support_s, support_manoeuvres, support_sigma_mps2: a node is supported by at least this much driving around
            it, in this many manoeuvres, if its standard error is at most this.
        delay_s: from value to acceleration; ``None`` = estimated.
        from_imu: accelerations are the IMU's; the wheels' only give its bias.
    """

    window: WindowConfig = field(default_factory=WindowConfig)
    neutral: float = 0.0
    value_timeout_s: float = 0.5
    max_pitch_rad: float = 0.15
    roughness: Roughness = ROUGHNESS
    min_sigma_mps2: float = 0.03
    support_s: float = 0.1
    support_manoeuvres: int = 2
    support_sigma_mps2: float = 0.08
    delay_s: float | None = None
    from_imu: bool = False


DEFAULTS = MapFitConfig()


RULES.update({
    NO_VALUE: "no value, or one that had timed out",
    NOT_DRIVEN: "the value didn't reach the actuator",
    BEYOND: "beyond the map's axes",
    STEEP: "ground steeper than the steepest pitch",
    OUTLYING: "fits nothing else that the car did",
})


@dataclass
class Data:
    """All windows of all drives, one drive after the other.

    Attributes:
        windows: of each drive.
        drive: each window's drive, (W,).
        acceleration, sigma: in m/s², and its standard error, (W,).
        slope: gravity per slope of each drive's ground along x and y, (W, 2·D).
        sees_slope: whether a drive shows its slope, (D,).
        part: the time from its drive's middle, as a ratio of the drive, −0.5..0.5, (W,).
        hop_s: how much driving a window stands for, (W,).
        state: MEASURED, TURNING, or why a window doesn't count, (W,).
        pitch_offset: of each drive's sensor in rad; NaN without.
    """

    windows: list[Windows]
    drive: np.ndarray
    acceleration: np.ndarray
    sigma: np.ndarray
    slope: np.ndarray
    sees_slope: np.ndarray
    part: np.ndarray
    hop_s: np.ndarray
    state: np.ndarray
    pitch_offset: list[float]


class ValuesBefore(NamedTuple):
    """The values under one delay."""

    value: np.ndarray  # along each window, (W, P)
    state: np.ndarray  # of the windows, by their values too, (W,)


class _Gathered(NamedTuple):
    """The windows of one drive; see Data."""

    windows: Windows
    acceleration: np.ndarray
    sigma: np.ndarray
    sees_slope: bool
    part: np.ndarray
    hop_s: np.ndarray
    state: np.ndarray
    pitch_offset: float


def gather(drives: Sequence[MapDrive], config: MapFitConfig) -> Data:
    """Divide drives into windows, and find which count by everything but the value."""
    gathered = [_gather(drive, config) for drive in drives]
    counts = [one.state.size for one in gathered]
    slope = np.zeros((sum(counts), 2 * len(drives)))
    number = np.repeat(np.arange(len(drives)), counts)
    for index, one in enumerate(gathered):
        slope[number == index, 2 * index] = -GRAVITY_MPS2 * one.windows.cos_yaw
        slope[number == index, 2 * index + 1] = -GRAVITY_MPS2 * one.windows.sin_yaw

    def column(name):
        return np.concatenate([getattr(one, name) for one in gathered])

    return Data([one.windows for one in gathered], number, column("acceleration"), column("sigma"), slope,
                np.array([one.sees_slope for one in gathered]), column("part"), column("hop_s"), column("state"),
                [one.pitch_offset for one in gathered])


def _gather(drive, config):
    one = windows(drive, config.window)
    state = one.state.copy()
    counted = state == windowing.MEASURED
    turning = ((state == windowing.STEERING) & np.isfinite(one.acceleration_mps2 + one.sigma_mps2)
               & (np.abs(one.acceleration_mps2) < config.window.max_mps2))
    spreads = _spread(one.cos_yaw, one.sin_yaw, counted, turning) >= MIN_SPREAD
    acceleration, sigma, offset = one.acceleration_mps2, one.sigma_mps2, float("nan")
    if config.from_imu:
        acceleration, sigma = one.force_mps2 - _bias(one, counted | turning, spreads), one.force_sigma_mps2
        spreads = False  # an accelerometer measures what the car would do on level ground
    elif drive.pitch is not None and np.isfinite(one.pitch_rad).all() and counted.any():
        offset = _pitch_offset(one, counted | turning) if spreads else 0.0
        pitch = one.pitch_rad - offset
        state[counted & (np.abs(pitch) > config.max_pitch_rad)] = STEEP
        acceleration = acceleration - GRAVITY_MPS2 * np.sin(np.nan_to_num(pitch))
        spreads = False  # gravity is subtracted already
    if spreads:
        state[turning] = TURNING
    state[(state == windowing.MEASURED) & ~np.isfinite(acceleration)] = windowing.NOT_MEASURED
    begin_s, end_s = drive.speed.t_s[[0, -1]] if drive.speed.t_s.size else (0.0, 1.0)
    hop_s = max(config.window.hop_s, (end_s - begin_s) / windowing.MAX_WINDOWS)
    return _Gathered(one, acceleration, np.hypot(np.nan_to_num(sigma), config.min_sigma_mps2), spreads,
                     (one.middle_s - (begin_s + end_s) / 2) / max(end_s - begin_s, 1.0),
                     np.full(state.size, hop_s), state, offset)


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
    """Return a matrix (W, W) that subtracts its mean from each turn, clears short turns, and leaves the rest alone.

    Args:
        turning: which windows are in a turn, (W,).
        drive: each window's drive, (W,).
    """
    windows = turning.size
    index = np.flatnonzero(turning)
    turns = np.split(index, np.flatnonzero((np.diff(index) > 1) | (np.diff(drive[index]) > 0)) + 1)
    number = np.full(windows, -1)
    for turn, members in enumerate(turns):
        number[members] = turn if members.size >= MIN_TURN else -1
    long = np.flatnonzero(number >= 0)
    member = sparse.csr_matrix((np.ones(long.size), (number[long], long)), shape=(max(1, len(turns)), windows))
    size = np.maximum(1.0, np.asarray(member.sum(axis=1)).ravel())
    keep = np.where(turning & (number < 0), 0.0, 1.0)
    return (sparse.diags(keep) - member.T @ sparse.diags(1.0 / size) @ member).tocsr()


def _pitch_offset(one, counted):
    """Return the part of the pitch that doesn't turn with the heading: a plane ground's would."""
    return _constant_part(one.pitch_rad, one, counted)


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


def sample(drives: Sequence[MapDrive], data: Data, delay_s: float, config: MapFitConfig) -> ValuesBefore:
    """Return the values ``delay_s`` earlier, and the windows' states by them."""
    values, states = [], []
    for index, (drive, one) in enumerate(zip(drives, data.windows)):
        state = data.state[data.drive == index].copy()
        t_s = one.t_s - delay_s
        value, age_s = _held(drive.value, t_s)
        timed_out = ~np.isfinite(value).all(axis=1) | (age_s > config.value_timeout_s).any(axis=1)
        state[(state == windowing.MEASURED) & timed_out] = NO_VALUE
        state[(state == TURNING) & timed_out] = windowing.STEERING
        if drive.driven is not None:
            driven, _ = _held(drive.driven, t_s)
            idle = ~(driven >= 0.5).all(axis=1)
            state[(state == windowing.MEASURED) & idle] = NOT_DRIVEN
            state[(state == TURNING) & idle] = windowing.STEERING
        values.append(np.where(np.isfinite(value), value, 0.0))
        states.append(state)
    return ValuesBefore(np.concatenate(values), np.concatenate(states))


def _held(series, t_s):
    """Return (the newest sample at each time, its age in s), of the shape of ``t_s``; NaN and inf before the first."""
    if not series.t_s.size:
        return np.full(t_s.shape, np.nan), np.full(t_s.shape, np.inf)
    last = np.searchsorted(series.t_s, t_s, side="right") - 1
    known = np.maximum(last, 0)
    return np.where(last >= 0, series.y[known], np.nan), np.where(last >= 0, t_s - series.t_s[known], np.inf)


def on_grid(sampled: ValuesBefore, speed: np.ndarray, grid: Grid) -> np.ndarray:
    """Return the states (W,) with windows left out that lie beyond a grid; speed in m/s, (W, P)."""
    inside = grid.has(sampled.value, np.nan_to_num(speed)).all(axis=1)
    state = np.where((sampled.state == windowing.MEASURED) & ~inside, BEYOND, sampled.state)
    return np.where((state == TURNING) & ~inside, windowing.STEERING, state)


def manoeuvres(data: Data, value: np.ndarray, state: np.ndarray, grid: Grid) -> np.ndarray:
    """Return the number of each window's manoeuvre (W,), −1 for windows that don't count.

    A new one begins where the value jumps, after windows that don't count, and after MANOEUVRE_S.
    """
    mean = value.mean(axis=1)
    jump = VALUE_JUMP * np.ptp(grid.rows)
    number, numbers = -1, np.full(state.size, -1)
    begun, before = 0.0, None
    middle = np.concatenate([one.middle_s for one in data.windows])
    for index in np.flatnonzero(state == windowing.MEASURED):
        goes_on = (before == index - 1 and data.drive[index] == data.drive[before]
                   and abs(mean[index] - mean[before]) <= jump and middle[index] - begun <= MANOEUVRE_S)
        if not goes_on:
            number, begun = number + 1, middle[index]
        numbers[index] = number
        before = index
    return numbers


def by_rule(state: np.ndarray) -> dict[str, int]:
    """Return how many windows count, and how many don't for each reason."""
    state = np.where(state == TURNING, windowing.STEERING, state)
    counts = {"counted": int((state == windowing.MEASURED).sum())}
    counts.update({text: int((state == rule).sum()) for rule, text in RULES.items()})
    return counts


def why_nothing(state: np.ndarray) -> str:
    """Return the reasons for which most windows don't count, as text."""
    counts = sorted(((number, text) for text, number in by_rule(state).items() if number), reverse=True)
    return "; ".join(f"{number} × {text}" for number, text in counts[:3]) or "the drive is shorter than a window"
