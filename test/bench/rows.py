"""The figures against their targets: statistics, the table, JSON. Pure.

A ``Row`` is one distribution. It has a line in the table for each of its targets.
"""
from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Mapping, NamedTuple, Sequence

MEDIAN, P99, P99_9, P99_99, WORST = "median", "p99", "p99.9", "p99.99", "max"
PERCENT = {MEDIAN: 50, P99: 99, P99_9: 99.9, P99_99: 99.99, WORST: 100}
COLUMNS = ("what", "figure", "unit", "to reach", "met", "bare rospy beside it", "ratio")
WIDTHS = (60, 12, 9, 15, 6, 20, 6)  # on a terminal


@dataclass(frozen=True)
class Summary:
    """A distribution: the number of its samples, and its percentiles by their names."""

    samples: int
    values: Mapping[str, float]

    @classmethod
    def of(cls, values: Sequence[float]) -> Summary:
        """Return the summary of at least one value."""
        ordered = sorted(values)
        return cls(len(ordered), {name: percentile(ordered, percent) for name, percent in PERCENT.items()})


def percentile(ordered: Sequence[float], percent: float) -> float:
    return ordered[max(0, math.ceil(len(ordered) * percent / 100) - 1)]


class Target(NamedTuple):
    """The bounds of one statistic of a row; without a bound it is only shown.

    ``low`` and ``high`` bound the figure itself: for what a machine that drives a car must reach. ``max_ratio`` bounds
    its ratio to bare rospy's beside it, which says the same on a slow machine and on a fast one.
    """

    statistic: str = MEDIAN
    low: float | None = None
    high: float | None = None
    max_ratio: float | None = None

    @property
    def is_bound(self) -> bool:
        return any(bound is not None for bound in (self.low, self.high, self.max_ratio))

    def met_by(self, value: float, floor: float | None = None) -> bool:
        """Return whether a value is within the bounds; without bare rospy's no bound of the ratio is met."""
        if self.max_ratio is not None and (floor is None or value > self.max_ratio * floor):
            return False
        return (self.low is None or value >= self.low) and (self.high is None or value <= self.high)

    def __str__(self) -> str:
        ratio = "" if self.max_ratio is None else f"≤ {self.max_ratio:g} ×"
        return ", ".join(filter(None, (self._absolute(), ratio)))

    def _absolute(self):
        if self.low is None:
            return "" if self.high is None else f"≤ {self.high:g}"
        if self.high is None:
            return f"≥ {self.low:g}"
        return f"{self.low:g}" if self.low == self.high else f"{self.low:g} … {self.high:g}"


@dataclass(frozen=True)
class Row:
    group: str
    what: str
    unit: str
    summary: Summary | None  # None when it could not be measured; the note says why
    targets: tuple[Target, ...] = (Target(),)
    floor: Summary | None = None  # the same quantity of bare rospy, in the same run
    note: str = ""
    digits: int = 3  # of a figure that is shown
    void: str = ""  # why the figure meets no target, however good it is

    def meets(self, target: Target) -> bool | None:
        """Return whether a target is met; None without a bound. What was not measured, or is void, meets no bound."""
        if not target.is_bound:
            return None
        return self.summary is not None and not self.void and target.met_by(*self._values(target))

    def missed(self) -> tuple[str, ...]:
        """Return the statistics whose target is missed, each with its figure, or its ratio where that is the target."""
        return tuple(self._missed_text(target) for target in self.targets if self.meets(target) is False)

    def _missed_text(self, target):
        if self.summary is None:
            return "not measured"
        value, floor = self._values(target)
        ratio = f"{value / floor:.2f} ×" if target.max_ratio is not None and floor else ""
        return f"{self._statistic(target)} {ratio or f'{number(value, self.digits)} {self.unit}'}".lstrip()

    def _values(self, target):
        return self.summary.values[target.statistic], self.floor and self.floor.values[target.statistic]

    def _statistic(self, target):
        is_single = self.summary is None or self.summary.samples == 1
        return "" if is_single and len(self.targets) == 1 else target.statistic

    def cells(self, target: Target) -> tuple[str, ...]:
        what = ", ".join(filter(None, (self.what, self._statistic(target))))
        met = {True: "yes", False: "no", None: ""}[self.meets(target)]
        if self.summary is None:
            return (what, "not measured", self.unit, str(target), met, "", "")
        value, floor = self._values(target)
        return (what, number(value, self.digits), self.unit, str(target), met,
                "" if floor is None else number(floor, self.digits), f"{value / floor:.2f}" if floor else "")

    def as_json(self) -> dict:
        return {**asdict(self), "targets": [{**target._asdict(), "met": self.meets(target)} for target in self.targets]}


def number(value: float, digits: int = 3) -> str:
    if value == int(value):
        return str(int(value))
    return f"{value:.{max(0, digits - 1 - math.floor(math.log10(abs(value))))}f}"


def table(lines: Sequence[Sequence[str]]) -> str:
    """Return lines of Markdown whose columns also line up on a terminal."""
    return "\n".join("| " + " | ".join(cell.ljust(width) for cell, width in zip(cells, WIDTHS)) + " |"
                     for cells in lines)


def verdict(rows: Sequence[Row]) -> str:
    """Return how many targets were met, and which were not."""
    count = sum(1 for row in rows for target in row.targets if target.is_bound)
    missed = "; ".join(f"{row.what} ({', '.join(row.missed())})" for row in rows if row.missed())
    return f"{count - sum(len(row.missed()) for row in rows)} of {count} targets met{missed and f'; missed: {missed}'}"
