"""By how much a car's turns widen with speed, from segments driven at the same steering and at different speeds.

Segments at the same place of the wheels have the same curvature at a crawl: what each of them lost by its speed (see
``steering.calibration.lost_per_m``) differs, and shows the one number of the car. It is known where enough places were
driven at speeds that differ enough; else the one that the calibration has stays.

Circles of one place repeat far better than places agree, so that its standard error is by how much places differ.
"""
from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from car_interface.steering.calibration import lost_per_m
from car_interface.tools.calibration.steering.segments import Observations, place_numbers
from car_interface.tools.calibration.steering.smooth import BAND

MIN_PLACES = 2
MIN_PART = 0.02  # of all that is known of it: a place with less doesn't count
# Standard error at least, as a ratio. By a² alone the two sides of the one car that was measured showed 0.0077 and
# 0.0099: they agree within two standard errors of their difference from 0.09 on.
MIN_SIGMA_RATIO = 0.1
MAX_ERROR_RATIO = 0.2  # two standard errors, of the number
USUAL = 0.009  # that car's left-hand circles show it: a smaller number may be as uncertain as this one
SEEN_SIGMAS = 3.0  # less than that is none
MAX_UNDERSTEER = 0.1
HUBER = 2.0  # standard errors, beyond which an observation pulls no harder
MAX_PASSES, CONVERGED = 100, 1e-9


class Understeer(NamedTuple):
    """What a drive shows of it."""

    value: float  # 1/m for each (m/s²)²
    sigma: float  # its standard error; inf: the drive doesn't show it
    places: int  # that were driven at several speeds

    @property
    def is_known(self) -> bool:
        """Whether the drive has the speeds for it."""
        return self.places >= MIN_PLACES and BAND * self.sigma <= MAX_ERROR_RATIO * max(self.value, USUAL)


UNKNOWN = Understeer(0.0, math.inf, 0)


def without_understeer(found: Observations, understeer: float) -> Observations:
    """Return the observations as if they had been driven at a crawl."""
    lost = lost_per_m(found.curvature_per_m, found.speed_mps, understeer)
    return found._replace(curvature_per_m=found.curvature_per_m + lost)


def estimate_understeer(found: Observations, slope_per_m: np.ndarray) -> Understeer:
    """Estimate it in least squares, each place with a curvature of its own. Outliers count less, but none is left out
    (Huber's weights): where places differ, that has to show in the standard error. ``slope_per_m``: of the curve at
    each observation, in 1/m for each duty, (S,): what a difference in duty is worth.
    """
    place = place_numbers(found.duty)
    repeated = np.bincount(place)[place] > 1
    if not repeated.any():
        return UNKNOWN
    place, slope_per_m = place[repeated], slope_per_m[repeated]
    found = Observations(*(column[repeated] for column in found[:-1]), None)
    sigma = np.hypot(found.sigma_per_m, found.duty_sigma * slope_per_m)
    weight, value = 1 / sigma ** 2, math.inf
    for _ in range(MAX_PASSES):
        lost = _less_mean(lost_per_m(found.curvature_per_m, found.speed_mps, 1.0), place, weight)
        widened = _less_mean(found.curvature_per_m, place, weight)
        widened = widened - slope_per_m * _less_mean(found.duty, place, weight)
        information = np.bincount(place, weight * lost ** 2)
        total = float(information.sum())
        if total <= 0.0:
            return UNKNOWN
        before, value = value, -float(np.sum(weight * lost * widened)) / total
        off = np.abs(widened + value * lost) / sigma
        scatter = max(1.0, 1.4826 * float(np.median(off)))
        if abs(value - before) <= CONVERGED:
            break
        weight = 1 / np.maximum(1.0, off / (scatter * HUBER)) / sigma ** 2
    places = int(np.sum(information >= MIN_PART * total))
    # By how much each place alone would move the sum, as clusters of observations whose errors aren't independent.
    moved = np.bincount(place, weight * lost * (widened + value * lost))
    between = math.sqrt(float(moved @ moved) * places / max(1, places - 1)) / total
    error = max(between, scatter / math.sqrt(total))
    if value < SEEN_SIGMAS * error:
        return Understeer(0.0, error, places)
    return Understeer(min(value, MAX_UNDERSTEER), max(error, MIN_SIGMA_RATIO * value), places)


def _less_mean(values, place, weight):
    """Return the values (S,) less the weighted mean of those at the same place, (S,)."""
    mean = np.bincount(place, weight * values) / np.maximum(np.bincount(place, weight), 1e-30)
    return values - mean[place]
