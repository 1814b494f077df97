"""Latency from an input of an arbiter to /servo/cmdVector, and from one of turn_arb's to the chip's registers.

Each latency is measured at a random phase of the arbiter's timer, in turns with one of bare rospy: a relay that does
nothing else, with the same messages over as many hops, and the same subscriptions beside them.
"""
from __future__ import annotations

import time
from typing import Any, Callable, Iterator, Mapping, NamedTuple

from std_msgs.msg import Bool, Float32, Int32MultiArray

from virtual_car import Chip
from waiting import eventually

from .effort import Effort
from .rows import MEDIAN, P99, PERCENT, WORST, Row, Summary, Target
from .stage import Stage, TimedSubscriber, connected_publisher

LEFT, CENTER, RIGHT = 3800, 5100, 6700  # config/turn_arb.yaml
COUNTS = {LEFT: 238, CENTER: 319, RIGHT: 419}
MEDIAN_RATIO, P99_RATIO = 1.3, 1.5  # to bare rospy
REACTION = (Target(MEDIAN, max_ratio=MEDIAN_RATIO), Target(P99, max_ratio=P99_RATIO), Target(WORST))
TO_CHIP = (Target(MEDIAN, high=0.9), Target(P99, high=1.8), Target(WORST))
TAIL = tuple(map(Target, PERCENT))
PAUSE_S, TAIL_PAUSE_S = (0.012, 0.032), (0.001, 0.012)  # periods of the timer: three at most, and about one


class Step(NamedTuple):
    """One reaction: the inputs before it, the input that triggers it, and the duties before and after."""

    before: dict
    trigger: tuple
    duties: tuple[int, int]


class Arbiter(NamedTuple):
    node: str
    config: str  # its file in config/
    arguments: tuple[str, ...]  # of its command line
    channel: int  # its own in /servo/cmdVector
    topics: Mapping[str, tuple[str, Any]]  # of each of its inputs that a step publishes, name and type
    nothing: Mapping[str, Any]  # those inputs while nobody asks for anything
    kinds: tuple[tuple[str, list[Step]], ...]  # of reactions: its name, and its steps, which alternate
    others: tuple[str, ...] = ()  # what else of inputs.INPUTS it gets all the time, and bare rospy with it


def both_ways(before: dict, name: str, values: tuple, duties: tuple[int, int]) -> list[Step]:
    """Return the steps of an input between two values, there and back."""
    return [Step({**before, name: old}, (name, new), (old_duty, new_duty)) for old, new, old_duty, new_duty in
            ((*values, *duties), (*values[::-1], *duties[::-1]))]


TURN_ARB = Arbiter(
    "turn_arb", "turn_arb.yaml", ("turn_arb/input/odometry:=odom",), 0,
    {"human": ("/teleop_logi/human_in_loop", Bool), "steering": ("/teleop_logi/tele_steer_req", Float32),
     "radius": ("/av_turnrad_req", Float32)},
    {"human": False},
    (("human_in_loop false", [Step({"steering": 1.0, "radius": 0.0, "human": True}, ("human", False), (LEFT, CENTER))]),
     ("gamepad's step", both_ways({"human": True, "radius": 0.0}, "steering", (1.0, -1.0), (LEFT, RIGHT))),
     ("planner's step", both_ways({"human": True, "steering": 0.0}, "radius", (1.0, -1.0), (LEFT, RIGHT)))),
    ("odometry",))


class ArbiterInputs:
    def __init__(self, arbiter: Arbiter, random, pause_s: tuple[float, float] = PAUSE_S):
        self._random, self._pause_s = random, pause_s
        self.nothing = arbiter.nothing
        self._publishers = {name: connected_publisher(*topic) for name, topic in arbiter.topics.items()}

    def publish(self, name, value) -> int:
        at_ns = time.monotonic_ns()
        self._publishers[name].publish(data=value)
        return at_ns

    def publish_all(self, values: Mapping[str, Any]) -> None:
        for name, value in values.items():
            self.publish(name, value)

    def pause(self) -> None:
        time.sleep(self._random.uniform(*self._pause_s))


def trials(inputs: ArbiterInputs, count: int, kind: list[Step], wait_for: Callable,
           floor: Callable) -> tuple[list[float], list[float]]:
    """Return the latencies of so many reactions and those of bare rospy, ms, without the first: it may yet connect.

    ``wait_for`` gets a duty and a time, ns; it returns when the duty was reached after that time.
    """
    times_ms, floors_ms = [], []
    for index in range(count + 1):
        step = kind[index % len(kind)]
        ready_ns = time.monotonic_ns()
        inputs.publish_all(step.before)
        wait_for(step.duties[0], ready_ns)
        inputs.pause()
        sent_ns = inputs.publish(*step.trigger)
        times_ms.append((wait_for(step.duties[1], sent_ns) - sent_ns) / 1e6)
        inputs.pause()
        floors_ms.append(floor())
    return times_ms[1:], floors_ms[1:]


def measure_reaction(effort: Effort, stage: Stage) -> Iterator[Row]:
    """Measure from the publication of an input to the callback with the new duty, over lasting connections."""
    for what, times_ms, floors_ms in reactions(effort.reactions, stage, TURN_ARB):
        yield Row("reaction", f"reaction: {what} → /servo/cmdVector", "ms", Summary.of(times_ms), REACTION,
                  Summary.of(floors_ms))


def measure_tail(effort: Effort, stage: Stage) -> Iterator[Row]:
    """Measure so many releases of the deadman that the rare late ones are among them."""
    for what, times_ms, floors_ms in reactions(effort.releases, stage, TURN_ARB, 1, TAIL_PAUSE_S):
        yield Row("tail", f"tail: {what} → /servo/cmdVector", "ms", Summary.of(times_ms), TAIL, Summary.of(floors_ms))


def reactions(count: int, stage: Stage, arbiter: Arbiter, kinds: int | None = None,
              pause_s: tuple[float, float] = PAUSE_S) -> Iterator[tuple[str, list[float], list[float]]]:
    """Yield each kind, or the first ``kinds``, with its latencies to /servo/cmdVector and those of bare rospy, ms."""
    stage.load(f"/{arbiter.node}", arbiter.config)
    with stage.running(stage.node(arbiter.node, *arbiter.arguments),
                       *stage.actors(("relay", "/bench/in", "/bench/out", *arbiter.others),
                                     *senders(arbiter.others, "none", "/bench/out"))):
        duties = TimedSubscriber("/servo/cmdVector", Int32MultiArray,
                                 lambda message: message.data[arbiter.channel]).connected()
        relayed = TimedSubscriber("/bench/out", Int32MultiArray).connected()
        to_relay, inputs = connected_publisher("/bench/in", Bool), ArbiterInputs(arbiter, stage.random, pause_s)

        def wait_for(duty, since_ns):
            return duties.first(lambda value: value == duty, since_ns)
        floor = floor_by(to_relay, lambda sent_ns: relayed.first(since_ns=sent_ns))
        first = arbiter.kinds[0][1][0]
        hold_deadman(inputs, first, lambda: any(value == first.duties[0] for _, value in duties.drain()))
        for what, kind in arbiter.kinds[:kinds]:
            yield (what, *trials(inputs, count, kind, wait_for, floor))


def senders(names: tuple[str, ...], arbiters: str, floor_topic: str) -> list[tuple[str, ...]]:
    """Return the roles of who publishes these of inputs.INPUTS: /servo/output is the board's, by what it receives.

    ``floor_topic`` is bare rospy's, which the board receives, too.
    """
    roles = [("inputs", arbiters, *(name for name in names if name != "output"))]
    return [*roles, ("board", floor_topic)] if "output" in names else roles


def hold_deadman(inputs: ArbiterInputs, step: Step, acts: Callable) -> None:
    def attempt():
        inputs.publish_all(inputs.nothing)
        time.sleep(0.05)
        inputs.publish_all(step.before)
        time.sleep(0.1)
        return acts()
    eventually(attempt, "the arbiter acts on its inputs")


def measure_chip(effort: Effort, stage: Stage) -> Iterator[Row]:
    """Measure from the publication of an input until the virtual chip's registers are written, by the chip's log."""
    chip_log, sink_log = stage.path("chip"), stage.path("sink")
    stage.load("/turn_arb", "turn_arb.yaml")
    stage.load("/pca9685", "pca9685.yaml", "steering/turn_arb.yaml")
    with stage.running(stage.node("pca9685", "_device:=virtual", f"_virtual_log:={chip_log}"), stage.node("turn_arb"),
                       *stage.actors(("relay", "/bench/in", "/bench/out"), ("sink", "/bench/out", sink_log))):
        chip, to_relay = Chip(chip_log), connected_publisher("/bench/in", Bool)
        inputs = ArbiterInputs(TURN_ARB, stage.random)
        eventually(lambda: chip.counts(0) is not None, "the chip")
        floor = floor_by(to_relay, lambda sent_ns: eventually(lambda: last_line_after(sink_log, sent_ns), "the sink"))
        hold_deadman(inputs, TURN_ARB.kinds[0][1][0], lambda: chip.counts(0) == COUNTS[LEFT])
        eventually(lambda: to_relay.publish(True) or last_line_after(sink_log, 0), "the relay")
        for what, kind in TURN_ARB.kinds:
            times_ms, floors_ms = trials(inputs, effort.chip_reactions, kind, reached(chip), floor)
            yield Row("chip", f"reaction: {what} → register write", "ms", Summary.of(times_ms), TO_CHIP,
                      Summary.of(floors_ms))


def reached(chip: Chip) -> Callable:
    """Return what waits for a duty of the steering on the chip, see ``trials``."""
    return lambda duty, since_ns: chip.wait_for(0, lambda counts: counts == COUNTS[duty], since_ns)


def floor_by(to_relay, arrival: Callable) -> Callable:
    """Return what measures bare rospy once, ms; ``arrival`` returns when its first message after a time, ns, came."""
    def floor():
        sent_ns = time.monotonic_ns()
        to_relay.publish(True)
        return (arrival(sent_ns) - sent_ns) / 1e6
    return floor


def last_line_after(path: str, since_ns: int) -> int | None:
    """Return the time in the last whole line of a file, ns, if it is later than ``since_ns``."""
    with open(path, "rb") as file:
        file.seek(0, 2)
        file.seek(max(0, file.tell() - 64))
        lines = file.read().split(b"\n")
    last_ns = int(lines[-2]) if len(lines) > 1 and lines[-2].isdigit() else 0
    return last_ns if last_ns > since_ns else None
