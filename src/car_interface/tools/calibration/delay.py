"""Estimates the delay and the first-order lag from a cause to its effect.

The cause holds its value until the next sample, as commands do; the effect depends on it by an unknown curve. No model
of that curve is needed: with the right delay and lag equal values of the (delayed, lagged) cause have equal effects.
Pure numpy.
"""
from __future__ import annotations

from typing import NamedTuple

import numpy as np

STEP_S = 0.02  # of the time scale on which delays are tried
BINS = 60
MAX_S = 0.4
COARSE_S, FINE_S = 0.04, 0.01
MIN_SAMPLES = 200


class Delay(NamedTuple):
    """How an effect follows its cause."""

    delay_s: float  # the time until a change begins
    lag_s: float  # the time from then until 63 % of it are done
    explained: float  # the ratio of the effect's variance that the cause explains with these; 0 = unknown


def held(t_s: np.ndarray, value: np.ndarray, at_s: np.ndarray) -> np.ndarray:
    """Return the values at the times ``at_s`` (M,) of a signal (N,) that holds each sample until the next: (M,).

    Before the first sample its value counts.
    """
    return value[np.maximum(np.searchsorted(t_s, at_s, side="right") - 1, 0)]


def lagged(value: np.ndarray, step_s: float, lag_s: float) -> np.ndarray:
    """Return an evenly sampled signal (N,) after a first-order lag: (N,)."""
    if lag_s < step_s / 10:
        return np.asarray(value, float)
    decay = float(np.exp(-step_s / lag_s))
    out, now = [], float(value[0])
    for wanted in value.tolist():
        now = wanted + (now - wanted) * decay
        out.append(now)
    return np.array(out)


def estimate(cause_s: np.ndarray, cause: np.ndarray, effect_s: np.ndarray, effect: np.ndarray,
             weight: np.ndarray) -> Delay | None:
    """Find delay and lag, at most MAX_S each.

    Args:
        cause_s, cause: the cause, (N,) each, held until the next sample.
        effect_s, effect: samples of the effect at rising times, (M,) each; noise and gaps don't matter.
        weight: of each sample of the effect, (M,); 0 = not used.

    Returns:
        ``None`` where there are too few samples, or where the cause explains next to nothing.
    """
    used = (weight > 0) & np.isfinite(effect) & (effect_s >= cause_s[0]) if len(cause_s) else np.zeros(0, bool)
    if used.sum() < MIN_SAMPLES or np.ptp(cause) == 0:
        return None
    at_s, y, w = effect_s[used], effect[used], weight[used]
    grid_s = np.arange(cause_s[0], at_s[-1] + STEP_S, STEP_S)
    commanded = held(cause_s, cause, grid_s)
    mean = np.average(y, weights=w)
    total = np.sum(w * (y - mean) ** 2)

    def best(delays_s, lags_s):
        """Return the least that remains unexplained, and by which delay and lag."""
        followed = [(lag_s, lagged(commanded, STEP_S, lag_s)) for lag_s in lags_s]
        return min((_scatter(np.interp(at_s - delay_s, grid_s, cause), y, w), delay_s, lag_s)
                   for delay_s in delays_s for lag_s, cause in followed)

    _, delay_s, lag_s = best(*[_steps(0.0, MAX_S, COARSE_S)] * 2)
    smallest, delay_s, lag_s = best(*(_steps(max(0.0, near_s - COARSE_S), near_s + COARSE_S, FINE_S)
                                      for near_s in (delay_s, lag_s)))
    explained = 1 - smallest / total if total > 0 else 0.0
    return Delay(delay_s, lag_s, float(explained)) if explained > 0.1 else None


def _steps(low, high, step):
    return [round(low + step * index, 4) for index in range(round((high - low) / step) + 1)]


def _scatter(x, y, w):
    """Return the weighted sum of squares of ``y`` around straight lines over ``x``, one in each of BINS equal bins."""
    order = np.argsort(x, kind="stable")
    x, y, w = x[order], y[order], w[order]
    starts = np.unique(np.linspace(0, len(x), BINS + 1).astype(int)[:-1])
    sum_w, sum_x, sum_y = (np.add.reduceat(column, starts) for column in (w, w * x, w * y))
    counts = np.diff(np.append(starts, len(x)))
    dx, dy = x - np.repeat(sum_x / sum_w, counts), y - np.repeat(sum_y / sum_w, counts)
    xx, xy, yy = (np.add.reduceat(column, starts) for column in (w * dx * dx, w * dx * dy, w * dy * dy))
    return float(np.sum(yy - np.where(xx > 1e-12, xy * xy / np.maximum(xx, 1e-12), 0.0)))
