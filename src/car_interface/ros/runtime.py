"""What every node does alike: start, wait, complain, end.

A node class takes ``Params`` and the ``Inbox`` in its ``__init__``. One thread calls ``step(now_ns)`` whenever
something arrived or is due; ``step`` returns when it wants to be called next. Callbacks of ROS only put what they heard
into the inbox. ``shut_down`` is called last, while topics still work.

That thread is the process's main one, or one of several in ``car_nodes``. A node class needn't know: what it has on the
ROS graph is made by ``advertise``, ``subscribe`` and ``serve``, which take its name from its inbox.
"""
from __future__ import annotations

import io
import logging
import os
import select
import signal
import sys
import threading
import time
import traceback
from collections import Counter
from concurrent.futures import Future, InvalidStateError
from typing import Any, Callable

import rospy

from car_interface.common.errors import CarInterfaceError
from car_interface.common.params import Params
from car_interface.common.staleness import DROPPED
from car_interface.common.units import NS_PER_S
from car_interface.ros.logs import LogsAside, LogStream

MAX_WAIT_NS = NS_PER_S
INBOX_LIMIT = 10_000  # more than any node is sent while its thread waits for a device
OVERFLOW_SHOWN_NS = 10_000_000_000  # for so long /diagnostics says that an inbox has overflowed
SHUT_DOWN_S = 2.0
LAST_WORDS_S = 0.5  # for what was logged at the end
SWITCH_INTERVAL_S = 0.0005  # how long one thread may keep the others from a message; Python's own 5 ms show
WARNING_PERIOD_NS = 10 * NS_PER_S
# To who waits for a service's answer.
ENDED, TOO_BUSY = "the node has ended", f"the node was held up for too long: {DROPPED}, and this request with them"


class Inbox:
    """Passes what callbacks heard to the node's thread, in order, and wakes it.

    It waits with select on a pipe: before Python 3.11 a timed ``Condition.wait`` follows the settable clock, and poll
    rounds up to whole milliseconds.

    It is bounded. When the node's thread was held up for so long that it is full, all that waits in it is dropped, and
    so is all that the node has heard before: among the dropped may be an emergency stop. Services are answered with an
    error, and what each node does about its inputs is called by ``on_overflow``.

    Args:
        node_name: the node's, with its namespace; ``None`` = the process's, of which it is the only node.
        limit: how much may wait.
    """

    def __init__(self, node_name: str | None = None, limit: int = INBOX_LIMIT):
        self.ending = False
        self._node_name = node_name
        self._made: list[Callable[[], None]] = []  # how to take back what the node has on the ROS graph
        self._asked: set[Future] = set()  # what services' callers wait for
        self._closed = False
        self.dropped = 0  # how much was put in and never taken
        self._dropped_ns = -OVERFLOW_SHOWN_NS  # when that was last said to the node
        self._overflow_handlers: list[Callable[[int], None]] = []
        self._overflow_warnings = ThrottledWarnings(rospy.logerr)
        self._limit = limit
        self._items: list[tuple] = []  # (handler, item, arrival_ns), and what to call if that is dropped
        self._lock = threading.Lock()  # of the items
        self._wake_read, self._wake_write = os.pipe()
        # It is closed with the last one who may wake: the number of a closed file may be a serial port's by then.
        self._pipe = [io.FileIO(fd) for fd in (self._wake_read, self._wake_write)]
        os.set_blocking(self._wake_read, False)
        os.set_blocking(self._wake_write, False)
        self._watched = [self._wake_read]

    @property
    def node_name(self) -> str:
        """The node's name, with its namespace."""
        return self._node_name or rospy.get_name()

    def resolve_name(self, name: str) -> str:
        """A name of a topic or service for rospy, which takes ``~state`` for the process's."""
        return f"{self._node_name}/{name[1:]}" if self._node_name and name.startswith("~") else name

    def on_close(self, take_back: Callable[[], None]) -> None:
        """Have ``close`` take back what was made on the ROS graph."""
        self._made.append(take_back)

    def close(self) -> None:
        """Take the node off the ROS graph while its process lives on; whoever waits for an answer is told."""
        self.ending = self._closed = True
        for take_back in reversed(self._made):
            try:
                take_back()
            except Exception:  # the master is gone: there is nothing to take back
                logging.getLogger("car_interface").info("%s", traceback.format_exc())
        self._made.clear()
        for done in list(self._asked):
            self._refuse(done, ENDED)

    def ask(self, handler: Callable[[Any, Future], None], request: Any) -> Any:
        """What the Future gets that the node's thread gives to ``handler(request, future)``. For other threads."""
        done: Future = Future()
        self._asked.add(done)
        self.put(lambda item, now_ns: handler(item, done), request, on_drop=lambda: self._refuse(done, TOO_BUSY))
        if self._closed:  # or ``close`` may have come before the question
            self._refuse(done, ENDED)
        try:
            return done.result()
        finally:
            self._asked.discard(done)

    @staticmethod
    def _refuse(done, reason):
        try:
            done.set_exception(rospy.ServiceException(reason))
        except InvalidStateError:
            pass  # it was answered meanwhile

    def put(self, handler: Callable[[Any, int], None], item: Any, wakes: bool = True,
            on_drop: Callable[[], None] | None = None) -> None:
        """Have the node's thread call ``handler(item, arrival_ns)``: now, or whenever it's next awake.

        May be called from any thread. Where the item is dropped ``on_drop`` is called, in any thread.
        """
        dropped: list[tuple] = []
        with self._lock:
            if len(self._items) >= self._limit:
                dropped.extend(self._items)
                self._items.clear()
                self.dropped += sum(event[0] != self._on_overflow for event, _ in dropped)
                self._items.append(((self._on_overflow, None, time.monotonic_ns()), None))
            self._items.append(((handler, item, time.monotonic_ns()), on_drop))
        for _, tell in dropped:
            if tell is not None:
                tell()
        if wakes:
            self.wake()

    def on_overflow(self, handler: Callable[[int], None]) -> None:
        """Have the node's thread call ``handler(now_ns)`` after messages were dropped, before it takes newer ones."""
        self._overflow_handlers.append(handler)

    def _on_overflow(self, _, now_ns):
        self._dropped_ns = now_ns
        self._overflow_warnings.warn("overflow", f"{self.overflow}; all that was heard before counts as lost")
        for handler in self._overflow_handlers:
            handler(now_ns)

    @property
    def overflow(self) -> str:
        """What was dropped so far, in words."""
        return f"the inbox of this node overflowed: {DROPPED}, {self.dropped} in all"

    def overflowed_lately(self, now_ns: int) -> bool:
        """Whether that was just now."""
        return now_ns - self._dropped_ns < OVERFLOW_SHOWN_NS

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
        left_ns = max(0, min(deadline_ns - time.monotonic_ns(), MAX_WAIT_NS))
        ready, _, _ = select.select(self._watched, [], [], left_ns / NS_PER_S)
        if self._wake_read in ready:
            os.read(self._wake_read, 4096)

    def drain(self) -> list[tuple]:
        """What has arrived, oldest first, as (handler, item, arrival_ns)."""
        with self._lock:
            taken = [event for event, _ in self._items]
            self._items.clear()
        return taken


class RateTimer:
    """A fixed grid of times. After a stall it goes on from now; it doesn't catch up."""

    def __init__(self, rate_hz: float, now_ns: int):
        self.period_ns = round(NS_PER_S / rate_hz)
        self.due_ns = now_ns

    def is_due(self, now_ns: int) -> bool:
        """Whether a beat is due; if so, the next one is a period later."""
        if now_ns < self.due_ns:
            return False
        self.due_ns += self.period_ns
        if self.due_ns <= now_ns:
            self.due_ns = now_ns + self.period_ns
        return True


class ThrottledWarnings:
    """Counts what goes wrong by kind, and logs each kind at once and then at most every 10 s.

    Args:
        log: rospy's function of the level.
    """

    def __init__(self, log: Callable = rospy.logwarn):
        self.counts: Counter = Counter()
        self._log = log
        self._silent_until_ns: dict[str, int] = {}

    def warn(self, kind: str, text: str, count: int = 1) -> None:
        """Count ``count`` of ``kind``; say ``text`` and the sum so far, unless that was said just now."""
        self.counts[kind] += count
        now_ns = time.monotonic_ns()
        if now_ns >= self._silent_until_ns.get(kind, 0):
            self._silent_until_ns[kind] = now_ns + WARNING_PERIOD_NS
            times = self.counts[kind]
            self._log("%s%s", text, f" ({times} so far)" if times > 1 else "")


def run(name: str, node_class) -> None:
    """A node's whole life: read parameters, build it, step it until it shall end, shut it down.

    Exits with code 1 and one line on a bad parameter, and when a device that is required can't be used.
    """
    sys.stdout, sys.stderr = LogStream(sys.stdout), LogStream(sys.stderr)
    logging.raiseExceptions = False  # a full disk is no fault of this node's either
    try:
        rospy.init_node(name, disable_signals=True)
    except KeyboardInterrupt:  # while it waited for the master
        sys.exit(1)
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    logs = LogsAside()
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
        spin(node_class, inbox)
    except Exception as error:
        rospy.logfatal("%s", describe_error(error))
        failed = True
    ended.set()
    rospy.signal_shutdown("ended")  # returns at once while another thread is doing that already
    unregistered.wait(SHUT_DOWN_S)
    if not logs.flush(LAST_WORDS_S):
        os._exit(1 if failed else 0)  # Python's own end would wait for whoever takes no more lines
    sys.exit(1 if failed else 0)


def spin(node_class, inbox: Inbox) -> None:
    """A node's life in this thread: read its parameters, build it, step it until it shall end, shut it down."""
    name = inbox.node_name
    node = node_class(Params(rospy.get_param(name, {}), lambda wanted: _search_parents(name, wanted)), inbox)
    try:
        while not inbox.ending:
            inbox.wait_until(node.step(time.monotonic_ns()))
    finally:
        node.shut_down()


def describe_error(error: Exception) -> str:
    """One line about what ended a node; where that is a fault of its own, the log file gets the traceback."""
    if isinstance(error, CarInterfaceError):
        return str(error)
    logging.getLogger("car_interface").error("%s", traceback.format_exc())  # ROS: to the log file only
    return f"a fault in this node itself (see its log file): {type(error).__name__}: {error}"


def _end_and_wait(inbox, ended):
    """ROS ends this node (``rosnode kill``): topics work until this returns, so let the node's thread finish."""
    inbox.end()
    if threading.current_thread() is not threading.main_thread():
        ended.wait(SHUT_DOWN_S)


def _search_parents(node_name, name):
    """A parameter's value from the nearest namespace around a node; None if none has it."""
    namespace = node_name
    while namespace:
        namespace = namespace.rpartition("/")[0]
        value = rospy.get_param(f"{namespace}/{name}", None)
        if value is not None:
            return value
    return None


def advertise(topic: str, message_type, inbox: Inbox, queue_size=10, latch=False) -> rospy.Publisher:
    """A publisher, for the life of the inbox's node."""
    publisher = rospy.Publisher(inbox.resolve_name(topic), message_type, queue_size=queue_size, latch=latch)
    inbox.on_close(publisher.unregister)
    return publisher


def serve(name: str, service_type, inbox: Inbox, handler: Callable[[Any, Future], None]) -> None:
    """Offer a service: ``handler(request, done)`` runs in the node's thread; the Future gets the response's fields."""
    def handle(request):
        return service_type._response_class(*inbox.ask(handler, request))
    inbox.on_close(rospy.Service(inbox.resolve_name(name), service_type, handle).shutdown)


def subscribe(topic: str, message_type, inbox: Inbox, handler: Callable[[Any, int], None], queue_size=10) -> None:
    """Subscribe so that ``handler(message, arrival_ns)`` runs in the node's thread, for each message, in order."""
    _subscribe(topic, message_type, inbox, lambda message: inbox.put(handler, message), queue_size)


def subscribe_changes(topic: str, message_type, inbox: Inbox, handler: Callable[[Any, int], None],
                      then: Callable[[int], Any] | None = None) -> None:
    """The same for a topic of std_msgs that mostly repeats itself, in a node that beats often.

    What says the same as the message before it doesn't wake the node: it is handled, with its own time of arrival, when
    the node is next awake. An input that comes 50 times a second costs a third of the CPU that way. After what is news
    ``then(arrival_ns)`` is called as well.
    """
    last = None

    def act(message, arrival_ns):
        handler(message, arrival_ns)
        then(arrival_ns)

    def receive(message):
        nonlocal last
        is_news = message.data != last  # as NaN always is
        last = message.data
        inbox.put(act if then and is_news else handler, message, wakes=is_news)
    _subscribe(topic, message_type, inbox, receive)


def _subscribe(topic, message_type, inbox, receive, queue_size=10):
    subscriber = rospy.Subscriber(inbox.resolve_name(topic), message_type, receive, queue_size=queue_size,
                                  tcp_nodelay=True)
    inbox.on_close(subscriber.unregister)


def has_subscribers(publisher) -> bool:
    """Whether anybody subscribes: rospy makes a message before it finds that nobody does."""
    return publisher.get_num_connections() > 0
