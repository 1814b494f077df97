"""A smoothing spline through observations with outliers, the nearest monotone sequence, and how far both may be off.

The spline is an integrated random walk whose strength is the likeliest, and varies along the duty where the curve
bends. It is robust by Tukey's biweight. Its errors grow in gaps between the places where it was driven. S observations,
K knots.
"""
from __future__ import annotations

import math

import numpy as np
from scipy import sparse
from scipy.linalg import cho_solve_banded, cholesky_banded

from car_interface.tools.calibration.shared import NothingToFit, rising
from car_interface.tools.calibration.steering.drive import KNOT
from car_interface.tools.calibration.steering.segments import Observations, place_numbers

NEIGHBOURS, CONTRADICTION_PER_M = 5, 0.03
# Standard errors to either side of a band. On virtual cars it holds the truth more often than 19 times of 20, also
# where the recording has gaps: see test/accuracy/steering_calibration.py.
BAND = 1.96
BEND_RATIO = 1 / math.sqrt(12)  # standard error of a uniform distribution over a range, in ranges
# Of what a curve changes from one place to the next: how far it is off the straight line half way between them, as a
# standard error. On virtual Slashes it was up to 0.16 in gaps of 250 duty whose two sides are as steep as each other.
UNSEEN_RATIO = 0.05


class Smooth:
    """The spline through observations; ``adapts``: its strength may vary along the duty.

    Attributes:
        curvatures: at the knots in 1/m, (K,).
        weight: of each observation, 0..1, (S,); 0 is an outlier.
        scatter: of the observations, in their own standard errors, at least 1.

    Raises:
        NothingToFit: no strength gives a curve that can be computed.
    """

    # Variance of a second difference of the curve from knot to knot, (1/m)². Below 1e-12 the equations of a nearly
    # straight curve can't be solved in floating point.
    STRENGTHS = np.exp(np.linspace(math.log(1e-12), math.log(1e-3), 30))
    SMOOTHING, ROBUST = 3, 4  # passes without and with weights
    TUKEY = 5.0
    MIN_STRENGTH_RATIO = 1e-5  # of the local strengths, smallest to largest
    SMOOTHED_OVER = 13  # knots

    def __init__(self, found: Observations, adapts: bool = True):
        self._h, self._y, self._stated = found.weights, found.curvature_per_m, found.sigma_per_m
        self._duty_sigma = found.duty_sigma
        knots = self._h.shape[1]
        self._second = sparse.diags([1.0, -2.0, 1.0], [0, 1, 2], shape=(knots - 2, knots), format="csr")
        self.weight = np.where(_contradicted(found.duty, self._y, self._stated), 0.0, 1.0)
        self.scatter = 1.0
        self._sigma = self._stated
        local = np.ones(knots - 2)
        for step in range(self.SMOOTHING + self.ROBUST):
            self._solve(local)
            steep = np.abs(self._h @ np.gradient(self.curvatures, KNOT))
            self._sigma = np.hypot(self._stated, self._duty_sigma * steep)
            off = np.abs(self._y - self._h @ self.curvatures) / self._sigma
            self.scatter = max(1.0, 1.4826 * float(np.median(off)))
            if step >= self.SMOOTHING:
                self.weight = (1 - np.minimum(off / (self.scatter * self.TUKEY), 1.0) ** 2) ** 2
            if adapts:
                local = self._local()
        self._solve(local)

    def cost(self, weights: sparse.csr_matrix) -> float:
        """Return twice the negative log likelihood, but for a constant, of other weights (S, K) of the same
        observations.
        """
        normal, right = self._normal_equations(weights)
        return self._cost(_banded(normal + self._penalty), right)[0]

    def standard_errors(self) -> np.ndarray:
        """Return the standard errors of the curvatures at the knots, (K,)."""
        inverse = cho_solve_banded((self._factor, True), np.eye(self._factor.shape[1]))
        return np.sqrt(np.maximum(np.diag(inverse), 0.0))

    def monotone(self, sigmas: np.ndarray) -> np.ndarray:
        """Return the nearest monotone curve (K,), weighted by standard errors (K,); it rises or falls as the
        observations.
        """
        places = self._h @ np.arange(self._h.shape[1])
        sign = 1.0 if np.polyfit(places, self._y, 1)[0] > 0 else -1.0
        return sign * rising(sign * self.curvatures, 1 / np.maximum(sigmas, 1e-9) ** 2)

    def _local(self):
        """Return the strength relative to its mean along the duty (K−2,): large where the curve bends, as at a stop."""
        bend = (self._second @ self.curvatures) ** 2
        kernel = np.hanning(self.SMOOTHED_OVER + 2)[1:-1]
        smoothed = np.convolve(np.pad(bend, self.SMOOTHED_OVER // 2, "edge"), kernel / kernel.sum(), "valid")
        smoothed = smoothed + 0.1 * np.median(smoothed) + 1e-18
        # Where the curve was straight so far it may still bend a little; and beyond a range of 1e8 the equations can't
        # be solved in floating point.
        smoothed = np.maximum(smoothed, smoothed.max() * self.MIN_STRENGTH_RATIO)
        return smoothed / np.exp(np.mean(np.log(smoothed)))

    def _solve(self, local):
        penalty = self._second.T @ sparse.diags(1 / local) @ self._second
        normal, right = self._normal_equations(self._h)
        # Bands of both, as wide as the wider. None of them as a difference from their sum: that rounded the penalty,
        # which is far smaller, so that straight curves weren't free, and came out otherwise with each LAPACK.
        height = len(_banded(normal + penalty))
        normal_band, penalty_band = _banded(normal, height), _banded(penalty, height)
        rank = self._second.shape[0]
        best = (math.inf, 1.0, None, None)
        for strength in self.STRENGTHS:
            cost, curvatures, factor = self._cost(normal_band + penalty_band / strength, right)
            cost += rank * math.log(strength)
            if cost < best[0]:
                best = cost, strength, curvatures, factor
        if best[2] is None:
            raise NothingToFit("no curve through the places where the steering was held can be computed: drive more of "
                               "them")
        _, strength, self.curvatures, self._factor = best
        self._penalty = penalty / strength

    def _normal_equations(self, h):
        weighted = h.multiply((self.weight / (self.scatter * self._sigma) ** 2)[:, None]).tocsr()
        return weighted.T @ h, weighted.T @ self._y

    def _cost(self, band, right):
        """Return (restricted likelihood but for constants, curve, factor) of normal equations in band form."""
        try:
            factor = cholesky_banded(band, lower=True)
        except np.linalg.LinAlgError:
            return math.inf, None, None
        curvatures = cho_solve_banded((factor, True), right)
        squares = (self.weight / (self.scatter * self._sigma) ** 2) @ self._y ** 2
        return float(2 * np.sum(np.log(factor[0])) + squares - right @ curvatures), curvatures, factor


def _contradicted(duty, curvature, sigma):
    """Return which observations (S,) no monotone curve can have beside most of their neighbours on one side."""
    order = np.argsort(duty, kind="stable")
    y, slack = curvature[order], 4 * sigma[order] + CONTRADICTION_PER_M
    if np.median(np.sign(y[len(y) // 2:])) > np.median(np.sign(y[:len(y) // 2])):
        y = -y  # it falls from here on
    contradictions = np.zeros((2, len(y)), int)
    for apart in range(1, NEIGHBOURS + 1):
        rises = y[apart:] - y[:-apart] > np.maximum(slack[apart:], slack[:-apart])
        contradictions[0, apart:] += rises
        contradictions[1, :-apart] += rises
    found = np.zeros(len(y), bool)
    found[order] = contradictions.max(axis=0) > NEIGHBOURS / 2
    return found


def _banded(matrix, height=None):
    """Return a symmetric sparse matrix in lower band form, as scipy's banded solvers take it."""
    matrix = matrix.tocoo()
    below = matrix.row - matrix.col
    dense = np.zeros((height or int(below.max()) + 1, matrix.shape[0]))
    lower = below >= 0
    np.add.at(dense, (below[lower], matrix.col[lower]), matrix.data[lower])
    return dense


# --- errors beyond the spline's ---


def bends(knots: np.ndarray, found: Observations) -> np.ndarray:
    """Return how far the curve may be off the straight line between the places where it was driven, at the knots, which
    are duties (K,): (K,).

    Between two places the curve may continue as steeply as it came and bend anywhere, as at a mechanical stop.
    """
    duty, curvature, sigma = _places(found)
    if len(duty) < 3:
        return np.zeros(len(knots))
    width = np.diff(duty)
    # Beyond the outermost places it may be level, as at a stop.
    steep, steep_sigma = np.pad(np.diff(curvature) / width, 1), np.pad(np.hypot(sigma[1:], sigma[:-1]) / width, 1)
    squared, noise = np.diff(steep) ** 2, np.hypot(steep_sigma[1:], steep_sigma[:-1])
    change = np.sqrt(squared) * squared / np.maximum(squared + noise ** 2, 1e-30)  # reduced as far as it may be noise
    at = np.clip(np.searchsorted(duty, knots) - 1, 0, len(width) - 1)
    from_begin, to_end = np.clip(knots - duty[at], 0, None), np.clip(duty[at + 1] - knots, 0, None)
    return np.minimum(change[at] * from_begin, change[at + 1] * to_end)


def unseen(duties: np.ndarray, found: Observations) -> np.ndarray:
    """Return the standard error of a curve at the duties (K,) by bends of its own that show at none of the places where
    it was driven: (K,). A curve that goes straight on before a gap and behind it needn't do so within.
    """
    duty, curvature, _ = _places(found)
    if len(duty) < 2:
        return np.zeros(len(duties))
    at = np.clip(np.searchsorted(duty, duties) - 1, 0, len(duty) - 2)
    part = np.clip((duties - duty[at]) / (duty[at + 1] - duty[at]), 0.0, 1.0)
    return UNSEEN_RATIO * np.abs(curvature[at + 1] - curvature[at]) * 4 * part * (1 - part)


def bounded(curvatures: np.ndarray, sigmas: np.ndarray) -> np.ndarray:
    """Standard errors (K,) of a monotone curve (K,): between two known places it can't lie beyond either of them."""
    up = curvatures if curvatures[-1] >= curvatures[0] else -curvatures
    upper = np.minimum.accumulate((up + BAND * sigmas)[::-1])[::-1]
    lower = np.maximum.accumulate(up - BAND * sigmas)
    return np.minimum(sigmas, np.maximum(np.maximum(upper - up, up - lower), 0.0) / BAND)


def _places(found):
    """Return (duty, curvature, standard error) (P,) of the observations, duties rising; within half a count they are
    one.
    """
    weight, place = 1 / found.sigma_per_m ** 2, place_numbers(found.duty)
    total = np.bincount(place, weight)
    return (np.bincount(place, weight * found.duty) / total,
            np.bincount(place, weight * found.curvature_per_m) / total, 1 / np.sqrt(total))
