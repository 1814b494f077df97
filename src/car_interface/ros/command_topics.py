"""Reports who publishes on the topics that a node obeys: on /diagnostics and, if a fault lasts, in the log.

A publisher with a wrong message type, on a host whose name can't be looked up, or that rospy has missed sends nothing
that arrives, so no message names it. One thread per process asks the master once a second instead, and the publishers
that have no connection to this process. A dead master, or a publisher that doesn't answer, blocks that thread only.

The master knows the publishers' names, and of the types only the first that was registered for a topic. Those whose
messages arrive have a connection to this process, which says the rest. The others are asked: a TCPROS handshake with
the MD5 ``*`` is answered with the publisher's type. See http://wiki.ros.org/ROS/TCPROS.
"""
from __future__ import annotations

import socket
import threading
import xmlrpc.client
from types import MappingProxyType
from typing import Any, Callable, Iterable, Mapping
from urllib.parse import urlsplit

import rosgraph
import rospy
from rosgraph.network import write_ros_handshake_header

from car_interface.common.publishers import ANY, OR, REPORT, CommandTopic, Fault, FaultLog, Publisher, find_faults
from car_interface.common.units import NS_PER_S
from car_interface.ros.clocks import SYSTEM
from car_interface.ros.diagnostics import ERROR, OK, WARN
from car_interface.ros.inbox import Inbox
from car_interface.ros.tcpros_limits import HandshakeTimeout, read_header
from car_interface.ros.xmlrpc_calls import ANSWER_WITHIN_S, TimeoutTransport, call

# No command, but a report: of pca9685, and of its guard while that acts in its place.
REPORTS = ("/servo/output",)
POLL_S = 1.0
# A publisher that is asked gets a subscriber for a moment, so it's not asked each time.
ASK_AGAIN_NS = 4 * NS_PER_S
ASK_SILENT_AGAIN_NS = 10 * NS_PER_S  # one that let the question time out
SLOW_NS = NS_PER_S // 2
# A publisher that has just registered is about to be connected. Asked before that, it would take the question for its
# first subscriber, and may send what it sends once to nobody else.
CONNECTING_NS = 3 * NS_PER_S // 10
GONE = ("the ROS master is gone: what is connected goes on, but no node that starts now can join, and one that ends is "
        "not replaced. Stop the car, then start the launch file again")
ANOTHER = ("there is another ROS master now, which doesn't know these nodes. Stop the car, then start the launch file "
           "again")


class CommandTopics:
    """Reports on the publishers of all topics that a node subscribes to.

    Args:
        shared: topics on which several nodes may publish.
        types: of topics that it subscribes to with any type, those that it takes.
        more_faults: what else the node finds, called with ``now_ns`` and the topics.
        find_unheard: finds faults in the names of all publishers by topic; called with a function that resolves a name.
    """

    def __init__(self, inbox: Inbox, shared: tuple[str, ...] = (),
                 more_faults: Callable[[int, list[CommandTopic]], list[Fault]] | None = None,
                 types: Mapping[str, tuple[str, ...]] = MappingProxyType({}),
                 find_unheard: Callable[[Mapping[str, list[str]], Callable[[str], str]], list[Fault]] | None = None):
        self.inbox = inbox
        self._shared = {inbox.resolve_name(name) for name in (*shared, *REPORTS)}
        self._types = {inbox.resolve_name(name): OR.join(taken) for name, taken in types.items()}
        self._more_faults = more_faults or (lambda now_ns, topics: [])
        self._find_unheard = find_unheard or (lambda listed, resolve: [])
        self._log = FaultLog()
        # The watch's thread sets these three.
        self._master_fault = ""
        self.topics: list[CommandTopic] = []  # as they were found last; none = not yet
        self.unheard: list[Fault] = []  # what ``find_unheard`` found last
        self.reports = {REPORT: self._report}  # for ``Diagnostics``

    def start(self, report_now: Callable[[], None], on_fault: Callable[[str, int], None] | None = None) -> None:
        """Begin, once the node has subscribed to its topics.

        Args:
            report_now: has the node's reports published at once.
            on_fault: called in the node's thread with a line about the master's fault, every second while there is one
                and with an empty line when it is over.
        """
        self._report_now, self._on_fault = report_now, on_fault
        self.inbox.on_overflow(lambda now_ns: report_now())  # what was dropped may have asked for that
        self.inbox.graph.watch(PROCESS_WATCH, self)

    def update(self, fault: str, listed: Mapping[str, list[str]], lookup: PublisherLookup) -> None:
        """Take what was found, and have what is new reported. Called in the watch's thread.

        Args:
            fault: the master's.
            listed: the names of the publishers by topic, as the master has them.
            lookup: finds out about each.
        """
        if self._on_fault is not None and (fault or self._master_fault):
            self.inbox.put(self._on_fault, fault)
        self._master_fault = fault
        subscriptions = [each.subscriber.impl for each in self.inbox.subscriptions]
        topics = [self._look_up(each, listed, lookup) for each in subscriptions if each is not None]  # None: closed
        unheard = self._find_unheard(listed, self.inbox.resolve_name)
        if (topics, unheard) != (self.topics, self.unheard):
            self.topics, self.unheard = topics, unheard
            self.inbox.put(lambda _, now_ns: self._report_now(), None)

    def _look_up(self, subscription, listed, lookup):
        name = subscription.resolved_name
        publishers = lookup.publishers(subscription, listed.get(name, []))
        return CommandTopic(name, self._types.get(name, subscription.type), publishers, name in self._shared)

    def _report(self, status):
        """For /diagnostics: each fault with its remedy, and all publishers."""
        now_ns = self.inbox.clocks.now_ns()
        faults = [fault for topic in self.topics for fault in find_faults(topic)]
        faults += [*self.unheard, *self._more_faults(now_ns, self.topics)]
        for fault in self._log.update(faults, now_ns):
            rospy.logwarn("%s", fault.text)
        status.summary(OK, "each has the publishers that it should have" if self.topics else "not looked at yet")
        for fault in faults:
            status.mergeSummary(ERROR if self._log.is_lasting(fault, now_ns) else WARN, fault.reason)
        status.add("cause", ", ".join(dict.fromkeys(fault.cause for fault in faults)))
        status.add("remedy", ". ".join(dict.fromkeys(fault.remedy for fault in faults)))
        for topic in self.topics:
            status.add(topic.name, ", ".join(map(str, topic.publishers)) or "no publisher")


class _ProcessWatch:
    """The thread, which starts with the first node that wants to know, and asks always the same master."""

    def __init__(self):
        self._watches: list[CommandTopics] = []
        self._lock = threading.Lock()
        self._master_pid = None

    def add(self, watch: CommandTopics) -> None:
        with self._lock:
            if not self._watches:
                threading.Thread(target=self._run, name="master watch", daemon=True).start()
            self._watches = [other for other in self._watches if not other.inbox.ending] + [watch]

    def _run(self):
        self._master = xmlrpc.client.ServerProxy(rosgraph.get_master_uri(), transport=TimeoutTransport())
        lookup = PublisherLookup(self._node_uri)
        while not rospy.is_shutdown():
            fault, listed = self._ask_master()
            lookup.begin()
            for watch in self._watches:
                if not watch.inbox.ending:
                    watch.update(fault, listed, lookup)
            SYSTEM.sleep(CONNECTING_NS / NS_PER_S if lookup.is_waiting else POLL_S)

    def _ask_master(self):
        """Return what is wrong with the master, and who publishes on each topic."""
        try:
            calls, name = xmlrpc.client.MultiCall(self._master), rospy.get_name()
            calls.getPid(name)
            calls.getSystemState(name)
            (_, _, pid), (_, _, (publishers, _, _)) = calls()
        except Exception:  # no usable answer, for whatever reason
            return GONE, {}
        self._master_pid = self._master_pid or pid
        return "" if pid == self._master_pid else ANOTHER, dict(publishers)

    def _node_uri(self, node):
        code, _, uri = self._master.lookupNode(rospy.get_name(), node)
        return uri if code == 1 else ""


PROCESS_WATCH = _ProcessWatch()


class PublisherLookup:
    """Knows the publishers of this process's topics.

    Args:
        node_uri: asks the master where a node answers; empty = the master doesn't know it. It may raise anything.
    """

    def __init__(self, node_uri: Callable[[str], str]):
        self._node_uri = node_uri
        # What publishers said, by topic and node: themselves, or None for those that are gone or silent; and until
        # when that counts, ns.
        self._answers: dict[tuple[str, str], tuple[Publisher | None, int]] = {}
        self._before = self._answers  # those of the round before
        self.is_waiting = False  # for connections: look again after CONNECTING_NS
        self._was_slow = False  # somebody let a question time out: the others are asked the next time

    def begin(self) -> None:
        """Begin anew: forget the answers of those that aren't listed any more."""
        self._was_slow = self.is_waiting = False
        self._before, self._answers = self._answers, {}

    def publishers(self, subscription: Any, listed: Iterable[str]) -> list[Publisher]:
        """Return all publishers of a topic, sorted.

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
        """Return a publisher without a connection; ``None`` = it's gone, or doesn't answer."""
        key, now_ns = (subscription.resolved_name, node), SYSTEM.now_ns()
        answer = self._answers.get(key) or self._before.get(key)
        if answer is None:
            answer = None, now_ns + CONNECTING_NS
            self.is_waiting = True
        elif now_ns >= answer[1] and not self._was_slow:
            publisher, lasts_ns = self._ask_now(subscription, node)
            answer = publisher, now_ns + lasts_ns
            self._was_slow = SYSTEM.now_ns() - now_ns >= SLOW_NS
        self._answers[key] = answer
        return answer[0]

    def _ask_now(self, subscription, node):
        """Return what a publisher says, and for how long that counts, ns."""
        uri, topic = "", subscription.resolved_name
        try:
            uri = self._node_uri(node)
            header = ask_type(uri, topic)
            if header["md5sum"] != subscription.data_class._md5sum:
                return Publisher(node, _machine(uri), header["type"]), ASK_AGAIN_NS
            # It is received, also by another name for the same fields. Have rospy connect to what it has missed, as the
            # master does when a publisher registers: of the lists of publishers that wait for its thread rospy takes
            # the newest, and the master's answer to this node, which has none yet, may come after the list that has it.
            call(rospy.get_node_uri(), "publisherUpdate", "/master", topic, [uri])
            return Publisher(node, _machine(uri), subscription.type), ASK_AGAIN_NS
        except ConnectionRefusedError:
            return None, 0  # it was killed, and may be back soon
        except socket.gaierror:
            return Publisher(node, _machine(uri), ""), ASK_SILENT_AGAIN_NS
        except (socket.timeout, HandshakeTimeout):
            return None, ASK_SILENT_AGAIN_NS
        except Exception:  # whatever it answers
            return None, ASK_AGAIN_NS


def ask_type(uri: str, topic: str) -> dict[str, str]:
    """Return what a node says of a topic that it publishes: ``type``, ``md5sum`` and more.

    Raises:
        OSError: it can't be reached.
        HandshakeError: it doesn't answer.
        LookupError: it doesn't publish that.
    """
    # Not this node's name: the publisher would take the question for its new connection, and drop the old one.
    caller = f"{rospy.get_name()}_asks_type"
    code, message, protocol = call(uri, "requestTopic", caller, topic, [["TCPROS"]])
    if code != 1 or not protocol:
        raise LookupError(message)
    with socket.create_connection((protocol[1], protocol[2]), timeout=ANSWER_WITHIN_S) as connection:
        write_ros_handshake_header(connection, {"topic": topic, "md5sum": "*", "type": "*", "callerid": caller})
        header = read_header(connection)
    if "error" in header:
        raise LookupError(header["error"])
    return header


def _is_connected(connection):
    """Return whether a publisher has accepted rospy's connection."""
    return connection.socket is not None and not connection.done and "type" in (connection.header or {})


def _type(subscription, connection):
    """Return the type of a connection's messages. A subscription to any type has the one of each publisher."""
    return connection.header["type"] if subscription.type == ANY else subscription.type


def _machine(uri):
    return urlsplit(uri).hostname or uri
