"""What was wrong with the gamepad during a drive, by teleop_logi's state."""
from __future__ import annotations

import math
from typing import Any, NamedTuple

from car_interface.common import causes
from car_interface.tools.report.faults import ERROR, MAX_ENTRIES, WARN, Fault, FaultLog

NODE = "teleop_logi"
NEVER_AFTER_S = 5.0  # a gamepad that isn't heard for so long from the start on is missing
APART_S = 1.0  # a release may be recorded so long before or after turn_arb's state that follows it, on a busy computer


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
        self._releases: list[Loss] = []  # what ended each time of a held deadman, a loss or not; likewise
        self._current: Loss | None = None  # the cause that lasts, a loss or not
        self._was_held = False
        self._unused: Loss | None = None  # an axis that doesn't count, likewise

    def on_state(self, time_s: float, message: Any) -> None:
        """car_interface/TeleopState."""
        if self._current is None or self._current.cause != message.cause:
            self._end_current(time_s)
            self._current = Loss(time_s, math.inf, message.cause, message.reason)
        if self._was_held and not message.human_in_loop and len(self._releases) < MAX_ENTRIES:
            self._releases.append(self._current)
        self._was_held = message.human_in_loop
        self._look_for_unused_axis(time_s, message)

    def loss_at(self, time_s: float) -> Loss | None:
        """The loss for which the deadman was false from a time on; ``None`` = there was none, or it was let go."""
        near = [release for release in self._releases if abs(release.start_s - time_s) <= APART_S]
        if near:
            release = min(near, key=lambda release: abs(release.start_s - time_s))
            return release if release.cause in causes.LOSSES else None
        current = self._current
        losses = [*self._losses, current] if current is not None and current.cause in causes.LOSSES else self._losses
        return next((loss for loss in losses if loss.start_s <= time_s <= loss.end_s), None)

    def finish(self) -> None:
        """Close what lasts."""
        self._end_current(self._duration_s)
        self._current = None
        self._end_unused(self._duration_s)

    def _look_for_unused_axis(self, time_s, message):
        """States from before there were such axes don't have the fields."""
        sticks = getattr(message, "steering_stick", ""), getattr(message, "throttle_stick", "")
        if causes.NOT_AT_REST not in sticks:
            self._end_unused(time_s)
        elif self._unused is None:
            self._unused = Loss(time_s, math.inf, causes.NOT_AT_REST, message.reason)

    def _end_unused(self, time_s):
        if self._unused is not None:
            self._faults.add(Fault(self._unused.start_s, time_s, WARN, NODE, self._unused.reason))
        self._unused = None

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
