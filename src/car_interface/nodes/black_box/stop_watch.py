"""Recognizes a stop that nobody asked for: the car was driven, and what drove it was lost.

It goes by the states of turn_arb, throttle_arb and teleop_logi. A person who releases the deadman or presses the e-stop
asks for the stop, and so does a planner that has stopped the car before it falls silent.
"""
from __future__ import annotations

import math
from typing import Any, NamedTuple

from car_interface.common import causes
from car_interface.common.sources import PLANNER, TELEOP

TURN_ARB, THROTTLE_ARB, TELEOP_LOGI = "turn_arb", "throttle_arb", "teleop_logi"
STANDSTILL_MPS = 0.05  # one pulse of a wheel, 15 mm, in 0.3 s
MIN_THROTTLE = 0.01
TICK_HZ = 10
# A car counts as driven for so long after it moved or had throttle: more than its stop at a time-out of 0.5 s lasts.
DRIVEN_TICKS = 2 * TICK_HZ
SILENT_TICKS = TICK_HZ  # of an arbiter that sends its state at 10 Hz or more: it has crashed or hangs


class Stop(NamedTuple):
    cause: str  # one of causes.LOSSES, or which node is silent
    reason: str


class StopWatch:
    """Follows who has the car. ``tick`` is called TICK_HZ times a second; a pause of the caller's counts as one tick.

    A state makes a stop if its node had given the car to somebody by the state before, and now names a loss.
    """

    def __init__(self):
        self._driven_ticks = 0  # for how long the car still counts as driven
        self._has_throttle_arb = False
        self._quiet_ticks: dict[str, int] = {}  # since the newest state, of the nodes by which somebody has the car

    def on_steering(self, state: Any) -> Stop | None:
        """Take a car_interface/SteeringState."""
        speed_mps = state.speed if state.odometry_age < 1.0 else math.nan
        # Without throttle_arb and without odometry nobody knows whether it moves.
        if abs(speed_mps) > STANDSTILL_MPS or not self._has_throttle_arb and math.isnan(speed_mps):
            self._driven_ticks = DRIVEN_TICKS
        return self._update(TURN_ARB, state.source in (TELEOP, PLANNER), state.cause, state.reason)

    def on_throttle(self, state: Any) -> Stop | None:
        """Take a car_interface/ThrottleState."""
        self._has_throttle_arb = True
        if abs(state.granted) > MIN_THROTTLE or abs(state.speed) > STANDSTILL_MPS:
            self._driven_ticks = DRIVEN_TICKS
        if state.esc_cause == causes.ESC_MOTION:
            return self._update(THROTTLE_ARB, False, state.esc_cause, state.esc_reason)
        return self._update(THROTTLE_ARB, state.source in (TELEOP, PLANNER), state.cause, state.reason)

    def on_gamepad(self, state: Any) -> Stop | None:
        """Take a car_interface/TeleopState: why a deadman is false that no hand has released."""
        return self._update(TELEOP_LOGI, state.human_in_loop, state.cause, state.reason)

    def tick(self) -> Stop | None:
        """Count the time; return a stop for an arbiter whose states have ended."""
        self._quiet_ticks = {node: ticks + 1 for node, ticks in self._quiet_ticks.items()}
        silent = [node for node, ticks in self._quiet_ticks.items() if ticks > SILENT_TICKS]
        for node in silent:
            del self._quiet_ticks[node]
        was_driven, self._driven_ticks = self._driven_ticks > 0, max(0, self._driven_ticks - 1)
        silent = [node for node in silent if node != TELEOP_LOGI]  # whose silence the arbiters report sooner
        return Stop(f"{silent[0]} silent", "its states have ended") if silent and was_driven else None

    def _update(self, node, has_car, cause, reason):
        had_car = self._quiet_ticks.pop(node, None) is not None
        if has_car:
            self._quiet_ticks[node] = 0
        elif had_car and self._driven_ticks and cause in causes.LOSSES:
            return Stop(cause, reason)
        return None
