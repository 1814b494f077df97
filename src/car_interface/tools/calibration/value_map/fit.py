"""Fits a value map to the accelerations of drives: level-ground acceleration at mean battery over value and velocity.

The model, solved by least squares that discount outliers:

    acceleration = mean under φ of [ f + k(t)·(f − f at neutral) ] + g·(a·cos yaw + b·sin yaw)

- f is the map: bilinear on its grid, smooth, rising with value by construction, for the value ``delay_s`` before.
- k is the battery's effect at time t, in proportion to the distance from the drive's middle; separate for values above
  and below neutral, since an ESC brakes without the battery. The map is that of the middle.
- a, b are the slope of a plane ground, in the frame of the heading.

The delay from value to acceleration is the one with which it fits best.

The slope of the ground shows where headings go all round. With a pitch sensor gravity is taken off by that instead, and
the part of the pitch that doesn't turn with the heading is the sensor's mounting. Where the headings of a drive don't
spread, a slope can't be distinguished from drag, and is ignored. Tight turns, in which tyres brake, don't count for the
map, but what changes within a turn as the heading goes round shows the slope.

A node is supported where enough driving, in enough manoeuvres, lies around it and its standard error is small. All
other nodes are not the drive's to state. W windows of P points each, of D drives; the grid has G nodes.
"""
from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, Sequence

import numpy as np
from scipy import sparse

from car_interface.tools.calibration.shared import NothingToFit
from car_interface.tools.calibration.value_map.recorded import DEFAULTS, MapConfig, MapDrive
from car_interface.tools.calibration.value_map.surface import (
    Grid,
    penalties,
    rising_least_squares,
    round_axis,
    rounded,
    value_axis,
)
from car_interface.tools.calibration.value_map.windows import (
    BEYOND,
    MEASURED,
    OUTLYING,
    TURNING,
    Data,
    by_rule,
    why_nothing,
    within_turns,
)

VELOCITIES = 8  # of a map, about as many
FIRST_DELAY_S = 0.1  # by which the axes are chosen, before the delay is known
MAX_DELAY_S = 0.6
COARSE_STEP_S = 0.04
COARSE_ROWS, COARSE_COLUMNS = 9, 5
# A node is supported by at least this much driving around it, in this many manoeuvres, if its standard error is at most
# this.
SUPPORT_S, SUPPORT_MANOEUVRES, SUPPORT_SIGMA_MPS2 = 0.1, 2, 0.08
MIN_DIFFERENCE = 9.0  # of the sum of squares between delays, or they can't be told apart: three sigmas
SLOPE_SIGMA, SAG_SIGMA = 0.05, 0.15  # expected of a slope, and of a battery in one drive
HUBER = 2.0  # residuals beyond this many sigmas count less
OUTLIER = 5.0  # and beyond this many don't count
PASSES = 6
BENDS = 0.05  # of the range of values: this near to neutral the map may bend freely
MAX_SAG = 0.5
MIN_S = 0.03  # of driving around a node, for a manoeuvre to count there
HELD_OUT = 5


class Ground(NamedTuple):
    """What was found about one drive besides the map."""

    # the slope in the direction of yaw 0, and in that of 90° to its left; NaN where headings don't spread
    uphill: tuple[float, float]
    sag_above: float  # the ratio of its effect that a value above neutral loses from start to end
    sag_below: float  # the same below neutral
    sag_sigma: tuple[float, float]  # their standard errors
    pitch_offset_rad: float  # of the pitch sensor; NaN without


@dataclass(frozen=True)
class Fit:
    """A map of R values and C velocities, and how well it is known."""

    values: np.ndarray  # (R,)
    velocities: np.ndarray  # (C,)
    accelerations: np.ndarray  # (R, C), in m/s², rounded to the CSV's decimals; every column rises
    sigma_mps2: np.ndarray  # standard errors, (R, C)
    seconds: np.ndarray  # of driving around each node, (R, C)
    supported: np.ndarray  # which nodes the drives support, (R, C)
    sure: np.ndarray  # which nodes have a small standard error, with or without driving around them, (R, C)
    delay_s: float  # from value to acceleration
    delay_sigma_s: float  # its standard error; NaN where the delay was given or doesn't show
    grounds: tuple[Ground, ...]  # one for each drive
    rejected: dict[str, int]  # windows by rule; those that count are under "counted"
    residual_mps2: float  # RMS over windows that count
    held_out_mps2: float  # the same over every 5th manoeuvre, from a fit to the others; NaN if there are too few
    held_out_windows: int  # how many these were


@np.errstate(invalid="ignore")  # NaN, for what wasn't measured, compares as false
def fit(drives: Sequence[MapDrive], values: np.ndarray | None, velocities: np.ndarray | None,
        config: MapConfig = DEFAULTS) -> Fit:
    """Fit a map to drives.

    Args:
        drives: at least one.
        values, velocities: the map's axes; ``None`` = chosen to fit what was driven.

    Raises:
        NothingToFit: no window counts.
    """
    data = Data(drives, config)
    _counting(data.windows.state)
    is_given = config.delay_s is not None
    value, state = data.sample(config.delay_s if is_given else FIRST_DELAY_S)
    inside = _counting(state)
    grid = Grid(value_axis(value[inside], config.neutral) if values is None else np.asarray(values, float),
                round_axis(data.windows.speed_mps[inside], 0.0, VELOCITIES) if velocities is None else
                np.asarray(velocities, float))
    delay_s, delay_sigma_s = (config.delay_s, math.nan) if is_given else estimate_delay(data, grid)
    value, state = data.sample(delay_s, grid)
    counts = _counting(state)
    model, manoeuvre = Model(grid, data, value), data.manoeuvres(value, state, grid)
    solved = solve(model, state)
    state = np.where(counts & solved.outlying, OUTLYING, state)
    seconds, count = coverage(model, state, manoeuvre)
    sigma = standard_errors(model, solved, state, manoeuvre)
    sure = sigma <= SUPPORT_SIGMA_MPS2
    supported = sure & (seconds >= SUPPORT_S) & (count >= SUPPORT_MANOEUVRES)
    by_node = [column.reshape(grid.rows.size, grid.columns.size)
               for column in (solved.nodes, sigma, seconds, supported, sure)]
    grounds = tuple(_ground(index, data, solved) for index in range(len(drives)))
    return Fit(grid.rows, grid.columns, rounded(by_node[0]), *by_node[1:], float(delay_s), float(delay_sigma_s),
               grounds, by_rule(state), rms(solved.residual[state == MEASURED]), *hold_out(model, state, manoeuvre))


def _counting(state):
    """Return which windows count, by their states (W,); NothingToFit is raised where none does."""
    counts = state == MEASURED
    if not counts.any():
        raise NothingToFit(why_nothing(state))
    return counts


def _ground(index, data, solved):
    uphill = solved.slope[2 * index:2 * index + 2].tolist() if data.sees_slope[index] else (math.nan, math.nan)
    at = solved.nodes.size + 2 * data.sees_slope.size + 2 * index
    sigma = np.sqrt(np.diag(np.linalg.inv(solved.normal))[at:at + 2]).tolist()
    return Ground(tuple(uphill), *(-solved.sag[index]).tolist(), tuple(sigma), float(data.pitch_offset[index]))


# --- the delay ---


def estimate_delay(data: Data, grid: Grid) -> tuple[float, float]:
    """Return (the delay in s, its standard error); the latter is NaN where the drives don't show one."""
    coarse = Grid(_thin(grid.rows, COARSE_ROWS), _thin(grid.columns, COARSE_COLUMNS))
    # Only windows that count under every delay are compared, or their number would decide.
    states = [data.sample(delay_s, grid)[1] for delay_s in (0.0, MAX_DELAY_S)]
    state = np.where(states[0] == MEASURED, states[1], states[0])
    used = state == MEASURED
    if used.sum() < 2 * coarse.size:
        return 0.0, math.nan

    def ratios(delay_s, grid):
        solved = solve(Model(grid, data, data.sample(delay_s)[0], sags=False), state, rising=False, passes=2)
        return np.abs(solved.residual[used] / data.windows.sigma_mps2[used])

    best, max_offset, step = 0.0, MAX_DELAY_S, COARSE_STEP_S
    for over in (coarse, grid, grid):
        delays_s = np.unique(np.clip(np.arange(best - max_offset, best + max_offset + step / 2, step), 0.0,
                                     MAX_DELAY_S))
        found = [ratios(delay_s, over) for delay_s in delays_s]
        scale = max(1.0, min(float(np.median(ratio)) for ratio in found) / 0.6745)
        found = np.array(found) / scale
        costs = np.where(found < HUBER, found**2, 2 * HUBER * found - HUBER**2).sum(axis=1)  # Huber's
        if np.ptp(costs) < MIN_DIFFERENCE and over is coarse:
            return 0.0, math.nan
        best, max_offset, step = float(delays_s[np.argmin(costs)]), 1.5 * step, step / 4
    a, b, _ = np.polyfit(delays_s - best, costs, 2)
    if a <= 0:
        return best, math.nan
    return float(np.clip(best - b / (2 * a), 0.0, best + max_offset)), float(1.0 / np.sqrt(a))


def _thin(axis, max_steps):
    step = -(-(axis.size - 1) // max_steps)
    return np.unique(np.append(axis[::step], axis[-1]))


# --- the model ---


class Model:
    """The model's matrices under one delay, by the value (W, P); ``sags``: the battery's effect is part of it.

    Attributes:
        map: the nodes' weights in each window, (W, G).
        push: the same of what values above and below neutral add to coasting, two of (W, G).
        penalty: of the map's roughness, (G, G).
    """

    def __init__(self, grid: Grid, data: Data, value: np.ndarray, sags: bool = True):
        self.grid, self.data = grid, data
        weight, speed, neutral = data.windows.weight, np.nan_to_num(data.windows.speed_mps), data.config.neutral
        self.map = grid.averages(value, speed, weight)
        above, coasting = value > neutral, np.full(value.shape, neutral)
        self.push = [grid.averages(value, speed, weight * side) - grid.averages(coasting, speed, weight * side)
                     for side in (above, ~above)] if sags else []
        kinks = np.abs(grid.rows - neutral) <= BENDS * np.ptp(grid.rows)
        rough = penalties(grid, kinks)
        self.penalty = (rough.T @ rough).toarray()


@dataclass
class Solution:
    """A solution of the model."""

    nodes: np.ndarray  # the map, (G,)
    slope: np.ndarray  # of each drive's ground along x and y, (2·D,)
    sag: np.ndarray  # of each drive above and below neutral, (D, 2)
    residual: np.ndarray  # of each window in m/s², (W,); of no meaning, as the next two, where it wasn't used
    weight: np.ndarray  # of each window, (W,)
    outlying: np.ndarray  # which windows are outliers, (W,)
    columns: sparse.csr_matrix  # of the last pass's equations: (W, U), (U, U), (U, U), with U = G + 4·D unknowns
    normal: np.ndarray
    prior: np.ndarray


def solve(model: Model, state: np.ndarray, rising: bool = True, passes: int = PASSES) -> Solution:
    """Solve by Gauss-Newton steps for the battery's effect, with Huber's weights. Of the windows' states (W,) MEASURED
    and TURNING are used; ``rising``: the map must rise with the value.
    """
    data, grid = model.data, model.grid
    used = (state == MEASURED) | (state == TURNING)
    within = within_turns(state == TURNING, data.drive)
    drives = data.sees_slope.size
    sag = np.zeros((drives, 2))
    nodes = np.zeros(grid.size)
    spread, weight, outlying = _robust(np.zeros(used.size), data.windows.sigma_mps2, used)
    prior = np.zeros((grid.size + 4 * drives,) * 2)
    prior[:grid.size, :grid.size] = model.penalty + 1e-8 * np.eye(grid.size)
    slope_at = np.arange(grid.size, grid.size + 2 * drives)
    sag_at = np.arange(grid.size + 2 * drives, grid.size + 4 * drives)
    prior[slope_at, slope_at] = np.where(np.repeat(data.sees_slope, 2), SLOPE_SIGMA**-2, 1e12)
    prior[sag_at, sag_at] = SAG_SIGMA**-2
    acceleration = within @ np.where(used, data.windows.acceleration_mps2, 0.0)
    for _ in range(passes):
        mapped, sagging = model.map, np.zeros((used.size, 2 * drives))
        for side, push in enumerate(model.push):
            mapped = mapped + sparse.diags(data.windows.part * sag[data.drive, side]) @ push
            sagging[np.arange(used.size), 2 * data.drive + side] = data.windows.part * (push @ nodes)
        columns = within @ sparse.hstack([mapped, sparse.csr_matrix(data.slope), sparse.csr_matrix(sagging)]).tocsr()
        counts = sparse.diags(np.where(outlying, 0.0, weight))
        normal = (columns.T @ counts @ columns).toarray() / spread**2 + prior
        # The unknown is the sag's change; its prior is about the sag.
        right = columns.T @ (counts @ acceleration) / spread**2
        right[sag_at] -= prior[sag_at, sag_at] * sag.ravel()
        found = rising_least_squares(grid, normal, right) if rising else np.linalg.solve(normal, right)
        nodes, slope = found[:grid.size], found[slope_at]
        sag = np.clip(sag + found[sag_at].reshape(drives, 2), -MAX_SAG, MAX_SAG)
        residual = acceleration - columns @ found
        spread, weight, outlying = _robust(residual, data.windows.sigma_mps2, used)
    return Solution(nodes, slope, sag, residual, weight / spread**2, outlying, columns, normal, prior)


def _robust(residual, sigma, used):
    """Return (the residuals' scatter in sigmas, Huber's weights (W,), which windows are outliers (W,))."""
    ratio = np.abs(residual) / sigma
    spread = max(1.0, float(np.median(ratio[used])) / 0.6745) if used.any() else 1.0
    ratio = ratio / spread
    weight = np.where(used, np.minimum(1.0, HUBER / np.maximum(ratio, 1e-12)) / sigma**2, 0.0)
    return spread, weight, used & (ratio > OUTLIER)


# --- how well it is known ---


def coverage(model: Model, state: np.ndarray, manoeuvre: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (seconds of driving around each node (G,), in how many manoeuvres (G,)), by each window's state and
    manoeuvre, (W,).
    """
    used = np.flatnonzero(state == MEASURED)
    time_s = sparse.diags(model.data.windows.hop_s[used]) @ model.map[used]
    seconds = np.asarray(time_s.sum(axis=0)).ravel()
    around = (_membership(manoeuvre, used) @ time_s).toarray()
    return seconds, (around >= MIN_S).sum(axis=0)


def standard_errors(model: Model, solved: Solution, state: np.ndarray, manoeuvre: np.ndarray) -> np.ndarray:
    """Standard errors of the nodes in m/s² (G,): the larger of those by window and those by manoeuvre (clustered).

    Windows of one manoeuvre have errors in common that the model doesn't know.
    """
    grid = model.grid
    inverse = np.linalg.inv(solved.normal)
    by_weight = np.diag(inverse)[:grid.size]
    used = np.flatnonzero((state == MEASURED) & ~solved.outlying)
    scores = sparse.diags(solved.weight[used] * solved.residual[used]) @ solved.columns[used]
    clusters = (_membership(manoeuvre, used) @ scores).toarray()
    middle = clusters.T @ clusters + solved.prior
    by_manoeuvre = np.einsum("ij,jk,ik->i", inverse[:grid.size], middle, inverse[:grid.size])
    return np.sqrt(np.maximum(by_weight, by_manoeuvre))


def hold_out(model: Model, state: np.ndarray, manoeuvre: np.ndarray) -> tuple[float, int]:
    """Return (RMS in m/s² over every 5th manoeuvre from a fit to all others, windows in it); NaN if there are none."""
    held = (manoeuvre >= 0) & (manoeuvre % HELD_OUT == HELD_OUT - 1) & (state == MEASURED)
    if not held.any():
        return math.nan, 0
    solved = solve(model, np.where(held, BEYOND, state))
    predicted = model.map @ solved.nodes + model.data.slope @ solved.slope
    for side, push in enumerate(model.push):
        predicted = predicted + model.data.windows.part * solved.sag[model.data.drive, side] * (push @ solved.nodes)
    return rms((model.data.windows.acceleration_mps2 - predicted)[held]), int(held.sum())


def rms(x: np.ndarray) -> float:
    """Return the root mean square; NaN without numbers."""
    return float(np.sqrt(np.mean(np.square(x)))) if x.size else math.nan


def _membership(manoeuvre, used):
    """Return a matrix (M, U) that sums the rows of used windows by manoeuvre."""
    return sparse.csr_matrix((np.ones(used.size), (manoeuvre[used], np.arange(used.size))),
                             shape=(manoeuvre.max() + 1, used.size))
