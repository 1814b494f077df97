"""Look up a calibrated map: (value, velocity) → acceleration, and its inverse: (acceleration, velocity) → value.

The map is a grid with bilinear interpolation. At any velocity the acceleration must rise with the value, or the inverse
would be ambiguous. ``ValueMap`` checks that at construction, so that a lookup can't fail. Format and method are those
of Autoware's value map. Velocities are in m/s, accelerations in m/s²; a value has the actuator's own unit.
"""
from __future__ import annotations

import csv
import io
import math
from array import array
from bisect import bisect_right
from typing import Iterator, NamedTuple, Sequence

from car_interface.common.errors import ConfigError, require
from car_interface.common.input_file import finite_number, read_file
from car_interface.common.lookup_table import check_axis

ALLOW_PLATEAUS = "accept a map in which acceleration stays level from one row to the next"  # as a parameter
RISING = "an acceleration that rises with value"
JOIN = "check_map --brake brake_map.csv accel_map.csv -o value_map.csv joins Autoware's two maps"
MAX_BYTES = 10_000_000  # 1,000 values at 1,000 velocities, 9 characters each; fitted maps have some hundred cells


class ValueMap:
    """Hold one map.

    Args:
        values: the rows' axis, at least two, strictly increasing.
        velocities: the columns' axis in m/s, at least two, strictly increasing.
        accelerations: a row for each value, in m/s²; along each column rising from row to row.
        allow_plateaus: accept equal accelerations in neighbouring rows, but not in all rows of a column.

    Raises:
        ConfigError: naming the axis, or rows and velocity.
    """

    def __init__(self, values: Sequence[float], velocities: Sequence[float], accelerations: Sequence[Sequence[float]],
                 allow_plateaus: bool = False, name: str = "value map"):
        check_axis(values, f"{name}, values")
        check_axis(velocities, f"{name}, velocities")
        require(len(accelerations) == len(values), f"{name}, rows", len(accelerations),
                f"{len(values)}, one for each value")
        for value, row in zip(values, accelerations):
            require(len(row) == len(velocities) and all(map(math.isfinite, row)), f"{name}, row of value {value}",
                    list(row), f"{len(velocities)} finite accelerations")
        self.values = tuple(map(float, values))
        self.velocities = tuple(map(float, velocities))
        self._columns = [array("d", column) for column in zip(*accelerations)]
        for velocity, column in zip(velocities, self._columns):
            _check_rising(values, column, velocity, allow_plateaus, name)
        self._intervals = self._between_columns()

    def _between_columns(self):
        """Return (begin, width, column at the begin, column at the end) for each interval of velocities.

        The intervals below the first velocity and above the last one have a width of 0.
        """
        velocities, columns = self.velocities, self._columns
        inner = zip(velocities, velocities[1:], columns, columns[1:])
        return [(velocities[0], 0.0, columns[0], columns[0]),
                *((begin, end - begin, low, high) for begin, end, low, high in inner),
                (velocities[-1], 0.0, columns[-1], columns[-1])]

    def value_at(self, acceleration: float, velocity: float) -> float:
        """Return the value that causes ``acceleration`` at ``velocity``; neither may be NaN.

        The velocity is clamped to the map, and an acceleration beyond the map gets the first or last value. On a
        plateau it is the value of least magnitude. O(log rows): an acceleration between two columns is a mean of
        theirs, so its row lies between the rows that the two columns have for it.
        """
        begin, width, low, high = self._intervals[bisect_right(self.velocities, velocity)]
        ratio = (velocity - begin) / width if width else 0.0
        values = self.values
        if ratio == 0.0:
            above = bisect_right(low, acceleration)
        else:
            first, above = bisect_right(low, acceleration), bisect_right(high, acceleration)
            if first > above:
                first, above = above, first
            while first < above:  # the first row with more than the requested acceleration
                middle = (first + above) >> 1
                if acceleration < low[middle] + ratio * (high[middle] - low[middle]):
                    above = middle
                else:
                    first = middle + 1
        if above == 0:
            return values[0]
        below = above - 1
        a0 = low[below] + ratio * (high[below] - low[below])
        if acceleration <= a0:  # less only by rounding
            return self._min_on_plateau(acceleration, low, high, ratio, below)
        if above == len(values):
            return values[-1]
        a1 = low[above] + ratio * (high[above] - low[above])
        if acceleration >= a1:  # more only by rounding
            return values[above]
        return values[below] + (acceleration - a0) / (a1 - a0) * (values[above] - values[below])

    def acceleration_at(self, value: float, velocity: float) -> float:
        """Return the acceleration that ``value`` causes at ``velocity``, both clamped to the map; neither is NaN."""
        begin, width, low, high = self._intervals[bisect_right(self.velocities, velocity)]
        ratio = (velocity - begin) / width if width else 0.0
        values = self.values
        value = max(values[0], min(values[-1], value))
        above = min(max(bisect_right(values, value), 1), len(values) - 1)
        below = above - 1
        a0 = low[below] + ratio * (high[below] - low[below])
        a1 = low[above] + ratio * (high[above] - low[above])
        return a0 + (value - values[below]) / (values[above] - values[below]) * (a1 - a0)

    def _min_on_plateau(self, acceleration, low, high, ratio, last):
        """Return the value of least magnitude among the rows up to ``last`` with exactly this acceleration."""
        first = last
        while first and low[first - 1] + ratio * (high[first - 1] - low[first - 1]) == acceleration:
            first -= 1
        return max(self.values[first], min(self.values[last], 0.0))


def _check_rising(values, column, velocity, allow_plateaus, name):
    require(math.isfinite(column[-1] - column[0]), f"{name}, at velocity {velocity} m/s", (column[0], column[-1]),
            "a finite span")
    # The inverse would answer any acceleration above it with the last value.
    require(min(column) != max(column), f"{name}, at velocity {velocity} m/s", column[0], RISING,
            f"is {column[0]} m/s² for every value")
    for index in range(1, len(column)):
        before, after = column[index - 1], column[index]
        if after > before or allow_plateaus and after == before:
            continue
        found = f"stays level at {after} m/s²" if after == before else f"falls from {before} to {after} m/s²"
        accepted = RISING + (" (allow_plateaus: true takes level stretches)" if after == before else "")
        raise ConfigError(f"{name}, at velocity {velocity} m/s, from value {values[index - 1]} to {values[index]}",
                          (before, after), accepted, found)


class Grid(NamedTuple):
    """The numbers of a map's file, with rising axes."""

    values: list[float]
    velocities: list[float]
    accelerations: list[array]  # one for each value

    def falls(self) -> bool:
        """Return whether acceleration falls with value, as in a brake_map of Autoware's."""
        ends = list(zip(self.accelerations[0], self.accelerations[-1]))
        return all(last <= first for first, last in ends) and any(last < first for first, last in ends)


def load_value_map(path: str, allow_plateaus: bool = False, text: str | None = None) -> ValueMap:
    """Read a map from a CSV file; for the arguments see ``read_grid`` and ``ValueMap``.

    Raises:
        ConfigError: naming file, line, column and fault.
    """
    grid = read_grid(path, text)
    require(not grid.falls(), path, "falling", f"{RISING}; {JOIN}",
            "has an acceleration that falls with value, as a brake_map has")
    return ValueMap(*grid, allow_plateaus, path)


def read_grid(path: str, text: str | None = None) -> Grid:
    """Read the numbers of a CSV file, or check its future content ``text``.

    The first row is a name and the velocities, every other row a value and its accelerations. CRLF, a byte-order mark,
    spaces around numbers, a comma at the end of a line and blank lines at the end are accepted.

    Raises:
        ConfigError: naming file, line, column and fault.
    """
    velocities, values, accelerations, lines = [], [], [], 0
    for lines, row in _read_rows(path, text):
        if lines == 1:
            width = len(row)
            require(width >= 3, f"{path}, line 1", row, "a name and at least two velocities")
            velocities = _numbers(path, 1, row, first_column=1)
        else:
            require(len(row) == width, f"{path}, line {lines}", len(row), f"{width}, as in line 1",
                    f"has {len(row)} columns")
            value, *numbers = _numbers(path, lines, row, first_column=0)
            values.append(value)
            accelerations.append(array("d", numbers))
    require(lines >= 3, path, lines, "a line of velocities and at least two lines of accelerations",
            f"has {lines} line(s)")
    _check_file_axis(path, velocities, lambda index: (1, index + 2))
    _check_file_axis(path, values, lambda index: (index + 2, 1))
    return Grid(values, velocities, accelerations)


def _read_rows(path, text) -> Iterator[tuple[int, list[str]]]:
    """Yield the lines up to the last that isn't blank, each with its number."""
    try:
        data = read_file(path, MAX_BYTES) if text is None else text.encode("utf-8")
        blank = 0
        lines = csv.reader(io.TextIOWrapper(io.BytesIO(data), encoding="utf-8-sig", newline=""))
        for number, row in enumerate(lines, 1):
            cells = [cell.strip() for cell in row]
            if not any(cells):
                blank = blank or number
                continue
            require(not blank, f"{path}, line {blank}", "", "numbers; a blank line may only come last", "is blank")
            yield number, cells if cells[-1] else cells[:-1]
    except OSError as error:
        raise ConfigError("csv_path_value_map", path, f"a file that can be read ({error.strerror})") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise ConfigError("csv_path_value_map", path, f"a CSV file in UTF-8 ({error})") from error


def _numbers(path, line, cells, first_column):
    numbers = []
    for column, cell in enumerate(cells[first_column:], first_column + 1):
        number = finite_number(cell)
        if number is None:
            raise ConfigError(f"{path}, line {line}, column {column}", cell, "a finite number")
        numbers.append(number)
    return numbers


def _check_file_axis(path, axis, place):
    for index in range(1, len(axis)):
        line, column = place(index)
        require(axis[index] > axis[index - 1], f"{path}, line {line}, column {column}", axis[index],
                f"more than the one before it, {axis[index - 1]}")
