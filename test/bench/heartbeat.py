"""An arbiter's output while nothing changes, and its CPU time, beside a bare node with the same topics."""
from __future__ import annotations

import time
from typing import Iterator, NamedTuple

import rospy
from std_msgs.msg import Int32MultiArray

from .effort import Effort
from .meters import CpuMeter
from .reaction import CENTER, TURN_ARB, Arbiter, senders
from .rows import P99, WORST, Row, Summary, Target
from .stage import Stage, TimedSubscriber

SETTLED_S = 1.0


class Heartbeat(NamedTuple):
    arbiter: Arbiter
    rate_hz: int  # of its timer
    rest: int  # the duty of its channel while nobody asks for anything
    names: tuple[str, ...]  # its inputs, of inputs.INPUTS
    note: str


TURN_ARBS = Heartbeat(TURN_ARB, 100, CENTER, ("human", "steering", "radius"), "three inputs at 50 Hz each")


def measure_heartbeat(effort: Effort, stage: Stage) -> Iterator[Row]:
    yield from heartbeat("heartbeat", TURN_ARBS, effort, stage)


def heartbeat(group: str, what: Heartbeat, effort: Effort, stage: Stage) -> Iterator[Row]:
    """Measure an arbiter with constant inputs. Both are measured at the same time."""
    arbiter = what.arbiter
    topics = ("/servo/cmdVector", "/bench/timer")
    stage.load(f"/{arbiter.node}", arbiter.config)
    node = stage.node(arbiter.node, *arbiter.arguments)
    bare, *others = stage.actors(("timer", str(what.rate_hz), *what.names),
                                 *senders(what.names, arbiter.node, topics[1]))
    with stage.running(node, bare, *others):
        duties = TimedSubscriber(topics[0], Int32MultiArray, lambda message: message.data[arbiter.channel])
        duties.first(lambda duty: duty != what.rest)
        duties.close()
        subscribers = [TimedSubscriber(topic, rospy.AnyMsg, lambda message: None).connected() for topic in topics]
        time.sleep(SETTLED_S)
        meters = CpuMeter(node.pid), CpuMeter(bare.pid)
        for subscriber in subscribers:
            subscriber.drain()
        time.sleep(effort.heartbeat_s)
        used = [meter.percent() for meter in meters]
        times_ns = [[at_ns for at_ns, _ in subscriber.drain()] for subscriber in subscribers]
    rates_hz = [1e9 * (len(times) - 1) / (times[-1] - times[0]) for times in times_ns]
    periods_ms = [[(now - before) / 1e6 for before, now in zip(times, times[1:])] for times in times_ns]
    yield Row(group, f"{group}: rate", "Hz", Summary.of(rates_hz[:1]),
              (Target(low=0.9995 * what.rate_hz, high=1.0005 * what.rate_hz),), Summary.of(rates_hz[1:]),
              digits=6)
    yield Row(group, f"{group}: period", "ms", Summary.of(periods_ms[0]),
              (Target(P99, high=1000 / what.rate_hz + 0.5), Target(WORST)), Summary.of(periods_ms[1]))
    yield Row(group, f"{group}: CPU of {arbiter.node} over {effort.heartbeat_s:.0f} s", "% of core",
              Summary.of(used[:1]), (Target(max_ratio=1.3),), Summary.of(used[1:]),
              note=f"{what.note}; bare rospy: the same subscribers and a publisher at {what.rate_hz} Hz")
