"""Looks up many values of a calibrated map at once, as numpy arrays.

The same function as ``ValueMap.value_at``, a million times at once: for a recording, or a plot. numpy is fast where its
arrays stay in the processor's cache, so the queries go through in pieces; and instead of searching, each query's place
is guessed from a table and put right by a step or two.
"""
from __future__ import annotations

from typing import Sequence

import numpy as np

PIECE = 16384  # queries; about a dozen arrays of it fit into a second-level cache
GUESSES_PER_ROW = 4


class BulkLookup:
    """A map prepared for many queries.

    Args:
        values, velocities: the map's axes.
        columns: for each velocity the accelerations, rising with the values.
    """

    def __init__(self, values: Sequence[float], velocities: Sequence[float], columns: Sequence[Sequence[float]]):
        self._values, self._value_step = np.array(values, dtype=float), np.diff(values)
        self._velocities, self._per_velocity = np.array(velocities, dtype=float), 1 / np.diff(velocities)
        table = np.array(columns, dtype=float)
        self._rows = len(values)
        self._low, self._step = _and_step(table)
        self._least, self._min_step = _and_step(table[:, 0])
        self._span, self._span_step = _and_step(table[:, -1] - table[:, 0])
        self._bins = _Bins(self._velocities)
        self._bins_per_column = GUESSES_PER_ROW * self._rows
        self._guess, self._guess_step = _and_step(_rows_by_share(table, self._bins_per_column))

    def __call__(self, accelerations, velocities) -> np.ndarray:
        """The values; both arguments of one shape, or to be broadcast to one; no element may be NaN."""
        accelerations, velocities = np.broadcast_arrays(np.asarray(accelerations, float), np.asarray(velocities, float))
        found = np.empty(accelerations.shape)
        flat, wanted, at = found.ravel(), accelerations.ravel(), velocities.ravel()
        for begin in range(0, flat.size, PIECE):
            piece = slice(begin, begin + PIECE)
            flat[piece] = self._look_up(wanted[piece], at[piece])
        return flat.reshape(accelerations.shape)

    def _look_up(self, accelerations, velocities):
        velocities = np.clip(velocities, self._velocities[0], self._velocities[-1])
        column = self._bins.find(velocities)
        part = (velocities - self._velocities.take(column)) * self._per_velocity.take(column)
        least = self._least.take(column) + part * self._min_step.take(column)
        span = self._span.take(column) + part * self._span_step.take(column)
        wanted = np.clip(accelerations - least, 0.0, span)
        bins = (_share(wanted, span) * self._bins_per_column).astype(np.intp)
        bins += column * (self._bins_per_column + 1)
        row = (self._guess.take(bins) + part * self._guess_step.take(bins)).astype(np.intp)
        return self._within(wanted + least, part, column * self._rows, row)

    def _within(self, wanted, part, base, row):
        """Put the guessed rows right, and interpolate between each and the next."""
        def acceleration(part, place):
            return self._low.take(place) + part * self._step.take(place)
        place = base + row
        below, above = acceleration(part, place), acceleration(part, place + 1)
        wrong = np.flatnonzero((wanted < below) | (wanted > above))
        while wrong.size:
            row[wrong] = np.clip(row[wrong] + np.where(wanted[wrong] < below[wrong], -1, 1), 0, self._rows - 2)
            place = base[wrong] + row[wrong]
            below[wrong], above[wrong] = acceleration(part[wrong], place), acceleration(part[wrong], place + 1)
            beyond = (wanted[wrong] < below[wrong]) & (row[wrong] > 0)
            beyond |= (wanted[wrong] > above[wrong]) & (row[wrong] < self._rows - 2)
            wrong = wrong[beyond]
        return self._values.take(row) + _share(wanted - below, above - below) * self._value_step.take(row)


class _Bins:
    """In which interval of an axis numbers are: from equal bins, none of which has more than one breakpoint in it."""

    MOST = 100_000

    def __init__(self, axis):
        self._axis = axis
        count = int(np.ceil((axis[-1] - axis[0]) / np.diff(axis).min())) + 1
        self._is_coarse = count > self.MOST
        if not self._is_coarse:
            self._per_unit = count / (axis[-1] - axis[0])
            edges = axis[0] + np.arange(count + 1) / self._per_unit
            self._first = np.clip(np.searchsorted(axis, edges, side="right") - 1, 0, len(axis) - 2)

    def find(self, numbers):
        """The index of the breakpoint below each; all of them on the axis."""
        if self._is_coarse:
            return np.clip(np.searchsorted(self._axis, numbers, side="right") - 1, 0, len(self._axis) - 2)
        index = self._first.take(((numbers - self._axis[0]) * self._per_unit).astype(np.intp))
        index += numbers >= self._axis.take(index + 1)
        index -= numbers < self._axis.take(index)
        return np.minimum(index, len(self._axis) - 2)


def _share(part, whole):
    """What part of the whole it is, 0 to 1; 0 of nothing, as a plateau is."""
    share = np.divide(part, whole, out=np.zeros_like(part), where=whole > 0)
    return np.clip(share, 0.0, 1.0, out=share)


def _and_step(table):
    """A table by velocity, flat: what it has at the lower end of each interval, and how much more at the upper end."""
    return table[:-1].ravel(), np.diff(table, axis=0).ravel()


def _rows_by_share(table, count):
    """For each column, and each of so many shares of its range: how many rows up that is, between two rows too."""
    shares = (np.arange(count + 1) + 0.5) / count
    rows = np.arange(table.shape[1])
    found = [np.interp(column[0] + shares * (column[-1] - column[0]), column, rows) for column in table]
    return np.minimum(found, rows[-1] - 0.001)  # so that there is one above it
