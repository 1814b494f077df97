"""A master of its own, nodes started as users start them, and what /proc says of a process."""
from __future__ import annotations

import os
import random
import shutil
import signal
import socket
import sys
import tempfile
import time
from contextlib import ExitStack, contextmanager
from queue import Empty, SimpleQueue
from typing import Callable, Iterator

import rospkg
import rospy
import yaml

from waiting import NodeProcess, eventually

PACKAGE = rospkg.RosPack().get_path("car_interface")
ACTOR = os.path.join(PACKAGE, "test", "bench", "actor.py")
TICKS_PER_S = os.sysconf("SC_CLK_TCK")
SWITCH_INTERVAL_S = 0.0005  # as the package's nodes: it's their time that is measured
PATIENCE_S = 20.0


class Stage:
    """The master and what runs on it. Everything that was started ends with it."""

    def __init__(self):
        self._stack = ExitStack()
        self.folder = tempfile.mkdtemp(prefix="car_interface_bench.")
        self._stack.callback(shutil.rmtree, self.folder, ignore_errors=True)
        self._has_master = False
        self.random = random.Random(1)

    def __enter__(self) -> Stage:
        return self

    def __exit__(self, *_) -> None:
        if self._has_master:
            rospy.signal_shutdown("measured")
        self._stack.close()

    def open(self) -> None:
        """Start the master and become a node, if that's still to do."""
        if self._has_master:
            return
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]
        os.environ.update(ROS_MASTER_URI=f"http://127.0.0.1:{port}", ROS_IP="127.0.0.1", ROS_LOG_DIR=self.folder)
        self._stack.callback(self.end, self.start(shutil.which("roscore"), "-p", str(port)))
        eventually(lambda: _answers(port), "a master", PATIENCE_S)
        rospy.init_node("bench", disable_signals=True)
        sys.setswitchinterval(SWITCH_INTERVAL_S)
        self._has_master = True

    def start(self, *command: str) -> NodeProcess:
        """Start a program."""
        process = NodeProcess(*command)
        self._stack.callback(process.clean_up)
        return process

    def node(self, node: str, *arguments: str) -> NodeProcess:
        """Start a node of this package as a user does. rosrun becomes the node, so that this is its process."""
        return self.start("rosrun", "car_interface", node, *arguments)

    def actors(self, *roles: tuple[str, ...]) -> list[NodeProcess]:
        """Start some of actor.py's roles, each with its arguments, and wait until all are ready."""
        processes = [self.start(sys.executable, ACTOR, *role) for role in roles]
        for process in processes:
            process.wait_for_info("^ready")
        return processes

    def actor(self, *role: str) -> NodeProcess:
        """Start one."""
        return self.actors(role)[0]

    @staticmethod
    def load(namespace: str, *names: str) -> None:
        """Set a node's parameters from files in config/."""
        for name in names:
            with open(os.path.join(PACKAGE, "config", name), encoding="utf-8") as file:
                for key, value in yaml.safe_load(file).items():
                    rospy.set_param(f"{namespace}/{key}", value)

    def path(self, name: str) -> str:
        """A file of the run's own."""
        return os.path.join(self.folder, name)

    @staticmethod
    def end(*processes: NodeProcess) -> None:
        """End processes, all at once, so that the master forgets them."""
        for process in processes:
            if process.runs():
                process.send(signal.SIGINT)
        for process in processes:
            try:
                process.wait_for_exit(5.0)
            except AssertionError:
                process.clean_up()

    @contextmanager
    def running(self, *processes: NodeProcess) -> Iterator[tuple[NodeProcess, ...]]:
        """End them afterwards, and forget their parameters."""
        try:
            yield processes
        finally:
            self.end(*processes)
            for name in rospy.get_param_names():
                if not name.startswith(("/run_id", "/ros")):
                    try:
                        rospy.delete_param(name)
                    except KeyError:
                        pass  # it went with the one before


class Ear:
    """Hears a topic: what arrived, and when, ns."""

    def __init__(self, topic: str, message_type, take: Callable = lambda message: message):
        self._heard: SimpleQueue = SimpleQueue()
        self._take = take
        self._topic = topic
        self._subscriber = rospy.Subscriber(topic, message_type, self._hear, tcp_nodelay=True)

    def _hear(self, message):
        now_ns = time.monotonic_ns()
        self._heard.put((now_ns, self._take(message)))

    def connected(self) -> Ear:
        """Wait for a publisher."""
        eventually(lambda: self._subscriber.get_num_connections() > 0, f"a publisher of {self._topic}", PATIENCE_S)
        return self

    def first(self, wanted: Callable = lambda value: True, since_ns: int = 0, within_s: float = PATIENCE_S) -> int:
        """When the first came that is wanted and not older than ``since_ns``; those before it are gone."""
        deadline_ns = time.monotonic_ns() + round(within_s * 1e9)
        while True:
            try:
                at_ns, value = self._heard.get(timeout=max(0.0, (deadline_ns - time.monotonic_ns()) / 1e9))
            except Empty:
                raise AssertionError(f"{self._topic}: what was waited for didn't come") from None
            if at_ns >= since_ns and wanted(value):
                return at_ns

    def all(self) -> list[tuple[int, object]]:
        """What arrived, with the times, and is not yet taken."""
        taken = []
        while not self._heard.empty():
            taken.append(self._heard.get())
        return taken

    def close(self) -> None:
        """Stop listening."""
        self._subscriber.unregister()


def mouth(topic: str, message_type, listeners: int = 1) -> rospy.Publisher:
    """A publisher that somebody listens to."""
    publisher = rospy.Publisher(topic, message_type, queue_size=10, tcp_nodelay=True)
    eventually(lambda: publisher.get_num_connections() >= listeners, f"a subscriber of {topic}", PATIENCE_S)
    return publisher


class CpuMeter:
    """What a process has used since this was made."""

    def __init__(self, pid: int):
        self._pid = pid
        self._begun_s, self._used_s = time.monotonic(), cpu_s(pid)

    def percent(self) -> float:
        """Of one core."""
        return 100 * (cpu_s(self._pid) - self._used_s) / (time.monotonic() - self._begun_s)


def cpu_s(pid: int) -> float:
    """User and system time of all threads of a process, s; in steps of 10 ms."""
    return sum(_times(pid)[1:3]) / TICKS_PER_S


def descendants_s() -> float:
    """The same of all living processes that this one has started, or they, and of those of theirs that have ended."""
    times = {}
    for name in filter(str.isdigit, os.listdir("/proc")):
        try:
            times[int(name)] = _times(int(name))
        except OSError:
            pass  # it has just ended
    found, parents = set(), {os.getpid()}
    while parents:
        parents = {pid for pid, (parent, *_) in times.items() if parent in parents}
        found |= parents
    return sum(sum(times[pid][1:]) for pid in found) / TICKS_PER_S


def _times(pid):
    """Its parent; ticks of its own in user and system mode, and of its ended children in both."""
    with open(f"/proc/{pid}/stat", encoding="utf-8", errors="replace") as file:
        fields = file.read().rpartition(")")[2].split()  # after the name, which may hold anything
    return [int(fields[index]) for index in (1, 11, 12, 13, 14)]


def rss_mb(pid: int) -> float:
    """What a process has in memory, MB."""
    return _kb(f"/proc/{pid}/status", "VmRSS:") / 1000


def pss_mb(pid: int) -> float:
    """The same, of what it has together with other processes only its share, MB."""
    return _kb(f"/proc/{pid}/smaps_rollup", "Pss:") / 1000


def _kb(path, key):
    with open(path, encoding="utf-8", errors="replace") as file:
        return next(int(line.split()[1]) for line in file if line.startswith(key))


class IdleMeter:
    """How much of the machine nobody used since this was made."""

    def __init__(self):
        self._before = _machine()

    def percent(self) -> float:
        """Of all cores together; 0 = saturated."""
        idle, total = (now - before for now, before in zip(_machine(), self._before))
        return 100 * idle / max(1, total)


class OthersMeter:
    """What programs that have nothing to do with this run have used since this was made: they disturb it."""

    def __init__(self):
        self._begun_s, self._before_s = time.monotonic(), self._others_s()

    @staticmethod
    def _others_s():
        idle, total = _machine()
        times = os.times()
        ours_s = times.user + times.system + times.children_user + times.children_system + descendants_s()
        return (total - idle) / TICKS_PER_S - ours_s

    def percent(self) -> float:
        """Of one core."""
        return max(0.0, 100 * (self._others_s() - self._before_s) / (time.monotonic() - self._begun_s))


def _machine():
    with open("/proc/stat", encoding="ascii") as file:
        times = [int(field) for field in file.readline().split()[1:9]]
    return times[3] + times[4], sum(times)


def _answers(port):
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0
