"""Downsamples curves, paths and places of a drive to bounded memory, whatever its length."""
from __future__ import annotations

import cmath
import math
from array import array

import numpy as np

EMPTY = math.nan


class Trace:
    """A value over time, of which the minimum and the maximum in each bin of time are kept.

    No peak is lost, however short. With fewer than three samples in each bin all of them are kept. With twice as many
    bins as pixels no difference can be seen.
    """

    def __init__(self, duration_s: float, bins: int = 1500):
        self._bins_per_s = bins / max(duration_s, 1e-9)
        self._last = bins - 1
        self._minima, self._maxima = ((array("d", [EMPTY]) * bins, array("d", [EMPTY]) * bins) for _ in range(2))
        self.count = 0  # of all samples, as are the next two
        self.minimum, self.maximum = math.inf, -math.inf

    def add(self, time_s: float, value: float) -> None:
        """Add a sample; one that is not finite is left out."""
        if not math.isfinite(value):
            return
        self.count += 1
        slot = min(max(int(time_s * self._bins_per_s), 0), self._last)
        times, values = self._minima
        if not values[slot] <= value:  # also when it is empty
            times[slot], values[slot] = time_s, value
        times, values = self._maxima
        if not values[slot] >= value:
            times[slot], values[slot] = time_s, value
        self.minimum, self.maximum = min(self.minimum, value), max(self.maximum, value)

    def curve(self, gap_s: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
        """Return (times (N,), values (N,)) in order, with a NaN in each gap of more than ``gap_s``."""
        times, values = (np.concatenate([np.frombuffer(low), np.frombuffer(high)])
                         for low, high in zip(self._minima, self._maxima))
        order = np.argsort(times[~np.isnan(values)], kind="stable")
        times, values = (column[~np.isnan(values)][order] for column in (times, values))
        gaps = np.flatnonzero(np.diff(times) > max(gap_s, 3 / self._bins_per_s)) + 1
        return np.insert(times, gaps, times[gaps]) if len(gaps) else times, np.insert(values, gaps, EMPTY)


class Traces(dict):
    """The traces of a drive by their names; one that nobody has written to yet is empty."""

    def __init__(self, duration_s: float):
        super().__init__()
        self.duration_s = duration_s

    def __missing__(self, name: str) -> Trace:
        self[name] = Trace(self.duration_s)
        return self[name]


class Path:
    """A path in the plane, in steps that double whenever there are too many points."""

    def __init__(self, step_m: float = 0.02, max_points: int = 8000):
        self._step_m, self._max_points = step_m, max_points
        self.places: list[complex] = []  # x + yi in m; NaN where the path is interrupted
        self.kinds: list[int] = []  # who steered the car to each of them

    def add(self, place: complex, kind: int) -> None:
        """Add a point, if it is far enough from the one before or somebody else steers."""
        if self.kinds and kind == self.kinds[-1] and abs(place - self.places[-1]) < self._step_m:
            return
        self.places.append(place)
        self.kinds.append(kind)
        if len(self.kinds) > self._max_points:
            self._step_m *= 2
            kept = [index for index, place in enumerate(self.places) if index % 2 == 0 or cmath.isnan(place)]
            if len(kept) > 0.75 * self._max_points:  # mostly interruptions
                kept = range(0, len(self.kinds), 2)
            self.places, self.kinds = ([column[index] for index in kept] for column in (self.places, self.kinds))

    def interrupt(self) -> None:
        """Leave a gap before the next point."""
        if self.kinds:
            self.places.append(complex(math.nan, math.nan))
            self.kinds.append(self.kinds[-1])


class Spots:
    """Places in the plane by the cell that they lie in; cells of the width cell_m, doubled if there are too many."""

    def __init__(self, cell_m: float = 0.02, max_cells: int = 12000):
        self.cell_m, self._max_cells = cell_m, max_cells
        self._cells: dict = {}  # whose keys are a set in order
        self.count = 0

    def add(self, place: complex) -> None:
        """Add a place, x + yi in m."""
        self.count += 1
        self._cells[round(place.real / self.cell_m), round(place.imag / self.cell_m)] = None
        if len(self._cells) > self._max_cells:
            self.cell_m *= 2
            self._cells = dict.fromkeys((round(x / 2), round(y / 2)) for x, y in self._cells)

    def places(self) -> np.ndarray:
        """Return the middles of the cells (N,), x + yi in m."""
        cells = np.array(list(self._cells), dtype=float).reshape(-1, 2) * self.cell_m
        return cells[:, 0] + 1j * cells[:, 1]
