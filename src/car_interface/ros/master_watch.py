"""Watches the ROS master, and who publishes on the topics of this process's nodes.

One thread per process asks the master once a second. A dead master, or a publisher that doesn't answer, blocks that
thread only. Nodes that share a process share it.
"""
from __future__ import annotations

import threading
import xmlrpc.client
from types import MappingProxyType
from typing import Callable, Mapping

import rosgraph
import rospy

from car_interface.common.publishers import OR, CommandTopic
from car_interface.common.units import NS_PER_S
from car_interface.ros.clocks import SYSTEM
from car_interface.ros.inbox import Inbox
from car_interface.ros.publisher_lookup import CONNECTING_NS, PublisherLookup
from car_interface.ros.xmlrpc_calls import TimeoutTransport

POLL_S = 1.0
GONE = ("the ROS master is gone: what is connected goes on, but no node that starts now can join, and one that ends is "
        "not replaced. Stop the car, then start the launch file again")
ANOTHER = ("there is another ROS master now, which doesn't know these nodes. Stop the car, then start the launch file "
           "again")


class MasterWatch:
    """Passes what is found to one node's thread.

    Args:
        inbox: the node's; the topics are all that it subscribes to.
        on_fault: called in the node's thread with a line about the master's fault, every second while there is one and
            with an empty line when it is over; ``None`` = nobody asks.
        on_topics: called in the node's thread with a ``CommandTopic`` for each topic, whenever they change; likewise.
        shared: topics, as the node names them, on which several nodes may publish.
        types: of topics, as the node names them, that it subscribes to with any type, those that it takes.
    """

    def __init__(self, inbox: Inbox, on_fault: Callable[[str, int], None] | None = None,
                 on_topics: Callable[[list[CommandTopic], int], None] | None = None, shared: tuple[str, ...] = (),
                 types: Mapping[str, tuple[str, ...]] = MappingProxyType({})):
        self._inbox = inbox
        self._on_fault = on_fault
        self._on_topics = on_topics
        self._shared = {inbox.resolve_name(name) for name in shared}
        self._types = {inbox.resolve_name(name): OR.join(taken) for name, taken in types.items()}
        self._fault = ""
        self._topics: list[CommandTopic] = []
        inbox.graph.watch(self)

    @property
    def has_ended(self) -> bool:
        """Whether the node has."""
        return self._inbox.ending

    def update(self, fault: str, listed: Mapping[str, list[str]], lookup: PublisherLookup) -> None:
        """Take the master's answer. Called in the watch's thread.

        Args:
            fault: the master's.
            listed: the names of the publishers by topic, as the master has them.
            lookup: finds out about each.
        """
        if self._on_fault is not None and (fault or self._fault):
            self._inbox.put(self._on_fault, fault)
        self._fault = fault
        if self._on_topics is not None:
            found = [self._look_up(subscriber, listed, lookup) for subscriber in self._inbox.subscribers]
            topics = [topic for topic in found if topic is not None]
            if topics != self._topics:
                self._topics = topics
                self._inbox.put(self._on_topics, topics, on_drop=self._forget)

    def _forget(self):
        """The node's inbox dropped what was found: pass it on again."""
        self._topics = []

    def _look_up(self, subscriber, listed, lookup):
        subscription = subscriber.impl  # None once it's closed
        if subscription is None:
            return None
        name = subscription.resolved_name
        publishers = lookup.publishers(subscription, listed.get(name, []))
        return CommandTopic(name, self._types.get(name, subscription.type), publishers, name in self._shared)


class _ProcessWatch:
    """The thread, which starts with the first node that wants to know."""

    def __init__(self):
        self._watches: list[MasterWatch] = []
        self._lock = threading.Lock()
        self._has_started = False

    def add(self, watch: MasterWatch) -> None:
        with self._lock:
            self._watches = [other for other in self._watches if not other.has_ended] + [watch]
            if not self._has_started:
                self._has_started = True
                threading.Thread(target=self._run, name="master watch", daemon=True).start()

    def _run(self):
        master = _Master()
        lookup = PublisherLookup(master.node_uri)
        while not rospy.is_shutdown():
            fault, listed = master.ask()
            lookup.begin()
            for watch in self._watches:
                if not watch.has_ended:
                    watch.update(fault, listed, lookup)
            SYSTEM.sleep(CONNECTING_NS / NS_PER_S if lookup.is_waiting else POLL_S)


PROCESS_WATCH = _ProcessWatch()


class _Master:
    """Asks the master, always the same one."""

    def __init__(self):
        self._proxy = xmlrpc.client.ServerProxy(rosgraph.get_master_uri(), transport=TimeoutTransport())
        self._pid = None

    def ask(self) -> tuple[str, dict[str, list[str]]]:
        """What is wrong with the master, and who publishes on each topic."""
        try:
            name = rospy.get_name()
            calls = xmlrpc.client.MultiCall(self._proxy)
            calls.getPid(name)
            calls.getSystemState(name)
            (_, _, pid), (_, _, (publishers, _, _)) = calls()
        except Exception:  # no usable answer, for whatever reason
            return GONE, {}
        self._pid = self._pid or pid
        return "" if pid == self._pid else ANOTHER, dict(publishers)

    def node_uri(self, node: str) -> str:
        """Where a node answers; empty when the master doesn't know it."""
        code, _, uri = self._proxy.lookupNode(rospy.get_name(), node)
        return uri if code == 1 else ""
