"""Collects what went wrong on a drive, and finds the questions that its recording can't answer."""
from __future__ import annotations

import math
import re
from typing import Any, Collection, NamedTuple

from car_interface.throttle.battery import REPORT as BATTERY_REPORT

OK, WARN, ERROR = range(3)  # as in diagnostic_msgs/DiagnosticStatus
# By the level in a rosgraph_msgs/Log or rcl_interfaces/Log, which have none in common; below these it is no fault.
LOG_LEVELS = {4: WARN, 8: ERROR, 16: ERROR, 30: WARN, 40: ERROR, 50: ERROR}
# A node's first report that is a warning, and becomes OK within so long, before anybody drives, is its start: the hub
# wants five pings, one a second, and the servo board's guard a second. So is a car that is started with its recording.
STARTS_WITHIN_S = 8.0
# Topics that report the same as these reports on /diagnostics, and more of it.
OWN_TOPICS = {"steering": "turn_arb/state", "Teensy link": "teensy_sensor_hub/link", "gamepad": "teleop_logi/state"}
NUMBER = re.compile(r"[-+]?\d[\d.,e+-]*|inf|nan")
MAX_ENTRIES = 2000
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


class Fault(NamedTuple):
    """Something that went wrong."""

    start_s: float
    level: int  # WARN or ERROR
    where: str
    what: str
    end_s: float = math.nan  # NaN: it is a moment, or lasted until the recording's end
    times: int = 1


class FaultLog:
    """The faults of a drive, up to MAX_ENTRIES of them.

    Args:
        present: the recorded topics; what turn_arb, the hub and teleop_logi report in topics of their own isn't added
            twice, nor is the battery, which throttle_arb reports on /diagnostics and logs.
    """

    def __init__(self, present: Collection[str] = ()):
        self._present = present
        self.entries: list = []  # in order of their ends; ``finish`` sorts them by their starts
        self.dropped = 0  # how many more there were
        self._open: dict = {}  # conditions that last, by key
        self._starting_s: dict = {}  # when a key was first reported; −inf from its first OK on
        self._starts: list = []  # faults that may have been a node's start
        self._repeated: dict = {}  # index of an entry, by key

    def add(self, fault: Fault) -> None:
        """Add a fault, or count it when there are too many."""
        if len(self.entries) < MAX_ENTRIES:
            self.entries.append(fault)
        else:
            self.dropped += 1

    def add_repeated(self, time_s: float, level: int, where: str, what: str) -> None:
        """Add a moment once, and count its repetitions, in which numbers may differ."""
        key = (where, without_numbers(what))
        index = self._repeated.get(key)
        if index is not None:
            self.entries[index] = self.entries[index]._replace(times=self.entries[index].times + 1)
            return
        if len(self.entries) < MAX_ENTRIES:
            self._repeated[key] = len(self.entries)
        self.add(Fault(time_s, level, where, what))

    def update_condition(self, time_s: float, key: str, level: int, where: str, what: str) -> None:
        """Begin, continue or end (level OK) the condition of a key. A text that differs in more than its numbers begins
        another one.
        """
        since_s, fault = self._starting_s.setdefault(key, time_s), self._open.get(key)
        goes_on = fault is not None and level != OK and without_numbers(fault.what) == without_numbers(what)
        if fault is not None and not goes_on:
            is_start = fault.level == WARN and time_s - since_s <= STARTS_WITHIN_S
            (self._starts.append if is_start else self.add)(self._open.pop(key)._replace(end_s=time_s))
        if level == OK:
            self._starting_s[key] = -math.inf
        elif goes_on:
            self._open[key] = fault._replace(level=max(level, fault.level))
        else:
            self._open[key] = Fault(time_s, level, where, what)

    def finish(self, driven_from_s: float = math.inf) -> None:
        """Add the conditions that lasted until the recording's end, and sort all faults by their starts. What a node
        reported of its start before somebody first drove is no fault.
        """
        for fault in (*self._open.values(), *(one for one in self._starts if one.end_s > driven_from_s)):
            self.add(fault)
        self.entries.sort(key=lambda fault: fault.start_s)

    def on_diagnostics(self, time_s: float, message: Any) -> None:
        """Take a diagnostic_msgs/DiagnosticArray."""
        for status in message.status:
            node, _, report = status.name.partition(": ")
            if OWN_TOPICS.get(report) in self._present:
                continue
            # rosbags has a message's byte as a number or as bytes.
            level = status.level[0] if isinstance(status.level, (bytes, bytearray)) else int(status.level)
            self.update_condition(time_s, status.name, min(level, ERROR), node.strip("/"), status.message)

    def on_log(self, time_s: float, message: Any) -> None:
        """Take a rosgraph_msgs/Log or rcl_interfaces/Log."""
        node, text, level = message.name.strip("/"), message.msg, LOG_LEVELS.get(message.level, OK)
        is_known = node.endswith("turn_arb") and OWN_TOPICS["steering"] in self._present or \
            text.startswith("human in loop: ") and OWN_TOPICS["gamepad"] in self._present or \
            text.startswith(f"{BATTERY_REPORT}: ") and DIAGNOSTICS in self._present
        if level != OK and not is_known:
            self.add_repeated(time_s, level, node, text)


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
        self._start_s: float | None = None  # when the first source was; before it the car's nodes weren't running
        self._seen: dict[str, tuple] = {}  # by source: its longest pause, from and to, and when it was last recorded

    def update(self, time_s: float, topic: str, message: Any) -> None:
        """Note what a recorded message answers."""
        names = [status.name.partition(": ")[2] for status in message.status] if topic == DIAGNOSTICS else [topic]
        for source in filter(None, map(SOURCES.get, names)):
            if self._start_s is None and source != LOG:
                self._start_s = time_s
            self._seen[source] = self._longest_pause(source, time_s), time_s

    @property
    def is_blind(self) -> bool:
        """Return whether nothing was recorded that answers any question."""
        return not self._seen

    def gaps(self) -> list[Gap]:
        """Return the questions that the recording can't answer, for all of it or for a time."""
        found = []
        for asks, sources in QUESTIONS.items():
            pauses = [(self._longest_pause(source, self._duration_s), source)
                      for source in sources if source in self._seen]
            if not pauses:
                found.append(Gap(asks, self._name(sources[0])))
                continue
            (start_s, end_s), source = min(pauses, key=lambda pause: pause[0][1] - pause[0][0])
            if end_s - start_s > MAX_PAUSE_S:
                found.append(Gap(asks, self._name(source), start_s, end_s))
        return found

    def _longest_pause(self, source, time_s):
        """Return the longest time without a message of a source, up to a time, as its start and end."""
        if source == LOG:  # it is published only when there is something to report
            return 0.0, 0.0
        longest, last_s = self._seen.get(source, ((0.0, 0.0), self._start_s))
        return max(longest, (last_s, time_s), key=lambda pause: pause[1] - pause[0])

    def _name(self, source):
        node, _, report = source.partition(": ")
        if report:
            return f"{DIAGNOSTICS} of {self._below.lstrip('/')}{node}"
        return source if source == LOG else self._below + source


def without_numbers(text: str) -> str:
    """Return a text with # for its numbers, which may change while what it says stays the same."""
    return NUMBER.sub("#", text)
