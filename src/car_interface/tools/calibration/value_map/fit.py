"""Fits a value map to the accelerations of drives: level-ground acceleration at mean battery over value and velocity.

The model is in ``model``. The delay from value to acceleration is the one with which it fits best.

The slope of the ground shows where headings go all round. With a pitch sensor gravity is taken off by that instead, and
the part of the pitch that doesn't turn with the heading is the sensor's mounting. Where the headings of a drive don't
spread, a slope can't be distinguished from drag, and is ignored. Tight turns, in which tyres brake, don't count for the
map, but what changes within a turn as the heading goes round shows the slope.

A node is supported where enough driving, in enough manoeuvres, lies around it and its standard error is small. All
other nodes are not the drive's to state.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Sequence

import numpy as np

from car_interface.tools.calibration.shared import NothingToFit
from car_interface.tools.calibration.value_map import acceleration as windowing
from car_interface.tools.calibration.value_map.acceleration import DEFAULTS, MapDrive, MapFitConfig
from car_interface.tools.calibration.value_map.model import (
    HUBER,
    Model,
    coverage,
    hold_out,
    rms,
    solve,
    standard_errors,
)
from car_interface.tools.calibration.value_map.surface import Grid, rounded, value_axis, velocity_axis
from car_interface.tools.calibration.value_map.windows import (
    OUTLYING,
    Data,
    by_rule,
    gather,
    manoeuvres,
    on_grid,
    sample,
    why_nothing,
)

FIRST_DELAY_S = 0.1  # by which the axes are chosen, before the delay is known
MAX_DELAY_S = 0.6
COARSE_STEP_S = 0.04
COARSE_ROWS, COARSE_COLUMNS = 9, 5
# A node is supported by at least this much driving around it, in this many manoeuvres, if its standard error is at most
# this.
SUPPORT_S, SUPPORT_MANOEUVRES, SUPPORT_SIGMA_MPS2 = 0.1, 2, 0.08
MIN_DIFFERENCE = 9.0  # of the sum of squares between delays, or they can't be told apart: three sigmas


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
    delay_is_given: bool
    grounds: tuple[Ground, ...]  # one for each drive
    rejected: dict[str, int]  # windows by rule; those that count are under "counted"
    residual_mps2: float  # RMS over windows that count
    held_out_mps2: float  # the same over every 5th manoeuvre, from a fit to the others; NaN if there are too few
    held_out_windows: int  # how many these were


@np.errstate(invalid="ignore")  # NaN, for what wasn't measured, compares as false
def fit(drives: Sequence[MapDrive], values: np.ndarray | None, velocities: np.ndarray | None,
        config: MapFitConfig = DEFAULTS) -> Fit:
    """Fit a map to drives.

    Args:
        drives: at least one.
        values, velocities: the map's axes; ``None`` = chosen to fit what was driven.

    Raises:
        NothingToFit: no window counts.
    """
    data = gather(drives, config)
    counted = data.state == windowing.MEASURED
    if not counted.any():
        raise NothingToFit(why_nothing(data.state))
    value, state = sample(drives, data, config.delay_s if config.delay_s is not None else FIRST_DELAY_S, config)
    inside = state == windowing.MEASURED
    if not inside.any():
        raise NothingToFit(why_nothing(state))
    grid = Grid(value_axis(value[inside], config.neutral) if values is None else np.asarray(values, float),
                velocity_axis(data.windows.speed_mps[inside]) if velocities is None else np.asarray(velocities, float))
    delay_s, delay_sigma_s = (config.delay_s, float("nan")) if config.delay_s is not None else estimate_delay(
        drives, data, grid, config)
    value, state = sample(drives, data, delay_s, config)
    state = on_grid(data, value, state, grid)
    if not (state == windowing.MEASURED).any():
        raise NothingToFit(why_nothing(state))
    model = Model(grid, data, value, config)
    manoeuvre = manoeuvres(data, value, state, grid)
    solved = solve(model, state)
    state = np.where((state == windowing.MEASURED) & solved.outlying, OUTLYING, state)
    seconds, count = coverage(model, state, manoeuvre)
    sigma = standard_errors(model, solved, state, manoeuvre)
    sure = sigma <= SUPPORT_SIGMA_MPS2
    supported = sure & (seconds >= SUPPORT_S) & (count >= SUPPORT_MANOEUVRES)
    held_out_mps2, held_out_windows = hold_out(model, state, manoeuvre)
    used = state == windowing.MEASURED
    shape = (grid.rows.size, grid.columns.size)
    grounds = tuple(_ground(index, data, solved) for index in range(len(drives)))
    return Fit(grid.rows, grid.columns, rounded(solved.nodes.reshape(shape)), sigma.reshape(shape),
               seconds.reshape(shape), supported.reshape(shape), sure.reshape(shape),
               float(delay_s), float(delay_sigma_s), config.delay_s is not None, grounds, by_rule(state),
               rms(solved.residual[used]), held_out_mps2, held_out_windows)


def _ground(index, data, solved):
    sees = data.sees_slope[index]
    uphill = tuple(float(x) if sees else float("nan") for x in solved.slope[2 * index:2 * index + 2])
    inverse = np.linalg.inv(solved.normal)
    at = solved.nodes.size + 2 * data.sees_slope.size + 2 * index
    sigma = np.sqrt(np.diag(inverse)[at:at + 2])
    above, below = (float(-x) for x in solved.sag[index])
    return Ground(uphill, above, below, (float(sigma[0]), float(sigma[1])), float(data.pitch_offset[index]))


# --- the delay ---


def estimate_delay(drives: Sequence[MapDrive], data: Data, grid: Grid, config: MapFitConfig) -> tuple[float, float]:
    """Return (the delay in s, its standard error); the latter is NaN where the drives don't show one."""
    coarse = Grid(_thin(grid.rows, COARSE_ROWS), _thin(grid.columns, COARSE_COLUMNS))
    # Only windows that count under every delay are compared, or their number would decide.
    states = [on_grid(data, *sample(drives, data, delay_s, config), grid) for delay_s in (0.0, MAX_DELAY_S)]
    state = np.where(states[0] == windowing.MEASURED, states[1], states[0])
    used = state == windowing.MEASURED
    if used.sum() < 2 * coarse.size:
        return 0.0, float("nan")

    def ratios(delay_s, grid):
        value, _ = sample(drives, data, delay_s, config)
        solved = solve(Model(grid, data, value, config, sags=False), state, rising=False, passes=2)
        return np.abs(solved.residual[used] / data.sigma[used])

    best, max_offset, step = 0.0, MAX_DELAY_S, COARSE_STEP_S
    for over in (coarse, grid, grid):
        delays_s = np.unique(np.clip(np.arange(best - max_offset, best + max_offset + step / 2, step), 0.0,
                                     MAX_DELAY_S))
        found = [ratios(delay_s, over) for delay_s in delays_s]
        scale = max(1.0, min(float(np.median(ratio)) for ratio in found) / 0.6745)
        found = np.array(found) / scale
        costs = np.where(found < HUBER, found**2, 2 * HUBER * found - HUBER**2).sum(axis=1)  # Huber's
        if np.ptp(costs) < MIN_DIFFERENCE and over is coarse:
            return 0.0, float("nan")
        best, max_offset, step = float(delays_s[np.argmin(costs)]), 1.5 * step, step / 4
    a, b, _ = np.polyfit(delays_s - best, costs, 2)
    if a <= 0:
        return best, float("nan")
    return float(np.clip(best - b / (2 * a), 0.0, best + max_offset)), float(1.0 / np.sqrt(a))


def _thin(axis, max_steps):
    step = -(-(axis.size - 1) // max_steps)
    return np.unique(np.append(axis[::step], axis[-1]))
