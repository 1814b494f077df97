"""The windows of all drives as the fit of a value map takes them: which count, and for which reason others don't.

Gathers every drive's windows into columns, subtracts gravity where a pitch is known, and samples the value under a
delay along each window. W windows of P points each, of D drives.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import Sequence

import numpy as np
from scipy import sparse

from car_interface.tools.calibration.value_map import acceleration as windowing
from car_interface.tools.calibration.value_map.acceleration import MapDrive, MapFitConfig, Windows, windows
from car_interface.tools.calibration.value_map.surface import Grid

GRAVITY_MPS2 = 9.81
MAX_PITCH_RAD = 0.15  # beyond it a window doesn't count
MIN_SIGMA_MPS2 = 0.03  # no window's acceleration is known better: floors are uneven, tyres flex
MIN_SPREAD = 0.1  # of headings: the part of a constant that cos and sin of yaw can't explain; 1 for all round
MIN_TURN = 5  # windows in a row
VALUE_JUMP = 0.05  # of the range of values: more begins another manoeuvre
MANOEUVRE_S = 5.0
NO_VALUE, NOT_DRIVEN, BEYOND, STEEP, OUTLYING = range(10, 15)
TURNING = 15  # steering, but good enough to show the slope
# Why a window doesn't count.
RULES = {
    windowing.BACKWARD: "rolling backward",
    windowing.STANDING: "a stop, or slower than the slowest speed",
    windowing.GEAR_CHANGE: "a gear change: the car had just rolled backward",
    windowing.NOT_MEASURED: "too few pulses or speeds",
    windowing.STEERING: "steering: a tight turn, or tyres at work",
    windowing.SLIPPING: "wheel slip: more than tyres hold, or wheels that disagree",
    NO_VALUE: "no value, or one that had timed out",
    NOT_DRIVEN: "the value didn't reach the actuator",
    BEYOND: "beyond the map's axes",
    STEEP: "ground steeper than the steepest pitch",
    OUTLYING: "fits nothing else that the car did",
}


@dataclass
class Data:
    """All windows of all drives."""

    windows: Windows  # their acceleration that on level ground; their state also TURNING, STEEP
    drive: np.ndarray  # each window's drive, (W,)
    part: np.ndarray  # the time from its drive's middle, as a ratio of the drive, −0.5..0.5, (W,)
    hop_s: np.ndarray  # how much driving a window stands for, (W,)
    slope: np.ndarray  # gravity per slope of each drive's ground along x and y, (W, 2·D)
    sees_slope: np.ndarray  # whether a drive shows its slope, (D,)
    pitch_offset: Sequence[float]  # of each drive's sensor in rad; NaN without


def gather(drives: Sequence[MapDrive], config: MapFitConfig) -> Data:
    """Divide drives into windows, and find which count by everything but the value."""
    found, columns, sees_slope, offset = zip(*(_gather(drive, config) for drive in drives))
    number = np.repeat(np.arange(len(drives)), [one.middle_s.size for one in found])
    together = Windows(*map(np.concatenate, zip(*found)))
    slope, at = np.zeros((number.size, 2 * len(drives))), np.arange(number.size)
    slope[at, 2 * number] = -GRAVITY_MPS2 * together.cos_yaw
    slope[at, 2 * number + 1] = -GRAVITY_MPS2 * together.sin_yaw
    return Data(together, number, *map(np.concatenate, zip(*columns)), slope, np.array(sees_slope), offset)


def _gather(drive, config):
    """Return (one drive's windows, two columns of Data, whether it shows its slope, its pitch's offset)."""
    one = windows(drive, config)
    state = one.state.copy()
    counted = state == windowing.MEASURED
    turning = ((state == windowing.STEERING) & np.isfinite(one.acceleration_mps2 + one.sigma_mps2)
               & (np.abs(one.acceleration_mps2) < windowing.MAX_MPS2))
    spreads = _spread(one.cos_yaw, one.sin_yaw, counted, turning) >= MIN_SPREAD
    acceleration, sigma, offset = one.acceleration_mps2, one.sigma_mps2, float("nan")
    if config.from_imu:
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
    state[(state == windowing.MEASURED) & ~np.isfinite(acceleration)] = windowing.NOT_MEASURED
    begin_s, end_s = drive.speed.t_s[[0, -1]] if drive.speed.t_s.size else (0.0, 1.0)
    hop_s = max(windowing.HOP_S, (end_s - begin_s) / windowing.MAX_WINDOWS)
    part = (one.middle_s - (begin_s + end_s) / 2) / max(end_s - begin_s, 1.0)
    found = one._replace(acceleration_mps2=acceleration, state=state,
                         sigma_mps2=np.hypot(np.nan_to_num(sigma), MIN_SIGMA_MPS2))
    return found, (part, np.full(state.size, hop_s)), spreads, offset


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


def sample(drives: Sequence[MapDrive], data: Data, delay_s: float,
           config: MapFitConfig) -> tuple[np.ndarray, np.ndarray]:
    """Return (the values ``delay_s`` earlier along each window (W, P), the windows' states by them, too (W,))."""
    values, timed_out, idle = [], [], []
    for index, drive in enumerate(drives):
        t_s = data.windows.t_s[data.drive == index] - delay_s
        value, age_s = _held(drive.value, t_s)
        driven = np.ones(t_s.shape) if drive.driven is None else _held(drive.driven, t_s)[0]
        values.append(value)
        timed_out.append(~np.isfinite(value).all(axis=1) | (age_s > config.value_timeout_s).any(axis=1))
        idle.append(~(driven >= 0.5).all(axis=1))
    value = np.concatenate(values)
    state = _left_out(data.windows.state, np.concatenate(timed_out), NO_VALUE)
    return np.where(np.isfinite(value), value, 0.0), _left_out(state, np.concatenate(idle), NOT_DRIVEN)


def _left_out(state, which, reason):
    """Return the states (W,) without those windows: they don't count for a reason, nor do they show the slope."""
    state = np.where(which & (state == windowing.MEASURED), reason, state)
    return np.where(which & (state == TURNING), windowing.STEERING, state)


def _held(series, t_s):
    """Return (the newest sample at each time, its age in s), of the shape of ``t_s``; NaN and inf before the first."""
    if not series.t_s.size:
        return np.full(t_s.shape, np.nan), np.full(t_s.shape, np.inf)
    last = np.searchsorted(series.t_s, t_s, side="right") - 1
    known = np.maximum(last, 0)
    return np.where(last >= 0, series.y[known], np.nan), np.where(last >= 0, t_s - series.t_s[known], np.inf)


def on_grid(data: Data, value: np.ndarray, state: np.ndarray, grid: Grid) -> np.ndarray:
    """Return the states (W,) with windows left out that lie beyond a grid; the value is (W, P)."""
    return _left_out(state, ~grid.has(value, np.nan_to_num(data.windows.speed_mps)).all(axis=1), BEYOND)


def manoeuvres(data: Data, value: np.ndarray, state: np.ndarray, grid: Grid) -> np.ndarray:
    """Return the number of each window's manoeuvre (W,), −1 for windows that don't count.

    A new one begins where the value jumps, after windows that don't count, and after MANOEUVRE_S.
    """
    mean = value.mean(axis=1)
    jump = VALUE_JUMP * np.ptp(grid.rows)
    number, numbers = -1, np.full(state.size, -1)
    begun, before, middle = 0.0, None, data.windows.middle_s
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
