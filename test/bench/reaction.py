"""Latency from an input to the steering topic and to the chip's registers, and turn_arb's output at 100 Hz.

Each latency is measured at a random phase of turn_arb's timer, in turns with one of bare rospy: a relay that does
nothing else, with the same messages over as many hops.
"""
from __future__ import annotations

import time
from typing import Callable, Iterator, NamedTuple

import rospy
from std_msgs.msg import Bool, Float32, Int32MultiArray

from virtual_car import Chip
from waiting import eventually

from .effort import Effort
from .meters import CpuMeter
from .rows import MEDIAN, P99, WORST, Row, Summary, Target
from .stage import Stage, TimedSubscriber, connected_publisher

LEFT, CENTER, RIGHT = 3800, 5100, 6700  # config/turn_arb.yaml
COUNTS = {LEFT: 238, CENTER: 319, RIGHT: 419}
REACTION = (Target(MEDIAN, high=0.45, original="15.5"), Target(P99, high=0.9, original="20.4"),
            Target(WORST, original="20.8"))
TO_CHIP = (Target(MEDIAN, high=0.9), Target(P99, high=1.8), Target(WORST))
PAUSE_S = (0.012, 0.032)  # one to three periods of turn_arb's timer
INPUTS = ("human", "steering", "radius")


class Step(NamedTuple):
    """One reaction: the inputs before it, the input that triggers it, and the duties before and after."""

    before: dict
    trigger: tuple
    duties: tuple[int, int]


def steps() -> list[tuple[str, list[Step]]]:
    """Return the name of each kind of reaction and its steps, which alternate."""
    release = Step({"steering": 1.0, "radius": 0.0, "human": True}, ("human", False), (LEFT, CENTER))
    gamepad = [Step({"human": True, "radius": 0.0, "steering": value}, ("steering", -value), duties)
               for value, duties in ((1.0, (LEFT, RIGHT)), (-1.0, (RIGHT, LEFT)))]
    planner = [Step({"human": True, "steering": 0.0, "radius": value}, ("radius", -value), duties)
               for value, duties in ((1.0, (LEFT, RIGHT)), (-1.0, (RIGHT, LEFT)))]
    return [("human_in_loop false", [release]), ("gamepad's step", gamepad), ("planner's step", planner)]


class SteeringInputs:
    """Publishes what turn_arb subscribes to."""

    def __init__(self, random):
        self._random = random
        self._publishers = {"human": connected_publisher("/teleop_logi/human_in_loop", Bool),
                        "steering": connected_publisher("/teleop_logi/tele_steer_req", Float32),
                        "radius": connected_publisher("/av_turnrad_req", Float32)}

    def publish(self, name, value) -> int:
        """Publish an input; return the time just before, ns."""
        at_ns = time.monotonic_ns()
        self._publishers[name].publish(value)
        return at_ns

    def prepare(self, step: Step) -> None:
        """Publish the inputs before the trigger."""
        for name, value in step.before.items():
            self.publish(name, value)

    def pause(self) -> None:
        """Wait for a random phase of turn_arb's timer."""
        time.sleep(self._random.uniform(*PAUSE_S))

    def close(self) -> None:
        """Unregister the publishers."""
        for publisher in self._publishers.values():
            publisher.unregister()


def trials(inputs: SteeringInputs, count: int, kind: list[Step], wait_for: Callable, floor: Callable
           ) -> tuple[list[float], list[float]]:
    """Return the latencies of so many reactions and those of bare rospy, ms.

    Args:
        wait_for: called with a duty and a time, ns; returns when the duty was reached after that time.
        floor: returns one latency of bare rospy.
    """
    times_ms, floors_ms = [], []
    for index in range(count):
        step = kind[index % len(kind)]
        ready_ns = time.monotonic_ns()
        inputs.prepare(step)
        wait_for(step.duties[0], ready_ns)
        inputs.pause()
        sent_ns = inputs.publish(*step.trigger)
        times_ms.append((wait_for(step.duties[1], sent_ns) - sent_ns) / 1e6)
        inputs.pause()
        floors_ms.append(floor())
    return times_ms, floors_ms


def measure_reaction(effort: Effort, stage: Stage) -> Iterator[Row]:
    """Measure from the publication of an input to the callback with the new duty, over lasting connections."""
    for what, times_ms, floors_ms in reactions(effort.reactions, stage, steps()):
        yield Row("reaction", f"reaction: {what} → /servo/cmdVector", "ms", Summary.of(times_ms), REACTION,
                  Summary.of(floors_ms))


def reactions(count: int, stage: Stage, kinds: list[tuple[str, list[Step]]]
              ) -> Iterator[tuple[str, list[float], list[float]]]:
    """Yield each kind with its latencies to /servo/cmdVector and those of bare rospy, ms; both with TCP_NODELAY.

    The first reaction of each kind is not counted: its connections may not be complete yet.
    """
    stage.load("/turn_arb", "turn_arb.yaml")
    with stage.running(stage.node("turn_arb"), stage.actor("relay", "/bench/in", "/bench/out")):
        duties = TimedSubscriber("/servo/cmdVector", Int32MultiArray, lambda message: message.data[0]).connected()
        relayed = TimedSubscriber("/bench/out", Int32MultiArray).connected()
        to_relay, inputs = connected_publisher("/bench/in", Bool), SteeringInputs(stage.random)

        def floor():
            sent_ns = time.monotonic_ns()
            to_relay.publish(True)
            return (relayed.first(since_ns=sent_ns) - sent_ns) / 1e6

        def wait_for(duty, since_ns):
            return duties.first(lambda value: value == duty, since_ns)
        hold_deadman(inputs, lambda: any(value == LEFT for _, value in duties.drain()))
        for what, kind in kinds:
            times_ms, floors_ms = trials(inputs, count + 1, kind, wait_for, floor)
            yield what, times_ms[1:], floors_ms[1:]
        for subscriber in (duties, relayed):
            subscriber.close()
        inputs.close()
        to_relay.unregister()


def hold_deadman(inputs: SteeringInputs, is_steering: Callable) -> None:
    """Release the deadman and hold it again until turn_arb acts on the inputs."""
    def attempt():
        inputs.publish("human", False)
        time.sleep(0.05)
        inputs.prepare(steps()[0][1][0])
        time.sleep(0.1)
        return is_steering()
    eventually(attempt, "turn_arb acts on the inputs")


def measure_chip(effort: Effort, stage: Stage) -> Iterator[Row]:
    """Measure from the publication of an input until the virtual chip's registers are written, by the chip's log."""
    chip_log, sink_log = stage.path("chip"), stage.path("sink")
    stage.load("/turn_arb", "turn_arb.yaml")
    stage.load("/pca9685", "pca9685.yaml")
    stage.load("/pca9685/steering", "turn_arb.yaml")
    with stage.running(stage.node("pca9685", "_device:=virtual", f"_virtual_log:={chip_log}"), stage.node("turn_arb"),
                       *stage.actors(("relay", "/bench/in", "/bench/out"), ("sink", "/bench/out", sink_log))):
        chip, to_relay, inputs = Chip(chip_log), connected_publisher("/bench/in", Bool), SteeringInputs(stage.random)
        eventually(lambda: chip.counts(0) is not None, "the chip")

        def wait_for(duty, since_ns):
            return chip.wait_for(0, lambda counts: counts == COUNTS[duty], since_ns)

        def floor():
            sent_ns = time.monotonic_ns()
            to_relay.publish(True)
            return (eventually(lambda: last_line_after(sink_log, sent_ns), "the sink") - sent_ns) / 1e6
        hold_deadman(inputs, lambda: chip.counts(0) == COUNTS[LEFT])
        eventually(lambda: to_relay.publish(True) or last_line_after(sink_log, 0), "the relay")
        for what, kind in steps():
            times_ms, floors_ms = trials(inputs, effort.chip_reactions + 1, kind, wait_for, floor)
            yield Row("chip", f"reaction: {what} → register write", "ms", Summary.of(times_ms[1:]), TO_CHIP,
                      Summary.of(floors_ms[1:]))
        inputs.close()
        to_relay.unregister()


def last_line_after(path: str, since_ns: int) -> int | None:
    """Return the time in the last whole line of a file, ns, if it is later than ``since_ns``."""
    with open(path, "rb") as file:
        file.seek(0, 2)
        file.seek(max(0, file.tell() - 64))
        lines = file.read().split(b"\n")
    last_ns = int(lines[-2]) if len(lines) > 1 and lines[-2].isdigit() else 0
    return last_ns if last_ns > since_ns else None


def measure_heartbeat(effort: Effort, stage: Stage) -> Iterator[Row]:
    """Measure turn_arb with three constant inputs at 50 Hz, beside a bare node with the same topics."""
    stage.load("/turn_arb", "turn_arb.yaml")
    arb, (bare, inputs) = stage.node("turn_arb"), stage.actors(("timer", *INPUTS), ("inputs", *INPUTS))
    with stage.running(arb, bare, inputs):
        duties = TimedSubscriber("/servo/cmdVector", Int32MultiArray, lambda message: message.data[0])
        duties.first(lambda duty: duty != CENTER)
        duties.close()
        subscribers = [TimedSubscriber(topic, rospy.AnyMsg, lambda message: None).connected()
                       for topic in ("/servo/cmdVector", "/bench/timer")]
        time.sleep(1.0)
        meters = CpuMeter(arb.pid), CpuMeter(bare.pid)
        for subscriber in subscribers:
            subscriber.drain()
        time.sleep(effort.heartbeat_s)
        used = [meter.percent() for meter in meters]
        times_ns = [[at_ns for at_ns, _ in subscriber.drain()] for subscriber in subscribers]
        for subscriber in subscribers:
            subscriber.close()
    rates_hz = [1e9 * (len(times) - 1) / (times[-1] - times[0]) for times in times_ns]
    periods_ms = [[(now - before) / 1e6 for before, now in zip(times, times[1:])] for times in times_ns]
    yield Row("heartbeat", "heartbeat: rate", "Hz", Summary.of(rates_hz[:1]),
              (Target(low=99.95, high=100.05),), Summary.of(rates_hz[1:]), digits=6)
    yield Row("heartbeat", "heartbeat: period", "ms", Summary.of(periods_ms[0]),
              (Target(P99, high=10.5), Target(WORST)), Summary.of(periods_ms[1]))
    yield Row("heartbeat", f"heartbeat: CPU of turn_arb over {effort.heartbeat_s:.0f} s", "% of core",
              Summary.of(used[:1]), (Target(high=2.5, original="1.9 to 3.8"),), Summary.of(used[1:]),
              note="three inputs at 50 Hz each; bare rospy: the same subscribers and a publisher at 100 Hz")
