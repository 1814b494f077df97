"""A ROS master of its own, nodes started as users start them, and topics with the times of their messages."""
from __future__ import annotations

import os
import random
import shutil
import signal
import sys
import tempfile
import time
from contextlib import ExitStack, contextmanager
from queue import Empty, SimpleQueue
from typing import Callable, Iterator

import rospkg
import rospy
import yaml
from processes import answers, end_descendants, free_port

from waiting import NodeProcess, eventually

PACKAGE = rospkg.RosPack().get_path("car_interface")
PATIENCE_S = 20.0
CLOSING: list[Callable] = []  # unregisters what is subscribed and published


class Stage:
    """The master and the processes on it. Everything that was started ends with it."""

    def __init__(self):
        self._stack = ExitStack()
        self.folder = tempfile.mkdtemp(prefix="car_interface_bench.")
        self._stack.callback(shutil.rmtree, self.folder, ignore_errors=True)
        self._has_master = False
        self.random = random.Random(1)

    def __enter__(self) -> Stage:
        return self

    def __exit__(self, error, *_) -> None:
        if error:
            end_descendants()  # all at once, also the nodes of a roslaunch
        if self._has_master:
            rospy.signal_shutdown("measured")
        self._stack.close()

    def open(self) -> None:
        if self._has_master:
            return
        port = free_port()
        os.environ.update(ROS_MASTER_URI=f"http://127.0.0.1:{port}", ROS_IP="127.0.0.1", ROS_LOG_DIR=self.folder)
        self._stack.callback(self.end, self.start(shutil.which("roscore"), "-p", str(port)))
        eventually(lambda: answers(port), "a master", PATIENCE_S)
        rospy.init_node("bench", disable_signals=True)
        sys.setswitchinterval(0.0005)  # as the package's nodes: it is their time that is measured
        self._has_master = True

    def start(self, *command: str) -> NodeProcess:
        process = NodeProcess(*command)
        self._stack.callback(process.clean_up)
        return process

    def node(self, node: str, *arguments: str) -> NodeProcess:
        return self.start("rosrun", "car_interface", node, *arguments)

    def actors(self, *roles: tuple[str, ...]) -> list[NodeProcess]:
        """Start some of actor.py's roles, each with its arguments, and wait until all are ready."""
        processes = [self.start(sys.executable, f"{PACKAGE}/test/bench/actor.py", *role) for role in roles]
        for process in processes:
            process.wait_for_info("^ready")
        return processes

    def actor(self, *role: str) -> NodeProcess:
        return self.actors(role)[0]

    @staticmethod
    def load(namespace: str, *paths: str) -> None:
        """Set a node's parameters from files in config/; a folder before a name is a namespace below the node's."""
        for path in paths:
            folder, _, name = path.rpartition("/")
            with open(os.path.join(PACKAGE, "config", name), encoding="utf-8") as file:
                for key, value in yaml.safe_load(file).items():
                    rospy.set_param("/".join(filter(None, (namespace, folder, key))), value)

    def path(self, name: str) -> str:
        return os.path.join(self.folder, name)

    @staticmethod
    def end(*processes: NodeProcess) -> None:
        """End processes, all at once, in such a way that the master unregisters them."""
        for process in processes:
            if process.runs():
                process.send(signal.SIGINT)
        for process in processes:
            try:
                process.wait_for_exit(5.0)
            except AssertionError:
                process.clean_up()

    @contextmanager
    def running(self, *processes: NodeProcess) -> Iterator[None]:
        """End the processes afterwards, unregister what subscribed and published, and delete the parameters."""
        try:
            yield
        finally:
            self.end(*processes)
            while CLOSING:
                CLOSING.pop()()
            try:
                delete_params()
            except OSError:
                pass  # an interrupt from the terminal ended the master too


def delete_params() -> None:
    for name in rospy.get_param_names():
        if not name.startswith(("/run_id", "/ros")):
            try:
                rospy.delete_param(name)
            except KeyError:
                pass  # it was deleted with the one before


class TimedSubscriber:
    """Receives a topic: what ``convert`` makes of its messages, with their times of arrival, ns."""

    def __init__(self, topic: str, message_type, convert: Callable = lambda message: message):
        self._received: SimpleQueue = SimpleQueue()
        self._convert = convert
        self._topic = topic
        self._subscriber = rospy.Subscriber(topic, message_type, self._store, tcp_nodelay=True)
        self.close = self._subscriber.unregister
        CLOSING.append(self.close)

    def _store(self, message):
        now_ns = time.monotonic_ns()
        self._received.put((now_ns, self._convert(message)))

    def connected(self) -> TimedSubscriber:
        eventually(lambda: self._subscriber.get_num_connections() > 0, f"a publisher of {self._topic}", PATIENCE_S)
        return self

    def first(self, wanted: Callable = lambda value: True, since_ns: int = 0) -> int:
        """Return when the first wanted value arrived that is not older than ``since_ns``; drop those before it."""
        deadline_ns = time.monotonic_ns() + round(PATIENCE_S * 1e9)
        while True:
            try:
                at_ns, value = self._received.get(timeout=max(0.0, (deadline_ns - time.monotonic_ns()) / 1e9))
            except Empty:
                raise AssertionError(f"{self._topic}: not received within {PATIENCE_S} s") from None
            if at_ns >= since_ns and wanted(value):
                return at_ns

    def drain(self) -> list[tuple[int, object]]:
        drained = []
        while not self._received.empty():
            drained.append(self._received.get())
        return drained


def connected_publisher(topic: str, message_type) -> rospy.Publisher:
    publisher = rospy.Publisher(topic, message_type, queue_size=10, tcp_nodelay=True)
    CLOSING.append(publisher.unregister)
    eventually(lambda: publisher.get_num_connections() >= 1, f"a subscriber of {topic}", PATIENCE_S)
    return publisher
