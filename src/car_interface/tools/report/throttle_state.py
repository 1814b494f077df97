"""Who drove the throttle during a drive and why, what was asked, and what the ESC was given."""
from __future__ import annotations

import math
from typing import Any, Mapping, NamedTuple

from car_interface.common import causes
from car_interface.tools.report.downsample import Trace
from car_interface.tools.report.faults import ERROR, MAX_ENTRIES, WARN, Fault, FaultLog

TRACES = ("throttle asked", "throttle granted")
# States of the ESC that come and go with the stick: an episode doesn't end with one of them.
USUAL = ("NEUTRAL", "FORWARD")
# The states of turn_arb and planner_interface say these, too.
SHARED = causes.INHIBITS | {causes.STEERING_STALE, causes.STEERING_STOPPED, causes.PLANNER_STALE}


class ThrottleEpisode(NamedTuple):
    """A time in which the same source drove for the same cause, and the ESC was in the same state."""

    start_s: float
    end_s: float
    source: int  # a value of ThrottleState.source
    cause: str  # a constant of common.causes
    esc: str  # the ESC's state; empty: one of USUAL
    esc_cause: str
    reason: str  # in words, at its start


class ThrottleWatch:
    """Follows throttle_arb's state.

    Args:
        traces: those of TRACES are written to.
        faults: losses that turn_arb doesn't report are added.
        duration_s: of the recording.

    Attributes:
        episodes: up to MAX_ENTRIES; more are counted as dropped faults.
        profile: the ESC's kind; empty: unknown.
    """

    def __init__(self, traces: Mapping[str, Trace], faults: FaultLog, duration_s: float):
        self._traces, self._faults, self._duration_s = traces, faults, duration_s
        self.episodes: list[ThrottleEpisode] = []
        self.profile = ""
        self._current: ThrottleEpisode | None = None

    def on_state(self, time_s: float, message: Any) -> None:
        """car_interface/ThrottleState."""
        self.profile = message.profile
        self._traces["throttle asked"].add(time_s, message.asked)
        self._traces["throttle granted"].add(time_s, message.granted)
        is_usual = message.esc in USUAL
        esc, esc_cause = ("", "") if is_usual else (message.esc, message.esc_cause)
        current = self._current
        if current is None or current[2:6] != (message.source, message.cause, esc, esc_cause):
            self._end_episode(time_s)
            reason = message.reason if is_usual else f"{message.reason}; {message.esc}: {message.esc_reason}"
            self._current = ThrottleEpisode(time_s, math.nan, message.source, message.cause, esc, esc_cause, reason)

    @property
    def source(self) -> int | None:
        """Who drives now; ``None`` = unknown."""
        return None if self._current is None else self._current.source

    def losses(self) -> list[ThrottleEpisode]:
        """The episodes with a loss of the throttle's own."""
        return [episode for episode in self.episodes if _is_loss(episode)]

    def finish(self) -> None:
        """Close the last episode."""
        self._end_episode(self._duration_s)

    def _end_episode(self, time_s):
        if self._current is None:
            return
        episode = self._current._replace(end_s=time_s)
        if len(self.episodes) < MAX_ENTRIES:
            self.episodes.append(episode)
        else:
            self._faults.dropped += 1
        if episode.esc_cause == causes.ESC_MOTION:
            self._faults.add(Fault(episode.start_s, time_s, ERROR, "throttle_arb", episode.reason))
        elif _is_loss(episode):
            self._faults.add(Fault(episode.start_s, time_s, WARN, "throttle_arb", episode.reason))


def _is_loss(episode):
    return episode.esc_cause == causes.ESC_MOTION or episode.cause in causes.LOSSES - SHARED
