"""Collects what went wrong on a drive: moments, conditions that lasted, and what the nodes reported."""
from __future__ import annotations

import math
import re
from typing import Any, Collection, NamedTuple

from car_interface.throttle.battery import REPORT as BATTERY_REPORT

OK, WARN, ERROR = range(3)  # as in diagnostic_msgs/DiagnosticStatus
LOG_LEVELS = {"rosgraph_msgs": (4, 8), "rcl_interfaces": (30, 40)}  # warning and error, by the package of Log
# A node's first report that is a warning, and becomes OK within so long, before anybody drives, is its start: the hub
# wants five pings, one a second, and the servo board's guard a second. So is a car that is started with its recording.
STARTS_WITHIN_S = 8.0
# Topics that report the same as these reports on /diagnostics, and more of it.
STATES = {"steering": "turn_arb/state", "Teensy link": "teensy_sensor_hub/link", "gamepad": "teleop_logi/state"}
NUMBER = re.compile(r"[-+]?\d[\d.,e+-]*|inf|nan")
MAX_ENTRIES = 2000


class Fault(NamedTuple):
    """Something that went wrong."""

    start_s: float
    end_s: float  # NaN: it is a moment, or lasted until the recording's end
    level: int  # WARN or ERROR
    where: str
    what: str
    times: int = 1


class FaultLog:
    """The faults of a drive, up to MAX_ENTRIES of them."""

    def __init__(self):
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

    def add_moment(self, time_s: float, level: int, where: str, what: str) -> None:
        """Add a fault without a duration."""
        self.add(Fault(time_s, math.nan, level, where, what))

    def add_repeated(self, time_s: float, level: int, where: str, what: str) -> None:
        """Add a moment once, and count its repetitions, in which numbers may differ."""
        key = (where, without_numbers(what))
        index = self._repeated.get(key)
        if index is not None:
            self.entries[index] = self.entries[index]._replace(times=self.entries[index].times + 1)
            return
        if len(self.entries) < MAX_ENTRIES:
            self._repeated[key] = len(self.entries)
        self.add_moment(time_s, level, where, what)

    def update_condition(self, time_s: float, key: str, level: int, where: str, what: str) -> None:
        """Begin, continue or end (level OK) the condition of a key. A text that differs in more than its numbers begins
        another one.
        """
        fault, since_s = self._open.get(key), self._starting_s.setdefault(key, time_s)
        if fault is not None and (level == OK or without_numbers(fault.what) != without_numbers(what)):
            ended = fault._replace(end_s=time_s)
            if fault.level == WARN and time_s - since_s <= STARTS_WITHIN_S:
                self._starts.append(ended)
            else:
                self.add(ended)
            del self._open[key]
            fault = None
        if level == OK:
            self._starting_s[key] = -math.inf
        else:
            self._open[key] = Fault(time_s, math.nan, level, where, what) if fault is None else \
                fault._replace(level=max(level, fault.level))

    def finish(self, driven_from_s: float = math.inf) -> None:
        """Add the conditions that lasted until the recording's end, and sort all faults by their starts. What a node
        reported of its start before somebody first drove is no fault.
        """
        for fault in (*self._open.values(), *(one for one in self._starts if one.end_s > driven_from_s)):
            self.add(fault)
        self.entries.sort(key=lambda fault: fault.start_s)


class NodeReports:
    """Adds the faults in /diagnostics and /rosout.

    Args:
        present: the recorded topics; what turn_arb, the hub and teleop_logi report in topics of their own isn't added
            twice, nor is the battery, which throttle_arb reports on /diagnostics and logs.
        log_type: the type of /rosout, such as rosgraph_msgs/msg/Log.
    """

    def __init__(self, faults: FaultLog, present: Collection[str], log_type: str):
        self._faults, self._present = faults, present
        self._warning, self._error = LOG_LEVELS.get(log_type.split("/")[0], LOG_LEVELS["rosgraph_msgs"])

    def on_diagnostics(self, time_s: float, message: Any) -> None:
        """Take a diagnostic_msgs/DiagnosticArray."""
        for status in message.status:
            node, _, report = status.name.partition(": ")
            if STATES.get(report) in self._present:
                continue
            # rosbags has a message's byte as a number or as bytes.
            level = status.level[0] if isinstance(status.level, (bytes, bytearray)) else int(status.level)
            self._faults.update_condition(time_s, status.name, min(level, ERROR), node.strip("/"), status.message)

    def on_log(self, time_s: float, message: Any) -> None:
        """Take a rosgraph_msgs/Log or rcl_interfaces/Log."""
        node, text = message.name.strip("/"), message.msg
        is_known = node.endswith("turn_arb") and STATES["steering"] in self._present or \
            text.startswith("human in loop: ") and STATES["gamepad"] in self._present or \
            text.startswith(f"{BATTERY_REPORT}: ") and "/diagnostics" in self._present
        if message.level >= self._warning and not is_known:
            self._faults.add_repeated(time_s, ERROR if message.level >= self._error else WARN, node, text)


def without_numbers(text: str) -> str:
    """Return a text with # for its numbers, which may change while what it says stays the same."""
    return NUMBER.sub("#", text)
