"""Waiting for what nodes do: topics and processes as a test sees them. Every wait has a deadline and none is blind."""
from __future__ import annotations

import os
import re
import signal
import subprocess
import threading
import time
from typing import Any, Callable, NamedTuple

import rospkg
import rospy
import yaml
from roslib.packages import find_node
from rosunit import xmlrunner

# rosunit counts a subtest that failed, and its results name none: they would say that every test passed.
_add_subtest = xmlrunner._XMLTestResult.addSubTest


def _add_and_name_subtest(result, test, subtest, error):
    _add_subtest(result, test, subtest, error)
    if error is not None:
        result._failure = (AssertionError, f"{subtest._subDescription()}: {error[1]}", error[2])


xmlrunner._XMLTestResult.addSubTest = _add_and_name_subtest

PACKAGE = rospkg.RosPack().get_path("car_interface")
PATIENCE_S = 90.0  # where others keep both CPUs busy nodes take 20 s to start; else a fraction of it passes
POLL_S = 0.005
# What the doctor finds on a busy computer: it gives up listening, and nodes report for a while that they stood still.
HELD_UP = re.compile("no answer in time: given up|couldn't check|node stood still for|"
                     "runs, but doesn't report on /diagnostics")
BUSY_S = 300.0  # in which a doctor that is run again and again is held up no more
# rospy's words about another process that connected and ended, as /rosout's does with a node that ends at once.
CALLER_GONE = "Inbound TCP/IP connection failed"


class Received(NamedTuple):
    """One message, or one line of a process, and when it arrived on the monotonic clock."""

    at_s: float
    what: Any


class Record:
    """What arrived so far, in order. Grows in another thread."""

    def __init__(self, name: str):
        self.name = name
        self._heard: list[Received] = []
        self._grown = threading.Condition()

    def add(self, what) -> None:
        with self._grown:
            self._heard.append(Received(time.monotonic(), what))
            self._grown.notify_all()

    def mark(self) -> int:
        """The place after the newest, for ``since``."""
        return len(self._heard)

    @property
    def newest(self) -> Any:
        return self._heard[-1].what

    def since(self, mark: int = 0) -> list[Any]:
        return [heard.what for heard in self._heard[mark:]]

    def wait_for(self, wanted: Callable[[Any], bool], since: int = 0, within_s: float = PATIENCE_S) -> Received:
        """The first from ``since`` on that is ``wanted``.

        Raises:
            AssertionError: when none came in time, with what came instead.
        """
        deadline_s = time.monotonic() + within_s
        next_index = since
        with self._grown:
            while True:
                while next_index < len(self._heard):
                    heard = self._heard[next_index]
                    next_index += 1
                    if wanted(heard.what):
                        return heard
                left_s = deadline_s - time.monotonic()
                if left_s <= 0:
                    seen = self._heard[since:]
                    raise AssertionError(
                        f"{self.name}: not within {within_s} s; {len(seen)} others came, "
                        f"the last {[h.what for h in seen[-3:]]}")
                self._grown.wait(left_s)

    def wait_for_count(self, count: int, since: int = 0) -> list[Any]:
        """All from ``since`` on, as soon as there are ``count``."""
        eventually(lambda: len(self._heard) - since >= count, f"{count} on {self.name}")
        return self.since(since)


class Topic(Record):
    """Everything that a topic carried since this was made."""

    def __init__(self, name: str, message_type):
        super().__init__(name)
        self._subscriber = rospy.Subscriber(name, message_type, self.add, tcp_nodelay=True)

    def connected(self) -> Topic:
        """Wait until a node publishes to it."""
        eventually(self._subscriber.get_num_connections, f"a publisher of {self.name}")
        return self

    def close(self) -> None:
        self._subscriber.unregister()


class Sender:
    """Publishes to a topic that has subscribers."""

    def __init__(self, name: str, message_type):
        self._publisher = rospy.Publisher(name, message_type, queue_size=100, tcp_nodelay=True)
        self.publish = self._publisher.publish
        eventually(self._publisher.get_num_connections, f"a subscriber of {name}")

    def close(self) -> None:
        self._publisher.unregister()


class Repeater:
    """Publishes the newest message of several senders over and over: inputs that stay fresh."""

    def __init__(self, period_s: float = 0.05):
        self._period_s = period_s
        self._messages: dict = {}
        self._lock = threading.Lock()
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def hold(self, sender: Sender, message) -> None:
        """Publish a message, or what a function returns, now, and again and again."""
        with self._lock:
            self._messages[sender] = message
            self.send(sender, message() if callable(message) else message)

    def send(self, sender: Sender, message) -> None:
        sender.publish(message)

    def drop(self, *senders: Sender) -> None:
        """Let inputs fall silent; all of them when none is named."""
        with self._lock:
            for sender in senders or list(self._messages):
                self._messages.pop(sender, None)

    def end(self) -> None:
        self._ending.set()
        self._thread.join()

    def _run(self):
        while not self._ending.wait(self._period_s):
            with self._lock:
                for sender, message in self._messages.items():
                    self.send(sender, message() if callable(message) else message)


class NodeProcess:
    """A node, or any program, started by the test. Its output is two records of lines.

    Args:
        command: program and arguments.
        env: what its environment has besides, or in place of, the test's.
    """

    def __init__(self, *command: str, env: dict[str, str] | None = None):
        self.name = " ".join(command)
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            universal_newlines=True, errors="replace", env={**os.environ, **(env or {})})
        self.stdout = Record(f"stdout of {self.name}")
        self.stderr = Record(f"stderr of {self.name}")
        self._readers = [threading.Thread(target=self._read, args=pipe, daemon=True)
                         for pipe in ((self._process.stdout, self.stdout), (self._process.stderr, self.stderr))]
        for reader in self._readers:
            reader.start()

    @staticmethod
    def _read(stream, record):
        with stream:
            for line in stream:
                if CALLER_GONE not in line:
                    record.add(line.rstrip("\n"))

    @property
    def pid(self) -> int:
        return self._process.pid

    def tell(self, line: str) -> None:
        self._process.stdin.write(line + "\n")
        self._process.stdin.flush()

    def send(self, number: int) -> float:
        """Send a signal; the time just before, s."""
        at_s = time.monotonic()
        self._process.send_signal(number)
        return at_s

    def runs(self) -> bool:
        return self._process.poll() is None

    def wait_for_line(self, pattern: str, since: int = 0) -> str:
        """The first line on stderr, from ``since`` on, in which the pattern is found."""
        return self.stderr.wait_for(lambda line: re.search(pattern, line), since).what

    def wait_for_info(self, pattern: str) -> str:
        """The first line on stdout in which the pattern is found; rospy logs up to INFO there."""
        return self.stdout.wait_for(lambda line: re.search(pattern, line)).what

    def wait_for_exit(self, within_s: float = PATIENCE_S) -> int:
        try:
            code = self._process.wait(within_s)
        except subprocess.TimeoutExpired:
            raise AssertionError(f"{self.name} didn't end within {within_s} s") from None
        for reader in self._readers:
            reader.join(within_s)
        self._process.stdin.close()
        return code

    def end(self, number: int = signal.SIGINT, within_s: float = PATIENCE_S) -> int:
        if self.runs():
            self._process.send_signal(number)
        return self.wait_for_exit(within_s)

    def clean_up(self) -> None:
        if self.runs():
            self._process.kill()
        self.wait_for_exit()


def executable(node: str) -> str:
    """The path of one of this package's nodes, as roslaunch finds it."""
    return find_node("car_interface", node)[0]


def config(*names: str) -> dict:
    values: dict = {}
    for name in names:
        with open(os.path.join(PACKAGE, "config", name), encoding="utf-8") as file:
            values.update(yaml.safe_load(file))
    return values


def start_node(test, node: str, *arguments: str, name: str | None = None) -> NodeProcess:
    """Start a node of this package by itself; it ends with the test at the latest."""
    names = [f"__name:={name}"] if name else []
    return start(test, executable(node), *arguments, *names)


def start(test, *command: str) -> NodeProcess:
    """Start a program; it ends with the test at the latest."""
    process = NodeProcess(*command)
    test.addCleanup(process.clean_up)
    return process


def eventually(condition: Callable[[], Any], what: str | Callable[[], str], within_s: float = PATIENCE_S) -> Any:
    """What ``condition`` returns once that is true.

    Args:
        condition: asked over and over.
        what: is waited for; a function is asked for it when time is up.

    Raises:
        AssertionError: when it stayed false until the deadline.
    """
    deadline_s = time.monotonic() + within_s
    while True:
        result = condition()
        if result:
            return result
        if time.monotonic() >= deadline_s:
            raise AssertionError(f"not within {within_s} s: {what() if callable(what) else what}")
        time.sleep(POLL_S)


def examine(*options: str, env: dict[str, str] | None = None, cwd: str | None = None) -> subprocess.CompletedProcess:
    """Run the doctor, again and again while the computer holds it or the nodes up; return the first run that isn't."""
    def examined():
        done = subprocess.run([executable("doctor"), *options], env={**os.environ, **(env or {})}, cwd=cwd, text=True,
                              stdin=subprocess.DEVNULL, capture_output=True, timeout=120, check=False)
        return not HELD_UP.search(done.stdout) and done
    return eventually(examined, "a doctor that isn't held up", BUSY_S)


def skip(test, reason: str) -> None:
    """Skip a test, and note it in the file that $CAR_INTERFACE_SKIPPED names: rosunit's results say that it passed."""
    path = os.environ.get("CAR_INTERFACE_SKIPPED")
    if path:
        with open(path, "a", encoding="utf-8") as file:
            file.write(f"{test.id()}: {reason}\n")
    test.skipTest(reason)


def one_process_params(folder: str, **pca9685) -> dict:
    """The shipped parameters of car_nodes, by node, with a chip in software; a Teensy may be at folder/teensy."""
    return {"turn_arb": config("turn_arb.yaml"),
            "pca9685": {**config("pca9685.yaml"), "steering": config("turn_arb.yaml"), "esc": config("throttle.yaml"),
                        "device": "virtual", **pca9685},
            "teensy_sensor_hub": {**config("teensy_sensor_hub.yaml", "sonars.yaml"),
                                  "port": os.path.join(folder, "teensy")},
            "generic_value_converter": {**config("generic_value_converter.yaml"),
                                        "csv_path_value_map": f"{PACKAGE}/config/value_map.csv"},
            "throttle_arb": config("throttle.yaml")}


def set_params(test, namespace: str, values: dict) -> None:
    for name, value in values.items():
        path = os.path.join(namespace, name)
        rospy.set_param(path, value)
        test.addCleanup(delete_param, path)


def delete_param(path) -> None:
    if rospy.has_param(path):
        rospy.delete_param(path)
