"""The center and the two ends of a steering curve."""
from __future__ import annotations

import math
from typing import NamedTuple, Sequence

import numpy as np

from car_interface.tools.calibration.steering.drive import COUNT

STOP_DUTY = 40.0  # a mechanical stop is one when the curve stays level over this duty
STOP_RATIO = 0.007  # level is a curvature that differs from the tightest by at most this ratio
RISE_LOW, RISE_HIGH = 0.90, 0.97  # of the tightest curvature: between them lies the rise to a stop


class Side(NamedTuple):
    """One end of the steering."""

    duty: float  # where the radius stops shrinking, or else the farthest that was driven
    curvature_per_m: float  # magnitude there
    sigma_per_m: float
    is_stop: bool  # the wheels turned no farther though the servo did
    is_end: bool  # that, or the servo isn't meant to turn farther
    farthest_duty: float  # that was driven


def find_side(knots: np.ndarray, curvatures: np.ndarray, sigmas: np.ndarray, towards: int, low: float, high: float,
              limits: Sequence[float] = (), backlash_duty: float = 0.0) -> Side:
    """Return the end of a curve, (K,) each, towards lower duties (−1) or higher ones (1).

    Args:
        low, high: the outermost duties that were driven.
        limits: duties beyond which nobody means to steer.
        backlash_duty: of the linkage: where the servo is at its limit the wheels stay behind it by half of that.
    """
    farthest = float(low if towards < 0 else high)
    ordered = slice(None, None, towards)
    curvature, duty, sigma = curvatures[ordered], knots[ordered], sigmas[ordered]
    inside = (duty - farthest) * towards <= 0
    curvature, duty, sigma = curvature[inside] * np.sign(curvature[inside][-1]), duty[inside], sigma[inside]
    tightest = float(curvature[-1])
    # The tightest curvature is as uncertain as those beside it.
    is_level = curvature >= tightest * (1 - STOP_RATIO) - min(2 * sigma[-1], 2 * STOP_RATIO * tightest)
    begin = len(is_level) - int(np.argmin(is_level[::-1])) if not is_level.all() else 0
    is_stop = (farthest - duty[begin]) * towards >= STOP_DUTY and tightest > 5 * sigma[-1]
    is_end = is_stop or any((farthest - limit) * towards >= -COUNT - backlash_duty / 2 for limit in limits
                            if (limit - np.mean(knots)) * towards > 0)
    end_duty = farthest
    if is_stop:
        end_duty = _count_at_stop(duty, curvature, tightest, _corner(duty, curvature, tightest, begin))
    return Side(end_duty, tightest, float(sigma[begin if is_stop else -1]), bool(is_stop), bool(is_end), farthest)


def find_center(knots: np.ndarray, curvatures: np.ndarray, sigmas: np.ndarray) -> tuple[float, float]:
    """Return (the duty that goes straight, its standard error) of a curve (K,); NaN where it never does."""
    if curvatures.min() > 0 or curvatures.max() < 0:
        return math.nan, math.nan
    sign = 1.0 if curvatures[-1] > curvatures[0] else -1.0
    up = sign * curvatures
    at = int(np.clip(np.searchsorted(up, 0.0), 1, len(knots) - 1))
    level = np.flatnonzero(np.abs(up) < 1e-9)
    if len(level):  # level at 0: its middle
        center = float(knots[level].mean())
    else:
        low, high = up[at - 1], up[at]
        center = float(knots[at - 1] + (0 - low) / (high - low) * (knots[at] - knots[at - 1]))
    steepness = slope(knots, up, center)
    return center, float(np.interp(center, knots, sigmas) / max(steepness, 1e-9))


def slope(knots: np.ndarray, curvatures: np.ndarray, duty: float) -> float:
    """Return the magnitude of the curve's slope around a duty, over two counts to each side: 1/m per duty."""
    low, high = max(knots[0], duty - 2 * COUNT), min(knots[-1], duty + 2 * COUNT)
    return abs(float(np.interp(high, knots, curvatures) - np.interp(low, knots, curvatures))) / max(high - low, 1.0)


def _corner(duty, curvature, tightest, begin):
    """Return where the rise would meet the level of the stop: the fitted curve is smooth, a stop isn't."""
    outward = math.copysign(2 * COUNT, duty[-1] - duty[0])
    is_rise = ((curvature >= RISE_LOW * tightest) & (curvature <= RISE_HIGH * tightest)
               & (np.arange(len(duty)) < begin))
    rise = np.flatnonzero(is_rise)
    if len(rise) < 2 or np.ptp(curvature[rise]) < 0.02 * tightest:
        return float(duty[begin])
    gradient, offset = np.polyfit(curvature[rise], duty[rise], 1)
    corner = gradient * tightest + offset
    low, high = sorted((duty[rise[-1]], duty[begin] + outward))
    return float(min(max(corner, low), high))


def _count_at_stop(duty, curvature, tightest, corner):
    """Return the first count from a stop's corner on that turns as tight: the board may round a duty back across it."""
    inward = math.copysign(1.0, duty[0] - duty[-1])
    counts = np.arange(round(corner / COUNT) * COUNT, duty[-1] - inward, -inward * COUNT)
    order = np.argsort(duty)
    is_level = np.interp(counts, duty[order], curvature[order]) >= tightest * (1 - STOP_RATIO)
    return float(counts[np.argmax(is_level)]) if is_level.any() else corner
