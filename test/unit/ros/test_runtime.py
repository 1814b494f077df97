"""The life of a node in its process: when it starts, what it does with refused parameters, and how it ends."""
import contextlib
import logging
import math
import os
import signal
import sys
from types import SimpleNamespace

import pytest

pytest.importorskip("rospy")

import rospy

from car_interface.common.errors import ConfigError, EndedEarly
from car_interface.common.units import NS_PER_S
from car_interface.ros import runtime
from car_interface.ros.diagnostics import ERROR, OK
from car_interface.ros.runtime import STANDSTILL_NS, Steps, describe_error, read_params

MS = 1_000_000
START = 1000 * 1000 * MS


class Inbox:
    """A node's inbox and clock, which goes on as the node waits."""

    def __init__(self, **parameters):
        self.now_ns, self.ending, self.subscriptions, self.begun_anew, self.waits = 0, False, [], [], []
        self.node_name = "/cars/red/turn_arb"
        self.clocks = SimpleNamespace(now_ns=lambda: self.now_ns, sleep=lambda seconds: self.waits.append("sleep"))
        self.graph = SimpleNamespace(parameter=parameters.get)

    def wait_until(self, due_ns):
        self.waits.append(due_ns)
        assert len(self.waits) < 100
        self.now_ns = max(self.now_ns, due_ns)

    def begin_anew(self, now_ns, still_ns):
        self.begun_anew.append(still_ns)

    def end(self):
        self.ending = True


# --- steps ---

class Node:
    """A node that ends with its third step; the next one is due a second later."""

    def __init__(self, params, inbox):
        self.inbox, self.stepped = inbox, []
        inbox.node = self

    def step(self, now_ns):
        self.stepped.append(now_ns)
        self.inbox.ending = len(self.stepped) == 3
        return now_ns + NS_PER_S

    def shut_down(self):
        self.stepped.append("shut down")


def test_a_node_is_stepped_when_it_is_due_until_it_ends_and_is_shut_down_before_its_last_messages_are_sent():
    inbox = Inbox()
    runtime.spin(Node, inbox, dict)
    assert inbox.node.stepped == [0, NS_PER_S, 2 * NS_PER_S, "shut down"]
    assert inbox.waits == [NS_PER_S, 2 * NS_PER_S, 3 * NS_PER_S, "sleep"]


def test_what_a_node_was_launched_with_is_logged_once_while_its_parameters_are_refused(monkeypatch, reports, caplog):
    monkeypatch.setenv("CAR_INTERFACE_RESPAWN", "1")
    monkeypatch.setattr(runtime, "read_params", lambda *_: SimpleNamespace(launched_with=lambda: "i2c auto"))
    caplog.set_level(logging.INFO)
    inbox = Inbox()
    build = building(REFUSED, REFUSED, Node(None, inbox))
    runtime.spin(lambda params, inbox: build(), inbox, dict)
    assert said(caplog).count("launched with i2c auto") == 1


@pytest.mark.parametrize("still_s, subscriptions, attributes, begins", [
    (3, ["one"], {}, True), (3, ["one"], {"notices_standstill": False}, True), (0, ["one"], {}, False),
    (3, [], {}, False), (3, ["one"], {"notices_standstill": True}, False)],
    ids=["it_does", "it_says_so", "on_time", "without_subscriptions", "it_sees_to_that_itself"])
def test_a_node_that_stood_still_begins_anew(still_s, subscriptions, attributes, begins):
    inbox = Inbox()
    inbox.subscriptions = subscriptions
    steps = Steps(SimpleNamespace(step=lambda now_ns: now_ns, **attributes), inbox)
    inbox.now_ns += still_s * NS_PER_S
    assert steps.step() == inbox.now_ns
    assert inbox.begun_anew == ([3 * NS_PER_S] if begins else [])


def standstills(*steps):
    """For how long, ms, the thread has stood still before each of its steps; 0 = it hasn't.

    Args:
        steps: (waits, lasts, due): ms from the end of the step before to this one's begin, ms that it lasts, and ms
            from its end to when the next one is due.
    """
    inbox, found = Inbox(), []
    inbox.subscriptions, inbox.now_ns = ["one"], START

    def step(now_ns):
        _, lasts, due = steps[len(found)]
        inbox.now_ns += round(lasts * MS)
        return inbox.now_ns + due * MS
    stepped = Steps(SimpleNamespace(step=step), inbox)
    for waits, _, _ in steps:
        inbox.now_ns += round(waits * MS)
        inbox.begun_anew.clear()
        stepped.step()
        found.append(sum(inbox.begun_anew) // MS)
    return found


@pytest.mark.parametrize("steps, expected", [
    ([(0, 0.1, 10)] + [(10, 0.1, 10)] * 99, [0] * 100),
    ([(0, 0.1, 10), (0.2, 0.1, 10), (0, 0.1, 10)], [0, 0, 0]),
    ([(0, 0.1, 10), (3010, 0.1, 10), (10, 0.1, 10)], [0, 3000, 0]),
    ([(0, 0.1, 10), (10, 3000, 10), (0, 0.1, 10), (10, 0.1, 10)], [0, 0, 3000, 0]),
    ([(0, 0.1, 10), (10, 500, 10), (0, 0.1, 10), (10, 0.1, 10)], [0, 0, 500, 0]),
    ([(0, 0.1, 10), (310, 0.1, 10), (10, 300, 10), (310, 0.1, 10)], [0, 0, 0, 0]),
    ([(0, 0.1, 10), (509, 0.1, 10), (510, 0.1, 10)], [0, 0, 500]),
    ([(0, 0.1, 10), (10, 400, 10), (400, 400, 10), (400, 0.1, 10)], [0] * 4),
    ([(0, 0.1, float("inf")), (1000, 0.1, 60_000), (1000, 0.1, 10)], [0, 0, 0]),
    ([(0, 0.1, 60_000), (4000, 0.1, 10)], [0, 3000]),
    ([(0, 0.1, -700), (1, 0.1, -700), (1, 0.1, 10)], [0, 0, 0]),
    ([(700, 0.1, 10)], [700]),
])
def test_a_thread_that_stood_still_is_told_from_a_busy_computer_s_delays(steps, expected):
    assert standstills(*steps) == expected


def test_limit_of_a_standstill_is_the_timeout_of_the_arbiters_inputs():
    from car_interface.interlock.motion_interlock import InterlockConfig
    assert round(InterlockConfig.human_timeout_s * 1e9) == STANDSTILL_NS


def test_parameters_are_the_node_s_and_those_of_the_nearest_namespace_around_it():
    params = read_params(Inbox(**{"/cars/red/turn_arb": {"own": 1}, "/cars/red/near": 2, "/cars/near": 3,
                                  "/cars/far": 4, "/top": 5}), {})
    assert [params.integer(name, 0, search_parents=True) for name in ("own", "near", "far", "top", "none")] == [
        1, 2, 4, 5, 0]


# --- ends ---

def test_the_line_with_which_a_node_ends_names_its_error():
    refused = ConfigError("servo_left", "x", "an integer")
    assert describe_error(refused) == str(refused)
    assert describe_error(MemoryError()).startswith("out of memory: ")
    assert describe_error(ValueError("x")) == "a fault in this node itself (see its log file): ValueError: x"


def test_a_node_that_ros_ends_ends_its_loop():
    inbox = Inbox()
    runtime._end_and_wait(inbox, None)
    assert inbox.ending


def test_a_signal_ends_a_node_unless_it_is_ignored(monkeypatch):
    taken = {}
    monkeypatch.setattr(signal, "getsignal", lambda number: signal.SIG_IGN if number == signal.SIGHUP else None)
    monkeypatch.setattr(signal, "signal", taken.__setitem__)
    runtime._on_end_signals(lambda: "ended")
    assert {number: act(number, None) for number, act in taken.items()} == {
        signal.SIGINT: "ended", signal.SIGTERM: "ended"}


def test_a_node_registers_its_name_without_rospy_s_signals_and_fails_if_it_is_ended_meanwhile(monkeypatch):
    acts, registered = [], []
    monkeypatch.setattr(runtime, "_on_end_signals", acts.append)
    monkeypatch.setattr(runtime, "wait_for_name", lambda name: contextlib.ExitStack())
    monkeypatch.setattr(rospy, "init_node", lambda *name, **how: registered.append((*name, how)))
    runtime._register("turn_arb")
    assert registered == [("turn_arb", {"disable_signals": True})]
    codes = []
    for act in acts:
        with pytest.raises(SystemExit) as ended:
            act()
        codes.append(ended.value.code)
    assert codes == [None, 1]

    def replaced(*_, **__):
        raise rospy.ROSInitException
    monkeypatch.setattr(rospy, "init_node", replaced)
    with pytest.raises(SystemExit) as ended:
        runtime._register("turn_arb")
    assert ended.value.code == 0


class Exited(Exception):
    """With an exit code, and whether it was at once, without Python's own exit."""


@pytest.fixture
def run(monkeypatch):
    """Run a process around a spin; return its exit code, whether it left at once, and what it called before."""
    calls = []

    def called(name, result=None):
        return lambda *args, **_: calls.append((name, *args)) or result

    def run_with(spin, is_flushed=True):
        def leave(code):
            raise Exited(code, True)
        for owner, name, value in (
                (runtime, "keep_tracebacks_from_terminal", called("tracebacks")), (runtime, "Inbox", Inbox),
                (runtime, "send_directly", called("directly")), (runtime, "limit_connections", lambda: "no limits"),
                (runtime, "_register", called("register")), (runtime, "_keep_rosout_parameter", called("rosout")),
                (runtime, "LogThreads", lambda: SimpleNamespace(flush=lambda within_s: is_flushed)),
                (runtime, "_on_end_signals", called("signals")), (runtime, "spin", spin), (os, "_exit", leave),
                (runtime, "gc", SimpleNamespace(collect=dict, freeze=dict)), (logging, "raiseExceptions", True),
                (rospy, "on_shutdown", called("on_shutdown")), (rospy, "logwarn", called("warn")),
                (rospy, "logfatal", called("fatal")), (rospy, "signal_shutdown", called("shutdown")),
                (rospy.core, "add_shutdown_hook", lambda hook: hook("")), (sys, "setswitchinterval", called("switch")),
                (sys, "stdout", sys.stdout), (sys, "stderr", sys.stderr)):
            monkeypatch.setattr(owner, name, value)
        with pytest.raises((SystemExit, Exited)) as ended:
            runtime.run("turn_arb", Node)
        assert not logging.raiseExceptions  # a full disk ends no node
        return (*ended.value.args, False)[:2], calls
    return run_with


def raising(error):
    def spin(*_):
        raise error
    return spin


@pytest.mark.parametrize("is_flushed", [True, False])
@pytest.mark.parametrize("spin, code, line", [
    (lambda *_: None, 0, None), (raising(EndedEarly("no gamepad")), 1, "warn"), (raising(ValueError("x")), 1, "fatal")])
def test_a_process_ends_with_code_1_after_an_error_and_at_once_if_its_log_hangs(run, spin, code, line, is_flushed):
    exit_, calls = run(spin, is_flushed)
    assert exit_ == (code, not is_flushed)
    names = [name for name, *_ in calls]
    assert names[:4] == ["tracebacks", "directly", "register", "warn"] and calls[3][2] == "no limits"
    assert names[-2:] == ([line] if line else [names[-2]]) + ["shutdown"]


# --- refused parameters ---

@pytest.fixture
def reports(monkeypatch):
    """What the node's diagnostics report, each time that it does so at once."""
    forced = []

    class Diagnostics:
        due_ns = math.inf

        def __init__(self, inbox, hardware_id, functions, now_ns):
            self.report, = functions.values()
            forced.append(self)

        def step(self, now_ns):
            self.force()

        def force(self):
            status = SimpleNamespace(values={})
            status.summary = lambda level, message: vars(status).update(level=level, message=message)
            status.add = status.values.__setitem__
            self.report(status)
            forced.append(status)
    monkeypatch.setattr(runtime, "Diagnostics", Diagnostics)
    return forced


def building(*outcomes):
    """A function that builds a node as these say: raises them, or returns one."""
    waiting = list(outcomes)

    def build():
        outcome = waiting.pop(0)
        if isinstance(outcome, Exception):
            raise outcome
        return outcome
    return build


REFUSED = ConfigError("servo_left", "x", "an integer")


@pytest.mark.parametrize("value, is_it", [("1", True), ("true", True), ("True", True), ("0", False), ("", False)])
def test_the_launch_file_says_whether_roslaunch_starts_a_node_again(monkeypatch, value, is_it):
    monkeypatch.setenv("CAR_INTERFACE_RESPAWN", value)
    assert runtime.is_respawned() is is_it


@pytest.mark.parametrize("error", [REFUSED, OSError("no master")])
def test_a_node_that_nobody_starts_again_ends_with_its_error(monkeypatch, reports, error):
    monkeypatch.delenv("CAR_INTERFACE_RESPAWN", raising=False)
    assert runtime.build_node(building("node"), Inbox()) == "node"
    with pytest.raises(type(error)):
        runtime.build_node(building(error, "node"), Inbox())
    assert reports == []


def test_a_node_that_is_started_again_reads_its_parameters_until_they_are_accepted(monkeypatch, reports, caplog):
    monkeypatch.setenv("CAR_INTERFACE_RESPAWN", "1")
    inbox = Inbox()
    caplog.set_level(logging.INFO)
    assert runtime.build_node(building(REFUSED, OSError("no master"), "node"), inbox) == "node"
    assert inbox.waits == [NS_PER_S, 3 * NS_PER_S]
    _, first, second, last = reports
    assert (first.level, first.values) == (second.level, second.values) == (
        ERROR, {"cause": "parameter refused", "parameter": "servo_left"})
    assert (last.level, last.message, last.values) == (OK, "accepted", {})
    assert [line[:25] for line in said(caplog)] == ["servo_left is 'x'; accept", "the parameters are accept"]


def said(caplog):
    return [record.getMessage() for record in caplog.records if record.name == "rosout"]


def pauses_of(inbox):
    return [(until - since) // NS_PER_S for since, until in zip([0, *inbox.waits], inbox.waits)]


def test_pauses_grow_from_one_second_to_thirty_and_the_line_that_says_so_comes_at_once_and_after_five_minutes(
        monkeypatch, reports, caplog):
    monkeypatch.setenv("CAR_INTERFACE_RESPAWN", "1")
    inbox = Inbox()
    runtime.build_node(building(*[REFUSED] * 14, "node"), inbox)
    assert pauses_of(inbox) == [1, 2, 4, 8, 16, *[30] * 9]
    assert said(caplog) == [f"{REFUSED}. This node waits, and reads its parameters again in 1 s, later every 30 s"]
    runtime.build_node(building(*[REFUSED] * 16, "node"), Inbox())
    assert said(caplog)[2:] == [f"{REFUSED}. This node waits, and reads its parameters again in 30 s"]


def test_new_reason_is_logged_at_once_and_the_pauses_begin_again(monkeypatch, reports, caplog):
    monkeypatch.setenv("CAR_INTERFACE_RESPAWN", "1")
    inbox, missing = Inbox(), ConfigError("servo_right", None, "an integer")
    runtime.build_node(building(*[REFUSED] * 5, missing, missing, "node"), inbox)
    assert pauses_of(inbox) == [1, 2, 4, 8, 16, 1, 2]
    assert [line.split(";")[0] for line in said(caplog)] == ["servo_left is 'x'", "servo_right is missing"]


def test_a_node_that_is_ended_while_it_waits_for_better_parameters_is_not_built(monkeypatch, reports):
    monkeypatch.setenv("CAR_INTERFACE_RESPAWN", "1")
    inbox = Inbox()

    def end(due_ns):
        inbox.waits.append(due_ns)
        inbox.ending = True
    inbox.wait_until = end
    assert runtime.build_node(building(REFUSED), inbox) is None and len(inbox.waits) == 1
