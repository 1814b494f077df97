"""Values that may be tuned while the car drives: how far, how fast, and what becomes of a request.

Pure: requests and ``now_ns`` in, the values in force out. A request never takes effect at a jump: all values glide
together, so that what lies between two valid sets of values is in force on the way.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Callable, Mapping, NamedTuple

from car_interface.common.errors import ConfigError
from car_interface.common.servo_channels import MAX_DUTY
from car_interface.common.units import NS_PER_S

MAX_STEP_NS = 50_000_000  # a node that was held up must not make up for it by a jump


@dataclass(frozen=True)
class TuningSettings:
    """What a car's owner allows.

    Attributes:
        reach: how far a value may be moved from where it was at start, in duty; 0 = not at all.
        save_to: the YAML file that values are saved back to; ``None`` = nowhere.
    """

    reach: int
    save_to: str | None = None


def read_tuning(params, reach: int) -> TuningSettings:
    """The settings from ~live_range (with this default) and ~save_to."""
    return TuningSettings(reach=params.integer("live_range", reach, low=0, high=MAX_DUTY),
                          save_to=params.path("save_to", None))


class Answer(NamedTuple):
    """What became of a request."""

    values: Mapping[str, int]  # what is accepted by now
    problem: str = ""  # what of the request wasn't, and why


class Tuning:
    """Duties that are tuned together.

    Args:
        start: the values at start, by name.
        reach: how far each may be moved from there, in duty.
        rate: how fast, in duty per second.
        check: raises ConfigError for values that can't be in force together.
    """

    def __init__(self, start: Mapping[str, int], reach: int, rate: float, check: Callable[[Mapping[str, int]], Any]):
        self._start = dict(start)
        self._rate = rate
        self._check = check
        self.low = {name: max(0, value - reach) for name, value in start.items()}
        self.high = {name: min(MAX_DUTY, value + reach) for name, value in start.items()}
        self.accepted: Mapping[str, int] = dict(start)
        self.in_force = self.accepted  # or on the way there
        self._from = self.in_force
        self._gone_ns = 0  # of the way from there
        self._stepped_ns = 0

    @property
    def moving(self) -> bool:
        """Whether what is in force isn't yet what was accepted."""
        return self.in_force is not self.accepted

    @property
    def changes(self) -> str:
        """What is accepted by now and was otherwise at start, in words; empty when nothing is."""
        return ", ".join(f"{name} {self._start[name]} → {value}" for name, value in self.accepted.items()
                         if value != self._start[name])

    def request(self, wanted: Mapping[str, Any], now_ns: int) -> Answer:
        """Take the values of a request: each clamped to its limits, and all of them or none.

        Names that aren't tuned are ignored, and so are those that are missing.
        """
        problems = []
        values = dict(self.accepted)
        for name in values:
            value = wanted.get(name, values[name])
            if isinstance(value, bool) or not isinstance(value, int):
                return Answer(self.accepted, f"{name} {value!r} is no duty: refused")
            values[name] = max(self.low[name], min(self.high[name], value))
            if values[name] != value:
                problems.append(f"{name} {value} is beyond {self.low[name]} to {self.high[name]}: clamped to "
                                  f"{values[name]}")
        try:
            self._check(values)
        except ConfigError as error:
            return Answer(self.accepted, f"{error}: refused")
        if values != self.accepted:
            self.accepted, self._from = values, self.in_force
            self._gone_ns, self._stepped_ns = 0, now_ns
        return Answer(self.accepted, "; ".join(problems))

    def advance(self, now_ns: int) -> bool:
        """Go on towards what was accepted; whether the values in force are others now."""
        if not self.moving:
            return False
        self._gone_ns += max(0, min(now_ns - self._stepped_ns, MAX_STEP_NS))
        self._stepped_ns = max(now_ns, self._stepped_ns)
        longest = max(abs(value - self._from[name]) for name, value in self.accepted.items())
        whole_ns = round(longest * NS_PER_S / self._rate)
        if self._gone_ns >= whole_ns:
            self.in_force = self.accepted
        else:
            # In integers: values that are in order at both ends of the way are so between.
            self.in_force = {name: (2 * self._from[name] * whole_ns + 2 * (value - self._from[name]) * self._gone_ns
                                    + whole_ns) // (2 * whole_ns) for name, value in self.accepted.items()}
        return True
