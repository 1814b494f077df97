"""Collects garbage while a node's thread has nothing to do, and at no other time.

Python's own collections start in whichever thread has just allocated an object, also between the arrival of a message
and its command, and stop all threads. The longest of them visits all objects of the imported modules.

Those objects are set aside here before the node's first message, so that a collection visits only those that are newer:
about a tenth. What remains to collect are cycles, mostly of calls to the ROS master.

Where several nodes share a process one thread collects, while all of them are idle.
"""
from __future__ import annotations

import gc
from contextlib import contextmanager
from typing import Iterator

from car_interface.common.units import NS_PER_MS, NS_PER_S

PERIOD_NS = NS_PER_S
MIN_IDLE_NS = 3 * NS_PER_MS  # what a node that waits for less is about to do could come late
SETTLED_NS = NS_PER_MS  # after a step: what it has sent to another node of the process has arrived by then
RETRY_NS = 2 * NS_PER_MS  # while a node of the process is not idle
MAX_POSTPONED_NS = NS_PER_S  # then it is enough that no node of the process is in a step
MAX_NEW_OBJECTS = 100_000  # since the last collection; more are collected even in a node that is never idle


class NodeActivity:
    """What a node's thread does, for the thread that collects."""

    def __init__(self):
        self.is_stepping = False
        self._ended_ns = 0
        self._idle_until_ns = 0.0

    def begin_step(self) -> None:
        """A step begins."""
        self.is_stepping = True

    def end_step(self, now_ns: int, idle_until_ns: float) -> float:
        """A step has ended; the thread has nothing to do until then, unless something arrives before.

        Returns:
            When to call it again before the next step: inf, never.
        """
        self._ended_ns, self._idle_until_ns = now_ns, idle_until_ns
        self.is_stepping = False
        return float("inf")

    def is_idle(self, now_ns: int) -> bool:
        """Whether nothing is going on, nor about to."""
        return (not self.is_stepping and now_ns - self._ended_ns >= SETTLED_NS
                and self._idle_until_ns - now_ns >= MIN_IDLE_NS)


ACTIVITIES: list[NodeActivity] = []  # of the process's nodes that don't collect


@contextmanager
def node_activity() -> Iterator[NodeActivity]:
    """What a thread of the process does that doesn't collect, for as long as it lives."""
    activity = NodeActivity()
    ACTIVITIES.append(activity)
    try:
        yield activity
    finally:
        ACTIVITIES.remove(activity)


class IdleCollector:
    """Replaces Python's automatic garbage collection in this process."""

    def __init__(self):
        gc.collect()
        gc.freeze()
        gc.disable()
        self._due_ns = 0
        self._postponed_ns: int | None = None  # when it would have collected but for the others

    def begin_step(self) -> None:
        """A step of the node whose thread collects begins."""

    def end_step(self, now_ns: int, idle_until_ns: float) -> float:
        """Collect if it is due and no node of the process has anything to do.

        Args:
            idle_until_ns: until when the node whose thread this is has nothing to do.

        Returns:
            When to call it again because of the others; inf = they don't matter.
        """
        if now_ns < self._due_ns or gc.get_count()[0] < MAX_NEW_OBJECTS and idle_until_ns - now_ns < MIN_IDLE_NS:
            return float("inf")
        if gc.get_count()[0] < MAX_NEW_OBJECTS and not self._others_allow(now_ns):
            return now_ns + RETRY_NS
        self._due_ns, self._postponed_ns = now_ns + PERIOD_NS, None
        gc.collect()
        return float("inf")

    def _others_allow(self, now_ns):
        if self._postponed_ns is None:
            self._postponed_ns = now_ns
        if now_ns - self._postponed_ns < MAX_POSTPONED_NS:
            return all(activity.is_idle(now_ns) for activity in ACTIVITIES)
        return not any(activity.is_stepping for activity in ACTIVITIES)
