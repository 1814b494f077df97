"""The part of a fitted value map that may be written, as its CSV has it: nothing is invented."""
from __future__ import annotations

from typing import NamedTuple

import numpy as np

from car_interface.calibration.value_map.fit import MIN_STEP_MPS2, RESOLUTION_MPS2, Fit, rounded
from car_interface.calibration.value_map.surface import rising_column

MIN_NODES = 3  # values, and velocities, that make a map worth driving with
BRACKET = 2  # nodes: so near on both sides must be others that are supported

class Table(NamedTuple):
    """What goes into the CSV.

    Attributes:
        values, velocities, accelerations: as of the fit, or part of it.
        origin: of each acceleration: DRIVEN, BETWEEN, OLD or MOVED.
        sigma_mps2: standard errors; NaN for the prior's.
    """

    values: np.ndarray
    velocities: np.ndarray
    accelerations: np.ndarray
    origin: np.ndarray
    sigma_mps2: np.ndarray

    def share(self) -> float:
        """Of its accelerations that the drives state."""
        return float(np.mean(self.origin <= BETWEEN))


# Where a table's acceleration is from: the drives themselves; from the drives next to it on both sides, and as sure; an
# old map; an old map, moved because its column would not have risen.
DRIVEN, BETWEEN, OLD, MOVED = range(4)


def table(found: Fit, neutral: float, prior: np.ndarray | None = None) -> Table | None:
    """The part of a fit that may be written: nothing is invented.

    Where the drives state nothing the prior's accelerations stay. Where an old one contradicts what its column has
    measured it is moved as far as it takes for the column to rise. Where there is no prior either, the axes are cut, to
    the largest part in which everything is stated.

    Args:
        found: the fit.
        neutral: the value at which the car coasts: the map should have values on both sides of it.
        prior: an old map's accelerations at the fit's nodes, NaN where it has none.

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
        least = np.full(wanted.shape[0] - 1, MIN_STEP_MPS2)
        weight = np.where(old, 1.0, 1e9)  # what was measured doesn't give way
        risen = np.stack([rising_column(wanted[:, k], weight[:, k], least) for k in range(wanted.shape[1])], axis=1)
        origin[old & (np.abs(risen - wanted) > RESOLUTION_MPS2)] = MOVED
        wanted = risen
        sigma[old] = np.nan
    return Table(found.values[part[0].ravel()], found.velocities[part[1].ravel()], rounded(wanted), origin, sigma)


def _between(found):
    """Nodes that the drives passed by on both sides, and know as well as those."""
    known = found.supported
    between = np.zeros(known.shape, bool)
    for axis in (0, 1):
        near = []
        for direction in (1, -1):
            side = np.zeros(known.shape, bool)
            for reach in range(1, BRACKET + 1):
                moved = np.roll(known, direction * reach, axis)
                edge = [slice(None), slice(None)]
                edge[axis] = slice(None, reach) if direction > 0 else slice(-reach, None)
                moved[tuple(edge)] = False
                side |= moved
            near.append(side)
        between |= near[0] & near[1]
    return between & ~known & found.sure


def _largest_part(stated, values, velocities, neutral):
    """Rows and columns of the largest part of a map in which everything is stated: at least two each, or ``None``.

    Its velocities follow one another. Of its values some may be left out, if no more than BRACKET side by side: the map
    is linear over them. How large it is goes by how far it reaches; a part that both drives and brakes is preferred,
    and one with less than MIN_NODES of either is the last choice.
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
