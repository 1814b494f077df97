"""Finds out who publishes on a topic, from where, and with which message type.

The master knows the names only, and of the types only the first that was registered for a topic. Those whose messages
arrive have a connection to this process, which says the rest. The others are asked: a TCPROS handshake with the MD5
``*`` is answered with the publisher's type. See http://wiki.ros.org/ROS/TCPROS.
"""
from __future__ import annotations

import socket
import xmlrpc.client
from typing import Any, Callable, Iterable, NamedTuple
from urllib.parse import urlsplit

import rospy
from rosgraph.network import write_ros_handshake_header

from car_interface.common.publishers import ANY, Publisher
from car_interface.common.units import NS_PER_S
from car_interface.ros.clocks import SYSTEM
from car_interface.ros.tcpros_limits import HandshakeTimeout, read_header
from car_interface.ros.xmlrpc_calls import ANSWER_WITHIN_S, TimeoutTransport

# A publisher that is asked gets a subscriber for a moment, so it's not asked each time.
ASK_AGAIN_NS = 4 * NS_PER_S
ASK_SILENT_AGAIN_NS = 10 * NS_PER_S  # one that let the question time out
SLOW_NS = NS_PER_S // 2
# A publisher that has just registered is about to be connected. Asked before that, it would take the question for its
# first subscriber, and may send what it sends once to nobody else.
CONNECTING_NS = 3 * NS_PER_S // 10


class _Answer(NamedTuple):
    """What a publisher said: itself, or ``None`` if it's gone or silent; and until when that counts."""

    publisher: Publisher | None
    until_ns: int


class PublisherLookup:
    """Knows the publishers of this process's topics.

    Args:
        node_uri: asks the master where a node answers; empty = the master doesn't know it. It may raise anything.
    """

    def __init__(self, node_uri: Callable[[str], str]):
        self._node_uri = node_uri
        self._answers: dict[tuple[str, str], _Answer] = {}  # by topic and node
        self._asked: set[tuple[str, str]] = set()
        self._first_seen_ns: dict[tuple[str, str], int] = {}
        self.is_waiting = False  # for connections: look again after CONNECTING_NS
        self._was_slow = False  # somebody let a question time out: the others are asked the next time

    def begin(self) -> None:
        """Begin anew: forget the answers of those that aren't listed any more."""
        self._was_slow = self.is_waiting = False
        self._first_seen_ns = {key: at_ns for key, at_ns in self._first_seen_ns.items() if key in self._asked}
        self._answers = {key: answer for key, answer in self._answers.items() if key in self._asked}
        self._asked = set()

    def publishers(self, subscription: Any, listed: Iterable[str]) -> list[Publisher]:
        """All of a topic, sorted.

        Args:
            subscription: rospy's object behind a Subscriber.
            listed: the names that the master has.
        """
        connected = {connection.callerid_pub: Publisher(connection.callerid_pub, _machine(connection.endpoint_id),
                                                        _type(subscription, connection))
                     for connection in subscription.connections if _is_connected(connection)}
        others = (self._ask(subscription, node) for node in set(listed) - set(connected))
        return sorted([*connected.values(), *filter(None, others)])

    def _ask(self, subscription, node):
        """A publisher without a connection; ``None`` = it's gone, or doesn't answer."""
        key = subscription.resolved_name, node
        self._asked.add(key)
        now_ns = SYSTEM.now_ns()
        if now_ns - self._first_seen_ns.setdefault(key, now_ns) < CONNECTING_NS:
            self.is_waiting = True
            return None
        answer = self._answers.get(key)
        if answer is None or now_ns >= answer.until_ns:
            if self._was_slow:
                return answer and answer.publisher
            self._answers[key] = answer = self._ask_now(subscription, node, now_ns)
            self._was_slow = SYSTEM.now_ns() - now_ns >= SLOW_NS
        return answer.publisher

    def _ask_now(self, subscription, node, now_ns):
        uri = ""
        try:
            uri = self._node_uri(node)
            header = ask_type(uri, subscription.resolved_name)
            # Another name for the same fields is received.
            is_same = header["md5sum"] == subscription.data_class._md5sum
            if is_same:
                connect(uri, subscription.resolved_name)
            publisher = Publisher(node, _machine(uri), subscription.type if is_same else header["type"])
            return _Answer(publisher, now_ns + ASK_AGAIN_NS)
        except ConnectionRefusedError:
            return _Answer(None, now_ns)  # it was killed, and may be back soon
        except socket.gaierror:
            return _Answer(Publisher(node, _machine(uri), ""), now_ns + ASK_SILENT_AGAIN_NS)
        except (socket.timeout, HandshakeTimeout):
            return _Answer(None, now_ns + ASK_SILENT_AGAIN_NS)
        except Exception:  # whatever it answers
            return _Answer(None, now_ns + ASK_AGAIN_NS)


def ask_type(uri: str, topic: str) -> dict[str, str]:
    """What a node says of a topic that it publishes: ``type``, ``md5sum`` and more.

    Raises:
        OSError: it can't be reached.
        HandshakeError: it doesn't answer.
        LookupError: it doesn't publish that.
    """
    # Not this node's name: the publisher would take the question for its new connection, and drop the old one.
    caller = f"{rospy.get_name()}_asks_type"
    with xmlrpc.client.ServerProxy(uri, transport=TimeoutTransport()) as node:
        code, message, protocol = node.requestTopic(caller, topic, [["TCPROS"]])
    if code != 1 or not protocol:
        raise LookupError(message)
    with socket.create_connection((protocol[1], protocol[2]), timeout=ANSWER_WITHIN_S) as connection:
        write_ros_handshake_header(connection, {"topic": topic, "md5sum": "*", "type": "*", "callerid": caller})
        header = read_header(connection)
    if "error" in header:
        raise LookupError(header["error"])
    return header


def connect(uri: str, topic: str) -> None:
    """Have rospy connect to a publisher that it has missed, as the master does when one registers.

    rospy takes the newest of the lists of publishers that wait for its thread. When a publisher registers while this
    node does, the master's answer to this node, which has none yet, may come to wait after the list that has it.

    Raises:
        OSError: this node itself can't be reached.
    """
    with xmlrpc.client.ServerProxy(rospy.get_node_uri(), transport=TimeoutTransport()) as node:
        node.publisherUpdate("/master", topic, [uri])


def _is_connected(connection):
    """Whether a publisher has accepted rospy's connection."""
    return connection.socket is not None and not connection.done and "type" in (connection.header or {})


def _type(subscription, connection):
    """The type of a connection's messages. A subscription to any type has the one of each publisher."""
    return connection.header["type"] if subscription.type == ANY else subscription.type


def _machine(uri):
    return urlsplit(uri).hostname or uri
