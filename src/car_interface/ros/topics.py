"""Publishers, subscribers and services of one node, under the node's name and handled in the node's thread."""
from __future__ import annotations

from concurrent.futures import Future
from functools import lru_cache
from typing import Any, Callable, Sequence

import rospy
from std_msgs.msg import Bool, Int32MultiArray, MultiArrayDimension, MultiArrayLayout

from car_interface.common.servo_channels import CHANNELS, one_channel
from car_interface.ros.backlog import Backlog
from car_interface.ros.inbox import Inbox

_LAYOUT = MultiArrayLayout(dim=[MultiArrayDimension(label="pwm_channel", size=CHANNELS, stride=1)], data_offset=0)


def advertise(topic: str, message_type, inbox: Inbox, queue_size=10, latch=False) -> rospy.Publisher:
    """A publisher that lives as long as the inbox's node."""
    publisher = inbox.graph.publisher(inbox.own_name(topic), message_type, queue_size, latch)
    inbox.on_close(publisher.unregister)
    return publisher


def serve(name: str, service_type, inbox: Inbox, handler: Callable[[Any, Future], None]) -> None:
    """Offer a service: ``handler(request, done)`` runs in the node's thread; the Future gets the response's fields."""
    def handle(request):
        return service_type._response_class(*inbox.ask(handler, request))
    inbox.on_close(inbox.graph.service(inbox.own_name(name), service_type, handle).shutdown)


def subscribe(topic: str, message_type, inbox: Inbox, handler: Callable[[Any, int], None], queue_size=10,
              wakes=True) -> rospy.Subscriber:
    """Subscribe so that ``handler(message, arrival_ns)`` runs in the node's thread, for each message, in order.

    With ``wakes`` false it runs when the node next wakes for another reason.
    """
    backlog = Backlog(inbox.graph)
    handler = backlog.without_old(handler)
    return _subscribe(topic, message_type, inbox, backlog, lambda message: inbox.put(handler, message, wakes=wakes),
                      queue_size)


def _data_of(message):
    return message.data


def subscribe_changes(topic: str, message_type, inbox: Inbox, handler: Callable[[Any, int], None],
                      on_change: Callable[[int], Any] | None = None, takes_latched: bool = False,
                      value_of: Callable[[Any], Any] = _data_of) -> None:
    """The same for a topic whose messages mostly repeat the last value, in a node with a fast timer.

    A repeated value doesn't wake the node: it is handled, with its own time of arrival, when the node next wakes. That
    reduces the CPU time of an input at 50 Hz to a third. After a new value ``on_change(arrival_ns)`` is called as well.

    Args:
        takes_latched: as of ``backlog.Backlog``.
        value_of: the value in a message. It is called in rospy's thread.
    """
    last = None
    backlog = Backlog(inbox.graph, takes_latched)

    def call_both(message, arrival_ns):
        handler(message, arrival_ns)
        on_change(arrival_ns)
    handle, handle_change = backlog.without_old(handler), backlog.without_old(call_both)

    def receive(message):
        nonlocal last
        value = value_of(message)
        has_changed = value != last  # as NaN always has
        last = value
        inbox.put(handle_change if on_change and has_changed else handle, message, wakes=has_changed)
    _subscribe(topic, message_type, inbox, backlog, receive)


def subscribe_any(topic: str, inbox: Inbox, handler: Callable[[Any, int], None], wakes: bool = True) -> None:
    """Subscribe to messages of any type: ``handler(message, arrival_ns)`` gets a rospy.AnyMsg.

    Args:
        wakes: False = the node handles it when it next wakes for another reason.
    """
    backlog = Backlog(inbox.graph)
    handler = backlog.without_old(handler)
    _subscribe(topic, rospy.AnyMsg, inbox, backlog, lambda message: inbox.put(handler, message, wakes))


def subscribe_interlock(inbox: Inbox, arbiter: Any, on_change: Callable[[int], Any]) -> None:
    """Pass the emergency stop and the deadman to an arbiter, and call ``on_change(arrival_ns)`` after a new value.

    An emergency stop may be latched and sent once (``e_stop_timeout`` 0), a deadman is repeated.
    """
    subscribe_changes("/e_stop", Bool, inbox,
                      lambda message, now_ns: arbiter.update_e_stop(message.data, now_ns), on_change,
                      takes_latched=True)
    subscribe_changes("/teleop_logi/human_in_loop", Bool, inbox,
                      lambda message, now_ns: arbiter.update_human(message.data, now_ns), on_change)


def duty_vector(duties: Sequence[int]) -> Int32MultiArray:
    """Return a vector of 16 duties, with the layout that the original servo commands carry."""
    return Int32MultiArray(layout=_LAYOUT, data=duties)


@lru_cache(maxsize=256)
def one_channel_duty(channel: int, duty: int) -> Int32MultiArray:
    """Return the vector that sets one channel. A command that comes again isn't built again."""
    return duty_vector(one_channel(channel, duty))


def md5_of(message: Any) -> str:
    """What the publisher of a message says of its fields: the MD5 of their definition."""
    return (getattr(message, "_connection_header", None) or {}).get("md5sum", "")


def has_subscribers(publisher: rospy.Publisher) -> bool:
    """Whether anybody subscribes: rospy serialises a message before it finds that nobody does."""
    return publisher.get_num_connections() > 0


def sender_of(message: Any) -> str:
    """The name of the node that sent a message; empty when it didn't come over a connection."""
    return (getattr(message, "_connection_header", None) or {}).get("callerid", "")


def _subscribe(topic, message_type, inbox, backlog, receive, queue_size=10):
    subscriber = inbox.graph.subscriber(inbox.own_name(topic), message_type, receive, queue_size)
    backlog.attach(subscriber)
    inbox.subscribers.append(subscriber)
    inbox.backlogs.append(backlog)
    inbox.on_close(subscriber.unregister)
    return subscriber
