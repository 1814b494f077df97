"""The part of a fitted value map that may be written, and its CSV: nothing is invented."""
from __future__ import annotations

from typing import NamedTuple

import numpy as np

from car_interface.tools.calibration.value_map.fit import Fit
from car_interface.tools.calibration.value_map.surface import (
    DECIMALS,
    MIN_STEP_MPS2,
    RESOLUTION_MPS2,
    rising_column,
    rounded,
)

MIN_NODES = 3  # values, and velocities, of a map that is fit to drive with
BRACKET = 2  # nodes: this near on both sides must be supported ones


class Table(NamedTuple):
    """A map of R values and C velocities, as it is written."""

    values: np.ndarray  # those of the fit, or part of it, (R,); so are the next two
    velocities: np.ndarray  # (C,)
    accelerations: np.ndarray  # (R, C)
    origin: np.ndarray  # of each acceleration: DRIVEN, BETWEEN, OLD or MOVED, (R, C)
    sigma_mps2: np.ndarray  # standard errors, (R, C); NaN for the prior's

    def driven_ratio(self) -> float:
        """Return the ratio of accelerations that come from the drives."""
        return float(np.mean(self.origin <= BETWEEN))


# The source of an acceleration: the drives; drives next to it on both sides, and as sure; an old map; an old map, moved
# because its column would not have risen.
DRIVEN, BETWEEN, OLD, MOVED = range(4)


def table(found: Fit, neutral: float, prior: np.ndarray | None = None) -> Table | None:
    """Return the part of a fit that may be written.

    Where the drives support nothing the prior's accelerations stay; one that contradicts the measured ones of its
    column is moved so that the column rises. Without a prior the axes are limited to the largest part in which every
    node is supported.

    Args:
        neutral: the value at which the car coasts: the map should have values on both sides of it.
        prior: an old map's accelerations at the fit's nodes, (R, C), NaN where it has none.

    Returns:
        The table, with at least two values and velocities, or ``None``.
    """
    between = _between(found)
    origin = np.where(found.supported, DRIVEN, np.where(between, BETWEEN, OLD))
    stated = found.supported | between
    if prior is not None:
        stated = stated | np.isfinite(prior)
    part = _largest_part(stated, found.values, found.velocities, neutral)
    if part is None:
        return None
    origin, sigma = origin[part].copy(), found.sigma_mps2[part].copy()
    old = origin == OLD
    wanted = found.accelerations[part]
    if old.any():
        wanted = np.where(old, prior[part], wanted)
        min_steps = np.full(wanted.shape[0] - 1, MIN_STEP_MPS2)
        weight = np.where(old, 1.0, 1e9)  # measured ones don't move
        risen = np.stack([rising_column(wanted[:, k], weight[:, k], min_steps) for k in range(wanted.shape[1])], axis=1)
        origin[old & (np.abs(risen - wanted) > RESOLUTION_MPS2)] = MOVED
        wanted = risen
        sigma[old] = np.nan
    return Table(found.values[part[0].ravel()], found.velocities[part[1].ravel()], rounded(wanted), origin, sigma)


def _between(found):
    """Return which nodes have supported ones on both sides, and are known as well (R, C)."""
    between = np.zeros(found.supported.shape, bool)
    for axis in (0, 1):
        known = np.moveaxis(np.pad(found.supported, [(BRACKET, BRACKET) if axis == one else (0, 0) for one in (0, 1)]),
                            axis, 0)
        shifted = [known[begin:len(known) - 2 * BRACKET + begin] for begin in range(2 * BRACKET + 1)]
        on_both_sides = np.any(shifted[:BRACKET], axis=0) & np.any(shifted[BRACKET + 1:], axis=0)
        between |= np.moveaxis(on_both_sides, 0, axis)
    return between & ~found.supported & found.sure


def _largest_part(stated, values, velocities, neutral):
    """Rows and columns of the largest part of a map in which every node is stated: at least two each, or ``None``.

    Its velocities are consecutive. Up to BRACKET consecutive values may be left out: the map is linear over them. Its
    size is the product of its ranges; a part that both drives and brakes is preferred, and one with less than MIN_NODES
    of either is the last choice.
    """
    best, largest = None, 0.0
    for first in range(velocities.size - 1):
        for last in range(first + 1, velocities.size):
            whole = np.flatnonzero(stated[:, first:last + 1].all(axis=1))
            for rows in np.split(whole, np.flatnonzero(np.diff(whole) > BRACKET + 1) + 1):
                if rows.size < 2:
                    continue
                low, high = values[rows[0]], values[rows[-1]]
                sides = 4.0 if low < neutral < high else 2.0 if low <= neutral <= high else 1.0
                few = 0.01 if min(rows.size, last - first + 1) < MIN_NODES else 1.0
                size = few * sides * (high - low) * (velocities[last] - velocities[first])
                if size > largest:
                    best, largest = np.ix_(rows, np.arange(first, last + 1)), size
    return best


def csv_text(written: Table) -> str:
    """Return the map's CSV, as generic_value_converter loads it."""
    lines = ["default," + ",".join(number_text(velocity) for velocity in written.velocities)]
    for value, row in zip(written.values, written.accelerations):
        lines.append(number_text(value) + "," + ",".join(f"{cell:.{DECIMALS}f}" for cell in row))
    return "\n".join(lines) + "\n"


def number_text(x: float) -> str:
    """Return a number on an axis, without the errors of binary fractions."""
    return repr(round(float(x), 9))
