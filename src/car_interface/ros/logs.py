"""What a node says is written by threads of its own: whoever takes it may stop taking it, the node's thread must not.

A terminal stops at Ctrl-S, or when the ssh connection to it breaks; a disk stalls; and rospy asks the master before it
publishes on /rosout. All that happens in the thread that logs, and that thread drives a car.
"""
from __future__ import annotations

import io
import logging
from logging.handlers import QueueHandler, QueueListener
from queue import Queue

WAITING = 1000  # lines for each who takes them; what comes on top is dropped


class LogStream:
    """Standard output or error: a line shows when it is said, in a pipe too; one that nobody can read is no fault.

    A terminal that was closed, or a pipe whose reader ended, must not end a node that drives a car.
    """

    def __init__(self, stream):
        self._stream = stream  # None: it was closed at start
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")

    def write(self, text: str) -> None:
        """Write and flush."""
        try:
            if self._stream is not None:
                self._stream.write(text)
                self._stream.flush()
        except OSError:
            self._stream = None

    def flush(self) -> None:
        """Nothing is held back."""

    def isatty(self) -> bool:
        """Whether it's a terminal."""
        return self._stream is not None and self._stream.isatty()


class LogsAside:
    """Moves each handler of the process's logs, as ROS has set them up, to a thread of its own.

    One that hangs keeps neither the node nor the others from going on.
    """

    def __init__(self):
        self._queues: list[Queue] = []
        for logger in (logging.getLogger(), logging.getLogger("rosout")):
            for handler in list(logger.handlers):
                logger.removeHandler(handler)
                logger.addHandler(self._aside(handler))

    def _aside(self, handler):
        waiting: Queue = Queue(WAITING)
        self._queues.append(waiting)
        QueueListener(waiting, handler, respect_handler_level=True).start()
        return QueueHandler(waiting)

    def flush(self, within_s: float) -> bool:
        """Wait until all that was logged is written; whether it is."""
        done = [_is_done(waiting, within_s) for waiting in self._queues]  # one that hangs doesn't cut off the others
        return all(done)


def _is_done(waiting, within_s):
    with waiting.all_tasks_done:
        return waiting.all_tasks_done.wait_for(lambda: not waiting.unfinished_tasks, within_s)
