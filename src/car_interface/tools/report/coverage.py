"""Finds the questions about a drive that its recording can't answer, since the source was not recorded."""
from __future__ import annotations

import math
from typing import Any, NamedTuple

MAX_PAUSE_S = 5.0  # what answers a question is published at 1 Hz or more; a longer pause is a hole in the recording
DIAGNOSTICS, LOG = "/diagnostics", "/rosout"
# What a reader of the report asks, and what answers it: topics, or nodes' reports on /diagnostics, which have a ": " in
# their names. The first source is the one to record.
QUESTIONS = {
    "who drove, and why the car stopped": ("turn_arb/state",),
    "errors of the Teensy's link": ("teensy_sensor_hub/link", "teensy_sensor_hub: Teensy link"),
    "errors of the servo board": ("pca9685: servo board",),
    "why the gamepad released the deadman": ("teleop_logi/state", "teleop_logi: gamepad"),
    "why the throttle stopped": ("throttle_arb/state", "generic_value_converter: converter"),
    "warnings in the nodes' logs": (LOG,),
}
# By the topic, or by the report's name without its node's, which may have another namespace.
SOURCES = {source.partition(": ")[2] or source: source for sources in QUESTIONS.values() for source in sources}


class Gap(NamedTuple):
    """A question without an answer, for the whole recording or from ``start_s`` to ``end_s``."""

    asks: str
    lacks: str  # what was not recorded
    start_s: float = math.nan
    end_s: float = math.nan


class Coverage:
    """Follows when the sources of answers were recorded; ``below`` begins the names of the car's topics."""

    def __init__(self, below: str, duration_s: float):
        self._below, self._duration_s = below, duration_s
        self._start_s = 0.0  # when the first source was recorded; before it the car's nodes weren't running
        self._last_s: dict[str, float] = {}
        self._longest_pause: dict[str, tuple[float, float]] = {}

    def update(self, time_s: float, topic: str, message: Any) -> None:
        """Note what a recorded message answers."""
        names = [status.name.partition(": ")[2] for status in message.status] if topic == DIAGNOSTICS else [topic]
        for source in filter(None, map(SOURCES.get, names)):
            if source != LOG:
                if not self._longest_pause:
                    self._start_s = time_s
                self._longest_pause[source] = self._pause_until(source, time_s)
            self._last_s[source] = time_s

    @property
    def is_blind(self) -> bool:
        """Return whether nothing was recorded that answers any question."""
        return not self._last_s

    def gaps(self) -> list[Gap]:
        """Return the questions that the recording can't answer, for all of it or for a time."""
        found = []
        for asks, sources in QUESTIONS.items():
            pauses = [(self._pause_until(source, self._duration_s), source)
                      for source in sources if source in self._last_s]
            if not pauses:
                found.append(Gap(asks, self._name(sources[0])))
                continue
            (start_s, end_s), source = min(pauses, key=lambda pause: pause[0][1] - pause[0][0])
            if end_s - start_s > MAX_PAUSE_S:
                found.append(Gap(asks, self._name(source), start_s, end_s))
        return found

    def _pause_until(self, source, time_s):
        """Return the longest time without a message of a source that was recorded, as its start and end."""
        if source == LOG:  # it is published only when there is something to report
            return 0.0, 0.0
        newest, longest = (self._last_s.get(source, self._start_s), time_s), self._longest_pause.get(source, (0.0, 0.0))
        return max(longest, newest, key=lambda pause: pause[1] - pause[0])

    def _name(self, source):
        node, _, report = source.partition(": ")
        if report:
            return f"{DIAGNOSTICS} of {self._below.lstrip('/')}{node}"
        return source if source == LOG else self._below + source
