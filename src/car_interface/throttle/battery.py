"""Judge the battery by its voltage: report a low one, and stop the planner at an empty one.

Under load the voltage falls by current times resistance, and it rises again once the car stands. So a battery is low,
or empty, once its voltage was below the limit for SUSTAINED_NS, and it remains so until its voltage was above that by
``recovery`` for as long. Only voltages that arrive count: silence, NaN or 0 make no battery empty and no empty one
full. Pure: ``now_ns`` is passed in.
"""
from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from car_interface.common import causes, declared
from car_interface.common.staleness import TimedInput
from car_interface.common.units import NS_PER_S

# The current's peak at a start is over by then: a car that pulls 5 m/s² has 10 m/s after it.
SUSTAINED_NS = 2 * NS_PER_S
REPORT = "battery"  # throttle_arb's on /diagnostics
SEE_WHO = "See who publishes battery_state: rostopic info battery_state"


@dataclass(frozen=True)
class BatteryConfig:
    """Configure the check of the battery; 0 V = off.

    The default of ``recovery`` is the fall at a start: a pack of two cells and its leads have some 25 mΩ, and a Slash's
    motor draws 30 A.
    """

    warn_below_v: float = declared.number(
        "warn_below", 0.0, "a warning below this voltage; 0 = none", "V", low=0.0, high=1000.0)
    stop_below_v: float = declared.number(
        "stop_below", 0.0, "[the planner is stopped](limits.md#battery) below this voltage; 0 = never", "V", low=0.0,
        high=1000.0)
    recovery_v: float = declared.number(
        "recovery", 0.75, "either ends this far above its voltage", "V", low=0.0, high=1000.0)
    timeout_s: float = declared.number(
        "timeout", 5.0, "age at which `battery_state` is stale", "s", above=0.0, high=3600.0)


class BatteryStatus(NamedTuple):
    """How the battery is."""

    cause: str  # one of car_interface.common.causes; empty: there is nothing wrong with it
    text: str

    @property
    def remedy(self) -> str:
        """Return what a person can do; empty: nothing has to be done."""
        if self.cause in (causes.BATTERY_LOW, causes.BATTERY_EMPTY):
            return "Charge or change the battery"
        if self.cause == causes.BATTERY_STALE:
            return f"{SEE_WHO}, and whether it does so less often than battery/timeout"
        return SEE_WHO if self.cause else ""


class BatteryWatch:
    """Judge one battery from its voltages."""

    def __init__(self, config: BatteryConfig = BatteryConfig()):
        self._config = config
        self._voltage = TimedInput("battery_state", config.timeout_s)
        self._valid_v = math.nan  # the newest that is a voltage
        self._low = _Limit(config.warn_below_v, config.recovery_v)
        self._empty = _Limit(config.stop_below_v, config.recovery_v)

    def update(self, voltage_v: float, now_ns: int) -> None:
        """Take a voltage; NaN, infinite, 0 or less = it isn't measured."""
        is_measured = 0 < voltage_v < math.inf
        for limit in (self._low, self._empty):
            if self._voltage.is_stale(now_ns):
                limit.update(math.nan, now_ns)  # what it was meanwhile isn't known
            limit.update(voltage_v if is_measured else math.nan, now_ns)
        self._voltage.update(voltage_v, now_ns)
        if is_measured:
            self._valid_v = voltage_v

    @property
    def is_empty(self) -> bool:
        """Return whether the planner has to stop."""
        return self._empty.is_below

    def status(self, now_ns: int) -> BatteryStatus:
        """Return how the battery is, for reasons and reports."""
        trouble = self._trouble(now_ns)
        for limit, cause, name, until in (
                (self._empty, causes.BATTERY_EMPTY, "stop_below", "no planner drives before it has"),
                (self._low, causes.BATTERY_LOW, "warn_below", "low until it has")):
            if limit.is_below:
                text = (f"the battery has {self._valid_v:.2f} V after it fell below {name}, {limit.volts:g} V: "
                        f"{until} {limit.end_v:g} V")
                return BatteryStatus(cause, f"{text}; {trouble.text}" if trouble else text)
        voltage = self._voltage
        return trouble or BatteryStatus("", f"{self._valid_v:.2f} V" if voltage.was_received else
                                        voltage.stale_reason(now_ns))

    def _trouble(self, now_ns):
        """Return what is wrong with the messages, or None."""
        voltage = self._voltage
        is_needed = voltage.was_received or self._config.stop_below_v
        if is_needed and voltage.is_stale(now_ns):
            return BatteryStatus(causes.BATTERY_STALE, f"{voltage.stale_reason(now_ns)}: the voltage isn't known")
        if voltage.was_received and not 0 < voltage.value < math.inf:
            return BatteryStatus(causes.BATTERY_NOT_FINITE,
                                 f"battery_state's voltage is {voltage.value:g}, none that a battery has")
        return None


class _Limit:
    """Whether a voltage is below a limit, with hysteresis; 0 = never. NaN, one that isn't known, asks for no change."""

    def __init__(self, volts, recovery_v):
        self.volts, self.end_v = volts, volts + recovery_v
        self.is_below = False
        self._since_ns = None  # since when the voltage asks for a change; None: it doesn't

    def update(self, voltage_v, now_ns):
        if not (voltage_v >= self.end_v if self.is_below else voltage_v < self.volts):
            self._since_ns = None
        elif self._since_ns is None:
            self._since_ns = now_ns
        elif now_ns - self._since_ns >= SUSTAINED_NS:
            self.is_below, self._since_ns = not self.is_below, None
