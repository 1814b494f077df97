"""What was wrong with the gamepad during a drive, by teleop_logi's state."""
from __future__ import annotations

import math
from typing import Any, NamedTuple

from car_interface.common import causes
from car_interface.report.faults import ERROR, MAX_ENTRIES, WARN, Fault, FaultLog

NODE = "teleop_logi"
NEVER_AFTER_S = 5.0  # a gamepad that isn't heard for so long from the start on is missing
# teleop_logi's and turn_arb's messages of the same moment are recorded in any order, this far apart.
BEFORE_S, AFTER_S = 0.05, 0.2


class Loss(NamedTuple):
    """A time in which the gamepad failed."""

    start_s: float
    end_s: float  # inf: it lasts
    cause: str  # a constant of common.causes
    reason: str  # in words, at its start


class GamepadWatch:
    """Follows teleop_logi's state.

    Args:
        faults: losses are added.
        duration_s: of the recording.
    """

    def __init__(self, faults: FaultLog, duration_s: float):
        self._faults, self._duration_s = faults, duration_s
        self._losses: list[Loss] = []  # up to MAX_ENTRIES
        self._current: Loss | None = None  # the cause that lasts, a loss or not

    def on_state(self, time_s: float, message: Any) -> None:
        """car_interface/TeleopState."""
        if self._current is None or self._current.cause != message.cause:
            self._end_current(time_s)
            self._current = Loss(time_s, math.inf, message.cause, message.reason)

    def loss_at(self, time_s: float) -> Loss | None:
        """The first of the losses that began or lasted at a time; ``None`` = there was none."""
        current = self._current
        losses = [*self._losses, current] if current is not None and current.cause in causes.LOSSES else self._losses
        return next((loss for loss in losses
                     if loss.start_s <= time_s + AFTER_S and loss.end_s >= time_s - BEFORE_S), None)

    def finish(self) -> None:
        """Close what lasts."""
        self._end_current(self._duration_s)
        self._current = None

    def _end_current(self, time_s):
        if self._current is None:
            return
        ended = self._current._replace(end_s=time_s)
        if ended.cause in causes.LOSSES and len(self._losses) < MAX_ENTRIES:
            self._losses.append(ended)
        never = ended.cause == causes.JOY_NEVER_RECEIVED and time_s - ended.start_s >= NEVER_AFTER_S
        if ended.cause in causes.LOSSES or never:
            level = ERROR if ended.cause in causes.JOY_UNUSABLE else WARN
            self._faults.add(Fault(ended.start_s, time_s, level, NODE, ended.reason))
