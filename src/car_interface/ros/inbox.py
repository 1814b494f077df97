"""The queue between the callbacks of ROS and a node's one thread."""
from __future__ import annotations

import logging
import select
import socket
import threading
import traceback
from concurrent.futures import Future, InvalidStateError
from contextlib import suppress
from typing import Any, Callable

import rospy
from diagnostic_msgs.msg import DiagnosticStatus

from car_interface.common.causes import NODE_STOOD_STILL
from car_interface.common.staleness import DROPPED
from car_interface.common.units import NS_PER_S
from car_interface.ros.graph import ROS, RosGraph
from car_interface.ros.logs import ThrottledWarnings

INBOX_LIMIT = 10_000  # more than any node receives while its thread waits for a device
MAX_WAIT_NS = NS_PER_S  # a node's thread wakes at least so often
SHOWN_NS = 10 * NS_PER_S  # how long /diagnostics reports an overflow or a standstill
# Errors for the caller of a service.
ENDED, TOO_BUSY = "the node has ended", f"the node was held up for too long: {DROPPED}, and this request with them"


class Inbox:
    """Passes what callbacks receive to the node's thread, in order, and wakes it.

    It waits with select on a socket: before Python 3.11 a timed ``Condition.wait`` follows the settable clock, and poll
    rounds up to whole milliseconds.

    It is bounded. When it is full, because the node's thread was held up, all items in it are dropped: among them may
    be an emergency stop. Service calls then fail, and the handlers of ``on_overflow`` mark the node's inputs stale. So
    they do when the node stood still, and what was sent meanwhile is dropped.

    Args:
        node_name: the node's, with its namespace; ``None`` = the process's, of which it is the only node.
        limit: the maximum number of items.
        graph: in which the node has its topics, services and clocks.
    """

    def __init__(self, node_name: str | None = None, limit: int = INBOX_LIMIT, graph: RosGraph = ROS):
        self.graph = graph
        self.clocks = graph.clocks
        self.ending = False
        self.subscriptions: list[Any] = []  # of ``topics``: one for each topic that the node subscribes to
        self._node_name = node_name
        self._close_actions: list[Callable[[], None]] = []
        self._open_requests: set[Future] = set()  # service calls that wait for an answer
        self._closed = False
        self.dropped = 0
        self._faults: dict[int, tuple[int, str]] = {}  # when the node last noticed one, and a line about it; by level
        self._overflow_handlers: list[Callable[[int], None]] = []
        self._overflow_warnings = ThrottledWarnings(self.clocks, rospy.logerr)
        self._limit = limit
        self._items: list[tuple] = []  # ((handler, item, arrival_ns), on_drop)
        self._lock = threading.Lock()  # of the items
        # Closed by the garbage collector after the last use: a closed fd's number may be a serial port's by then.
        self._woken, self._waker = socket.socketpair()
        self._waker.setblocking(False)
        self._watched: dict[str, int] = {}  # file descriptors, by what they are of

    @property
    def node_name(self) -> str:
        """Return the node's name, with its namespace."""
        return self._node_name or self.graph.process_name()

    def own_name(self, name: str) -> str:
        """Return a topic's or service's name for rospy, which resolves ``~`` to the process's name, not the node's."""
        return f"{self._node_name}/{name[1:]}" if self._node_name and name.startswith("~") else name

    def resolve_name(self, name: str) -> str:
        """Return the full name of a topic, service or parameter of the node, as remapped."""
        return self.graph.resolve_name(self.own_name(name))

    def on_close(self, action: Callable[[], None]) -> None:
        """Have ``close`` call ``action``, which removes something of the node from the ROS graph."""
        self._close_actions.append(action)

    def close(self) -> None:
        """Take the node off the ROS graph while its process lives on. Pending service calls fail."""
        self.ending = self._closed = True
        for action in reversed(self._close_actions):
            try:
                action()
            except Exception:  # the master is gone
                logging.getLogger("car_interface").info("%s", traceback.format_exc())
        self._close_actions.clear()
        for done in list(self._open_requests):
            self._refuse(done, ENDED)

    def ask(self, handler: Callable[[Any, Future], None], request: Any, within_s: float | None = None) -> Any:
        """Call ``handler(request, future)`` in the node's thread and wait for the future. For other threads.

        Raises:
            rospy.ServiceException: the node ended, or the request was dropped.
            concurrent.futures.TimeoutError: it took longer than ``within_s``; ``None`` = any time.
        """
        done: Future = Future()
        self._open_requests.add(done)
        self.put(lambda item, now_ns: handler(item, done), request, on_drop=lambda: self._refuse(done, TOO_BUSY))
        if self._closed:  # ``close`` may have run before this request was added
            self._refuse(done, ENDED)
        try:
            return done.result(within_s)
        finally:
            self._open_requests.discard(done)

    @staticmethod
    def _refuse(done, reason):
        with suppress(InvalidStateError):  # it was answered meanwhile
            done.set_exception(rospy.ServiceException(reason))

    def put(self, handler: Callable[[Any, int], None], item: Any, wakes: bool = True,
            on_drop: Callable[[], None] | None = None) -> None:
        """Have the node's thread call ``handler(item, arrival_ns)``. May be called from any thread.

        Args:
            wakes: False = the node handles it when it next wakes for another reason.
            on_drop: called when the item is dropped, in any thread.
        """
        dropped: list[tuple] = []
        with self._lock:
            if len(self._items) >= self._limit:
                dropped.extend(self._items)
                self._items.clear()
                self.dropped += sum(event[0] != self._on_overflow for event, _ in dropped)
                self._items.append(((self._on_overflow, None, self.clocks.now_ns()), None))
            self._items.append(((handler, item, self.clocks.now_ns()), on_drop))
        for _, notify in dropped:
            if notify is not None:
                notify()
        if wakes:
            self.wake()

    def work(self, work: Callable[[], Any], handler: Callable[[Any, int], None]) -> None:
        """Have ``handler(work(), now_ns)`` called in the node's thread. What ``work`` raises is raised there, too.

        An overflow doesn't drop it: nobody says it again, and the node waits for it.
        """
        def put(handler, result):
            self.put(handler, result, on_drop=lambda: put(handler, result))

        def run():
            try:
                result = work()
            except Exception as error:
                put(_fail, error)
            else:
                put(handler, result)
        self.graph.start_thread(run, "work")

    def on_overflow(self, handler: Callable[[int], None]) -> None:
        """Have the node's thread call ``handler(now_ns)`` after messages were dropped, before it handles newer ones."""
        self._overflow_handlers.append(handler)

    def begin_anew(self, now_ns: int, still_ns: int) -> str:
        """Drop all messages that were sent so far. To be called in the node's thread, after it stood still.

        Args:
            still_ns: for how long; 0 = unknown.

        Returns:
            A line about it.
        """
        for subscription in self.subscriptions:
            subscription.renew()
        lasted = f" for {still_ns / NS_PER_S:.2f} s" if still_ns else ""
        text = f"{NODE_STOOD_STILL}{lasted}: what was sent meanwhile is dropped"
        self._lose_all(DiagnosticStatus.WARN, text, now_ns)
        return text

    @property
    def old_messages(self) -> int:
        """Return how many messages were dropped because the node stood still when they were sent."""
        return sum(subscription.dropped for subscription in self.subscriptions)

    def report(self, status) -> None:
        """Add to a report whether the node stood still or messages were dropped in the last 10 s, and how many ever."""
        now_ns = self.clocks.now_ns()
        for level, (noticed_ns, text) in self._faults.items():
            if now_ns - noticed_ns < SHOWN_NS:
                status.mergeSummary(level, text)
        if self.dropped:
            status.add("messages dropped by its inbox", self.dropped)
        if self.old_messages:
            status.add("messages dropped after it stood still", self.old_messages)

    def _on_overflow(self, _, now_ns):
        text = f"the inbox of this node overflowed: {DROPPED}, {self.dropped} in all"
        self._overflow_warnings.warn("overflow", f"{text}; all that was heard before counts as lost")
        self._lose_all(DiagnosticStatus.ERROR, text, now_ns)

    def _lose_all(self, level, text, now_ns):
        self._faults[level] = now_ns, text
        for handler in self._overflow_handlers:
            handler(now_ns)

    def wake(self) -> None:
        """End the node's wait, now or the next one. For signal handlers too."""
        with suppress(BlockingIOError):  # there are enough wake-ups already
            self._waker.send(b"\0")

    def end(self) -> None:
        """Have the node's thread leave its loop."""
        self.ending = True
        self.wake()

    def watch(self, what: str, fd: int | None) -> None:
        """Also end a wait when ``fd``, of this name, is readable or in error; ``None`` = no longer."""
        self._watched.pop(what, None)
        if fd is not None:
            self._watched[what] = fd

    def wait_until(self, deadline_ns: float) -> None:
        """Sleep until an item arrives, a watched fd is readable, or the monotonic clock reaches the deadline."""
        left_ns = max(0, min(deadline_ns - self.clocks.now_ns(), MAX_WAIT_NS))
        ready, _, _ = select.select([self._woken, *self._watched.values()], [], [], left_ns / NS_PER_S)
        if self._woken in ready:
            self._woken.recv(4096)

    def drain(self) -> list[tuple]:
        """Remove and return all items, oldest first, as (handler, item, arrival_ns)."""
        with self._lock:
            events = [event for event, _ in self._items]
            self._items.clear()
        return events

    def dispatch(self) -> None:
        """Call the handler of each item that has arrived, oldest first."""
        for handler, item, arrival_ns in self.drain():
            handler(item, arrival_ns)


def _fail(error, now_ns):
    raise error
