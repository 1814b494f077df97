"""Accelerations of a drive → a value map: the level-ground acceleration at mean battery over value and velocity.

What is fitted, to every window that counts, by weighted least squares that discount outliers:

    acceleration = mean under φ of [ f + k(t)·(f − f at neutral) ] + g·(a·cos yaw + b·sin yaw)

- f is the map: bilinear on its grid, smooth, rising with value by construction, the value taken ``delay_s`` earlier.
- k is what the battery gives at time t, in proportion to its distance from the drive's middle; apart for values above
  neutral and below it (an ESC brakes without the battery). The map is that of the middle.
- a, b are a plane ground's slope in the heading's own frame. With a pitch sensor gravity is taken off by that instead,
  and what of the pitch doesn't turn with the heading is the sensor's mounting. Both need headings all round: where the
  headings of a drive don't spread, a slope can't be told from drag, and is left alone. Tight turns, whose tyres brake,
  don't count for the map, but what changes within a turn as the heading goes round tells the slope.

The delay is the one under which this model fits best. A node is supported where enough driving, in enough manoeuvres,
lies around it and its standard error is small. No other node is the drive's to state.
"""
from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple, Sequence

import numpy as np
from scipy import sparse

from car_interface.calibration.value_map import acceleration as cut
from car_interface.calibration.value_map.acceleration import Drive, WindowConfig
from car_interface.calibration.value_map.surface import Grid, Roughness, penalties, rising_least_squares
from car_interface.calibration.value_map.windows import (
    BEYOND,
    OUTLYING,
    TURNING,
    by_rule,
    gather,
    manoeuvres,
    on_grid,
    sample,
    why_nothing,
    within_turns,
)

DECIMALS = 3  # of a map's CSV, as Autoware's calibrators write it
RESOLUTION_MPS2 = 10.0**-DECIMALS
# A step of two roundings' width is still one when both of its ends have been rounded towards each other.
MIN_STEP_MPS2 = 2 * RESOLUTION_MPS2
# A throttle curve's (6·u^1.5 has 9 on the average, over a value axis taken as 1); and, per (m/s)², a motor's that has
# half its thrust at 9 m/s.
ROUGHNESS = Roughness(8.0, 0.15)
SLOPE_SIGMA, SAG_SIGMA = 0.05, 0.15  # what is to be expected of a slope, and of a battery in one drive
HUBER = 2.0  # residuals beyond so many sigmas count less
OUTLIER = 5.0  # and beyond so many don't count
PASSES = 6
HELD_OUT = 5
MIN_S = 0.03  # of driving around a node, for a manoeuvre to count there
NEAR = 0.25  # of the step between rows: so far from neutral there are two more
BENDS = 0.05  # so near to neutral, as a share of the values, the map may bend as it likes
DELAYS_S = np.array([0.0, 0.6])  # the least and the most that is looked at
TELLING = 9.0  # what the squares must get worse by, or they tell nothing: three sigmas


@dataclass(frozen=True)
class FitConfig:
    """How a map is fitted, and what supports one.

    Attributes:
        window: how drives are cut up.
        neutral: the value at which the actuator neither drives nor brakes; the map may bend there.
        value_silent_s: a value holds no longer than this.
        steepest_rad: pitch beyond which a window doesn't count.
        roughness: what the map's second derivatives may be expected to be.
        floor_mps2: no window is better than this: floors are uneven, and tyres flex.
        support_s, support_manoeuvres, support_sigma_mps2: a node is supported by at least so much driving around it,
            in so many manoeuvres, if its standard error is at most this.
        delay_s: ``None`` = estimate it.
        from_imu: accelerations are the IMU's; the wheels' only tell its bias.
    """

    window: WindowConfig = field(default_factory=WindowConfig)
    neutral: float = 0.0
    value_silent_s: float = 0.5
    steepest_rad: float = 0.15
    roughness: Roughness = ROUGHNESS
    floor_mps2: float = 0.03
    support_s: float = 0.1
    support_manoeuvres: int = 2
    support_sigma_mps2: float = 0.08
    delay_s: float | None = None
    from_imu: bool = False


class Ground(NamedTuple):
    """What was found of one drive besides the map.

    Attributes:
        uphill: the slope in the direction of yaw 0, and in that of 90° to its left; NaN where headings don't spread.
        sag_above, sag_below: the share of its push that a value above (below) neutral loses from the start to the end.
        sag_sigma: their standard errors.
        pitch_offset_rad: of the pitch sensor; NaN without.
    """

    uphill: tuple[float, float]
    sag_above: float
    sag_below: float
    sag_sigma: tuple[float, float]
    pitch_offset_rad: float


@dataclass(frozen=True)
class Fit:
    """A map, and how well it is known.

    Attributes:
        values, velocities: its axes.
        accelerations: a row for each value, in m/s², rounded to the CSV's decimals; every column rises.
        sigma_mps2: standard error of each.
        seconds, manoeuvres: of driving around each.
        supported: which of them the drives support.
        sure: whose standard error is small, be there driving around them or not.
        delay_s, delay_sigma_s: from value to acceleration; the second is NaN where it was given or can't be told.
        grounds: one for each drive.
        rejected: windows by rule; those that count are under "counted".
        residual_mps2: RMS over windows that count.
        held_out_mps2, held_out_windows: the same over every 5th manoeuvre, from a fit to the others; NaN if there are
            too few.
    """

    values: np.ndarray
    velocities: np.ndarray
    accelerations: np.ndarray
    sigma_mps2: np.ndarray
    seconds: np.ndarray
    manoeuvres: np.ndarray
    supported: np.ndarray
    sure: np.ndarray
    delay_s: float
    delay_sigma_s: float
    grounds: tuple[Ground, ...]
    rejected: dict[str, int]
    residual_mps2: float
    held_out_mps2: float
    held_out_windows: int


class NothingToFit(ValueError):
    """Drives without a single window that counts; the text says by which rules the windows went."""


@np.errstate(invalid="ignore")  # NaN, for what wasn't measured, compares as false
def fit(drives: Sequence[Drive], values: np.ndarray | None, velocities: np.ndarray | None,
        config: FitConfig = FitConfig()) -> Fit:
    """Fit a map to drives.

    Args:
        drives: at least one.
        values, velocities: the map's axes; ``None`` = chosen to fit what was driven.
        config: see there.

    Raises:
        NothingToFit: no window counts.
    """
    data = gather(drives, config)
    counted = data.state == cut.MEASURED
    if not counted.any():
        raise NothingToFit(why_nothing(data.state))
    sampled = sample(drives, data, config.delay_s if config.delay_s is not None else 0.1, config)
    inside = sampled.state == cut.MEASURED
    if not inside.any():
        raise NothingToFit(why_nothing(sampled.state))
    speed = np.concatenate([one.speed_mps for one in data.windows])
    grid = Grid(_value_axis(sampled.value[inside], config.neutral) if values is None else np.asarray(values, float),
                _round_axis(speed[inside], 0.0, 8) if velocities is None else np.asarray(velocities, float))
    delay_s, delay_sigma_s = (config.delay_s, float("nan")) if config.delay_s is not None else _delay(
        drives, data, grid, speed, config)
    sampled = sample(drives, data, delay_s, config)
    state = on_grid(sampled, speed, grid)
    if not (state == cut.MEASURED).any():
        raise NothingToFit(why_nothing(state))
    rows = _Rows(grid, data, sampled.value, speed, config)
    manoeuvre = manoeuvres(data, sampled.value, state, grid, config)
    solved = _solve(rows, state, config)
    state = np.where((state == cut.MEASURED) & solved.outlying, OUTLYING, state)
    seconds, count = _coverage(rows, state, manoeuvre)
    sigma = _standard_errors(rows, solved, state, manoeuvre)
    sure = sigma <= config.support_sigma_mps2
    supported = sure & (seconds >= config.support_s) & (count >= config.support_manoeuvres)
    held_out_mps2, held_out_windows = _hold_out(rows, state, manoeuvre, config)
    used = state == cut.MEASURED
    shape = (grid.rows.size, grid.columns.size)
    grounds = tuple(_ground(index, data, solved) for index in range(len(drives)))
    return Fit(grid.rows, grid.columns, rounded(solved.nodes.reshape(shape)), sigma.reshape(shape),
               seconds.reshape(shape), count.reshape(shape), supported.reshape(shape), sure.reshape(shape),
               float(delay_s), float(delay_sigma_s), grounds, by_rule(state), _rms(solved.residual[used]),
               held_out_mps2, held_out_windows)


# --- data ---


def rounded(accelerations: np.ndarray) -> np.ndarray:
    """To the CSV's decimals, as numbers that rise along every column: rows that rise by MIN_STEP_MPS2 still rise."""
    counts = np.round(accelerations / RESOLUTION_MPS2).astype(np.int64)
    for row in range(1, counts.shape[0]):
        counts[row] = np.maximum(counts[row], counts[row - 1] + 1)
    return counts / 10.0**DECIMALS


def _value_axis(value, neutral):
    """Round numbers over what was driven; and two near neutral, where an ESC's curve bends."""
    axis = _round_axis(value, neutral, 10)
    near = neutral + np.array([-NEAR, NEAR]) * (axis[1] - axis[0])
    return np.union1d(axis, near[(near > axis[0]) & (near < axis[-1])])


def _round_axis(x, zero, wanted):
    """Round numbers, ``zero`` among them, about as many as wanted: as far as a quarter of their step past the data."""
    low, high = min(float(np.min(x)), zero), max(float(np.max(x)), zero)
    rough = max(high - low, 1e-6) / wanted
    power = 10.0 ** np.floor(np.log10(rough))
    step = power * min((1.0, 2.0, 2.5, 5.0, 10.0), key=lambda factor: abs(factor * power - rough))
    first, last = int(np.floor((low - zero) / step + 0.25)), int(np.ceil((high - zero) / step - 0.25))
    return np.round(zero + step * np.arange(first, max(last, first + 1) + 1), 9)


# --- the model ---

class _Rows:
    """The model's matrices under one delay."""

    def __init__(self, grid, data, value, speed, config, sags=True):
        self.grid, self.data, self.config = grid, data, config
        weight = np.concatenate([one.weight for one in data.windows])
        speed = np.nan_to_num(speed)
        self.map = grid.averages(value, speed, weight)
        # What a value adds to coasting, above neutral and below: what sags.
        above = value > config.neutral
        coasting = np.full(value.shape, config.neutral)
        self.push = [grid.averages(value, speed, weight * side) - grid.averages(coasting, speed, weight * side)
                     for side in (above, ~above)] if sags else []
        kinks = np.abs(grid.rows - config.neutral) <= BENDS * np.ptp(grid.rows)
        rough = penalties(grid, config.roughness, kinks)
        self.penalty = (rough.T @ rough).toarray()


@dataclass
class _Solved:
    nodes: np.ndarray
    slope: np.ndarray
    sag: np.ndarray  # for each drive: above, below
    residual: np.ndarray
    weight: np.ndarray
    outlying: np.ndarray
    columns: sparse.csr_matrix
    normal: np.ndarray
    prior: np.ndarray


def _solve(rows, state, config, rising=True, passes=PASSES):
    """Gauss-Newton over the battery's part, with Huber's weights."""
    data, grid = rows.data, rows.grid
    used = (state == cut.MEASURED) | (state == TURNING)
    within = within_turns(state == TURNING, data.drive)
    drives = data.sees_slope.size
    sag = np.zeros((drives, 2))
    # A step below the CSV's decimals is none; where the map hardly rises it rises by that.
    least = np.full(grid.rows.size - 1, MIN_STEP_MPS2)
    weight = np.where(used, 1.0 / data.sigma**2, 0.0)
    nodes, spread, outlying = None, 1.0, np.zeros(used.size, bool)
    prior = np.zeros((grid.size + 4 * drives,) * 2)
    prior[:grid.size, :grid.size] = rows.penalty + 1e-8 * np.eye(grid.size)
    slope_at = np.arange(grid.size, grid.size + 2 * drives)
    sag_at = np.arange(grid.size + 2 * drives, grid.size + 4 * drives)
    prior[slope_at, slope_at] = np.where(np.repeat(data.sees_slope, 2), SLOPE_SIGMA**-2, 1e12)
    prior[sag_at, sag_at] = SAG_SIGMA**-2
    acceleration = within @ np.where(used, data.acceleration, 0.0)
    for _ in range(passes):
        mapped = rows.map.copy()
        for side, push in enumerate(rows.push):
            mapped = mapped + sparse.diags(data.part * sag[data.drive, side]) @ push
        sagging = np.zeros((used.size, 2 * drives))
        if nodes is not None:
            for side, push in enumerate(rows.push):
                sagging[np.arange(used.size), 2 * data.drive + side] = data.part * (push @ nodes)
        columns = within @ sparse.hstack([mapped, sparse.csr_matrix(data.slope), sparse.csr_matrix(sagging)]).tocsr()
        counts = sparse.diags(np.where(outlying, 0.0, weight))
        normal = (columns.T @ counts @ columns).toarray() / spread**2 + prior
        # The unknown is the sag's change; its prior is about the sag.
        right = columns.T @ (counts @ acceleration) / spread**2
        right[sag_at] -= prior[sag_at, sag_at] * sag.ravel()
        found = (rising_least_squares(grid, normal, right, least) if rising
                 else np.linalg.solve(normal, right))
        nodes, slope = found[:grid.size], found[slope_at]
        if rows.push:
            sag = np.clip(sag + found[sag_at].reshape(drives, 2), -0.5, 0.5)
        residual = acceleration - columns @ found
        spread, weight, outlying = _robust(residual, data.sigma, used)
    return _Solved(nodes, slope, sag, np.where(used, residual, 0.0), np.where(outlying, 0.0, weight) / spread**2,
                   outlying, columns, normal, prior)


def _robust(residual, sigma, used):
    """How much wider residuals scatter than their sigmas say, Huber's weights under that, and what lies far out."""
    ratio = np.abs(residual) / sigma
    spread = max(1.0, float(np.median(ratio[used])) / 0.6745) if used.any() else 1.0
    ratio = ratio / spread
    weight = np.where(used, np.minimum(1.0, HUBER / np.maximum(ratio, 1e-12)) / sigma**2, 0.0)
    return spread, weight, used & (ratio > OUTLIER)


def _delay(drives, data, grid, speed, config):
    """The delay under which the map fits best, and its standard error from how fast the fit gets worse around it."""
    coarse = Grid(_thin(grid.rows, 9), _thin(grid.columns, 5))
    # Only windows that count under every delay are compared, or their number would decide.
    states = [on_grid(sample(drives, data, delay_s, config), speed, grid) for delay_s in DELAYS_S[[0, -1]]]
    state = np.where(states[0] == cut.MEASURED, states[1], states[0])
    used = state == cut.MEASURED
    if used.sum() < 2 * coarse.size:
        return 0.0, float("nan")

    def ratios(delay_s, grid):
        value = sample(drives, data, delay_s, config).value
        solved = _solve(_Rows(grid, data, value, speed, config, sags=False), state, config, rising=False, passes=2)
        return np.abs(solved.residual[used] / data.sigma[used])

    best, reach, step = 0.0, DELAYS_S[-1], 0.04
    for over in (coarse, grid, grid):
        delays_s = np.unique(np.clip(np.arange(best - reach, best + reach + step / 2, step), 0.0, DELAYS_S[-1]))
        found = [ratios(delay_s, over) for delay_s in delays_s]
        scale = max(1.0, min(float(np.median(ratio)) for ratio in found) / 0.6745)
        costs = np.array([_cost(ratio / scale) for ratio in found])
        if np.ptp(costs) < TELLING and over is coarse:
            return 0.0, float("nan")  # nothing tells one from another
        best, reach, step = float(delays_s[np.argmin(costs)]), 1.5 * step, step / 4
    a, b, _ = np.polyfit(delays_s - best, costs, 2)
    if a <= 0:
        return best, float("nan")
    return float(np.clip(best - b / (2 * a), 0.0, best + reach)), float(1.0 / np.sqrt(a))


def _cost(ratio):
    return float(np.where(ratio < HUBER, ratio**2, 2 * HUBER * ratio - HUBER**2).sum())


def _thin(axis, most):
    step = -(-(axis.size - 1) // most)
    return np.unique(np.append(axis[::step], axis[-1]))


# --- how well it is known ---

def _coverage(rows, state, manoeuvre):
    """Seconds of driving around each node, and in how many manoeuvres."""
    used = np.flatnonzero(state == cut.MEASURED)
    shares = rows.map[used]
    shares = sparse.diags(rows.data.hop_s[used]) @ shares
    seconds = np.asarray(shares.sum(axis=0)).ravel()
    member = sparse.csr_matrix((np.ones(used.size), (manoeuvre[used], np.arange(used.size))),
                               shape=(manoeuvre.max() + 1, used.size))
    around = (member @ shares).toarray()
    return seconds, (around >= MIN_S).sum(axis=0)


def _standard_errors(rows, solved, state, manoeuvre):
    """The larger of two: what the weights say, and what manoeuvres as wholes disagree by.

    Windows of one manoeuvre share what the model doesn't know, so that their number says too little.
    """
    grid = rows.grid
    inverse = np.linalg.inv(solved.normal)
    by_weight = np.diag(inverse)[:grid.size]
    used = np.flatnonzero((state == cut.MEASURED) & ~solved.outlying)
    scores = sparse.diags(solved.weight[used] * solved.residual[used]) @ solved.columns[used]
    member = sparse.csr_matrix((np.ones(used.size), (manoeuvre[used], np.arange(used.size))),
                               shape=(manoeuvre.max() + 1, used.size))
    clusters = (member @ scores).toarray()
    middle = clusters.T @ clusters + solved.prior
    by_manoeuvre = np.einsum("ij,jk,ik->i", inverse[:grid.size], middle, inverse[:grid.size])
    return np.sqrt(np.maximum(by_weight, by_manoeuvre))


def _hold_out(rows, state, manoeuvre, config):
    """RMS over every 5th manoeuvre, from a fit to all others."""
    held = (manoeuvre >= 0) & (manoeuvre % HELD_OUT == HELD_OUT - 1) & (state == cut.MEASURED)
    if not held.any():
        return float("nan"), 0
    solved = _solve(rows, np.where(held, BEYOND, state), config)
    predicted = rows.map @ solved.nodes + rows.data.slope @ solved.slope
    for side, push in enumerate(rows.push):
        predicted = predicted + rows.data.part * solved.sag[rows.data.drive, side] * (push @ solved.nodes)
    return _rms((rows.data.acceleration - predicted)[held]), int(held.sum())


def _ground(index, data, solved):
    sees = data.sees_slope[index]
    uphill = tuple(float(x) if sees else float("nan") for x in solved.slope[2 * index:2 * index + 2])
    inverse = np.linalg.inv(solved.normal)
    at = solved.nodes.size + 2 * data.sees_slope.size + 2 * index
    sigma = np.sqrt(np.diag(inverse)[at:at + 2])
    above, below = (float(-x) for x in solved.sag[index])
    return Ground(uphill, above, below, (float(sigma[0]), float(sigma[1])), float(data.pitch_offset[index]))


def _rms(x):
    return float(np.sqrt(np.mean(np.square(x)))) if x.size else float("nan")
