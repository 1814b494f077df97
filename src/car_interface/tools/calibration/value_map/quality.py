"""How well a fitted map is known: driving around its nodes, standard errors, and prediction of held-out driving.

W windows, G nodes, M manoeuvres.
"""
from __future__ import annotations

import numpy as np
from scipy import sparse

from car_interface.tools.calibration.value_map import acceleration as windowing
from car_interface.tools.calibration.value_map.model import Model, Solution, solve
from car_interface.tools.calibration.value_map.windows import BEYOND

MIN_S = 0.03  # of driving around a node, for a manoeuvre to count there
HELD_OUT = 5


def coverage(model: Model, state: np.ndarray, manoeuvre: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(seconds of driving around each node (G,), in how many manoeuvres (G,)).

    Args:
        model: the model.
        state, manoeuvre: of each window, (W,).
    """
    used = np.flatnonzero(state == windowing.MEASURED)
    time_s = sparse.diags(model.data.hop_s[used]) @ model.map[used]
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
    used = np.flatnonzero((state == windowing.MEASURED) & ~solved.outlying)
    scores = sparse.diags(solved.weight[used] * solved.residual[used]) @ solved.columns[used]
    clusters = (_membership(manoeuvre, used) @ scores).toarray()
    middle = clusters.T @ clusters + solved.prior
    by_manoeuvre = np.einsum("ij,jk,ik->i", inverse[:grid.size], middle, inverse[:grid.size])
    return np.sqrt(np.maximum(by_weight, by_manoeuvre))


def hold_out(model: Model, state: np.ndarray, manoeuvre: np.ndarray) -> tuple[float, int]:
    """(RMS in m/s² over every 5th manoeuvre from a fit to all others, windows in it); NaN if there are none."""
    held = (manoeuvre >= 0) & (manoeuvre % HELD_OUT == HELD_OUT - 1) & (state == windowing.MEASURED)
    if not held.any():
        return float("nan"), 0
    solved = solve(model, np.where(held, BEYOND, state))
    predicted = model.map @ solved.nodes + model.data.slope @ solved.slope
    for side, push in enumerate(model.push):
        predicted = predicted + model.data.part * solved.sag[model.data.drive, side] * (push @ solved.nodes)
    return rms((model.data.acceleration - predicted)[held]), int(held.sum())


def rms(x: np.ndarray) -> float:
    """The root mean square; NaN without numbers."""
    return float(np.sqrt(np.mean(np.square(x)))) if x.size else float("nan")


def _membership(manoeuvre, used):
    """A matrix (M, U) that sums the rows of used windows by manoeuvre."""
    return sparse.csr_matrix((np.ones(used.size), (manoeuvre[used], np.arange(used.size))),
                             shape=(manoeuvre.max() + 1, used.size))
