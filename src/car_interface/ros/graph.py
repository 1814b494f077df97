"""A node's access to the ROS graph: topics, services, parameters, and what watches the graph for it.

A test gives a node's inbox a graph of its own, in which it delivers the messages itself.
"""
from __future__ import annotations

import threading
from typing import Any, Callable

import rosgraph
import rospy

from car_interface.ros.backlog import replace_connections
from car_interface.ros.clocks import SYSTEM


class RosGraph:
    """The graph that rospy has joined.

    Attributes:
        clocks: of the nodes in it.
    """

    clocks = SYSTEM

    def process_name(self) -> str:
        """Return the name that this process has registered."""
        return rospy.get_name()

    def namespace(self) -> str:
        """Return the namespace of the process's name, with a slash at both ends."""
        return rospy.get_namespace()

    def resolve_name(self, name: str) -> str:
        """Return the full name of a topic or service, as remapped."""
        return rospy.resolve_name(name)

    def publisher(self, name: str, message_type, queue_size: int, latch: bool) -> rospy.Publisher:
        """Advertise a topic."""
        return rospy.Publisher(name, message_type, queue_size=queue_size, latch=latch)

    def subscriber(self, name: str, message_type, callback: Callable[[Any], None], queue_size: int) -> rospy.Subscriber:
        """Subscribe to a topic; ``callback`` is called in a thread of ROS."""
        return rospy.Subscriber(name, message_type, callback, queue_size=queue_size, tcp_nodelay=True)

    def replace_connections(self, subscriber: rospy.Subscriber) -> Callable[[Any], bool]:
        """Replace all connections of a subscriber; return whether a message's header is that of an old one."""
        return replace_connections(subscriber)

    def service(self, name: str, service_type, handler: Callable[[Any], Any]) -> rospy.Service:
        """Offer a service; ``handler`` is called in a thread of ROS."""
        return rospy.Service(name, service_type, handler)

    def call(self, service: str, service_type, request: Any, on_done: Callable[[Any, str], None]) -> None:
        """Call a service beside the node's thread; ``on_done(answer, problem)`` is called there: None if it failed."""
        def run():
            try:
                answer, problem = rospy.ServiceProxy(service, service_type)(request), ""
            except (rospy.ServiceException, rospy.ROSException, OSError) as error:
                answer, problem = None, str(error)
            on_done(answer, problem)
        self.start_thread(run, "call")

    def parameter(self, name: str, default: Any) -> Any:
        """Return a parameter, or the default where there is none."""
        return rospy.get_param(name, default)

    def set_parameter(self, name: str, value: Any) -> None:
        """Set a parameter.

        Raises:
            OSError: the master is gone.
        """
        rospy.set_param(name, value)

    def reconfigure_server(self, config_type, callback, namespace: str):
        """Offer dynamic_reconfigure's interface below a namespace."""
        from car_interface.ros.reconfigure import Server  # which imports this package's inbox
        return Server(config_type, callback, namespace)

    def watch(self, watch) -> None:
        """Have a node's ``CommandTopics`` updated once a second."""
        from car_interface.ros.command_topics import PROCESS_WATCH  # likewise
        PROCESS_WATCH.add(watch)

    def start_thread(self, target: Callable[[], None], name: str) -> None:
        """Run a function beside the node's thread."""
        threading.Thread(target=target, name=name, daemon=True).start()

    def repeat_in_thread(self, target: Callable[[], None], period_s: float, is_over: Callable[[], bool],
                         name: str) -> None:
        """Call a function again and again beside the node's thread, first after ``period_s``."""
        def run():
            while not (rospy.is_shutdown() or is_over()):
                self.clocks.sleep(period_s)
                target()
        self.start_thread(run, name)

    def publishers(self, topic: str) -> list[str]:
        """Return the names of the nodes that publish on a topic."""
        published, _, _ = rosgraph.Master(rospy.get_name()).getSystemState()
        return [node for name, nodes in published if name == topic for node in nodes]


ROS = RosGraph()
