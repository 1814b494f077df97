"""Collects garbage while a node's thread has nothing to do, and at no other time.

Python's own collections start in whichever thread has just allocated an object, also between the arrival of a message
and its command, and stop all threads. The longest of them visits all objects of the imported modules.

Those objects are set aside here before the node's first message, so that a collection visits only those that are newer:
about a tenth. What remains to collect are cycles, mostly of calls to the ROS master.
"""
from __future__ import annotations

import gc

from car_interface.common.units import NS_PER_MS, NS_PER_S

PERIOD_NS = NS_PER_S
MIN_IDLE_NS = 3 * NS_PER_MS  # what a node that waits for less is about to do could come late
MAX_NEW_OBJECTS = 100_000  # since the last collection; more are collected even in a node that is never idle


class IdleCollector:
    """Replaces Python's automatic garbage collection in this process."""

    def __init__(self):
        gc.collect()
        gc.freeze()
        gc.disable()
        self._due_ns = 0

    def step(self, now_ns: int, idle_until_ns: float) -> None:
        """Collect if it is due and the node has nothing to do until ``idle_until_ns``."""
        if now_ns < self._due_ns or (idle_until_ns - now_ns < MIN_IDLE_NS and gc.get_count()[0] < MAX_NEW_OBJECTS):
            return
        self._due_ns = now_ns + PERIOD_NS
        gc.collect()
