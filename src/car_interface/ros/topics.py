"""Publishers, subscribers and services of one node, under the node's name and handled in the node's thread.

A node that was frozen finds the messages of that time in the sockets of its connections, and in the buffers of those
who sent them; when it goes on they arrive all at once and look new. So every connection is replaced by a new one, which
carries only what is sent from then on. The publishers' addresses are known: no master is needed.

The nodes of one process that subscribe to a topic share its connections. Each of them drops by itself what is old.
"""
from __future__ import annotations

import logging
import socket
import traceback
from concurrent.futures import Future
from operator import attrgetter
from typing import Any, Callable, Sequence

import rospy
from rospy.impl.tcpros_pubsub import QueuedConnection
from std_msgs.msg import Bool, Int32MultiArray, MultiArrayDimension, MultiArrayLayout

from car_interface.common.staleness import TimedInput
from car_interface.common.units import CHANNELS, NS_PER_S, one_channel
from car_interface.ros.inbox import Inbox

FALLBACK_NS = NS_PER_S  # where connections can't be replaced nothing is obeyed for so long
_LAYOUT = MultiArrayLayout(dim=[MultiArrayDimension(label="pwm_channel", size=CHANNELS, stride=1)], data_offset=0)


Handler = Callable[[Any, int], None]


def advertise(topic: str, message_type, inbox: Inbox, queue_size=10, latch=False) -> rospy.Publisher:
    """Return a publisher that lives as long as the inbox's node."""
    publisher = inbox.graph.publisher(inbox.own_name(topic), message_type, queue_size, latch)
    inbox.on_close(publisher.unregister)
    return publisher


def serve(name: str, service_type, inbox: Inbox, handler: Callable[[Any, Future], None]) -> None:
    """Offer a service: ``handler(request, done)`` runs in the node's thread; the Future gets the response's fields."""
    def handle(request):
        return service_type._response_class(*inbox.ask(handler, request))
    inbox.on_close(inbox.graph.service(inbox.own_name(name), service_type, handle).shutdown)


class Subscription:
    """Knows which messages of one node's subscription are old.

    Args:
        takes_latched: obey the message with which a latching publisher's new connection begins. It is the publisher's
            last word, however old.
    """

    def __init__(self, inbox: Inbox, takes_latched: bool = False):
        self.dropped = 0  # how many messages were old
        self._inbox = inbox
        self._takes_latched = takes_latched
        self.subscriber: rospy.Subscriber | None = None  # until it is opened
        self._is_retired: Callable[[Any], bool] = lambda header: False
        self._old_until_ns = -1  # what arrived until then is old
        self._is_renewed = False  # every connection was replaced
        self._latched_headers: list[dict] = []  # of new connections that have delivered their latched message

    def open(self, topic: str, message_type, receive: Callable[[Any], None], queue_size=10) -> None:
        """Have ``receive(message)`` called in a thread of ROS."""
        self.subscriber = self._inbox.graph.subscriber(self._inbox.own_name(topic), message_type, receive, queue_size)
        self._inbox.subscriptions.append(self)
        self._inbox.on_close(self.subscriber.unregister)

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
        graph, self._latched_headers = self._inbox.graph, []
        try:
            self._is_retired = graph.replace_connections(self.subscriber)
            self._old_until_ns, self._is_renewed = graph.clocks.now_ns(), True
        except Exception:  # of another rospy
            logging.getLogger("car_interface").error("%s", traceback.format_exc())
            self._old_until_ns, self._is_renewed = graph.clocks.now_ns() + FALLBACK_NS, False

    def _is_old(self, header, arrival_ns):
        if self._is_retired(header):
            return True
        if self._is_renewed and self._is_latched(header):
            return not self._takes_latched  # also if it arrived while other connections were still being replaced
        return arrival_ns <= self._old_until_ns

    def _is_latched(self, header):
        """Return whether it is the first message of a new connection to a publisher that latches."""
        if not header or header.get("latching") != "1" or any(header is known for known in self._latched_headers):
            return False
        self._latched_headers.append(header)
        return True


def subscribe(topic: str, message_type, inbox: Inbox, handler: Handler, queue_size=10, wakes=True) -> None:
    """Subscribe so that ``handler(message, arrival_ns)`` runs in the node's thread, for each message, in order.

    Args:
        message_type: ``rospy.AnyMsg`` for messages of any type.
        wakes: False = the handler runs when the node next wakes for another reason.
    """
    subscription = Subscription(inbox)
    handler = subscription.without_old(handler)
    subscription.open(topic, message_type, lambda message: inbox.put(handler, message, wakes), queue_size)


def listen(topic: str, message_type, inbox: Inbox, timeout_s: float, wakes=True) -> TimedInput:
    """Subscribe; return what has the newest message, and its age."""
    newest = TimedInput(topic, timeout_s)
    subscribe(topic, message_type, inbox, newest.update, wakes=wakes)
    return newest


def subscribe_changes(topic: str, message_type, inbox: Inbox, handler: Handler,
                      on_change: Callable[[int], Any], takes_latched: bool = False,
                      value_of: Callable[[Any], Any] = attrgetter("data")) -> None:
    """Do the same for a topic whose messages mostly repeat the last value, in a node with a fast timer.

    A repeated value doesn't wake the node: it is handled, with its own time of arrival, when the node next wakes. That
    reduces the CPU time of an input at 50 Hz to a third. After a new value ``on_change(arrival_ns)`` is called as well.

    Args:
        takes_latched: as of ``Subscription``.
        value_of: the value in a message. It is called in rospy's thread.
    """
    last = None
    subscription = Subscription(inbox, takes_latched)

    def call_both(message, arrival_ns):
        handler(message, arrival_ns)
        on_change(arrival_ns)
    handle, handle_change = subscription.without_old(handler), subscription.without_old(call_both)

    def receive(message):
        nonlocal last
        value = value_of(message)
        has_changed = value != last  # as NaN always has
        last = value
        inbox.put(handle_change if has_changed else handle, message, wakes=has_changed)
    subscription.open(topic, message_type, receive)


def subscribe_interlock(inbox: Inbox, arbiter: Any, on_change: Callable[[int], Any]) -> None:
    """Pass both emergency stops and the deadman to an arbiter, and call ``on_change(arrival_ns)`` after a new value.

    An emergency stop may be latched and sent once (``e_stop_timeout`` 0), a deadman is repeated.
    """
    # phone_drive keeps its stop as a parameter, too, which is there before its first message.
    if inbox.graph.parameter(inbox.resolve_name("phone_drive/e_stop"), False):
        arbiter.await_phone_e_stop()
    # A topic of its own: a false that somebody repeats on /e_stop must not end a stop by phone.
    for topic, update, takes_latched in (("/e_stop", arbiter.update_e_stop, True),
                                         ("phone/e_stop", arbiter.update_phone_e_stop, True),
                                         ("/teleop_logi/human_in_loop", arbiter.update_human, False)):
        subscribe_changes(topic, Bool, inbox, lambda message, now_ns, update=update: update(message.data, now_ns),
                          on_change, takes_latched)


def duty_vector(duties: Sequence[int]) -> Int32MultiArray:
    """Return a vector of 16 duties, with the layout that the original servo commands carry."""
    return Int32MultiArray(layout=_LAYOUT, data=duties)


def one_channel_duty(channel: int, duty: int) -> Int32MultiArray:
    """Return the vector that sets one channel."""
    return duty_vector(one_channel(channel, duty))


def md5_of(message: Any) -> str:
    """Return the MD5 of the definition of a message's fields, as its publisher has it."""
    return _header(message).get("md5sum", "")


def sender_of(message: Any) -> str:
    """Return the name of the node that sent a message; empty when it didn't come over a connection."""
    return _header(message).get("callerid", "")


def _header(message):
    return getattr(message, "_connection_header", None) or {}


def has_subscribers(publisher: rospy.Publisher) -> bool:
    """Return whether anybody subscribes: rospy serialises a message before it finds that nobody does."""
    return publisher.get_num_connections() > 0


class DirectConnection(QueuedConnection):
    """A connection to one subscriber, over which the thread that publishes a message sends it.

    rospy's ``QueuedConnection`` hands each message to a thread of its own and yields to that: two changes of thread per
    message and subscriber, which cost turn_arb a quarter of its CPU time (2.1 % of a core with this class, 2.7 without,
    in 90 s at 100 Hz; ``./dev bench --only heartbeat``). Here that thread sends only what the subscriber's socket
    doesn't take at once. A subscriber that no longer reads delays nobody, as with rospy: up to queue_size messages wait
    for it, and the oldest are dropped.

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
        """Return how many bytes the socket took. Errors are left to the thread: rospy knows what each of them means."""
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
