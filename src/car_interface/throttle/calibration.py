"""Convert between the converter's values, requests, and the duties of the ESC's channel.

A request is a fraction of the duty between neutral and each end: 1 is the duty of the highest value, −1 the duty of the
lowest. The table of an ESC that drives forward on shorter pulses falls.
"""
from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Sequence

from car_interface.common import declared
from car_interface.common.declared import REQUIRED
from car_interface.common.errors import require
from car_interface.common.lookup_table import LookupTable, round_half_away
from car_interface.common.units import MAX_DUTY


@dataclass(frozen=True)
class ThrottleCalibration:
    """Convert values, requests and duties by the ESC's table, which is linear between its values and saturates beyond.

    The duties only rise or only fall from value to value; neighbours may be equal.

    Raises:
        ConfigError: naming the parameter.
    """

    channel: int = declared.channel("servo/channel", REQUIRED, "the ESC's channel")
    value_axis: Sequence[float] = declared.numbers(
        "servo/value_axis", REQUIRED, "the converter's values, of the table", "increasing")
    duty_table: Sequence[float] = declared.duties(
        "servo/duty_table", REQUIRED, "the duty for each value, only rising or only falling")
    neutral: int = declared.duty("servo/neutral", REQUIRED, "neither drives nor brakes; within the table")
    _duty_of_value: LookupTable = field(init=False, repr=False, compare=False)

    def __post_init__(self):
        table = LookupTable(self.value_axis, self.duty_table, "servo/value_axis", "servo/duty_table")
        object.__setattr__(self, "_duty_of_value", table)
        steps = [high - low for low, high in zip(self.duty_table, self.duty_table[1:])]
        require(any(steps) and not min(steps) < 0 < max(steps), "servo/duty_table", list(self.duty_table),
                "duties that only rise, or only fall")
        require(min(self.duty_table) <= self.neutral <= max(self.duty_table), "servo/neutral", self.neutral,
                "a duty within the range of servo/duty_table")

    def request_of_value(self, value: float) -> float:
        """Return the request for one of the converter's values; NaN for NaN."""
        return self._request(self._duty_of_value(value)) if value == value else value

    def request_of_duty(self, duty: int) -> float | None:
        """Return the request that a duty on the channel stands for; beyond ±1 outside of the table.

        Without a pulse it is ``None``: −1 (never set), 0 (off), the full duty (on).
        """
        return self._request(duty) if 0 < duty < MAX_DUTY else None

    def duty(self, request: float) -> int:
        """Return the duty for a request, which is clamped to −1..1."""
        span = self.duty_table[-1 if request >= 0 else 0] - self.neutral
        return max(0, min(MAX_DUTY, round_half_away(self.neutral + min(1.0, abs(request)) * span)))

    def _request(self, duty):
        beyond = duty - self.neutral
        forward, behind = self.duty_table[-1] - self.neutral, self.duty_table[0] - self.neutral
        forward, behind = forward or -behind, behind or -forward
        return (beyond / forward if beyond * forward > 0 else -beyond / behind) + 0.0  # no negative zero


def trimmed(calibration: ThrottleCalibration, neutral: int) -> ThrottleCalibration:
    """Return a calibration with another neutral and the table shifted by the same, so that a value of 0 stays neutral.

    Raises:
        ConfigError: naming the parameter.
    """
    shift = neutral - calibration.neutral
    return replace(calibration, neutral=neutral,
                   duty_table=[max(0, min(MAX_DUTY, duty + shift)) if shift else duty
                               for duty in calibration.duty_table])
