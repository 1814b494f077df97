"""What every node does alike: start, wait, complain, end.

A node class takes ``Params`` and the ``Inbox`` in its ``__init__``. One thread, the main one, calls ``step(now_ns)``
whenever something arrived or is due; ``step`` returns when it wants to be called next. Callbacks of ROS only put what
they heard into the inbox. ``shut_down`` is called last, while topics still work.
"""
from __future__ import annotations

import logging
import os
import select
import signal
import sys
import threading
import time
import traceback
from collections import Counter, deque
from typing import Any, Callable

import rospy

from car_interface.errors import CarInterfaceError
from car_interface.nodes.params import Params

NS_PER_S = 1_000_000_000
LONGEST_WAIT_NS = NS_PER_S
INBOX_LIMIT = 10_000  # more than any node is sent while its thread waits for a device
SHUT_DOWN_S = 2.0
SWITCH_INTERVAL_S = 0.0005  # how long one thread may keep the others from a message; Python's own 5 ms show
COMPLAINT_PERIOD_NS = 10 * NS_PER_S


class Inbox:
    """Passes what callbacks heard to the node's thread, in order, and wakes it.

    It waits with select on a pipe: before Python 3.11 a timed ``Condition.wait`` follows the settable clock, and poll
    rounds up to whole milliseconds.
    """

    def __init__(self):
        self.ending = False
        self._items: deque = deque(maxlen=INBOX_LIMIT)
        self._wake_read, self._wake_write = os.pipe()
        os.set_blocking(self._wake_read, False)
        os.set_blocking(self._wake_write, False)
        self._watched = [self._wake_read]

    def put(self, handler: Callable[[Any, int], None], item: Any, wakes: bool = True) -> None:
        """Have the node's thread call ``handler(item, arrival_ns)``: now, or whenever it's next awake.

        May be called from any thread.
        """
        self._items.append((handler, item, time.monotonic_ns()))
        if wakes:
            self.wake()

    def wake(self) -> None:
        """End the wait under way, or the next one. May be called from any thread, and from a signal handler."""
        try:
            os.write(self._wake_write, b"\0")
        except BlockingIOError:
            pass  # the pipe is full of wakes already

    def end(self) -> None:
        """Have the node's thread leave its loop."""
        self.ending = True
        self.wake()

    def watch(self, fd: int) -> None:
        """Also end a wait when ``fd`` can be read, or fails."""
        self._watched.append(fd)

    def unwatch(self, fd: int) -> None:
        """No longer wait for ``fd``."""
        self._watched = [watched for watched in self._watched if watched != fd]

    def wait_until(self, deadline_ns: float) -> None:
        """Sleep until something arrives, a watched fd can be read, or the monotonic clock reaches the deadline."""
        left_ns = max(0, min(deadline_ns - time.monotonic_ns(), LONGEST_WAIT_NS))
        ready, _, _ = select.select(self._watched, [], [], left_ns / NS_PER_S)
        if self._wake_read in ready:
            os.read(self._wake_read, 4096)

    def take(self) -> list[tuple]:
        """What has arrived, oldest first, as (handler, item, arrival_ns)."""
        taken = []
        while self._items:
            taken.append(self._items.popleft())
        return taken


class Heartbeat:
    """A fixed grid of times. After a stall it goes on from now; it doesn't catch up."""

    def __init__(self, rate_hz: float, now_ns: int):
        self._period_ns = round(NS_PER_S / rate_hz)
        self.due_ns = now_ns

    def is_due(self, now_ns: int) -> bool:
        """Whether a beat is due; if so, the next one is a period later."""
        if now_ns < self.due_ns:
            return False
        self.due_ns += self._period_ns
        if self.due_ns <= now_ns:
            self.due_ns = now_ns + self._period_ns
        return True


class Complaints:
    """Counts what goes wrong by kind, and logs each kind at once and then at most every 10 s."""

    def __init__(self):
        self.counts: Counter = Counter()
        self._silent_until_ns: dict[str, int] = {}

    def warn(self, kind: str, text: str, count: int = 1) -> None:
        """Count ``count`` of ``kind``; say ``text`` and the sum so far, unless that was said just now."""
        self.counts[kind] += count
        now_ns = time.monotonic_ns()
        if now_ns >= self._silent_until_ns.get(kind, 0):
            self._silent_until_ns[kind] = now_ns + COMPLAINT_PERIOD_NS
            times = self.counts[kind]
            rospy.logwarn("%s%s", text, f" ({times} so far)" if times > 1 else "")


def run(name: str, node_class) -> None:
    """A node's whole life: read parameters, build it, step it until it shall end, shut it down.

    Exits with code 1 and one line on a bad parameter, and when a device that is required can't be used.
    """
    sys.stdout, sys.stderr = _LogStream(sys.stdout), _LogStream(sys.stderr)
    logging.raiseExceptions = False  # a full disk is no fault of this node's either
    try:
        rospy.init_node(name, disable_signals=True)
    except KeyboardInterrupt:  # while it waited for the master
        sys.exit(1)
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    inbox = Inbox()
    ended = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) != signal.SIG_IGN:  # as nohup has it
            signal.signal(number, lambda *_: inbox.end())
    rospy.on_shutdown(lambda: _end_and_wait(inbox, ended))
    unregistered = threading.Event()
    rospy.core.add_shutdown_hook(lambda reason: unregistered.set())  # comes after rospy's own
    failed = False
    try:
        _live(node_class, inbox)
    except CarInterfaceError as error:
        rospy.logfatal("%s", error)
        failed = True
    except Exception as error:
        rospy.logfatal("a fault in this node itself (see its log file): %s: %s", type(error).__name__, error)
        logging.getLogger("car_interface").error("%s", traceback.format_exc())  # ROS: to the log file only
        failed = True
    ended.set()
    rospy.signal_shutdown("ended")  # returns at once while another thread is doing that already
    unregistered.wait(SHUT_DOWN_S)
    sys.exit(1 if failed else 0)


class _LogStream:
    """Standard output or error: a line shows when it is said, in a pipe too; one that nobody can read is no fault.

    A terminal that was closed, or a pipe whose reader ended, must not end a node that drives a car.
    """

    def __init__(self, stream):
        self._stream = stream  # None: it was closed at start

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


def _live(node_class, inbox):
    node = node_class(Params(rospy.get_param("~", {}), _search_outward), inbox)
    try:
        while not inbox.ending:
            inbox.wait_until(node.step(time.monotonic_ns()))
    finally:
        node.shut_down()


def _end_and_wait(inbox, ended):
    """ROS ends this node (``rosnode kill``): topics work until this returns, so let the node's thread finish."""
    inbox.end()
    if threading.current_thread() is not threading.main_thread():
        ended.wait(SHUT_DOWN_S)


def _search_outward(name):
    """A parameter's value from the nearest enclosing namespace, as roscpp's searchParam does; None if none has it."""
    found = rospy.search_param(name)
    return None if found is None else rospy.get_param(found, None)


def subscribe(topic: str, message_type, inbox: Inbox, handler: Callable[[Any, int], None], queue_size=10) -> None:
    """Subscribe so that ``handler(message, arrival_ns)`` runs in the node's thread, for each message, in order."""
    rospy.Subscriber(topic, message_type, lambda message: inbox.put(handler, message), queue_size=queue_size,
                     tcp_nodelay=True)


def subscribe_changes(topic: str, message_type, inbox: Inbox, handler: Callable[[Any, int], None]) -> None:
    """The same for a topic of std_msgs that mostly repeats itself, in a node that beats often.

    What says the same as the message before it doesn't wake the node: it is handled, with its own time of arrival, when
    the node is next awake. An input that comes 50 times a second costs a third of the CPU that way.
    """
    last = None

    def hear(message):
        nonlocal last
        is_news = message.data != last  # as NaN always is
        last = message.data
        inbox.put(handler, message, wakes=is_news)
    rospy.Subscriber(topic, message_type, hear, queue_size=10, tcp_nodelay=True)


def is_heard(publisher) -> bool:
    """Whether anybody subscribes: rospy makes a message before it finds that nobody does."""
    return publisher.get_num_connections() > 0
