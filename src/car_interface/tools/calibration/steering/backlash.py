"""Estimates the linkage's backlash: the one with which positions approached from both sides agree best."""
from __future__ import annotations

import math
from typing import Sequence

import numpy as np

from car_interface.tools.calibration.steering.drive import FitConfig, NothingToFit
from car_interface.tools.calibration.steering.segments import Segmentation, all_segments, design, observations
from car_interface.tools.calibration.steering.smooth import Smooth, rising

STEP_DUTY = 2.0
MAX_CONTRADICTION = 6.0  # so much more contradiction than with the best backlash is chance
MIN_SIGMA = 1.0
PRIOR_SCALE_DUTY = 20.0  # before any data the backlash is exponentially distributed with this mean
CORRELATION = 4.0  # segments at one position err alike: likelihoods count for so much less
MAX_SQUARE = 25.0  # what one segment adds to the contradiction at most


def estimate_backlash(segmentations: Sequence[Segmentation], config: FitConfig) -> tuple[float, float]:
    """The likeliest backlash and its standard error, both in duty.

    With a wrong backlash positions that were approached from both sides contradict each other: no monotone curve goes
    through them. Of the values that remain the likeliest is taken, all compared by noise and smoothness as known with
    one of them: first by a curve that is equally smooth everywhere, because one that may be sharp in places has its
    places where that value puts them; then, near the truth, by one that may, because the smooth one is too flat where
    the car's is steep.

    Raises:
        NothingToFit: no value fits.
    """
    candidates = np.arange(0.0, config.max_backlash_duty + 1.0, STEP_DUTY)
    contradictions = np.array([_contradiction(segmentations, candidate) for candidate in candidates])
    candidates = candidates[contradictions <= contradictions.min() + MAX_CONTRADICTION]
    backlash_duty = float(np.median(candidates))
    for adapts in (False, True):
        smooth = Smooth(observations(segmentations, backlash_duty), adapts)
        costs = np.array([smooth.cost(design(segmentations, candidate)[0]) for candidate in candidates])
        costs = costs + 2 * candidates / PRIOR_SCALE_DUTY
        if not np.isfinite(costs).any():
            raise NothingToFit("no backlash of the steering fits the places where it was held: drive more of them")
        costs = np.where(np.isfinite(costs), costs, np.inf)
        likelihood = np.exp(-(costs - costs.min()) / 2 / CORRELATION)
        likelihood /= likelihood.sum()
        backlash_duty = float(likelihood @ candidates)
    spread = math.sqrt(float(likelihood @ (candidates - backlash_duty) ** 2))
    return backlash_duty, math.hypot(spread, MIN_SIGMA)


def _contradiction(segmentations, backlash_duty):
    """How far the segments lie off the nearest monotone curve: the sum of bounded squares of standard errors."""
    _, duties = design(segmentations, backlash_duty)
    segments = all_segments(segmentations)
    curvature = np.array([segment.curvature_per_m for segment in segments])
    sigma = np.hypot([segment.sigma_per_m for segment in segments], 3 * segmentations[0].config.min_sigma_per_m)
    order = np.argsort(duties, kind="stable")
    smallest = math.inf
    for sign in (1.0, -1.0):
        y, weight = sign * curvature[order], 1 / sigma[order] ** 2
        smallest = min(smallest, float(np.minimum(weight * (y - rising(y, weight)) ** 2, MAX_SQUARE).sum()))
    return smallest
