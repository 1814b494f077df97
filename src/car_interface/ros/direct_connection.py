"""Sends a message in the thread that publishes it.

rospy hands each message to a thread of the connection and yields to it: two changes of thread per message and
subscriber, which take longer than the sending. Here that thread sends only what the subscriber's socket doesn't take
at once. A subscriber that no longer reads delays nobody, as with rospy: up to queue_size messages wait for it, and the
oldest are dropped.
"""
from __future__ import annotations

import socket

import rospy
from rospy.impl.tcpros_pubsub import QueuedConnection


class DirectConnection(QueuedConnection):
    """A connection to one subscriber; takes the place of rospy's ``QueuedConnection``.

    Args:
        connection: rospy's ``TCPROSTransport``.
        queue_size: how many messages wait for the thread at most; 0 = any number.
    """

    def __init__(self, connection, queue_size: int):
        self._rest = b""  # of a message of which the socket took a part
        self._is_relaying = False  # the thread has messages that come before the next one
        super().__init__(connection, queue_size)

    def write_data(self, data: bytes) -> bool:
        """Send a serialised message, or queue it.

        Raises:
            Exception: what sending an earlier message raised in the thread; rospy then drops the connection.
        """
        with self._lock:
            if self._error:
                error, self._error = self._error, None
                raise error
            if self._is_relaying:
                if 0 < self._queue_size <= len(self._queue):
                    del self._queue[0]
                self._queue.append(data)
                return True
            sent = self._send(data)
            if sent < len(data):
                # In _rest nothing drops it: after a part of a message the subscriber could make nothing of the next.
                self._rest, self._is_relaying = data[sent:], True
                self._cond_data_available.notify()
        return True

    def _send(self, data):
        """How many bytes the socket took. Errors are left to the thread: rospy knows what each of them means."""
        connection = self._connection
        subscriber = connection.socket  # None once another thread has closed it
        if subscriber is None:
            return 0
        try:
            sent = subscriber.send(data, socket.MSG_DONTWAIT)
        except OSError:  # BlockingIOError too
            return 0
        connection.stat_bytes += sent
        connection.stat_num_msg += sent == len(data)
        return sent

    def _run(self):
        connection = self._connection
        while not connection.done:
            with self._lock:
                self._is_relaying = bool(self._rest or self._queue)
                while not (self._rest or self._queue or connection.done):
                    self._cond_data_available.wait()
                waiting, self._rest, self._queue = [self._rest, *self._queue], b"", []
            for data in filter(None, waiting):
                try:
                    connection.write_data(data)
                except Exception as error:  # write_data raises it
                    with self._lock:
                        self._error = error


def send_directly() -> None:
    """Have this process's publishers use it. To be called before the first one is made."""
    rospy.topics.QueuedConnection = DirectConnection
