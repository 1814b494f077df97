"""Finds the questions about a drive that its recording can't answer, since the source was not recorded."""
from __future__ import annotations

import math
from typing import Any, Callable, Mapping, NamedTuple

MAX_PAUSE_S = 5.0  # what answers a question is published at 1 Hz or more; a longer pause is a hole in the recording
DIAGNOSTICS = "/diagnostics"
Handler = Callable[[float, Any], None]  # of time in s and message


class Source(NamedTuple):
    """Where an answer comes from: a topic, or one node's report on /diagnostics."""

    topic: str
    report: str = ""  # of /diagnostics, as in "pca9685: servo board"
    has_pauses: bool = False  # it is published only when there is something to report


class Question(NamedTuple):
    """What a reader of the report asks, and what answers it; the first source is the one to record."""

    asks: str
    sources: tuple[Source, ...]


QUESTIONS = (
    Question("who drove, and why the car stopped", (Source("turn_arb/state"),)),
    Question("errors of the Teensy's link",
             (Source("teensy_sensor_hub/link"), Source(DIAGNOSTICS, "teensy_sensor_hub: Teensy link"))),
    Question("errors of the servo board", (Source(DIAGNOSTICS, "pca9685: servo board"),)),
    Question("why the gamepad released the deadman",
             (Source("teleop_logi/state"), Source(DIAGNOSTICS, "teleop_logi: gamepad"))),
    Question("why the throttle stopped",
             (Source("throttle_arb/state"), Source(DIAGNOSTICS, "generic_value_converter: converter"))),
    Question("warnings in the nodes' logs", (Source("/rosout", has_pauses=True),)),
)


class Gap(NamedTuple):
    """A question without an answer, for the whole recording or from ``start_s`` to ``end_s``."""

    asks: str
    lacks: str  # what was not recorded
    start_s: float = math.nan
    end_s: float = math.nan


class Coverage:
    """Follows when the sources of answers were recorded."""

    def __init__(self, namespace: str, duration_s: float):
        self._below = "/" + "/".join([*filter(None, namespace.split("/")), ""])
        self._duration_s = duration_s
        self._start_s = 0.0  # when the first source was recorded; before it the car's nodes weren't running
        self._last_s: dict[Source, float] = {}
        self._longest_pause: dict[Source, tuple[float, float]] = {}
        sources = [source for question in QUESTIONS for source in question.sources]
        self._by_topic = {source.topic: source for source in sources if not source.report}
        self._by_report = {source.report.partition(": ")[2]: source for source in sources if source.report}

    def watched(self, handlers: Mapping[str, Handler]) -> dict:
        """Return the handlers by topic; those of sources also note when a message was recorded."""
        noting = {topic: (lambda time_s, message, source=source: self._note(source, time_s))
                  for topic, source in self._by_topic.items()}
        noting[DIAGNOSTICS] = self._note_reports
        return {topic: both(noting[topic], handler) if topic in noting else handler
                for topic, handler in handlers.items()}

    @property
    def is_blind(self) -> bool:
        """Return whether nothing was recorded that answers any question."""
        return not self._last_s

    def gaps(self) -> list[Gap]:
        """Return the questions that the recording can't answer, for all of it or for a time."""
        found = []
        for question in QUESTIONS:
            recorded = [source for source in question.sources if source in self._last_s]
            if not recorded:
                found.append(Gap(question.asks, self._name(question.sources[0])))
                continue
            pauses = [(self._pause_until(source, self._duration_s), source) for source in recorded]
            (start_s, end_s), source = min(pauses, key=lambda pause: pause[0][1] - pause[0][0])
            if end_s - start_s > MAX_PAUSE_S:
                found.append(Gap(question.asks, self._name(source), start_s, end_s))
        return found

    def _note_reports(self, time_s, message):
        for status in message.status:
            source = self._by_report.get(status.name.partition(": ")[2])
            if source is not None:
                self._note(source, time_s)

    def _note(self, source, time_s):
        if not source.has_pauses:
            if not self._longest_pause:
                self._start_s = time_s
            self._longest_pause[source] = self._pause_until(source, time_s)
        self._last_s[source] = time_s

    def _pause_until(self, source, time_s):
        """Return the longest time without a message of a source that was recorded, as its start and end."""
        if source.has_pauses:
            return 0.0, 0.0
        newest, longest = (self._last_s.get(source, self._start_s), time_s), self._longest_pause.get(source, (0.0, 0.0))
        return max(longest, newest, key=lambda pause: pause[1] - pause[0])

    def _name(self, source):
        if source.report:
            return f"{source.topic} of {self._below.lstrip('/')}{source.report.partition(': ')[0]}"
        return source.topic if source.topic == "/rosout" else self._below + source.topic


def both(first: Handler, second: Handler) -> Handler:
    """Return a handler that calls two."""
    def handle(time_s, message):
        first(time_s, message)
        second(time_s, message)
    return handle
