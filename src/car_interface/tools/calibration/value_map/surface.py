"""A bilinear grid over two axes, fitted to averages of itself: smooth, and rising along the first axis.

R rows, C columns, G = R·C nodes, counted row by row. Pure numpy and scipy.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.optimize import lsq_linear

INTERVALS = 10.0  # of the axis for which a second derivative is expected; on a finer grid nodes differ by less


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
        """Whether points, of any shape, are on the grid."""
        rows, columns = self.rows, self.columns
        return (u >= rows[0]) & (u <= rows[-1]) & (v >= columns[0]) & (v <= columns[-1])

    def averages(self, u: np.ndarray, v: np.ndarray, weight: np.ndarray) -> sparse.csr_matrix:
        """The nodes' weights (W, G) in the weighted sums over the points of each row of the arguments (W, P).

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

    def at(self, nodes: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """The surface with these nodes (G,) at points (N,): (N,)."""
        return self.averages(np.reshape(u, (-1, 1)), np.reshape(v, (-1, 1)), np.ones((np.size(u), 1))) @ nodes.ravel()


class Roughness(NamedTuple):
    """The expected second derivatives, as standard deviations: along the rows' axis taken as 1, and per unit of the
    columns' axis."""

    rows: float
    columns: float


def penalties(grid: Grid, roughness: Roughness, kinks: np.ndarray) -> sparse.csr_matrix:
    """The second differences of a surface as ratios of the expected ones: a matrix (D, G).

    Args:
        grid: the grid.
        roughness: what is expected.
        kinks: (R,), the rows at which the surface may bend freely.
    """
    rows = _second_differences((grid.rows - grid.rows[0]) / np.ptp(grid.rows), roughness.rows)
    inside = kinks[1:-1]
    rows[inside] *= 0.05
    columns = _second_differences(grid.columns, roughness.columns)
    return sparse.vstack([sparse.kron(sparse.csr_matrix(rows), sparse.identity(grid.columns.size)),
                          sparse.kron(sparse.identity(grid.rows.size), sparse.csr_matrix(columns))]).tocsr()


def rising_least_squares(grid: Grid, normal: np.ndarray, right: np.ndarray,
                         min_steps: np.ndarray) -> np.ndarray:
    """Minimise x·normal·x − 2·x·right over grids that rise by at least ``min_steps`` from row to row: x (U,).


    Args:
        grid: its nodes are the first of x; those after them are free.
        normal, right: of the normal equations, (U, U), positive definite, and (U,).
        min_steps: (R−1,).
    """
    count, columns = grid.size, grid.columns.size
    # Unknowns are the first row and the steps: x = sums · z + the minimum steps.
    sums = np.eye(normal.shape[0])
    sums[:count, :count] = np.kron(np.tril(np.ones((grid.rows.size, grid.rows.size))), np.eye(columns))
    offset = np.zeros(normal.shape[0])
    offset[:count] = np.repeat(np.concatenate(([0.0], np.cumsum(min_steps))), columns)
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


def rising_column(wanted: np.ndarray, weight: np.ndarray, min_steps: np.ndarray) -> np.ndarray:
    """The column (R,) nearest to ``wanted`` (R,) that rises by at least ``min_steps`` (R−1,).

    In least squares weighted by ``weight`` (R,), by pooling adjacent violators.
    """
    offset = np.concatenate(([0.0], np.cumsum(min_steps)))
    blocks: list[list[float]] = []  # value, weight, count
    for y, w in zip(wanted - offset, weight):
        blocks.append([y, w, 1])
        while len(blocks) > 1 and blocks[-2][0] > blocks[-1][0]:
            y1, w1, n1 = blocks.pop()
            y0, w0, n0 = blocks.pop()
            blocks.append([(y0 * w0 + y1 * w1) / (w0 + w1), w0 + w1, n0 + n1])
    return np.repeat([block[0] for block in blocks], [int(block[2]) for block in blocks]) + offset


def _place(axis, x):
    """(the interval of each point, its position within it, 0..1), of the shape of ``x``."""
    index = np.clip(np.searchsorted(axis, x, side="right") - 1, 0, axis.size - 2)
    return index, np.clip((x - axis[index]) / (axis[index + 1] - axis[index]), 0.0, 1.0)


def _second_differences(axis, expected):
    """The slope's change at each inner node as a ratio of the one expected between nodes at that distance: (N−2, N)."""
    steps = np.diff(axis)
    differences = np.zeros((max(0, axis.size - 2), axis.size))
    for index in range(axis.size - 2):
        before, after = steps[index], steps[index + 1]
        span = (before + after) / 2
        # The second derivative is a random walk: the variance of its mean goes with 1 / span.
        factor = 1.0 / (expected * span * (np.ptp(axis) / INTERVALS / span) ** 0.5)
        differences[index, index:index + 3] = (factor / before, -factor / before - factor / after, factor / after)
    return differences
