"""Drops what was sent to a node while it stood still.

A node that was frozen finds the messages of that time in the sockets of its connections, and in the buffers of those
who sent them; when it goes on they arrive all at once and look new. So every connection is replaced by a new one, which
carries only what is sent from then on. The publishers' addresses are known: no master is needed.
"""
from __future__ import annotations

import logging
import time
import traceback
from typing import Any, Callable

import rospy
from rospy.impl.tcpros_pubsub import TCPROSHandler

from car_interface.common.units import NS_PER_MS
from car_interface.ros.inbox import Inbox
from car_interface.ros.topics import subscribe

FALLBACK_NS = 1000 * NS_PER_MS  # where connections can't be replaced nothing is obeyed for so long


class Subscription:
    """A subscription whose handler isn't given what was sent before ``renew``.

    Args:
        topic, message_type, inbox, handler: as of ``topics.subscribe``.
    """

    def __init__(self, topic: str, message_type, inbox: Inbox, handler: Callable[[Any, int], None]):
        self.dropped = 0
        self._handler = handler
        self._old_until_ns = -1  # what arrived until then is old
        # rospy gives each connection a header of its own, and every message that of its connection.
        self._old_headers: list[dict] = []
        self._latched_headers: list[dict] = []  # of new connections that have delivered their latched message
        self._subscriber = subscribe(topic, message_type, inbox, self._receive)

    def renew(self) -> None:
        """Replace every connection. What arrived before, and what still arrives over the old ones, is dropped."""
        self._old_until_ns = time.monotonic_ns()
        try:
            connections = list(self._subscriber.impl.connections)
            self._old_headers = [each.header for each in connections if each.header]
            self._latched_headers = []
            for connection in connections:
                self._replace(connection)
        except Exception:  # of another rospy: these are its internals
            logging.getLogger("car_interface").error("%s", traceback.format_exc())
            self._old_headers = []
            self._old_until_ns += FALLBACK_NS

    def _replace(self, connection):
        host, port = connection.dest_address
        done, text, _ = TCPROSHandler().create_transport(
            self._subscriber.impl.resolved_name, connection.endpoint_id, ["TCPROS", host, port])
        if not done:
            raise rospy.ROSException(text)
        connection.close()

    def _receive(self, message, arrival_ns):
        if self._is_old(getattr(message, "_connection_header", None), arrival_ns):
            self.dropped += 1
        else:
            self._handler(message, arrival_ns)

    def _is_old(self, header, arrival_ns):
        if arrival_ns <= self._old_until_ns or any(header is old for old in self._old_headers):
            return True
        if self._old_until_ns >= 0 and header and header.get("latching") == "1" and not any(
                header is known for known in self._latched_headers):
            self._latched_headers.append(header)
            return True  # a new connection begins with the last message, however old that is
        return False
