"""By how much a car's turns widen with speed, from segments driven at the same steering and at different speeds.

The curvature that is lost grows with the square of the lateral acceleration: κ = κ₀ − q · κ |κ| v⁴, one q for the car
(see ``steering.calibration``, where circles of a real car stand behind it). Two segments at the same place of the
wheels have the same κ₀, so that each pair of them measures q. It is known where a drive has such pairs, of speeds that
differ enough; else the one that the calibration has stays.
"""
from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from car_interface.tools.calibration.steering.segments import Observations

SAME_DUTY = 8.0  # half a count of the board
MIN_PAIRS = 6
MAX_SIGMA = 0.0015  # of q: a fifth of what a car has that was measured
SEEN_SIGMAS = 3.0  # less than that is none
MAX_UNDERSTEER = 0.1
TUKEY = 4.0


class Understeer(NamedTuple):
    """What a drive shows of it."""

    value: float  # 1/m for each (m/s²)²
    sigma: float  # its standard error; inf: the drive doesn't show it
    pairs: int

    @property
    def is_known(self) -> bool:
        """Whether the drive has the speeds for it."""
        return self.pairs >= MIN_PAIRS and self.sigma <= MAX_SIGMA


UNKNOWN = Understeer(0.0, math.inf, 0)


def lost_per_m(found: Observations) -> np.ndarray:
    """Return the curvature that each segment has lost for q = 1, left positive, (S,)."""
    return found.curvature_per_m * np.abs(found.curvature_per_m) * found.speed_mps ** 4


def without_understeer(found: Observations, understeer: float) -> Observations:
    """Return the observations as if they had been driven at a crawl."""
    if not understeer:
        return found
    return found._replace(curvature_per_m=found.curvature_per_m + understeer * lost_per_m(found))


def estimate_understeer(found: Observations, slope_per_m: np.ndarray) -> Understeer:
    """Estimate it from pairs of observations at the same place of the wheels.

    Args:
        found: the observations, S of them.
        slope_per_m: of the curve at each, in 1/m for each duty, (S,): what a difference in duty is worth.
    """
    one, other = _pairs(found.duty)
    if len(one) < MIN_PAIRS:
        return UNKNOWN
    lost = lost_per_m(found)
    widened = found.curvature_per_m[one] - found.curvature_per_m[other]
    lost = lost[one] - lost[other]
    apart = (found.duty[one] - found.duty[other]) * slope_per_m[one]
    duty_sigma = np.hypot(found.duty_sigma[one], found.duty_sigma[other]) * np.abs(slope_per_m[one])
    sigma = np.sqrt(found.sigma_per_m[one] ** 2 + found.sigma_per_m[other] ** 2 + duty_sigma ** 2 + apart ** 2)
    weight = np.ones(len(one))
    value, scatter = 0.0, 1.0
    for _ in range(8):
        scaled = weight / sigma ** 2
        information = float(np.sum(scaled * lost ** 2))
        if information <= 0.0:
            return UNKNOWN
        value = -float(np.sum(scaled * lost * (widened - apart))) / information
        off = np.abs(widened - apart + value * lost) / sigma
        scatter = max(1.0, 1.4826 * float(np.median(off)))
        weight = (1 - np.minimum(off / (scatter * TUKEY), 1.0) ** 2) ** 2
    # An observation is in several pairs: they tell as much as there are observations.
    repeats = max(1.0, len(one) / max(1, len(set(one) | set(other)) - 1))
    error = scatter * math.sqrt(repeats / information)
    if value < SEEN_SIGMAS * error:
        value = 0.0
    return Understeer(min(value, MAX_UNDERSTEER), error, len(one))


def _pairs(duty):
    """Indices of all pairs at the same place: those that follow each other by duty, up to eight on."""
    order = np.argsort(duty, kind="stable")
    ones, others = [], []
    for step in range(1, 9):
        near = duty[order[step:]] - duty[order[:-step]] <= SAME_DUTY
        ones.append(order[step:][near])
        others.append(order[:-step][near])
    return np.concatenate(ones), np.concatenate(others)
