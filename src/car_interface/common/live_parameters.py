"""Duties that may be tuned while the car drives, within limits and at a limited rate.

Pure: requests and ``now_ns`` in, the active values out. A request never takes effect in one step: all values change
together, linearly, so that every intermediate set is a mean of two valid ones.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Callable, Mapping

from car_interface.common import declared
from car_interface.common.errors import ConfigError
from car_interface.common.units import MAX_DUTY, NS_PER_S

MAX_STEP_NS = 50_000_000  # of one step, five ticks of an arbiter: a node that was held up makes no jump


@dataclass(frozen=True)
class TuningSettings:
    """Limits of tuning."""

    max_offset: int = declared.duty(
        "live_range", 0, "how far it may be [tuned](tuning.md) from its start; 0 = not at all")
    save_to: str | None = declared.path(
        "save_to", None, "the file that `~save` writes", default_text="none; the launch file's own")
    saves_to_package: bool = declared.flag(
        "save_to_package", True, "false = `~save` refuses a file in the package's own `config`, as in the demo")


class Tuning:
    """Duties that are tuned together.

    Args:
        start: the values at start, by name.
        max_offset: the largest change of each from there, in duty.
        rate: the maximum rate of change, in duty per second.
        check: raises ConfigError for values that don't fit together.
    """

    def __init__(self, start: Mapping[str, int], max_offset: int, rate: float,
                 check: Callable[[Mapping[str, int]], Any]):
        self._start = dict(start)
        self._rate = rate
        self._check = check
        self.low = {name: max(0, value - max_offset) for name, value in start.items()}
        self.high = {name: min(MAX_DUTY, value + max_offset) for name, value in start.items()}
        self.accepted: Mapping[str, int] = dict(start)
        self.active = self.accepted  # or values between the old and the accepted ones
        self._from = self.active
        self._elapsed_ns = 0  # of the change from there to the accepted values
        self._stepped_ns = 0

    @property
    def is_changing(self) -> bool:
        """Return whether the active values have not reached the accepted ones yet."""
        return self.active is not self.accepted

    @property
    def changes(self) -> str:
        """The accepted values that differ from those at start, as text; empty when none does."""
        return ", ".join(f"{name} {self._start[name]} → {value}" for name, value in self.accepted.items()
                         if value != self._start[name])

    def request(self, wanted: Mapping[str, Any], now_ns: int) -> str:
        """Accept the values of a request, each clamped to its limits; all of them or none.

        Unknown and missing names are ignored.

        Returns:
            What was clamped or refused, and why; empty = nothing.
        """
        problems = []
        values = dict(self.accepted)
        for name in values:
            value = wanted.get(name, values[name])
            if isinstance(value, bool) or not isinstance(value, int):
                return f"{name} {value!r} is no duty: refused"
            values[name] = max(self.low[name], min(self.high[name], value))
            if values[name] != value:
                problems.append(f"{name} {value} is beyond {self.low[name]} to {self.high[name]}: clamped to "
                                  f"{values[name]}")
        try:
            self._check(values)
        except ConfigError as error:
            return f"{error}: refused"
        if values != self.accepted:
            self.accepted, self._from = values, self.active
            self._elapsed_ns, self._stepped_ns = 0, now_ns
        return "; ".join(problems)

    def advance(self, now_ns: int) -> bool:
        """Step towards the accepted values; return whether the active values have changed."""
        if not self.is_changing:
            return False
        self._elapsed_ns += max(0, min(now_ns - self._stepped_ns, MAX_STEP_NS))
        self._stepped_ns = max(now_ns, self._stepped_ns)
        largest_change = max(abs(value - self._from[name]) for name, value in self.accepted.items())
        duration_ns = round(largest_change * NS_PER_S / self._rate)
        if self._elapsed_ns >= duration_ns:
            self.active = self.accepted
        else:
            # In integers, so that values which are in order at both ends of the change are in order between them.
            self.active = {name: (2 * self._from[name] * duration_ns + 2 * (value - self._from[name]) * self._elapsed_ns
                                    + duration_ns) // (2 * duration_ns) for name, value in self.accepted.items()}
        return True
