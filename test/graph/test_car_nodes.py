"""Several nodes in one process: which there are, what becomes of one that ends, and how all of them end.

Here a node's run is the test's; test/process/parameters.test has the real ones.
"""
import logging
import queue
import threading
from functools import partial

import pytest

from car_interface.common.errors import CarInterfaceError
from car_interface.common.params import Params
from car_interface.nodes import car_nodes
from car_interface.nodes.car_nodes import CarNodes

MS, S = 1_000_000, 1_000_000_000
WITHIN_S = 30
ALWAYS = ["generic_value_converter", "pca9685", "teensy_sensor_hub", "turn_arb"]


class Clocks:
    """A clock of the test's. Joining a thread takes as long as the test says, or all the time that there is."""

    def __init__(self):
        self.time_ns, self.joins_s = 0, {}
        self.waits_s = []

    def now_ns(self):
        return self.time_ns

    def wait_for(self, condition, within_s, poll_s):
        self.waits_s.append(within_s)
        self.time_ns += round(self.joins_s.get(len(self.waits_s), 0.0) * S)
        return len(self.waits_s) not in self.joins_s or self.joins_s[len(self.waits_s)] < within_s


class Inbox:
    """Of a node: it ends when it is told to. Of the process: it runs what was put when it is dispatched."""

    def __init__(self, name, clocks):
        self.name, self.clocks = name, clocks
        self.is_closed, self._ended, self._items = False, threading.Event(), queue.Queue()

    def end(self):
        self._ended.set()

    def wait(self):
        assert self._ended.wait(WITHIN_S)

    def close(self):
        self.is_closed = True

    def put(self, handler, item):
        self._items.put((handler, item))

    def dispatch(self):
        while not self._items.empty():
            handler, item = self._items.get()
            handler(item, self.clocks.time_ns)

    def await_item(self):
        item = self._items.get(timeout=WITHIN_S)
        self._items.put(item)


class Process:
    """car_nodes with runs that are the test's: ``runs`` says by name what a node does once it is built."""

    def __init__(self, monkeypatch, **parameters):
        self.clocks, self.inboxes, self.built, self.runs, self.log = Clocks(), [], queue.Queue(), {}, []
        monkeypatch.setattr(car_nodes, "Inbox", self._inbox)
        monkeypatch.setattr(car_nodes, "spin", self._spin)
        monkeypatch.setattr(car_nodes, "fixed_parameters", lambda name, arguments, process: {"of": (name, process)})
        monkeypatch.setattr(car_nodes, "NODES", {name: partial(self._build, name) for name in car_nodes.NODES})
        monkeypatch.setattr(car_nodes.rospy, "logfatal", lambda text, *values: self.log.append(text % values))
        self.inbox, self._parameters = Inbox("car_nodes", self.clocks), parameters

    def start(self):
        self.nodes = CarNodes(Params(self._parameters), self.inbox)
        count = 4 + sum(bool(value) for value in self._parameters.values())
        return self.started(count)

    def started(self, count):
        return sorted(self.built.get(timeout=WITHIN_S) for _ in range(count))

    def _inbox(self, name):
        self.inboxes.append(Inbox(name, self.clocks))
        return self.inboxes[-1]

    def _build(self, name, params, inbox):
        assert inbox.name.endswith(f"/{name}")
        if name in self.runs and self.runs[name][0] == "build":
            self.built.put(name)
            raise self.runs.pop(name)[1]
        return name, inbox

    def _spin(self, build, inbox, read_fixed):
        name, own_inbox = build(None, inbox)
        assert own_inbox is inbox and read_fixed() == {"of": (name, "car_nodes")}
        self.built.put(name)
        if name in self.runs:
            _, error = self.runs.pop(name)
            if error is not None:
                raise error
        else:
            inbox.wait()

    def step(self, time_ns):
        self.clocks.time_ns = time_ns
        return self.nodes.step(time_ns)


@pytest.fixture
def process(monkeypatch):
    process = Process(monkeypatch)
    yield process
    for inbox in process.inboxes:
        inbox.end()
    for thread in threading.enumerate():
        if thread.name in car_nodes.NODES:
            thread.join(WITHIN_S)
    logging.getLogger("rosout").removeFilter(car_nodes._name_part)


@pytest.mark.parametrize("parameters, more", [
    ({}, []), ({"throttle": False, "planner": False}, []), ({"throttle": True}, ["throttle_arb"]),
    ({"planner": True}, ["planner_interface"]), ({"throttle": True, "planner": True},
                                                 ["planner_interface", "throttle_arb"])])
def test_throttle_and_planner_are_on_request(process, parameters, more):
    process._parameters = parameters
    assert process.start() == sorted(ALWAYS + more)
    threads = [each for each in threading.enumerate() if each.name in ALWAYS + more]
    assert len(threads) == len(ALWAYS + more) and all(each.daemon for each in threads)


@pytest.mark.parametrize("error, text", [
    (None, "it ended"), (RuntimeError("broken"), "RuntimeError: broken"), (CarInterfaceError("no chip"), "no chip")])
def test_a_node_that_ends_once_it_has_started_is_closed_and_started_again_after_a_second(process, error, text):
    process.runs["turn_arb"] = ("run", error)
    process.start()
    process.inbox.await_item()
    assert process.step(5 * S) == 6 * S
    assert len(process.log) == 1 and process.log[0].startswith("turn_arb: ") and text in process.log[0]
    assert [inbox.name[-8:] for inbox in process.inboxes if inbox.is_closed] == ["turn_arb"]
    assert process.step(6 * S - 1) == 6 * S and len(process.inboxes) == 4
    assert process.step(6 * S) == float("inf")
    assert process.started(1) == ["turn_arb"] and len(process.inboxes) == 5


def test_a_parameter_that_is_refused_at_the_first_start_ends_the_process_and_later_it_does_not(process):
    process.runs["turn_arb"] = ("build", CarInterfaceError("servo_min is 9"))
    process.start()
    process.inbox.await_item()
    with pytest.raises(CarInterfaceError, match=r"^turn_arb: servo_min is 9$"):
        process.step(0)


def test_a_parameter_that_is_refused_at_a_later_start_only_delays_the_node(process):
    process.runs["turn_arb"] = ("run", None)
    process.start()
    process.inbox.await_item()
    process.step(0)
    process.runs["turn_arb"] = ("build", CarInterfaceError("servo_min is 9"))
    process.step(S)
    assert process.started(1) == ["turn_arb"]
    process.inbox.await_item()
    assert process.step(2 * S) == 3 * S


def test_an_error_in_a_first_start_that_is_nobody_s_parameter_delays_the_node(process):
    process.runs["turn_arb"] = ("build", RuntimeError("broken"))
    process.start()
    process.inbox.await_item()
    assert process.step(0) == S


def test_all_end_together_and_have_five_seconds_in_all(process):
    process.start()
    process.clocks.joins_s = {1: 2.0, 2: 0.5}
    process.nodes.shut_down()
    assert process.clocks.waits_s == [5.0, 3.0, 2.5, 2.5]
    assert not any(inbox.is_closed for inbox in process.inboxes)  # rospy does that


def test_a_node_that_hangs_is_named_and_one_that_waits_for_its_restart_is_not(process):
    process.runs["pca9685"] = ("run", RuntimeError("broken"))
    process.start()
    process.inbox.await_item()
    process.step(0)
    process.clocks.joins_s = {1: 6.0}
    with pytest.raises(CarInterfaceError, match=r"^turn_arb: it hangs and can't be shut down$"):
        process.nodes.shut_down()


def test_each_line_of_the_log_names_its_node(process):
    process.start()
    logger, lines = logging.getLogger("rosout"), []
    handler = logging.Handler()
    handler.emit = lambda record: lines.append(record.getMessage())
    logger.addHandler(handler)
    try:
        for name in ("turn_arb", "MainThread"):
            logger.handle(logging.LogRecord("rosout", logging.ERROR, "", 0, "said %s", ("this",), None))
            record = logging.LogRecord("rosout", logging.ERROR, "", 0, "said %s", ("this",), None)
            record.threadName = name
            logger.handle(record)
    finally:
        logger.removeHandler(handler)
    assert lines == ["said this", "turn_arb: said this", "said this", "said this"]
