"""From each fault to the servo at its center and the ESC at neutral: exactly, in each phase of the nodes' timers.

The bounds are those of the table in docs/safety.md. Each fault is made twice: with messages that take no time, and with
20 ms for each input and each command on its way, which come on top of the bounds.
"""
from __future__ import annotations

import math
import os
import re
from pathlib import Path
from typing import Any, Callable, Iterable, NamedTuple

import pytest
from sensor_msgs.msg import Joy
from std_msgs.msg import Bool, Float32, String

from car import CENTER, ESC_NEUTRAL, LEFT, MANUAL, RIGHT, Car
from car_interface.common.causes import MANUAL as BY_HUMAN
from inputs import control, odometry

SAFETY = Path(__file__).resolve().parents[2] / "docs" / "safety.md"
MS = 1_000_000
NEUTRALS = (CENTER, ESC_NEUTRAL)
HOP_S = 0.02  # a multiple of the nodes' periods of 10 and 20 ms: it leaves the phases as they are
CONTINUES = "continues"  # of a channel, in the page's table
HOUR_NS = 3600 * 1000 * MS
# Of the moment of a fault, ns: at, just after and just before a tick of turn_arb, and of throttle_arb or teleop_logi.
PHASES = (0, 1, 10 * MS - 1, 20 * MS - 1) + (7 * MS, 10 * MS) * bool(os.environ.get("CAR_INTERFACE_ALL"))


def joy(stick):
    """Both sticks with the manual deadman; 0 = all released."""
    return Joy(axes=[stick, 0.0, 0.0, 0.0, stick, 0.0], buttons=[int(index == MANUAL and stick != 0)
                                                                 for index in range(11)])


INPUTS: dict[str, tuple[str, Callable]] = {
    "human": ("/teleop_logi/human_in_loop", Bool),
    "e_stop": ("/e_stop", Bool),
    "steering": ("/teleop_logi/tele_steer_req", Float32),
    "throttle": ("/teleop_logi/tele_throt_req", Float32),
    "mode": ("/teleop_logi/mode", String),
    "radius": ("/av_turnrad_req", Float32),
    "acceleration": ("/control/command/control_cmd", control),
    "odometry": ("/odom", odometry),
    "joy": ("/joy", joy)}
HELD = {"human": True, "joy": 1.0, "throttle": 1.0}
PLANNER = {"acceleration": 1.0, "odometry": 1.0}
BY_RADIUS = {"human": False, "e_stop": False, "radius": 1.0, **PLANNER}
STEERED = {"human": False, "e_stop": False, "steering": 1.0, **PLANNER}  # by hand, with the planner's throttle
BY_HAND = {"human": False, "steering": 1.0, "throttle": 1.0, "mode": BY_HUMAN}
BY_GAMEPAD = {"joy": 0.0, **PLANNER}


class Chain:
    """The nodes between the inputs and the board, and the inputs, each at 50 Hz by a sender of its own.

    Args:
        values: of the inputs, by name.
        hop_s: how long each input and each command takes. turn_arb's state takes no time.
    """

    def __init__(self, values: dict[str, Any], hop_s: float = 0.0, **pca9685: Any):
        self.car = Car()
        self.graph, self.board = self.car.graph, self.car.board
        self.inputs, self.values = values, dict(values)
        for topic, _ in INPUTS.values():
            self.graph.link(topic, delay_s=hop_s)
        for topic in ("/servo/cmdVector", "/generic/output/value", "/generic_value_converter/state"):
            self.graph.link(topic, delay_s=hop_s)
        self.board.guard_delay_s = hop_s
        self.car.pca9685(guard=True, **pca9685)
        for start in (self.car.turn_arb, self.car.converter, self.car.throttle_arb):
            start()
        if "joy" in values:
            self.car.teleop()
        self.graph.record("/servo/cmdVector", "/generic/output/value", *(topic for topic, _ in INPUTS.values()))
        for name in INPUTS:
            self.graph.repeat_each(0.02, lambda name=name: name in self.values and self.send(name))
        self.run(1.1)
        self.drive()

    def run(self, duration_s: float) -> None:
        self.graph.run(duration_s)

    def send(self, name: str, *value: Any) -> int:
        """Publish an input's value, a new one if given; return when."""
        if value:
            self.values[name], = value
        topic, make = INPUTS[name]
        self.graph.publish(topic, make(self.values[name]), f"/{name}_node")
        return self.graph.now_ns

    def node(self, name: str) -> Any:
        return self.graph.nodes[f"/{name}"]

    def drive(self) -> None:
        """Release the deadman and hold it: the car drives to the left."""
        deadman = "joy" if "joy" in self.inputs else "human"
        released = {name: type(self.inputs[name])() for name in ("throttle", deadman) if name in self.inputs}
        for name, value in released.items():
            self.send(name, value)
        self.run(0.3)
        for name in released:
            self.send(name, HELD[name])
        self.graph.run_until(lambda: self.drives, 3.0)
        self.run(0.001)  # what changes from now on is not the start's

    def recover(self) -> None:
        """Start again what was killed, and have every input as it was, with the deadman held."""
        self.values.update(self.inputs)
        self.values.update({name: held for name, held in HELD.items() if name in self.inputs})
        for node in self.graph.nodes.values():
            if not node.is_alive:
                node.start()
            self.graph.run_to(max(self.graph.now_ns, node.stalled_until_ns))
        self.run(0.1)

    @property
    def drives(self) -> bool:
        return self.board.counts[0] == LEFT and self.board.counts[1] > ESC_NEUTRAL

    def go_to(self, phase_ns: int) -> int:
        """Let time go on to a phase of the nodes that have run from the beginning; return when that is."""
        self.graph.run_to(self.graph.now_ns + (phase_ns - self.graph.now_ns) % (100 * MS))
        return self.graph.now_ns

    def after_message(self, topic: str, sender: str, offset_ns: int) -> int:
        """Let time go on to some time after the next message of a node; return when that is."""
        records = self.graph.recorded[topic]
        count = len(records)
        self.graph.run_until(lambda: any(each.sender == f"/{sender}" for each in records[count:]))
        self.graph.run_to(self.graph.now_ns + offset_ns)
        return self.graph.now_ns

    def neutral_ms(self, since_ns: int, stops: Iterable[int]) -> dict[int, float]:
        """Return after how long each channel was at its neutral."""
        found = {}
        for channel in stops:
            neutral = NEUTRALS[channel]
            self.graph.run_until(lambda channel=channel, neutral=neutral: self.board.counts[channel] == neutral, 2.0)
            at_ns = next((at_ns for at_ns, counts in self.board.since(since_ns, channel) if counts == neutral))
            found[channel] = (at_ns - since_ns) / MS
        return found


Fault = Callable[[Chain, int], int]  # makes it in a phase, and returns from when the time counts


def sends(name: str, value: Any) -> Fault:
    def fault(chain, phase_ns):
        chain.go_to(phase_ns)
        return chain.send(name, value)
    return fault


def falls_silent(*names: str) -> Fault:
    """The time counts from the last messages."""
    def fault(chain, phase_ns):
        chain.go_to(phase_ns)
        for name in names:
            chain.send(name)
            del chain.values[name]
        return chain.graph.now_ns
    return fault


def offset_ns(phase_ns: int, period_ms: int) -> int:
    """Return the time from a message to a fault: none, almost until the next message, or half of it."""
    return {0: 0, 10 * MS - 1: period_ms * MS - 1}.get(phase_ns % (10 * MS), period_ms * MS // 2)


def is_lost(do: Callable[[Any], None], name: str, topic: str, period_ms: int, by: str = "") -> Fault:
    """A node that was started in a phase is killed or stands still, some time after its message.

    Args:
        by: the input by which it publishes; empty = its timer.
    """
    def fault(chain, phase_ns):
        if by:
            value = chain.values.pop(by)
            chain.run(HOP_S)
            chain.go_to(phase_ns)
            chain.send(by, value)
            del chain.values[by]
        else:
            chain.node(name).kill()
            chain.go_to(phase_ns)
            chain.node(name).start()
            chain.run(0.1)
            chain.drive()
            chain.go_to(MS)  # of two states of turn_arb within 100 ms always the same
        at_ns = chain.after_message(topic, name, offset_ns(phase_ns, period_ms))
        do(chain.node(name))
        return at_ns
    return fault


def kill(node):
    node.kill()


def freeze(node):
    node.stall(0.8, frozen=True)


def stall(node):
    node.stall(0.8)


def pca9685_lost(do: Callable[[Any], None]) -> Fault:
    """Of which only the guard takes notice: at once after a sign of life, somewhen, or just before the next."""
    def fault(chain, phase_ns):
        guard = chain.board.guards[-1]
        count = guard.signs_sent
        chain.graph.run_until(lambda: guard.signs_sent > count)
        chain.graph.run_to(chain.graph.now_ns + offset_ns(phase_ns, 50))
        do(chain.node("pca9685"))
        return chain.graph.now_ns
    return fault


def ended(node):
    node.end()


class Row(NamedTuple):
    """A row of the table.

    Attributes:
        title: its first cell.
        inputs: of the car that drives before the fault.
        fault: makes it.
        hops: of the way to the servo, and to the ESC, which the fault or its lack of messages must take.
        phases: of the fault, with the first and the last of which the two bounds are met.
        rearms: the car stands until the deadman was released and held; else it drives on when the fault is over.
    """

    title: str
    inputs: dict[str, Any]
    fault: Fault
    hops: tuple[int, int] = (2, 2)
    phases: tuple[int, ...] = PHASES
    rearms: bool = True


NAN = float("nan")
JOY_PHASES = (10 * MS, 7 * MS, 10 * MS - 1)
LOST = (0, 7 * MS, 20 * MS - 1)
TELEOP_LOST, TURN_ARB_LOST = (20 * MS, 7 * MS, 20 * MS - 1), (10 * MS, 7 * MS, 10 * MS - 1)
COMMAND, VALUE, MODE = "/servo/cmdVector", "/generic/output/value", "/teleop_logi/mode"
STATE = "/turn_arb/state"
ROWS = [
    Row("the deadman is released", STEERED, sends("human", False), rearms=False),
    Row("`/e_stop` is true", STEERED, sends("e_stop", True)),
    Row("`tele_steer_req` is NaN", STEERED, sends("steering", NAN), rearms=False),
    Row("`tele_throt_req` is NaN", BY_HAND, sends("throttle", NAN), rearms=False),
    Row("`av_turnrad_req` is NaN", BY_RADIUS, sends("radius", NAN), rearms=False),
    Row("the acceleration is NaN", STEERED, sends("acceleration", NAN), (0, 3), rearms=False),
    Row("the speed is NaN", STEERED, sends("odometry", NAN), rearms=False),
    Row("`human_in_loop` stale", STEERED, falls_silent("human")),
    Row("`/e_stop` stale", STEERED, falls_silent("e_stop")),
    Row("`tele_steer_req` stale", STEERED, falls_silent("steering"), rearms=False),
    Row("`tele_throt_req` stale", BY_HAND, falls_silent("throttle"), rearms=False),
    Row("`mode` stale", BY_HAND, falls_silent("mode"), rearms=False),
    Row("`av_turnrad_req` stale", BY_RADIUS, falls_silent("radius"), rearms=False),
    Row("acceleration stale", STEERED, falls_silent("acceleration"), (0, 3), rearms=False),
    Row("odometry stale", STEERED, falls_silent("odometry"), rearms=False),
    Row("`/joy` stale", BY_GAMEPAD, falls_silent("joy"), (3, 3), JOY_PHASES),
    Row("teleop_logi killed", BY_GAMEPAD, is_lost(kill, "teleop_logi", MODE, 100), phases=TELEOP_LOST),
    Row("teleop_logi stands still", BY_GAMEPAD, is_lost(freeze, "teleop_logi", MODE, 100), phases=TELEOP_LOST),
    Row("turn_arb killed", STEERED, is_lost(kill, "turn_arb", STATE, 50), (1, 1), phases=TURN_ARB_LOST),
    Row("turn_arb stands still", STEERED, is_lost(stall, "turn_arb", STATE, 50), (1, 1), phases=TURN_ARB_LOST),
    Row("throttle_arb killed", STEERED, is_lost(kill, "throttle_arb", COMMAND, 20), (0, 1), phases=LOST),
    Row("throttle_arb stands still", STEERED, is_lost(freeze, "throttle_arb", COMMAND, 20), (0, 1), phases=LOST),
    Row("generic_value_converter killed", STEERED, is_lost(kill, "generic_value_converter", VALUE, 20, "acceleration"),
        (0, 2), phases=LOST, rearms=False),
    Row("pca9685 killed", STEERED, pca9685_lost(kill), (1, 1), phases=LOST, rearms=False),
    Row("pca9685 frozen", STEERED, pca9685_lost(freeze), (1, 1), phases=LOST, rearms=False),
    Row("pca9685's thread stands still", STEERED, pca9685_lost(stall), (1, 1), phases=LOST, rearms=False),
]


def page_rows() -> dict[str, list[tuple[float, float] | None]]:
    """Return the bounds in the page's table, by fault: those of the servo and of the ESC; ``None`` = it continues."""
    _, _, section = SAFETY.read_text(encoding="utf-8").partition("## Exact bounds\n")
    found: dict = {}
    for line in section.partition("\n## ")[0].splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if len(cells) == 3 and re.match(rf"\d|{CONTINUES}", cells[1]):
            bounds = [None if cell == CONTINUES else [float(number) for number in cell.split(" to ")]
                      for cell in cells[1:3]]
            for title in cells[0].split(", "):
                found[title] = [each and (each[0], each[-1]) for each in bounds]
    return found


@pytest.mark.once
@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.title)
@pytest.mark.parametrize("hop_s", [0.0, HOP_S], ids=["at_once", "delayed"])
def test_time_from_fault_to_neutral_is_that_of_the_page(row, hop_s):
    bounds = page_rows()[row.title]
    stops = [channel for channel in (0, 1) if bounds[channel] is not None]
    chain = Chain(row.inputs, hop_s)
    found: dict[int, list[float]] = {channel: [] for channel in stops}
    for phase_ns in row.phases if not hop_s else (row.phases[0], row.phases[-1]):
        at_ns = row.fault(chain, phase_ns)
        times_ms = chain.neutral_ms(at_ns, stops)
        for channel in stops:
            found[channel].append(times_ms[channel] - row.hops[channel] * 1e3 * hop_s)
        assert all(not chain.board.since(at_ns, channel) for channel in (0, 1) if channel not in stops)
        chain.recover()
        if row.rearms and phase_ns == row.phases[0]:
            chain.run(1.0)
            assert all(chain.board.counts[channel] == NEUTRALS[channel] for channel in stops)
        chain.drive()
    assert {channel: (round(min(each), 3), round(max(each), 3)) for channel, each in found.items()} == {
        channel: bounds[channel] for channel in stops}


def test_each_row_of_the_page_is_tested():
    assert sorted(page_rows()) == sorted(row.title for row in ROWS)


@pytest.mark.parametrize("step_ns", [-HOUR_NS, HOUR_NS])
def test_clock_that_is_set_by_an_hour_moves_nothing_and_changes_no_timeout(step_ns):
    chain = Chain(STEERED)
    at_ns = chain.go_to(0)
    chain.graph.ros_ahead_ns += step_ns
    chain.run(1.5)
    assert chain.drives and not chain.board.since(at_ns, 0) and not chain.board.since(at_ns, 1)
    at_ns = falls_silent("human")(chain, 0)
    chain.run(0.2)
    chain.graph.ros_ahead_ns -= step_ns
    assert chain.neutral_ms(at_ns, (0, 1)) == {0: 510.0, 1: 510.0}


def test_network_that_is_cut_stops_the_car_and_it_stands_when_the_network_is_back():
    """The gamepad is on another computer than the car."""
    chain = Chain(STEERED)
    at_ns = chain.after_message(INPUTS["human"][0], "human_node", 0)
    for name in ("human", "steering"):
        chain.graph.link(sender=f"/{name}_node", loses=lambda message: True)
    assert chain.neutral_ms(at_ns, (0, 1)) == {0: 510.0, 1: 510.0}
    for name in ("human", "steering"):
        chain.graph.link(sender=f"/{name}_node")
    chain.run(1.0)
    assert chain.board.counts[:2] == NEUTRALS
    assert chain.graph.newest("/turn_arb/state").reason == (
        "human_in_loop was silent; let go once: publish false, then true")
    chain.drive()


def test_board_that_does_not_receive_turn_arb_is_given_no_throttle():
    chain = Chain(STEERED)
    at_ns = chain.after_message(COMMAND, "turn_arb", 0)
    chain.graph.link(COMMAND, "/turn_arb", "/pca9685", loses=lambda message: True)
    assert chain.neutral_ms(at_ns, (0, 1)) == {0: 250.0, 1: 750.0}
    chain.run(0.01)
    assert chain.graph.newest("/throttle_arb/state").reason == (
        "the servo board holds 5104 on channel 0, where turn_arb commands 3800")


class TestBoardWithAGuard:
    @pytest.mark.parametrize("frozen_ms", [1400, 1413, 1427])
    def test_thawed_node_obeys_only_what_is_sent_from_then_on_and_then_gets_throttle(self, frozen_ms):
        chain = Chain(STEERED)
        at_ns = pca9685_lost(lambda node: node.stall(frozen_ms / 1e3, frozen=True))(chain, 0)
        chain.neutral_ms(at_ns, (0, 1))
        chain.send("steering", -1.0)
        chain.run(0.6)
        chain.send("steering", 1.0)
        thawed_ns = at_ns + frozen_ms * MS
        chain.graph.run_to(thawed_ns - 1)
        assert chain.board.counts[:2] == NEUTRALS
        steered_ns = chain.graph.run_until(lambda: chain.board.counts[0] != CENTER)
        driven_ns = chain.graph.run_until(lambda: chain.drives)
        assert 0 < steered_ns - thawed_ns <= 10 * MS  # turn_arb's next command
        assert 500 * MS <= driven_ns - thawed_ns <= 520 * MS  # after it has followed the steering for 0.5 s
        assert [counts for _, counts in chain.board.since(at_ns, 0)] == [CENTER, LEFT]

    @pytest.mark.parametrize(("do", "fault", "noticed_ms"), [
        (lambda guard: guard.kill(), "it has ended (killed by signal 9)", 50),
        (lambda guard: guard.stall(9.0), "it doesn't answer", 450)])
    def test_guard_that_is_lost_is_reported_and_another_one_acts_when_the_node_dies(self, do, fault, noticed_ms):
        chain = Chain(STEERED)
        lost = chain.board.guards[-1]
        at_ns = chain.go_to(0)
        do(lost)
        chain.run(noticed_ms / 1e3)
        absent, = (text for text in chain.graph.lines("/pca9685", at_ns + 1) if "guard absent" in text)
        assert absent == (f"guard absent: {fault}. Until there is one PCA9685 at 0x40 on virtual goes on pulsing if "
                          "this node dies or hangs. Starting it anew")
        chain.run(chain.board.guard_start_s + 0.1)
        assert any("watches again after 0." in text for text in chain.graph.lines("/pca9685", at_ns))
        assert chain.board.guards[-1] is not lost and chain.drives
        at_ns = chain.go_to(0)
        chain.node("pca9685").kill()
        assert chain.neutral_ms(at_ns, (0, 1)) == {0: 0.0, 1: 0.0}


@pytest.mark.once
@pytest.mark.parametrize(("radii_m", "after_ms"), [([], (500, 520)), ([1.0], (200, 300))], ids=["center", "in_a_turn"])
def test_teensy_that_is_unplugged_stops_the_throttle_and_the_steering_goes_on(radii_m, after_ms):
    """Where a planner steers, so that the throttle depends on the speed, the odometry is awaited for less long."""
    car = Car()
    graph = car.whole(collisions=False).graph
    graph.record("/odom")
    for radius_m in radii_m:
        graph.hold("/av_turnrad_req", Float32(radius_m))
    graph.hold("/control/command/control_cmd", control(1.0))
    graph.run(1.5)
    car.pad(autonomous=True)
    graph.run_until(lambda: car.speed_mps > 0.5)
    graph.nodes["/car_sim"].kill()
    stopped_ns = graph.run_until(lambda: car.board.counts[1] == ESC_NEUTRAL)
    measured_ns = graph.newest("/odom").header.stamp.to_nsec() - graph.ros_ahead_ns
    assert after_ms[0] * MS < stopped_ns - measured_ns <= after_ms[1] * MS
    graph.hold("/av_turnrad_req", Float32(-1.0))
    graph.run_until(lambda: car.board.counts[0] == RIGHT)
    graph.nodes["/car_sim"].start()
    graph.run_until(lambda: car.board.counts[1] > ESC_NEUTRAL)


@pytest.mark.once
@pytest.mark.parametrize(("speed_mps", "column"), [(2, 1), (2, 2), (5, 1), (5, 2), (10, 1), (10, 2)])
def test_stopping_distance_is_that_of_the_page(speed_mps, column):
    """From releasing the deadman to standstill, on a floor without walls."""
    _, _, section = SAFETY.read_text(encoding="utf-8").partition("## Stopping distances\n")
    cells = next(line for line in section.splitlines() if line.startswith(f"| {speed_mps} m/s")).strip("|").split("|")
    car = Car()
    measured = {"profile": "brake_then_reverse", "profile_measured": True} if column == 1 else {}
    car.pca9685()
    car.sim(collisions=False, esc_kind="brake_then_reverse")
    car.hub()
    car.turn_arb()
    car.throttle_arb(human_scale=1.0, **{f"esc/{name}": value for name, value in measured.items()})
    graph, held = car.graph, [False]
    graph.repeat(INPUTS["human"][0], lambda: Bool(held[0]), 50)
    # A push of less than the dwell is braked to the margin only, then it coasts.
    stick = 0.4 if speed_mps == 2 else 1.0
    graph.repeat(INPUTS["throttle"][0], lambda: Float32(stick * held[0]), 50)
    graph.run(1.5)
    held[0] = True
    graph.run_until(lambda: car.speed_mps >= speed_mps, 20.0)
    held[0] = False
    graph.publish(INPUTS["human"][0], Bool(False))
    begin = car.truth().pose.pose.position
    graph.run_until(lambda: car.speed_mps == 0.0, 60.0)
    end = car.truth().pose.pose.position
    distance_m = math.hypot(end.x - begin.x, end.y - begin.y)
    assert cells[column].strip() == f"{distance_m:.2g} m"
