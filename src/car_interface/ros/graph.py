"""A node's access to the ROS graph: topics, services, parameters, and what watches the graph for it.

A test gives a node's inbox a graph of its own, in which it delivers the messages itself.
"""
from __future__ import annotations

import threading
from typing import Any, Callable

import rosgraph
import rospy
from rospy.impl.tcpros_pubsub import TCPROSHandler

from car_interface.common.units import NS_PER_MS
from car_interface.ros.clocks import SYSTEM

SAME_STANDSTILL_NS = 200 * NS_PER_MS  # a replacement for another node of this process counts for so long
MAX_RETIRED = 32  # connections that may still deliver what they have read: the newest of each topic
_REPLACING = threading.Lock()


class RosGraph:
    """The graph that rospy has joined."""

    clocks = SYSTEM  # of the nodes in it
    process_name = staticmethod(rospy.get_name)  # with its namespace
    namespace = staticmethod(rospy.get_namespace)  # of the process, with a slash at both ends
    resolve_name = staticmethod(rospy.resolve_name)  # of a topic or service, as remapped
    parameter = staticmethod(rospy.get_param)  # name, default
    set_parameter = staticmethod(rospy.set_param)  # name, value; raises OSError when the master is gone
    service = staticmethod(rospy.Service)  # name, type, handler, which is called in a thread of ROS

    def publisher(self, name: str, message_type, queue_size: int, latch: bool) -> rospy.Publisher:
        """Advertise a topic."""
        return rospy.Publisher(name, message_type, queue_size=queue_size, latch=latch)

    def subscriber(self, name: str, message_type, callback: Callable[[Any], None], queue_size: int) -> rospy.Subscriber:
        """Subscribe to a topic; ``callback`` is called in a thread of ROS."""
        return rospy.Subscriber(name, message_type, callback, queue_size=queue_size, tcp_nodelay=True)

    def replace_connections(self, subscriber: rospy.Subscriber) -> Callable[[Any], bool]:
        """Replace all connections of a subscriber, unless that has just been done for another one of its topic.

        Returns:
            Whether a message's header is that of a replaced one.

        Raises:
            Exception: of whatever kind, by another rospy: these are its internals.
        """
        subscription = subscriber.impl
        if subscription is None:  # it is closed
            return lambda header: False
        with _REPLACING:
            # rospy gives each connection a header of its own, and every message that of its connection.
            retired, replaced_ns = getattr(subscription, "car_interface_retired", ((), -SAME_STANDSTILL_NS))
            now_ns = self.clocks.now_ns()
            if now_ns - replaced_ns >= SAME_STANDSTILL_NS:
                connections = list(subscription.connections)
                retired = (*retired, *(each.header for each in connections if each.header))[-MAX_RETIRED:]
                for connection in connections:
                    _replace(subscription, connection)
                subscription.car_interface_retired = retired, now_ns
        return lambda header: any(header is one for one in retired)

    def call(self, service: str, service_type, request: Any, on_done: Callable[[Any, str], None]) -> None:
        """Call a service beside the node's thread; ``on_done(answer, problem)`` is called there: None if it failed."""
        def run():
            try:
                answer, problem = rospy.ServiceProxy(service, service_type)(request), ""
            except Exception as error:  # of many kinds: of rospy, of XML-RPC, of the network
                answer, problem = None, str(error)
            on_done(answer, problem)
        self.start_thread(run, "call")

    def watch(self, process_watch, watch) -> None:
        """Have the process's watch of the master update a node's ``CommandTopics`` once a second."""
        process_watch.add(watch)

    def start_thread(self, target: Callable[[], None], name: str) -> None:
        """Run a function beside the node's thread."""
        threading.Thread(target=target, name=name, daemon=True).start()

    def publishers(self, topic: str) -> list[str]:
        """Return the names of the nodes that publish on a topic."""
        published, _, _ = rosgraph.Master(rospy.get_name()).getSystemState()
        return [node for name, nodes in published if name == topic for node in nodes]


ROS = RosGraph()


def _replace(subscription, connection):
    """Replace one of rospy's connections to a publisher."""
    host, port = connection.dest_address
    done, text, _ = TCPROSHandler().create_transport(
        subscription.resolved_name, connection.endpoint_id, ["TCPROS", host, port])
    if not done:
        raise rospy.ROSException(text)
    connection.close()
