"""Axes of a value map, and the rounding of its numbers."""
from __future__ import annotations

import numpy as np

DECIMALS = 3  # of a map's CSV, as Autoware's calibrators write it
RESOLUTION_MPS2 = 10.0**-DECIMALS
# A step of two roundings' width is still one when both of its ends are rounded towards each other.
MIN_STEP_MPS2 = 2 * RESOLUTION_MPS2
NEAR = 0.25  # of the step between rows: two more rows lie this far from neutral
VALUES, VELOCITIES = 10, 8  # about as many


def value_axis(value: np.ndarray, neutral: float) -> np.ndarray:
    """Round numbers over the driven values, of any shape, and two more near neutral, where an ESC's curve bends."""
    axis = _round_axis(value, neutral, VALUES)
    near = neutral + np.array([-NEAR, NEAR]) * (axis[1] - axis[0])
    return np.union1d(axis, near[(near > axis[0]) & (near < axis[-1])])


def velocity_axis(speed_mps: np.ndarray) -> np.ndarray:
    """Round numbers over the driven speeds, of any shape, 0 among them."""
    return _round_axis(speed_mps, 0.0, VELOCITIES)


def rounded(accelerations: np.ndarray) -> np.ndarray:
    """Round a map (R, C) to the CSV's decimals so that each column still rises from row to row."""
    counts = np.round(accelerations / RESOLUTION_MPS2).astype(np.int64)
    for row in range(1, counts.shape[0]):
        counts[row] = np.maximum(counts[row], counts[row - 1] + 1)
    return counts / 10.0**DECIMALS


def _round_axis(x, zero, wanted):
    """Round numbers, ``zero`` among them, about as many as wanted, up to a quarter of their step past the data."""
    low, high = min(float(np.min(x)), zero), max(float(np.max(x)), zero)
    rough = max(high - low, 1e-6) / wanted
    power = 10.0 ** np.floor(np.log10(rough))
    step = power * min((1.0, 2.0, 2.5, 5.0, 10.0), key=lambda factor: abs(factor * power - rough))
    first, last = int(np.floor((low - zero) / step + 0.25)), int(np.ceil((high - zero) / step - 0.25))
    return np.round(zero + step * np.arange(first, max(last, first + 1) + 1), 9)
