"""What a drive leaves in a report, in memory that doesn't grow with its length: curves, paths, spots."""
from __future__ import annotations

import math
from array import array

import numpy as np

EMPTY = math.nan


class Trace:
    """A value over time, thinned to what can be drawn: of each stretch of time the least and the greatest.

    A peak is never lost, however short. With fewer than three samples in each stretch it is all there.

    Args:
        start_s, end_s: of the drive.
        stretches: how many it is divided into: twice as many as pixels make the thinning invisible.
    """

    def __init__(self, start_s: float, end_s: float, stretches: int = 1500):
        self._start_s = start_s
        self._per_s = stretches / max(end_s - start_s, 1e-9)
        self._last = stretches - 1
        self._least, self._greatest = ((array("d", [EMPTY]) * stretches, array("d", [EMPTY]) * stretches)
                                       for _ in range(2))
        self.count = 0
        self.least, self.greatest = math.inf, -math.inf
        self.min_s = self.greatest_s = math.nan

    def add(self, time_s: float, value: float) -> None:
        """Take a sample; one that is not finite is left out."""
        if not math.isfinite(value):
            return
        self.count += 1
        slot = min(max(int((time_s - self._start_s) * self._per_s), 0), self._last)
        times, values = self._least
        if not values[slot] <= value:  # also when there is none yet
            times[slot], values[slot] = time_s, value
        times, values = self._greatest
        if not values[slot] >= value:
            times[slot], values[slot] = time_s, value
        if value < self.least:
            self.least, self.min_s = value, time_s
        if value > self.greatest:
            self.greatest, self.greatest_s = value, time_s

    def curve(self, gap_s: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
        """Times and values in order, a NaN where nothing came for longer than ``gap_s``."""
        times, values = (np.concatenate([np.frombuffer(low), np.frombuffer(high)])
                         for low, high in zip(self._least, self._greatest))
        order = np.argsort(times[~np.isnan(values)], kind="stable")
        times, values = (column[~np.isnan(values)][order] for column in (times, values))
        gaps = np.flatnonzero(np.diff(times) > max(gap_s, 3 / self._per_s)) + 1
        return np.insert(times, gaps, times[gaps]) if len(gaps) else times, np.insert(values, gaps, EMPTY)


class Path:
    """A way in the plane, in steps that double whenever there are too many.

    Attributes:
        x_m, y_m: the points.
        kinds: what the car was driven by on the way to each.
    """

    def __init__(self, step_m: float = 0.02, most: int = 8000):
        self._step_m, self._most = step_m, most
        self.x_m, self.y_m, self.kinds = array("d"), array("d"), array("b")

    def add(self, x_m: float, y_m: float, kind: int) -> None:
        """Take a point, if it is far enough from the one before or the driver is another."""
        if self.kinds and kind == self.kinds[-1] and \
                math.hypot(x_m - self.x_m[-1], y_m - self.y_m[-1]) < self._step_m:
            return
        self.x_m.append(x_m)
        self.y_m.append(y_m)
        self.kinds.append(kind)
        if len(self.kinds) > self._most:
            self._step_m *= 2
            kept = [index for index, x_m in enumerate(self.x_m) if index % 2 == 0 or math.isnan(x_m)]
            if len(kept) > 0.75 * self._most:  # more interruptions than ways
                kept = range(0, len(self.x_m), 2)
            self.x_m, self.y_m, self.kinds = (array(column.typecode, [column[index] for index in kept])
                                              for column in (self.x_m, self.y_m, self.kinds))

    def interrupt(self) -> None:
        """What comes next isn't connected with what was before."""
        if self.kinds:
            self.x_m.append(math.nan)
            self.y_m.append(math.nan)
            self.kinds.append(self.kinds[-1])


class Spots:
    """Places in the plane, those in the same cell taken together; the cells grow whenever there are too many.

    Attributes:
        count: of all that were added.
        cell_m: the cells' width.
    """

    def __init__(self, cell_m: float = 0.02, most: int = 12000):
        self.cell_m, self._most = cell_m, most
        self._cells: dict = {}
        self.count = 0

    def add(self, x_m: float, y_m: float) -> None:
        """Take a place."""
        self.count += 1
        cell = (round(x_m / self.cell_m), round(y_m / self.cell_m))
        self._cells[cell] = self._cells.get(cell, 0) + 1
        if len(self._cells) > self._most:
            self.cell_m *= 2
            before, self._cells = self._cells, {}
            for (x, y), count in before.items():
                cell = (round(x / 2), round(y / 2))
                self._cells[cell] = self._cells.get(cell, 0) + count

    def places(self) -> tuple[np.ndarray, np.ndarray]:
        """The cells' middles, in m."""
        cells = np.array(list(self._cells), dtype=float).reshape(-1, 2) * self.cell_m
        return cells[:, 0], cells[:, 1]
