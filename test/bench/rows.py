"""What was measured, against what was to be reached: statistics, the table, JSON. Pure.

A ``Row`` is one distribution. It has a line in the table for each of its targets.
"""
from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple, Sequence

MEDIAN, P99, WORST = "median", "p99", "max"
COLUMNS = ("what", "n", "figure", "unit", "target", "ratio", "met", "bare rospy", "ratio to it", "the original")


@dataclass(frozen=True)
class Summary:
    """A distribution in four numbers; p99 and max are its bad end, whichever end that is."""

    samples: int
    median: float
    p99: float
    max: float

    @classmethod
    def of(cls, values: Sequence[float], more_is_better: bool = False) -> Summary:
        """Of at least one value. With ``more_is_better`` p99 is what 99 % reach, and max is the least."""
        ordered = sorted(values, reverse=more_is_better)
        return cls(len(ordered), percentile(ordered, 50), percentile(ordered, 99), ordered[-1])


def percentile(ordered: Sequence[float], percent: float) -> float:
    """Nearest rank: the first of the ordered values that so many percent don't lie beyond."""
    return ordered[max(0, math.ceil(len(ordered) * percent / 100) - 1)]


class Target(NamedTuple):
    """What one statistic of a row must be; without a bound it is only shown."""

    statistic: str = MEDIAN
    low: float | None = None
    high: float | None = None
    original: str = ""  # what the original reaches

    @property
    def is_bound(self) -> bool:
        """Whether there is anything to meet."""
        return self.low is not None or self.high is not None

    def met_by(self, value: float) -> bool:
        """Whether it is."""
        return (self.low is None or value >= self.low) and (self.high is None or value <= self.high)

    def ratio(self, value: float) -> float | None:
        """Of the value to the bound, or to the middle of two; ``None`` where there is none, or it is 0."""
        bounds = [bound for bound in (self.low, self.high) if bound is not None]
        wanted = sum(bounds) / len(bounds) if bounds else 0
        return value / wanted if wanted else None

    def __str__(self) -> str:
        if self.low is None:
            return "" if self.high is None else f"≤ {self.high:g}"
        if self.high is None:
            return f"≥ {self.low:g}"
        return f"{self.low:g}" if self.low == self.high else f"{self.low:g} … {self.high:g}"


@dataclass(frozen=True)
class Row:
    """One thing that was measured."""

    group: str
    what: str
    unit: str
    summary: Summary | None  # None: it could not be measured, and the note says why
    targets: tuple[Target, ...] = (Target(),)
    floor: Summary | None = None  # the same of bare rospy, in the same run
    note: str = ""
    digits: int = 3  # of a figure that count
    void: str = ""  # why the figure, however good, meets no target
    missed: tuple[str, ...] = field(init=False, default=())

    def __post_init__(self):
        object.__setattr__(self, "missed", tuple(
            target.statistic for target in self.targets if self.meets(target) is False))

    def value(self, target: Target) -> float:
        """The figure that a target is about."""
        return getattr(self.summary, target.statistic)

    def meets(self, target: Target) -> bool | None:
        """Whether a target is met; ``None`` when there is nothing to meet. What wasn't measured, or is void, isn't."""
        if not target.is_bound:
            return None
        return self.summary is not None and not self.void and target.met_by(self.value(target))

    def lost_to_rospy(self) -> tuple[str, ...]:
        """The statistics whose target is missed, and by bare rospy as well."""
        return tuple(target.statistic for target in self.targets if self.meets(target) is False
                     and self.floor is not None and not target.met_by(getattr(self.floor, target.statistic)))

    def lines(self) -> list[tuple[str, ...]]:
        """The table's cells, a line for each target."""
        return [self._cells(target) for target in self.targets]

    def _cells(self, target):
        single = self.summary is None or self.summary.samples == 1
        what = self.what if single and len(self.targets) == 1 else f"{self.what}, {target.statistic}"
        if self.summary is None:
            return (what, "0", "not measured", self.unit, str(target), "", "**no**", "", "", target.original)
        value, floor = self.value(target), self.floor and getattr(self.floor, target.statistic)
        met = {True: "yes", False: "**no**", None: ""}[self.meets(target)]
        return (what, str(self.summary.samples), number(value, self.digits), self.unit, str(target),
                _times(target.ratio(value)), met, "" if floor is None else number(floor, self.digits),
                _times(value / floor if floor else None), target.original)

    def as_json(self) -> dict:
        """For a file: everything, rounded to six digits."""
        record = {"group": self.group, "what": self.what, "unit": self.unit,
                  **_summary_as_json(self.summary), "note": self.note, "void": self.void,
                  "targets": [self._target_as_json(target) for target in self.targets]}
        if self.floor is not None:
            record["bare_rospy"] = _summary_as_json(self.floor)
        return record

    def _target_as_json(self, target):
        value = None if self.summary is None else self.value(target)
        floor = self.floor and getattr(self.floor, target.statistic)
        return {"statistic": target.statistic, "low": target.low, "high": target.high,
                "ratio": None if value is None else _rounded(target.ratio(value)),
                "met": self.meets(target),
                "ratio_to_bare_rospy": _rounded(value / floor) if floor and value is not None else None,
                "original": target.original}


def _summary_as_json(summary):
    if summary is None:
        return {"samples": 0, "median": None, "p99": None, "max": None}
    return {"samples": summary.samples, "median": _rounded(summary.median), "p99": _rounded(summary.p99),
            "max": _rounded(summary.max)}


def _rounded(value):
    return None if value is None else float(f"{value:.6g}")


def number(value: float, digits: int = 3) -> str:
    """So many digits that count, or a whole number as it is."""
    if value == int(value):
        return str(int(value))
    return f"{value:.{max(0, digits - 1 - math.floor(math.log10(abs(value))))}f}"


def _times(ratio):
    return "" if ratio is None else f"{ratio:.2f}"


def table(lines: Sequence[Sequence[str]]) -> str:
    """Markdown whose columns also line up on a terminal, without its head; see ``head``."""
    return "\n".join("| " + " | ".join(cell.ljust(width) for cell, width in zip(cells, WIDTHS)) + " |"
                     for cells in lines)


WIDTHS = (58, 5, 12, 9, 14, 5, 6, 10, 11, 12)


def head() -> str:
    """The table's first two lines."""
    return table([COLUMNS, ["-" * width for width in WIDTHS]])


def verdict(rows: Sequence[Row]) -> str:
    """The last words: how many targets were met, and which were not; those that bare rospy misses too come apart."""
    count = sum(1 for row in rows for target in row.targets if target.is_bound)
    met = count - sum(len(row.missed) for row in rows)
    ours = _named((row, [name for name in row.missed if name not in row.lost_to_rospy()]) for row in rows)
    rospys = _named((row, row.lost_to_rospy()) for row in rows)
    return (f"{met} of {count} targets met" + (f"; missed: {ours}" if ours else "")
            + (f"; missed by bare rospy as well: {rospys}" if rospys else ""))


def _named(missed):
    return "; ".join(f"{row.what} ({', '.join(statistics)})" for row, statistics in missed if statistics)
