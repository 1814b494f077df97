"""What the planner asked for during a drive, and why it wasn't obeyed."""
from __future__ import annotations

import math
from typing import Any, Mapping

from car_interface.common import causes
from car_interface.tools.report.downsample import Trace
from car_interface.tools.report.faults import WARN, Fault, FaultLog

TRACES = ("planner's speed", "reference speed")
# The others are reported by those that stop because of them.
TOLD_HERE = causes.LOSSES | {causes.REQUEST_REFUSED}


class PlannerWatch:
    """Follows planner_interface's state.

    Args:
        traces: those of TRACES are written to.
        faults: losses and refusals are added.
        duration_s: of the recording.

    Attributes:
        source: the source that was obeyed; empty: unknown.
        others: the sources that weren't, with their messages, at the end; empty: none.
    """

    def __init__(self, traces: Mapping[str, Trace], faults: FaultLog, duration_s: float):
        self._traces, self._faults, self._duration_s = traces, faults, duration_s
        self.source = self.others = ""
        self._current: Fault | None = None
        self._cause = ""

    def on_state(self, time_s: float, message: Any) -> None:
        """car_interface/PlannerState."""
        self.source, self.others = message.source, message.others
        is_obeyed = message.cause == causes.PLANNER
        self._traces["planner's speed"].add(time_s, message.speed if is_obeyed else math.nan)
        self._traces["reference speed"].add(time_s, message.reference_speed if is_obeyed else math.nan)
        if message.cause != self._cause:
            self._end(time_s)
            self._cause = message.cause
            if message.cause in TOLD_HERE:
                self._current = Fault(time_s, math.nan, WARN, "planner_interface", message.reason)

    def finish(self) -> None:
        """Close the last fault."""
        self._end(self._duration_s)

    def _end(self, time_s):
        if self._current is not None:
            self._faults.add(self._current._replace(end_s=time_s))
            self._current = None
