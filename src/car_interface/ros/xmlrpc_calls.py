"""Calls of the ROS master and of other nodes with a time limit: a dead or frozen one must not hold up its caller."""
from __future__ import annotations

import xmlrpc.client
from typing import Any

ANSWER_WITHIN_S = 1.0


class TimeoutTransport(xmlrpc.client.Transport):
    """A transport whose connections end after ``ANSWER_WITHIN_S`` without an answer."""

    def make_connection(self, host: Any):
        """Return a connection with a time limit."""
        connection = super().make_connection(host)
        connection.timeout = ANSWER_WITHIN_S
        return connection


def call(uri: str, method: str, *arguments: Any) -> tuple:
    """Return an XML-RPC server's answer: in ROS (code, message, value), where a code of 1 is success.

    Raises:
        OSError: no connection, or no answer in time.
        xmlrpc.client.Fault: it has no such method.
        Exception: what listens there is no XML-RPC server.
    """
    with xmlrpc.client.ServerProxy(uri, transport=TimeoutTransport()) as server:
        return getattr(server, method)(*arguments)
