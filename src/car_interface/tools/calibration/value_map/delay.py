"""Estimates the delay from value to acceleration: the one with which the map fits best."""
from __future__ import annotations

from typing import Sequence

import numpy as np

from car_interface.tools.calibration.value_map import acceleration as windowing
from car_interface.tools.calibration.value_map.acceleration import Drive
from car_interface.tools.calibration.value_map.config import FitConfig
from car_interface.tools.calibration.value_map.model import HUBER, Model, solve
from car_interface.tools.calibration.value_map.surface import Grid
from car_interface.tools.calibration.value_map.windows import Data, on_grid, sample

MAX_DELAY_S = 0.6
COARSE_STEP_S = 0.04
COARSE_ROWS, COARSE_COLUMNS = 9, 5
MIN_DIFFERENCE = 9.0  # of the sum of squares between delays, or they can't be told apart: three sigmas


def estimate_delay(drives: Sequence[Drive], data: Data, grid: Grid, speed: np.ndarray,
                   config: FitConfig) -> tuple[float, float]:
    """(the delay in s, its standard error); the latter is NaN where the drives don't show one.

    Args:
        drives: all.
        data: their windows.
        grid: of the map.
        speed: in m/s, (W, P).
        config: of the fit.
    """
    coarse = Grid(_thin(grid.rows, COARSE_ROWS), _thin(grid.columns, COARSE_COLUMNS))
    # Only windows that count under every delay are compared, or their number would decide.
    states = [on_grid(sample(drives, data, delay_s, config), speed, grid) for delay_s in (0.0, MAX_DELAY_S)]
    state = np.where(states[0] == windowing.MEASURED, states[1], states[0])
    used = state == windowing.MEASURED
    if used.sum() < 2 * coarse.size:
        return 0.0, float("nan")

    def ratios(delay_s, grid):
        value = sample(drives, data, delay_s, config).value
        solved = solve(Model(grid, data, value, speed, config, sags=False), state, rising=False, passes=2)
        return np.abs(solved.residual[used] / data.sigma[used])

    best, max_offset, step = 0.0, MAX_DELAY_S, COARSE_STEP_S
    for over in (coarse, grid, grid):
        delays_s = np.unique(np.clip(np.arange(best - max_offset, best + max_offset + step / 2, step), 0.0,
                                     MAX_DELAY_S))
        found = [ratios(delay_s, over) for delay_s in delays_s]
        scale = max(1.0, min(float(np.median(ratio)) for ratio in found) / 0.6745)
        costs = np.array([_cost(ratio / scale) for ratio in found])
        if np.ptp(costs) < MIN_DIFFERENCE and over is coarse:
            return 0.0, float("nan")
        best, max_offset, step = float(delays_s[np.argmin(costs)]), 1.5 * step, step / 4
    a, b, _ = np.polyfit(delays_s - best, costs, 2)
    if a <= 0:
        return best, float("nan")
    return float(np.clip(best - b / (2 * a), 0.0, best + max_offset)), float(1.0 / np.sqrt(a))


def _cost(ratio):
    """Huber's loss of residuals in sigmas."""
    return float(np.where(ratio < HUBER, ratio**2, 2 * HUBER * ratio - HUBER**2).sum())


def _thin(axis, max_steps):
    step = -(-(axis.size - 1) // max_steps)
    return np.unique(np.append(axis[::step], axis[-1]))
