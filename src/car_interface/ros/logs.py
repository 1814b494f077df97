"""A node's log: lines that repeat are throttled, and nothing that takes them blocks the node.

A terminal blocks at Ctrl-S, or when the ssh connection to it breaks; a disk stalls; and rospy asks the master before it
publishes on /rosout. Each of them would block the thread that drives the car, so they are written to in other threads.
"""
from __future__ import annotations

import io
import logging
import threading
import traceback
from collections import Counter
from logging.handlers import QueueHandler, QueueListener
from queue import Queue
from typing import Callable

import rospy

from car_interface.common.units import NS_PER_S
from car_interface.ros.clocks import Clocks

MAX_LINES = 1000  # that wait for a handler; more are dropped
WARNING_PERIOD_NS = 10 * NS_PER_S


class ThrottledWarnings:
    """Counts faults by kind, and logs each kind at once and then at most every 10 s."""

    def __init__(self, clocks: Clocks, log: Callable = rospy.logwarn):
        self.counts: Counter = Counter()
        self._clocks = clocks
        self._log = log
        self._next_log_ns: dict[str, int] = {}
        self._lock = threading.Lock()

    def warn(self, kind: str, text: str, count: int = 1) -> None:
        """Count ``count`` of ``kind``; log ``text`` and the sum so far unless this kind was logged recently.

        May be called from any thread.
        """
        with self._lock:
            self.counts[kind] += count
            now_ns = self._clocks.now_ns()
            if now_ns >= self._next_log_ns.get(kind, 0):
                self._next_log_ns[kind] = now_ns + WARNING_PERIOD_NS
                times = self.counts[kind]
                self._log("%s%s", text, f" ({times} so far)" if times > 1 else "")


def keep_tracebacks_from_terminal() -> None:
    """Have the tracebacks that rospy prints go to the log file, such as that of a peer which leaves in a handshake."""
    traceback.print_exc = lambda *_, **__: logging.getLogger("car_interface").error("%s", traceback.format_exc())


class LogStream:
    """Standard output or error, flushed after each write. Write errors are ignored.

    A terminal that was closed, or a pipe whose reader ended, must not end a node that drives a car.
    """

    def __init__(self, stream):
        self._stream = stream  # None: it was closed at start
        self.written = 0  # how often something was
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")

    def write(self, text: str) -> None:
        """Write and flush."""
        self.written += 1
        try:
            if self._stream is not None:
                self._stream.write(text)
                self._stream.flush()
        except OSError:
            self._stream = None

    def flush(self) -> None:
        """Nothing is buffered."""

    def isatty(self) -> bool:
        """Whether it's a terminal."""
        return self._stream is not None and self._stream.isatty()


class LogThreads:
    """Moves each log handler that ROS has set up to a thread of its own.

    A handler that blocks then delays neither the node nor the other handlers.
    """

    def __init__(self):
        self._queues: list[Queue] = []
        for logger in (logging.getLogger(), logging.getLogger("rosout")):
            for handler in list(logger.handlers):
                logger.removeHandler(handler)
                logger.addHandler(self._in_thread(handler))

    def _in_thread(self, handler):
        queue: Queue = Queue(MAX_LINES)
        self._queues.append(queue)
        QueueListener(queue, handler, respect_handler_level=True).start()
        return QueueHandler(queue)

    def flush(self, within_s: float) -> bool:
        """Wait until all lines are written, for each handler at most so long; whether they are."""
        done = [_is_done(queue, within_s) for queue in self._queues]  # a list: every queue is waited for
        return all(done)


def _is_done(queue, within_s):
    with queue.all_tasks_done:
        return queue.all_tasks_done.wait_for(lambda: not queue.unfinished_tasks, within_s)
