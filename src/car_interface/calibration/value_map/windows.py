"""Windows of drives, as the fit of a value map takes them: which count, and why the others don't.

Gathers every drive's windows into long columns, takes gravity off where a pitch is known, and has the value under a
delay along each window. Stops, gear changes, steering, slip, silence: what doesn't count says by which rule.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import sparse

from car_interface.calibration.value_map import acceleration as cut
from car_interface.calibration.value_map.acceleration import Windows, windows

GRAVITY_MPS2 = 9.81
SPREAD = 0.1  # of headings: what cos and sin of yaw leave unexplained of a constant; 1 all round, and there and back
MIN_TURN = 5  # windows in a row

# Why a window doesn't count, in the order in which it is asked.
RULES = {
    cut.BACKWARD: "rolling backward",
    cut.STANDING: "a stop, or slower than the slowest speed",
    cut.TURNED_ROUND: "a gear change: the car had just rolled backward",
    cut.NOTHING_MEASURED: "too few pulses or speeds",
    cut.STEERING: "steering: a tight turn, or tyres at work",
    cut.SLIPPING: "wheel slip: more than tyres hold, or wheels that disagree",
}
NO_VALUE, NOT_DRIVEN, BEYOND, STEEP, OUTLYING = range(10, 15)
TURNING = 15  # steering, but good enough to tell the slope
RULES.update({
    NO_VALUE: "no value, or one that had fallen silent",
    NOT_DRIVEN: "the value didn't reach the actuator",
    BEYOND: "beyond the map's axes",
    STEEP: "ground steeper than the steepest pitch",
    OUTLYING: "fits nothing else that the car did",
})


@dataclass
class Data:
    """All windows of all drives, one under the other."""

    windows: list[Windows]
    drive: np.ndarray
    acceleration: np.ndarray
    sigma: np.ndarray
    slope: np.ndarray  # one column pair for each drive, of the gravity that a slope adds
    sees_slope: np.ndarray  # of each drive
    part: np.ndarray  # of its drive's time that a window is from the middle, -0.5..0.5
    hop_s: np.ndarray  # how much driving a window stands for
    state: np.ndarray
    pitch_offset: list[float]


class Sampled(NamedTuple):
    """The values under one delay: along each window, and what became of windows because of them."""

    value: np.ndarray
    state: np.ndarray

def gather(drives, config) -> Data:
    """Cut drives up, and judge their windows by everything but the value."""
    found, slopes, parts, offsets, sees = [], [], [], [], []
    accelerations, sigmas, states, numbers, hops = [], [], [], [], []
    for index, drive in enumerate(drives):
        one = windows(drive, config.window)
        state = one.state.copy()
        counted = state == cut.MEASURED
        cos, sin = one.cos_yaw, one.sin_yaw
        turning = ((state == cut.STEERING) & np.isfinite(one.acceleration_mps2 + one.sigma_mps2)
                   & (np.abs(one.acceleration_mps2) < config.window.max_mps2))
        spreads = _spread(cos, sin, counted, turning) >= SPREAD
        acceleration, sigma, offset = one.acceleration_mps2, one.sigma_mps2, float("nan")
        if config.from_imu:
            acceleration, sigma = one.force_mps2 - _bias(one, counted | turning, spreads), one.force_sigma_mps2
            spreads = False  # an accelerometer feels what the car would do on level ground
        elif drive.pitch is not None and np.isfinite(one.pitch_rad).all() and counted.any():
            offset = _pitch_offset(one, counted | turning) if spreads else 0.0
            pitch = one.pitch_rad - offset
            state[counted & (np.abs(pitch) > config.steepest_rad)] = STEEP
            acceleration = acceleration - GRAVITY_MPS2 * np.sin(np.nan_to_num(pitch))
            spreads = False  # gravity is off already
        if spreads:
            state[turning] = TURNING
        found.append(one)
        slope = np.zeros((cos.size, 2 * len(drives)))
        slope[:, 2 * index] = -GRAVITY_MPS2 * cos
        slope[:, 2 * index + 1] = -GRAVITY_MPS2 * sin
        slopes.append(slope)
        begins, ends = drive.speed.t_s[[0, -1]] if drive.speed.t_s.size else (0.0, 1.0)
        parts.append((one.middle_s - (begins + ends) / 2) / max(ends - begins, 1.0))
        offsets.append(offset)
        sees.append(spreads)
        accelerations.append(acceleration)
        sigmas.append(np.hypot(np.nan_to_num(sigma), config.floor_mps2))
        state[(state == cut.MEASURED) & ~np.isfinite(acceleration)] = cut.NOTHING_MEASURED
        states.append(state)
        numbers.append(np.full(cos.size, index))
        hops.append(np.full(cos.size, max(config.window.hop_s, (ends - begins) / cut.MAX_WINDOWS)))
    join = np.concatenate
    return Data(found, join(numbers), join(accelerations), join(sigmas), join(slopes), np.array(sees), join(parts),
                 join(hops), join(states), offsets)


def _spread(cos, sin, counted, turning):
    """What headings leave unexplained of something that is the same at all of them; see SPREAD."""
    if counted.sum() < 10:
        return 0.0
    within = within_turns(turning, np.zeros(turning.size, int))
    told = counted | within.diagonal().astype(bool) & turning
    columns = (within @ np.stack((cos, sin), axis=1))[told]
    constant = counted[told].astype(float)
    apart = constant - columns @ np.linalg.lstsq(columns, constant, rcond=1e-6)[0]
    return float(apart @ apart / constant.sum())


def within_turns(turning, drive):
    """A matrix that takes its mean off each turn, leaves nothing of short ones, and leaves all else alone."""
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
    """What of the pitch doesn't turn with the heading, as a plane ground's would."""
    return _constant_part(one.pitch_rad, one, counted)


def _bias(one, counted, spreads):
    """Of the IMU, against the wheels: what of the difference isn't the ground's."""
    known = counted & np.isfinite(one.force_mps2)
    if not known.any():
        return 0.0
    apart = one.force_mps2 - one.acceleration_mps2
    return _constant_part(apart, one, known) if spreads else float(np.median(apart[known]))


def _constant_part(y, one, counted):
    columns = np.stack((np.ones(counted.sum()), one.cos_yaw[counted], one.sin_yaw[counted]), axis=1)
    return float(np.linalg.lstsq(columns, y[counted], rcond=None)[0][0])


def sample(drives, data, delay_s, config) -> Sampled:
    """The values so much earlier, and the windows judged by them."""
    values, states = [], []
    for index, (drive, one) in enumerate(zip(drives, data.windows)):
        state = data.state[data.drive == index].copy()
        t_s = one.t_s - delay_s
        value, age_s = _held(drive.value, t_s)
        silent = ~np.isfinite(value).all(axis=1) | (age_s > config.value_silent_s).any(axis=1)
        state[(state == cut.MEASURED) & silent] = NO_VALUE
        state[(state == TURNING) & silent] = cut.STEERING
        if drive.driven is not None:
            driven, _ = _held(drive.driven, t_s)
            idle = ~(driven >= 0.5).all(axis=1)
            state[(state == cut.MEASURED) & idle] = NOT_DRIVEN
            state[(state == TURNING) & idle] = cut.STEERING
        values.append(np.where(np.isfinite(value), value, 0.0))
        states.append(state)
    return Sampled(np.concatenate(values), np.concatenate(states))


def _held(series, t_s):
    if not series.t_s.size:
        return np.full(t_s.shape, np.nan), np.full(t_s.shape, np.inf)
    last = np.searchsorted(series.t_s, t_s, side="right") - 1
    known = np.maximum(last, 0)
    return np.where(last >= 0, series.y[known], np.nan), np.where(last >= 0, t_s - series.t_s[known], np.inf)


def on_grid(sampled, speed, grid):
    """States with those windows left out that lie beyond a grid."""
    inside = grid.has(sampled.value, np.nan_to_num(speed)).all(axis=1)
    state = np.where((sampled.state == cut.MEASURED) & ~inside, BEYOND, sampled.state)
    return np.where((state == TURNING) & ~inside, cut.STEERING, state)


def manoeuvres(data, value, state, grid, config):
    """Numbers stretches of driving: a new one where the value jumps, where windows don't count, and after 5 s."""
    mean = value.mean(axis=1)
    jump = 0.05 * np.ptp(grid.rows)
    number, numbers = -1, np.full(state.size, -1)
    begun, before = 0.0, None
    middle = np.concatenate([one.middle_s for one in data.windows])
    for index in np.flatnonzero(state == cut.MEASURED):
        goes_on = (before == index - 1 and data.drive[index] == data.drive[before]
                   and abs(mean[index] - mean[before]) <= jump and middle[index] - begun <= 5.0)
        if not goes_on:
            number, begun = number + 1, middle[index]
        numbers[index] = number
        before = index
    return numbers


def by_rule(state) -> dict[str, int]:
    """How many windows count, and how many don't by each rule."""
    state = np.where(state == TURNING, cut.STEERING, state)
    counts = {"counted": int((state == cut.MEASURED).sum())}
    counts.update({text: int((state == rule).sum()) for rule, text in RULES.items()})
    return counts


def why_nothing(state) -> str:
    """The rules by which most windows went, in words."""
    counts = sorted(((number, text) for text, number in by_rule(state).items() if number), reverse=True)
    return "; ".join(f"{number} × {text}" for number, text in counts[:3]) or "the drive is shorter than a window"
