"""Who steered during a drive and why, what was requested, and what the servo board output."""
from __future__ import annotations

import math
from collections import Counter
from typing import Any, Mapping, NamedTuple

from car_interface.common import causes
from car_interface.steering.arbiter import LOCKED, NEUTRAL, NO_HUMAN, PLANNER, TELEOP
from car_interface.tools.report.downsample import Trace
from car_interface.tools.report.faults import ERROR, MAX_ENTRIES, WARN, Fault, FaultLog
from car_interface.tools.report.gamepad import GamepadWatch
from car_interface.tools.report.old_reasons import cause_of

UNKNOWN_DRIVER = -1
STEERING_CHANNEL = 0  # as config/turn_arb.yaml has it
COUNT = 16  # duty of one count of the servo board
TRACES = ("requested curvature", "sent curvature", "gamepad")


class Episode(NamedTuple):
    """A time in which the same source steered for the same cause."""

    start_s: float
    end_s: float
    source: int  # a value of SteeringState.source
    cause: str  # a constant of common.causes; empty = unknown
    reason: str  # in words, at its start


class SteeringWatch:
    """Follows turn_arb's state, the requests, and the servo board's output.

    Args:
        traces: those of TRACES are written to.
        faults: losses and locks are added.
        duration_s: of the recording.
        gamepad: knows why a deadman was false.

    Attributes:
        episodes: up to MAX_ENTRIES; more are counted as dropped faults.
        source_s: seconds by source.
        source: who steers now.
        duties: a Trace by channel, for those that were ever driven.
        steering_channel: the channel that follows turn_arb's duty; ``None`` = unknown.
        curvature_per_m: sent by turn_arb now, left positive; ``None`` = unknown.
        unchanged_since_s: when turn_arb's duty last changed.
    """

    def __init__(self, traces: Mapping[str, Trace], faults: FaultLog, duration_s: float, gamepad: GamepadWatch):
        self._traces, self._faults, self._duration_s, self._gamepad = traces, faults, duration_s, gamepad
        self.episodes: list = []
        self.source_s: Counter = Counter()
        self.source = UNKNOWN_DRIVER
        self.duties: dict = {}
        self.steering_channel: int | None = None
        self.curvature_per_m: float | None = None
        self.unchanged_since_s = 0.0
        self._duty = None  # of the newest state
        self._matches: Counter = Counter()  # by channel: how often its output was turn_arb's duty
        self._current: Episode | None = None

    def on_state(self, time_s: float, message: Any) -> None:
        """car_interface/SteeringState."""
        self.source, cause = message.source, cause_of(message)
        current = self._current
        if current is None or (current.source, current.cause) != (message.source, cause):
            self._end_episode(time_s)
            self._current = Episode(time_s, math.nan, message.source, cause, message.reason)
        self.curvature_per_m = 1 / message.turn_radius if message.turn_radius else math.nan
        self._traces["sent curvature"].add(time_s, self.curvature_per_m)
        if message.duty != self._duty:
            self._duty, self.unchanged_since_s = message.duty, time_s

    def on_output(self, time_s: float, message: Any) -> None:
        """std_msgs/Int32MultiArray of /servo/output."""
        if self._duty is not None:
            self._matches.update(channel for channel, duty in enumerate(message.data)
                                 if abs(duty - self._duty) <= COUNT)
        for channel, duty in enumerate(message.data):
            if duty > 0 and channel not in self.duties:
                self.duties[channel] = Trace(0.0, self._duration_s)
            if channel in self.duties:
                self.duties[channel].add(time_s, duty)

    def on_planner(self, time_s: float, message: Any) -> None:
        """std_msgs/Float32: the planner's turn radius in m; 0 requests nothing."""
        if message.data:
            self._traces["requested curvature"].add(time_s, 1 / message.data)

    def on_gamepad(self, time_s: float, message: Any) -> None:
        """std_msgs/Float32: the gamepad's steering."""
        self._traces["gamepad"].add(time_s, message.data)

    def stops(self) -> list[Episode]:
        """The episodes in which nobody drove any more."""
        return [episode for before, episode in zip(self.episodes, self.episodes[1:])
                if before.source in (TELEOP, PLANNER) and episode.source in (LOCKED, NO_HUMAN, NEUTRAL)]

    def losses(self) -> list[Episode]:
        """Those of the stops at which something was lost or locked."""
        return [stop for stop in self.stops() if stop.source == LOCKED or stop.cause in causes.LOSSES]

    def finish(self) -> None:
        """Close the last episode, and find the steering channel."""
        self._end_episode(self._duration_s)
        if self._matches:
            self.steering_channel = self._matches.most_common(1)[0][0]
        elif STEERING_CHANNEL in self.duties:  # turn_arb's state was not recorded
            self.steering_channel = STEERING_CHANNEL

    def _end_episode(self, time_s):
        if self._current is None:
            return
        episode = self._current._replace(end_s=time_s)
        loss = self._gamepad.loss_at(episode.start_s) if episode.cause == causes.HUMAN_ABSENT else None
        if loss is not None:  # the gamepad's own fault is another line of the table of faults
            episode = episode._replace(cause=loss.cause, reason=f"human_in_loop is false: {loss.reason}")
        self.source_s[episode.source] += time_s - episode.start_s
        if len(self.episodes) < MAX_ENTRIES:
            self.episodes.append(episode)
        else:
            self._faults.dropped += 1
        is_loss = episode.source in (NO_HUMAN, NEUTRAL) and episode.cause in causes.LOSSES and loss is None
        if episode.source == LOCKED or is_loss:
            level = ERROR if episode.source == LOCKED else WARN
            self._faults.add(Fault(episode.start_s, time_s, level, "turn_arb", episode.reason))
