"""Standard errors of a steering curve beyond those of its spline: gaps between the places where it was driven."""
from __future__ import annotations

import math

import numpy as np

from car_interface.tools.calibration.steering.segments import Observations, place_numbers

# Standard errors to either side of a band. On virtual cars it holds the truth more often than 19 times of 20, also
# where the recording has gaps: see test/accuracy/steering_calibration.py.
BAND = 1.96
BEND_RATIO = 1 / math.sqrt(12)  # standard error of a uniform distribution over a range, in ranges
# Of what a curve changes from one place to the next: how far it is off the straight line half way between them, as a
# standard error. On virtual Slashes it was up to 0.16 in gaps of 250 duty whose two sides are as steep as each other.
UNSEEN_RATIO = 0.05


def bends(knots: np.ndarray, found: Observations, used: np.ndarray) -> np.ndarray:
    """Return how far the curve may be off the straight line between the places where it was driven, at the knots, which
    are duties (K,): (K,). ``used``: which of the observations count, (S,).

    Between two places the curve may continue as steeply as it came and bend anywhere, as at a mechanical stop.
    """
    duty, curvature, sigma = _places(found, used)
    if len(duty) < 3:
        return np.zeros(len(knots))
    width = np.diff(duty)
    steep, steep_sigma = np.diff(curvature) / width, np.hypot(sigma[1:], sigma[:-1]) / width
    # Beyond the outermost places it may be level, as at a stop.
    before, behind = np.append(0.0, steep[:-1]), np.append(steep[1:], 0.0)
    before_sigma, behind_sigma = np.append(0.0, steep_sigma[:-1]), np.append(steep_sigma[1:], 0.0)
    begins = _beyond_noise(steep - before, np.hypot(steep_sigma, before_sigma))
    ends = _beyond_noise(behind - steep, np.hypot(steep_sigma, behind_sigma))
    at = np.clip(np.searchsorted(duty, knots) - 1, 0, len(width) - 1)
    from_begin, to_end = np.clip(knots - duty[at], 0, None), np.clip(duty[at + 1] - knots, 0, None)
    return np.minimum(begins[at] * from_begin, ends[at] * to_end)


def unseen(duties: np.ndarray, found: Observations, used: np.ndarray) -> np.ndarray:
    """Return the standard error of a curve at the duties (K,) by bends of its own that show at none of the places where
    it was driven: (K,). A curve that goes straight on before a gap and behind it needn't do so within.
    """
    duty, curvature, _ = _places(found, used)
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


def _beyond_noise(difference, sigma):
    """Return the magnitude of a difference, reduced as far as it may be noise."""
    squared = difference ** 2
    return np.abs(difference) * squared / np.maximum(squared + sigma ** 2, 1e-30)


def _places(found, used):
    """Return (duty, curvature, standard error) (P,) of the observations, duties rising; within half a count they are
    one.
    """
    duty, weight = found.duty[used], 1 / found.sigma_per_m[used] ** 2
    place = place_numbers(duty)
    total = np.bincount(place, weight)
    return (np.bincount(place, weight * duty) / total,
            np.bincount(place, weight * found.curvature_per_m[used]) / total, 1 / np.sqrt(total))
