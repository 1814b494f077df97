"""What waits for a node's thread, and what becomes of the node when that is too much: all that was heard is lost."""
import logging
import math
import re
import threading
import time

import pytest
import rospy
from car_interface.msg import Float64Stamped, SteeringState, TeleopState, ThrottleState
from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_updater import DiagnosticStatusWrapper
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Joy, Temperature
from std_msgs.msg import Bool, Float32, Int32MultiArray

from car import Car
from car_interface.common.causes import INHIBITS
from car_interface.ros.inbox import Inbox
from car_interface.teensy.sensing.measurements import Measurements
from graph import NodeClocks, TopicPublisher
from inputs import control, odometry

LIMIT = 20  # of the inboxes in here
LEFT, CENTER = 3800, 5100
ESC_NEUTRAL, ESC_FULL = 4915, 6554


class Queue:
    """An inbox for 5 items, and what a node's thread took out of it."""

    def __init__(self):
        self.inbox = Inbox(limit=5)
        self.taken = []
        self.inbox.on_overflow(lambda now_ns: self.taken.append("overflow"))

    def put(self, *items):
        for item in items:
            self.inbox.put(lambda item, now_ns: self.taken.append(item), item)

    def take(self):
        self.inbox.dispatch()
        return self.taken

    @property
    def level(self):
        status = DiagnosticStatusWrapper()
        self.inbox.report(status)
        return status.level


@pytest.fixture
def queue():
    return Queue()


def test_inbox_that_is_full_has_lost_nothing(queue):
    queue.put(*range(5))
    assert queue.take() == [0, 1, 2, 3, 4]
    assert queue.inbox.dropped == 0 and queue.level == DiagnosticStatus.OK


@pytest.mark.parametrize("count", [6, 10, 100])
def test_inbox_that_overflows_drops_all_that_waits_says_so_once_and_goes_on_with_what_is_newer(queue, graph, count):
    queue.put(*range(count))
    taken = list(queue.take())
    assert taken == ["overflow", *range(count - len(taken) + 1, count)] and len(taken) <= 5
    assert queue.inbox.dropped == count - len(taken) + 1  # each item once
    assert queue.level == DiagnosticStatus.ERROR
    queue.put("more")
    assert queue.take() == [*taken, "more"]
    queue.put(*range(6))
    queue.take()
    line, = graph.lines(level=logging.ERROR)  # at most every ten seconds
    assert re.fullmatch(r"the inbox of this node overflowed: messages were dropped, \d+ in all; all that was heard "
                        "before counts as lost", line)


def test_request_that_is_dropped_is_answered_with_an_error(queue):
    answers = []

    def ask():
        with pytest.raises(rospy.ServiceException) as error:
            queue.inbox.ask(lambda request, done: done.set_result(request), "request")
        answers.append(str(error.value))
    thread = threading.Thread(target=ask, daemon=True)
    thread.start()
    while not queue.inbox._items:
        time.sleep(0.001)
    queue.put(*range(5))
    thread.join(30)
    assert answers == ["the node was held up for too long: messages were dropped, and this request with them"]
    assert queue.take() == ["overflow", 4]


def test_result_of_work_is_handled_after_an_overflow_too(queue):
    queue.inbox.work(lambda: "result", lambda item, now_ns: queue.taken.append(item))
    while not queue.inbox._items:
        time.sleep(0.001)
    queue.put(*range(5))
    assert queue.take() == ["overflow", 4, "result"]


def test_items_of_several_threads_are_taken_or_counted(queue):
    threads = [threading.Thread(target=lambda: queue.put(*range(2000))) for _ in range(3)]
    for thread in threads:
        thread.start()
    while any(thread.is_alive() for thread in threads):
        queue.take()
    queue.take()
    assert sum(item != "overflow" for item in queue.taken) + queue.inbox.dropped == 6000


# --- nodes whose inboxes overflow: each stops with the messages that it couldn't take ---

class SmallCar(Car):

    def __init__(self):
        super().__init__()
        self.graph.record("/servo/cmdVector", "/teleop_logi/human_in_loop", "/generic/output/value",
                          "/generic_value_converter/state")
        add = self.graph.add
        self.graph.add = lambda *arguments: add(*arguments, inbox_limit=LIMIT)

    def send(self, topic, *messages):
        for message in messages:
            self.graph.publish(topic, message)
        self.graph.run(0.02)

    def flood(self, topic, message):
        """More than the inbox holds; then the node's thread has its turn."""
        self.graph.flood(topic, message, LIMIT + 1)
        self.graph.run(0.02)

    def deadman(self, *held):
        self.send("/teleop_logi/human_in_loop", *map(Bool, held))

    @property
    def command(self):
        return self.graph.newest("/servo/cmdVector").data


@pytest.fixture
def small():
    return SmallCar()


def test_turn_arb_that_loses_messages_centers_until_the_deadman_was_let_go(small):
    small.turn_arb(grant_at_start=True, e_stop_timeout=0, input_timeout=0)
    small.send("/teleop_logi/tele_steer_req", Float32(1.0))
    small.deadman(True)
    assert small.command[0] == LEFT
    flooded_ns = small.graph.now_ns
    small.flood("/av_turnrad_req", Float32(5.0))
    assert CENTER in [record.message.data[0] for record in small.graph.recorded["/servo/cmdVector"]
                      if record.at_ns == flooded_ns]
    since_ns = small.graph.now_ns + 1
    small.send("/teleop_logi/tele_steer_req", Float32(0.9))
    small.deadman(True)
    small.graph.run(2.0)
    assert {vector.data[0] for vector in small.graph.messages("/servo/cmdVector", since_ns)} == {CENTER}
    report = small.graph.report("turn_arb: steering")
    assert report.level == DiagnosticStatus.ERROR and "the inbox of this node overflowed" in report.message
    assert int(report.values["messages dropped by its inbox"]) >= LIMIT
    small.deadman(False, True)
    assert small.command[0] == 3930


def test_throttle_arb_that_loses_messages_has_the_esc_at_neutral_until_the_deadman_was_let_go(small):
    small.throttle_arb(grant_at_start=True, e_stop_timeout=0, human_timeout=0, steering_timeout=0, command_timeout=0,
                       odometry_timeout=0, output_required=False)

    def all_heard(*deadman):
        small.send("/turn_arb/state", SteeringState(source=SteeringState.TELEOP))
        small.send("/odom", Odometry())
        small.send("/generic/output/value", Float64Stamped(data=100.0))
        small.deadman(*deadman)
    all_heard(False, True)
    small.graph.run(2.0)
    assert small.command[1] == ESC_FULL
    small.flood("/odom", Odometry())
    assert small.command[1] == ESC_NEUTRAL
    all_heard(True)
    small.graph.run(2.0)
    assert small.command[1] == ESC_NEUTRAL
    all_heard(False, True)
    assert small.command[1] == ESC_FULL


def pressed(button):
    return Joy(axes=[0.0] * 8, buttons=[0] * 4 + [button] + [0] * 6)


def test_teleop_logi_that_loses_messages_holds_nothing_until_all_deadmen_were_let_go(small):
    small.teleop(joy_timeout=3600)
    small.send("/joy", pressed(0), pressed(1))

    def holds():
        return small.graph.newest("/teleop_logi/human_in_loop").data
    assert holds()
    small.flood("/joy", pressed(1))
    assert not holds()
    small.send("/joy", pressed(0), pressed(1))
    assert holds()


def test_pca9685_that_loses_messages_has_each_channel_at_its_timeout_value_until_a_new_command(small):
    small.pca9685(timeout=0)
    left = Int32MultiArray(data=[LEFT] + [-1] * 15)
    small.send("/servo/cmdVector", left)
    assert small.graph.newest("/servo/output").data[0] == 3808
    small.flood("/command", Int32MultiArray(data=[-1] * 15 + [9600]))
    output = small.graph.newest("/servo/output").data
    assert (output[0], output[15]) == (5104, 9600)
    small.send("/servo/cmdVector", left)
    assert small.graph.newest("/servo/output").data[0] == 3808


def test_turn_arb_that_loses_messages_no_longer_knows_how_the_car_turned(small):
    small.turn_arb()
    small.graph.hold("/odom", odometry(1.0, 0.5), 20)
    for lost, turn in ((False, "2.00 m"), (True, "nan m")):
        small.graph.run(1.0)
        small.flood("/av_steer_req" if lost else "/elsewhere", Float32(0.0))
        since_ns = small.graph.now_ns
        small.graph.run(1.0)
        reports = [status for array in small.graph.messages("/diagnostics", since_ns) for status in array.status
                   if status.name == "turn_arb: steering by the wheels"]
        assert {pair.value for pair in reports[0].values if pair.key == "estimated_turn_radius"} == {turn}


def test_teensy_sensor_hub_that_loses_messages_no_longer_knows_the_commanded_turn(small, monkeypatch):
    steered = []
    monkeypatch.setattr(Measurements, "steer", lambda self, curvature_per_m: steered.append(curvature_per_m))
    small.hub(use_steering=True)
    small.send("/turn_arb/state", SteeringState(turn_radius=2.0))
    assert steered == [0.5]
    small.flood("/temperature", Temperature(temperature=20.0))
    assert math.isnan(steered[-1])


# --- messages that can wait for the next tick ---

WAITING = {
    "turn_arb": {"/odom": Odometry(), "/teleop_logi/state": TeleopState()},
    "throttle_arb": {"/servo/output": Int32MultiArray(data=[0] * 16), "/teleop_logi/state": TeleopState()},
    "planner_interface": {"/odom": Odometry(), "/throttle_arb/state": ThrottleState(),
                          "/turn_arb/state": SteeringState()},
    "converter": {"/odom": Odometry()}}


@pytest.mark.parametrize("name", WAITING)
def test_message_that_nothing_depends_on_at_once_wakes_nobody(car, name):
    node, counts = getattr(car, name)(), []
    for messages in ({}, WAITING[name]):
        for topic, message in messages.items():
            car.graph.hold(topic, message, 40, phase_s=0.0041)
        car.graph.run(2.0)
        before = node.turns
        car.graph.run(1.0)
        counts.append(node.turns - before)
    assert counts[1] - counts[0] < 10


# --- nodes that stood still ---

MEANWHILE = (False, False, False, True, True, True, False)  # the deadman is released and held again, and released


DRIVES = {3830}, {5412}  # 2 m to the left; 1 m/s² at 1 m/s by the map
STANDS = {CENTER}, {ESC_NEUTRAL}


class FrozenCar:
    """A car that a planner drives, whose processes are frozen."""

    NODES = ("turn_arb", "converter", "throttle_arb", "pca9685")

    def __init__(self, e_stop_is_latched=False, **arbiters):
        self.car = Car()
        self.graph = self.car.graph
        self.graph.record("/servo/cmdVector")
        for name in self.NODES:
            getattr(self.car, name)(**arbiters if name.endswith("_arb") else {})
        self.e_stop = TopicPublisher(self.graph, "/lock", "/e_stop", Bool, e_stop_is_latched, NodeClocks(self.graph))
        self.e_stop.publish(Bool(False))
        for topic, message in (("/av_turnrad_req", Float32(2.0)), ("/control/command/control_cmd", control(1.0)),
                               ("/odom", odometry(1.0)), *([] if e_stop_is_latched else [("/e_stop", Bool(False))])):
            self.graph.hold(topic, message, 50)
        self.arm()

    def arm(self):
        """Let go and hold again: it drives."""
        for held, lasts_s in ((False, 1.1), (True, 0.6)):
            self.graph.hold("/teleop_logi/human_in_loop", Bool(held), 50)
            self.graph.run(lasts_s)
        assert self.duties(self.graph.now_ns - 50_000_000) == DRIVES

    def duties(self, since_ns):
        return tuple({vector.data[channel] for vector in self.graph.messages("/servo/cmdVector", since_ns)} - {-1}
                     for channel in (0, 1))

    def freeze(self, seconds, *names, meanwhile=MEANWHILE, after_step=False):
        """Freeze processes; in the middle of it the human does something. Return when they went on."""
        for name in names:
            self.graph.nodes[f"/{name}"].stall(seconds, frozen=True, after_step=after_step)
        self.graph.run(seconds / 2)
        if meanwhile and not meanwhile[-1]:
            self.graph.silence("/teleop_logi/human_in_loop")
        for held in meanwhile:
            self.graph.publish("/teleop_logi/human_in_loop", Bool(held))
        self.graph.run(seconds / 2 - 1e-9)
        return self.graph.now_ns


ALL = ("turn_arb", "generic_value_converter", "throttle_arb", "pca9685")


@pytest.mark.once
@pytest.mark.parametrize("seconds, after_step", [(0.55, False), (1.5, True)])
@pytest.mark.parametrize("names, duties", [(("turn_arb",), STANDS), (("throttle_arb",), (DRIVES[0], STANDS[1])),
                                           (ALL, STANDS)], ids=["turn_arb", "throttle_arb", "all"])
def test_node_that_was_frozen_obeys_nothing_that_was_sent_meanwhile(names, duties, seconds, after_step):
    frozen = FrozenCar()
    graph = frozen.graph
    since_ns = frozen.freeze(seconds, *names, after_step=after_step,
                             meanwhile=(False, True) if duties[0] == DRIVES[0] else MEANWHILE)
    graph.run(1.2)
    assert frozen.duties(since_ns + 1) == duties
    for name in names:  # but the converter, which acts once a second
        stood_still = [line.startswith("node stood still for ") for line in graph.lines(f"/{name}", since_ns)]
        assert any(stood_still) or "converter" in name and seconds < 1, name
    if "turn_arb" in names:
        states = graph.messages("/turn_arb/state", since_ns)
        assert {state.cause for state in states} <= INHIBITS
        assert re.fullmatch(r"node stood still for \d\.\d\d s: what was sent meanwhile is dropped; what is sent from "
                            "now on counts", graph.lines("/turn_arb", since_ns, logging.WARNING)[0])
        assert any("messages were dropped" in state.reason for state in states)
    report = graph.report(f"{names[0]}: {'steering' if names[0] == 'turn_arb' else 'throttle'}", since_ns)
    assert report.level >= DiagnosticStatus.WARN and "node stood still for" in report.message
    assert int(report.values["messages dropped after it stood still"]) > 0
    frozen.arm()


def test_delays_of_a_busy_computer_change_nothing():
    frozen = FrozenCar()
    for seconds in (0.25, 0.45, 0.45):
        since_ns = frozen.freeze(seconds, "turn_arb", meanwhile=())
        frozen.graph.run(0.3)
        assert CENTER not in frozen.duties(since_ns)[0]
    assert frozen.graph.lines("/turn_arb", since_ns - 10 ** 10, logging.WARNING) == []


def test_e_stop_that_is_latched_and_sent_once_still_counts_after_a_standstill():
    frozen = FrozenCar(e_stop_is_latched=True, e_stop_timeout=0)
    frozen.freeze(3.0, "turn_arb")
    frozen.arm()
    frozen.e_stop.publish(Bool(True))
    frozen.graph.run(0.0)
    assert frozen.graph.newest("/servo/cmdVector").data[0] == CENTER
