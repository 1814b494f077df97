"""From an input to the steering: reaction to the topic, reaction to the chip, and the heartbeat.

Each reaction is measured at a random phase of the node's heartbeat, and next to it one of bare rospy: a relay that does
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
from .rows import MEDIAN, P99, WORST, Row, Summary, Target
from .stage import CpuMeter, Ear, Stage, mouth

LEFT, CENTER, RIGHT = 3800, 5100, 6700  # config/turn_arb.yaml
COUNTS = {LEFT: 238, CENTER: 319, RIGHT: 419}
REACTION = (Target(MEDIAN, high=0.45, original="15.5"), Target(P99, high=0.9, original="20.4"),
            Target(WORST, original="20.8"))
TO_CHIP = (Target(MEDIAN, high=0.9), Target(P99, high=1.8), Target(WORST))
PAUSE_S = (0.012, 0.032)  # one to three heartbeats
INPUTS = ("human", "steering", "radius")


class Step(NamedTuple):
    """One kind of reaction: what leads to the state before it, the trigger, and the duties before and after."""

    what: str
    before: dict
    trigger: tuple
    duties: tuple[int, int]


def steps() -> list[tuple[str, list[Step]]]:
    """By kind; those to the left and to the right take turns."""
    lets_go = Step("human lets go", {"steering": 1.0, "radius": 0.0, "human": True}, ("human", False), (LEFT, CENTER))
    gamepad = [Step("gamepad steps", {"human": True, "radius": 0.0, "steering": value}, ("steering", -value), duties)
               for value, duties in ((1.0, (LEFT, RIGHT)), (-1.0, (RIGHT, LEFT)))]
    planner = [Step("planner steps", {"human": True, "steering": 0.0, "radius": value}, ("radius", -value), duties)
               for value, duties in ((1.0, (LEFT, RIGHT)), (-1.0, (RIGHT, LEFT)))]
    return [("human_in_loop false", [lets_go]), ("gamepad's step", gamepad), ("planner's step", planner)]


class Person:
    """Says what the steering hears."""

    def __init__(self, random):
        self._random = random
        self._mouths = {"human": mouth("/teleop_logi/human_in_loop", Bool),
                        "steering": mouth("/teleop_logi/tele_steer_req", Float32),
                        "radius": mouth("/av_turnrad_req", Float32)}

    def say(self, name, value) -> int:
        """Publish; when, ns: just before."""
        at_ns = time.monotonic_ns()
        self._mouths[name].publish(value)
        return at_ns

    def prepare(self, step: Step) -> None:
        """What comes before the trigger."""
        for name, value in step.before.items():
            self.say(name, value)

    def pause(self) -> None:
        """Until any phase of the heartbeat."""
        time.sleep(self._random.uniform(*PAUSE_S))

    def close(self) -> None:
        """Fall silent."""
        for publisher in self._mouths.values():
            publisher.unregister()


def trials(person: Person, count: int, kind: list[Step], wait_for: Callable, floor: Callable
           ) -> tuple[list[float], list[float]]:
    """Delays of so many reactions, ms, and of bare rospy; ``wait_for(duty, since_ns)`` tells when it was reached."""
    times_ms, floors_ms = [], []
    for index in range(count):
        step = kind[index % len(kind)]
        ready_ns = time.monotonic_ns()
        person.prepare(step)
        wait_for(step.duties[0], ready_ns)
        person.pause()
        sent_ns = person.say(*step.trigger)
        times_ms.append((wait_for(step.duties[1], sent_ns) - sent_ns) / 1e6)
        person.pause()
        floors_ms.append(floor())
    return times_ms, floors_ms


def measure_reaction(effort: Effort, stage: Stage) -> Iterator[Row]:
    """From the publication of an input to the callback that hears the new duty, by persistent TCP_NODELAY connections.

    The first reaction of each kind isn't counted: its connections may still be in the making.
    """
    stage.load("/turn_arb", "turn_arb.yaml")
    with stage.running(stage.node("turn_arb"), stage.actor("relay", "/bench/in", "/bench/out")):
        duties = Ear("/servo/cmdVector", Int32MultiArray, lambda message: message.data[0]).connected()
        passed = Ear("/bench/out", Int32MultiArray).connected()
        relayed, person = mouth("/bench/in", Bool), Person(stage.random)

        def floor():
            sent_ns = time.monotonic_ns()
            relayed.publish(True)
            return (passed.first(since_ns=sent_ns) - sent_ns) / 1e6

        def wait_for(duty, since_ns):
            return duties.first(lambda value: value == duty, since_ns)
        arm(person, lambda: any(value == LEFT for _, value in duties.all()))
        for what, kind in steps():
            times_ms, floors_ms = trials(person, effort.reactions + 1, kind, wait_for, floor)
            yield Row("reaction", f"reaction: {what} → /servo/cmdVector", "ms", Summary.of(times_ms[1:]), REACTION,
                      Summary.of(floors_ms[1:]))
        for ear in (duties, passed):
            ear.close()
        person.close()
        relayed.unregister()


def arm(person: Person, drives: Callable) -> None:
    """Let go and hold again until the steering obeys."""
    def attempt():
        person.say("human", False)
        time.sleep(0.05)
        person.prepare(steps()[0][1][0])
        time.sleep(0.1)
        return drives()
    eventually(attempt, "turn_arb obeys")


def measure_chip(effort: Effort, stage: Stage) -> Iterator[Row]:
    """From the publication of an input until the virtual chip takes the registers, by the chip's own log."""
    chip_log, sink_log = stage.path("chip"), stage.path("sink")
    stage.load("/turn_arb", "turn_arb.yaml")
    stage.load("/pca9685", "pca9685.yaml")
    with stage.running(stage.node("pca9685", "_device:=virtual", f"_virtual_log:={chip_log}"), stage.node("turn_arb"),
                       *stage.actors(("relay", "/bench/in", "/bench/out"), ("sink", "/bench/out", sink_log))):
        chip, relayed, person = Chip(chip_log), mouth("/bench/in", Bool), Person(stage.random)
        eventually(lambda: chip.counts(0) is not None, "the chip")

        def wait_for(duty, since_ns):
            return chip.wait_for(0, lambda counts: counts == COUNTS[duty], since_ns)

        def floor():
            sent_ns = time.monotonic_ns()
            relayed.publish(True)
            return (eventually(lambda: _last_after(sink_log, sent_ns), "the sink") - sent_ns) / 1e6
        arm(person, lambda: chip.counts(0) == COUNTS[LEFT])
        eventually(lambda: relayed.publish(True) or _last_after(sink_log, 0), "the relay")
        for what, kind in steps():
            times_ms, floors_ms = trials(person, effort.chip_reactions + 1, kind, wait_for, floor)
            yield Row("chip", f"reaction: {what} → register write", "ms", Summary.of(times_ms[1:]), TO_CHIP,
                      Summary.of(floors_ms[1:]))
        person.close()
        relayed.unregister()


def _last_after(path, since_ns):
    with open(path, "rb") as file:
        file.seek(0, 2)
        file.seek(max(0, file.tell() - 64))
        lines = file.read().split(b"\n")
    last_ns = int(lines[-2]) if len(lines) > 1 and lines[-2].isdigit() else 0
    return last_ns if last_ns > since_ns else None


def measure_heartbeat(effort: Effort, stage: Stage) -> Iterator[Row]:
    """All three inputs at 50 Hz from another process, never changing; beside it a bare node that does the same."""
    stage.load("/turn_arb", "turn_arb.yaml")
    arb, (bare, inputs) = stage.node("turn_arb"), stage.actors(("beat", *INPUTS), ("inputs", *INPUTS))
    with stage.running(arb, bare, inputs):
        duties = Ear("/servo/cmdVector", Int32MultiArray, lambda message: message.data[0])
        duties.first(lambda duty: duty != CENTER)
        duties.close()
        ears = [Ear(topic, rospy.AnyMsg, lambda message: None).connected()
                for topic in ("/servo/cmdVector", "/bench/beat")]
        time.sleep(1.0)
        meters = CpuMeter(arb.pid), CpuMeter(bare.pid)
        for ear in ears:
            ear.all()
        time.sleep(effort.heartbeat_s)
        used = [meter.percent() for meter in meters]
        times_ns = [[at_ns for at_ns, _ in ear.all()] for ear in ears]
        for ear in ears:
            ear.close()
    rates_hz = [1e9 * (len(times) - 1) / (times[-1] - times[0]) for times in times_ns]
    periods_ms = [[(now - before) / 1e6 for before, now in zip(times, times[1:])] for times in times_ns]
    yield Row("heartbeat", "heartbeat: rate", "Hz", Summary.of(rates_hz[:1]),
              (Target(low=99.95, high=100.05),), Summary.of(rates_hz[1:]), digits=6)
    yield Row("heartbeat", "heartbeat: period", "ms", Summary.of(periods_ms[0]),
              (Target(P99, high=10.5), Target(WORST)), Summary.of(periods_ms[1]))
    yield Row("heartbeat", f"heartbeat: CPU of turn_arb over {effort.heartbeat_s:.0f} s", "% of core",
              Summary.of(used[:1]), (Target(high=2.5, original="1.9 to 3.8"),), Summary.of(used[1:]),
              note="three inputs at 50 Hz each; bare rospy: the same subscribers and a publisher at 100 Hz")
