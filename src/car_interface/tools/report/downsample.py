"""Downsamples curves, paths and places of a drive to bounded memory, whatever its length."""
from __future__ import annotations

import cmath
import math
from collections import defaultdict
from functools import partial
from itertools import chain
from operator import itemgetter

import numpy as np


class Trace:
    """A value over time, of which the minimum and the maximum in each bin of time are kept.

    No peak is lost, however short. With fewer than three samples in each bin all of them are kept. With twice as many
    bins as pixels no difference can be seen.
    """

    def __init__(self, duration_s: float, bins: int = 1500):
        self._bins_per_s, self._last = bins / max(duration_s, 1e-9), bins - 1
        self._extremes: dict = {}  # by bin: its lowest and its highest sample, (time in s, value) each
        self.count = 0  # of all samples, as are the next two
        self.minimum, self.maximum = math.inf, -math.inf

    def add(self, time_s: float, value: float) -> None:
        """Add a sample; one that is not finite is left out."""
        if not math.isfinite(value):
            return
        self.count += 1
        self.minimum, self.maximum = min(self.minimum, value), max(self.maximum, value)
        slot, sample = min(max(int(time_s * self._bins_per_s), 0), self._last), (time_s, value)
        lowest, highest = self._extremes.get(slot, (sample, sample))
        self._extremes[slot] = (sample if value < lowest[1] else lowest, sample if value > highest[1] else highest)

    def curve(self, gap_s: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
        """Return (times (N,), values (N,)) in order, with a NaN in each gap of more than ``gap_s``."""
        samples = sorted(chain(*self._extremes.values()), key=itemgetter(0))
        times, values = np.array(samples, float).reshape(-1, 2).T
        gaps = np.flatnonzero(np.diff(times) > max(gap_s, 3 / self._bins_per_s)) + 1
        return np.insert(times, gaps, times[gaps]), np.insert(values, gaps, math.nan)


class Traces(defaultdict):
    """The traces of a drive by their names; one that nobody has written to yet is empty."""

    def __init__(self, duration_s: float):
        super().__init__(partial(Trace, duration_s))
        self.duration_s = duration_s


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
