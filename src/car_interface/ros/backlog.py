"""Drops what was sent to a node while it stood still.

A node that was frozen finds the messages of that time in the sockets of its connections, and in the buffers of those
who sent them; when it goes on they arrive all at once and look new. So every connection is replaced by a new one, which
carries only what is sent from then on. The publishers' addresses are known: no master is needed.

The nodes of one process that subscribe to a topic share its connections. Each of them drops by itself what is old.
"""
from __future__ import annotations

import logging
import traceback
from typing import Any, Callable

import rospy

from car_interface.common.units import NS_PER_S
from car_interface.ros.graph import RosGraph

FALLBACK_NS = NS_PER_S  # where connections can't be replaced nothing is obeyed for so long

Handler = Callable[[Any, int], None]


class Backlog:
    """Knows which messages of one node's subscription are old.

    Args:
        takes_latched: obey the message with which a latching publisher's new connection begins. It is the publisher's
            last word, however old.
    """

    def __init__(self, graph: RosGraph, takes_latched: bool = False):
        self.dropped = 0  # how many messages were old
        self._graph = graph
        self._takes_latched = takes_latched
        self.subscriber: rospy.Subscriber | None = None  # until there is one
        self._is_retired: Callable[[Any], bool] = lambda header: False
        self._old_until_ns = -1  # what arrived until then is old
        self._is_renewed = False  # every connection was replaced
        self._latched_headers: list[dict] = []  # of new connections that have delivered their latched message

    def without_old(self, handler: Handler) -> Handler:
        """Return a handler that gets what isn't old."""
        def handle(message, arrival_ns):
            if self._old_until_ns >= 0 and self._is_old(getattr(message, "_connection_header", None), arrival_ns):
                self.dropped += 1
            else:
                handler(message, arrival_ns)
        return handle

    def renew(self) -> None:
        """Replace every connection. What arrived before, and what still arrives over the old ones, is old."""
        self._latched_headers = []
        try:
            self._is_retired = self._graph.replace_connections(self.subscriber)
            self._old_until_ns = self._graph.clocks.now_ns()
            self._is_renewed = True
        except Exception:  # of another rospy
            logging.getLogger("car_interface").error("%s", traceback.format_exc())
            self._is_renewed = False
            self._old_until_ns = self._graph.clocks.now_ns() + FALLBACK_NS

    def _is_old(self, header, arrival_ns):
        is_latched = self._is_latched(header)  # remembered in any case
        if self._is_retired(header):
            return True
        if is_latched and self._takes_latched and self._is_renewed:
            return False  # also if it arrived while other connections were still being replaced
        return arrival_ns <= self._old_until_ns or is_latched and not self._takes_latched

    def _is_latched(self, header):
        """Return whether it is the first message of a new connection to a publisher that latches."""
        if not header or header.get("latching") != "1" or any(header is known for known in self._latched_headers):
            return False
        self._latched_headers.append(header)
        return True
