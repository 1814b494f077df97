"""A bilinear grid over two axes, fitted to averages of itself: smooth, and rising along the first axis.

R rows, C columns, G = R·C nodes, counted row by row. Pure numpy and scipy.
"""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.optimize import lsq_linear

from car_interface.tools.calibration.shared import rising

# The expected second derivatives, as standard deviations. Along the rows' axis, taken as 1: a throttle curve's (6·u^1.5
# has 9 on the average). Along the columns', per (m/s)²: a motor's that has half its thrust at 9 m/s.
ROUGH_ROWS, ROUGH_COLUMNS = 8.0, 0.15
INTERVALS = 10.0  # of the axis for which a second derivative is expected; on a finer grid nodes differ by less
DECIMALS = 3  # of a map's CSV, as Autoware's calibrators write it
RESOLUTION_MPS2 = 10.0**-DECIMALS
# A smaller step would vanish in the CSV: one of two roundings' width is still one when both of its ends are rounded
# towards each other. Where a map hardly rises it rises by that.
MIN_STEP_MPS2 = 2 * RESOLUTION_MPS2
NEAR = 0.25  # of the step between rows: two more rows lie this far from neutral
VALUES = 10  # about as many


@dataclass(frozen=True)
class Grid:
    """The axes, each at least two strictly rising numbers: ``rows`` (R,) and ``columns`` (C,)."""

    rows: np.ndarray
    columns: np.ndarray

    @property
    def size(self) -> int:
        """The number of nodes."""
        return self.rows.size * self.columns.size

    def has(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return whether points, of any shape, are on the grid."""
        return ((u >= self.rows[0]) & (u <= self.rows[-1]) & (v >= self.columns[0]) & (v <= self.columns[-1]))

    def averages(self, u: np.ndarray, v: np.ndarray, weight: np.ndarray) -> sparse.csr_matrix:
        """Return the nodes' weights (W, G) in the weighted sums over the points of each row of the arguments (W, P).

        Points beyond the grid are moved to its edge.
        """
        row, up = _place(self.rows, u)
        column, right = _place(self.columns, v)
        index = np.repeat(np.arange(u.shape[0]), u.shape[1])
        parts = []
        for rise, across, factor in ((0, 0, (1 - up) * (1 - right)), (0, 1, (1 - up) * right),
                                    (1, 0, up * (1 - right)), (1, 1, up * right)):
            node = (row + rise) * self.columns.size + column + across
            parts.append(((factor * weight).ravel(), node.ravel()))
        data, node = (np.concatenate(column) for column in zip(*parts))
        return sparse.coo_matrix((data, (np.tile(index, 4), node)), shape=(u.shape[0], self.size)).tocsr()


def penalties(grid: Grid, kinks: np.ndarray) -> sparse.csr_matrix:
    """Return the second differences of a surface as ratios of the expected ones: a matrix (D, G). At the rows of
    ``kinks`` (R,) it may bend freely.
    """
    rows = _second_differences((grid.rows - grid.rows[0]) / np.ptp(grid.rows), ROUGH_ROWS)
    inside = kinks[1:-1]
    rows[inside] *= 0.05
    columns = _second_differences(grid.columns, ROUGH_COLUMNS)
    return sparse.vstack([sparse.kron(sparse.csr_matrix(rows), sparse.identity(grid.columns.size)),
                          sparse.kron(sparse.identity(grid.rows.size), sparse.csr_matrix(columns))]).tocsr()


def rising_least_squares(grid: Grid, normal: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Minimise x·normal·x − 2·x·right over grids that rise by at least MIN_STEP_MPS2 from row to row: x (U,).

    Args:
        grid: its nodes are the first of x; those after them are free.
        normal, right: of the normal equations, (U, U), positive definite, and (U,).
    """
    count, columns = grid.size, grid.columns.size
    # Unknowns are the first row and the steps: x = sums · z + the minimum steps.
    sums = np.eye(normal.shape[0])
    sums[:count, :count] = np.kron(np.tril(np.ones((grid.rows.size, grid.rows.size))), np.eye(columns))
    offset = np.zeros(normal.shape[0])
    offset[:count] = np.repeat(MIN_STEP_MPS2 * np.arange(grid.rows.size), columns)
    scale = 1.0 / np.sqrt(np.diag(normal))
    factor = np.linalg.cholesky((normal * scale).T * scale).T  # of the scaled unknowns
    wanted = np.linalg.solve(factor.T, (right - normal @ offset) * scale)
    lower = np.full(normal.shape[0], -np.inf)
    lower[columns:count] = 0.0
    found = lsq_linear(factor @ (sums / scale[:, None]), wanted, bounds=(lower, np.full(lower.size, np.inf)),
                       method="bvls" if count < 60 else "trf", tol=1e-12, lsq_solver="exact")
    z = found.x
    z[columns:count] = np.maximum(z[columns:count], 0.0)
    return sums @ z + offset


def rising_column(wanted: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return the column (R,) nearest to ``wanted`` (R,), in least squares with weights (R,), that rises by at least
    MIN_STEP_MPS2 from row to row.
    """
    offset = MIN_STEP_MPS2 * np.arange(wanted.size)
    return rising(wanted - offset, weight) + offset


def _place(axis, x):
    """Return (the interval of each point, its position within it, 0..1), of the shape of ``x``."""
    index = np.clip(np.searchsorted(axis, x, side="right") - 1, 0, axis.size - 2)
    return index, np.clip((x - axis[index]) / (axis[index + 1] - axis[index]), 0.0, 1.0)


def _second_differences(axis, expected):
    """Return the slope's change at each inner node as a ratio of the one expected between nodes at that distance: (N−2,
    N).
    """
    steps = np.diff(axis)
    span = (steps[:-1] + steps[1:]) / 2
    # The second derivative is a random walk: the variance of its mean goes with 1 / span.
    factor = 1.0 / (expected * span * (np.ptp(axis) / INTERVALS / span) ** 0.5)
    return factor[:, None] * np.diff(np.diff(np.eye(axis.size), axis=0) / steps[:, None], axis=0)


def value_axis(value: np.ndarray, neutral: float) -> np.ndarray:
    """Round numbers over the driven values, of any shape, and two more near neutral, where an ESC's curve bends."""
    axis = round_axis(value, neutral, VALUES)
    near = neutral + np.array([-NEAR, NEAR]) * (axis[1] - axis[0])
    return np.union1d(axis, near[(near > axis[0]) & (near < axis[-1])])


def rounded(accelerations: np.ndarray) -> np.ndarray:
    """Round a map (R, C) to the CSV's decimals so that each column still rises from row to row."""
    rows = np.arange(len(accelerations))[:, None]
    counts = np.round(accelerations / RESOLUTION_MPS2).astype(np.int64)
    return (np.maximum.accumulate(counts - rows) + rows) / 10.0**DECIMALS


def round_axis(x: np.ndarray, zero: float, wanted: int) -> np.ndarray:
    """Round numbers over the data, of any shape, ``zero`` among them, about as many as wanted, up to a quarter of their
    step past the data.
    """
    low, high = min(float(np.min(x)), zero), max(float(np.max(x)), zero)
    rough = max(high - low, 1e-6) / wanted
    power = 10.0 ** np.floor(np.log10(rough))
    step = power * min((1.0, 2.0, 2.5, 5.0, 10.0), key=lambda factor: abs(factor * power - rough))
    first, last = int(np.floor((low - zero) / step + 0.25)), int(np.ceil((high - zero) / step - 0.25))
    return np.round(zero + step * np.arange(first, max(last, first + 1) + 1), 9)
