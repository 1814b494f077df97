"""Latency from a frame's last byte on the serial line to a subscriber, and the CPU that a full line needs."""
from __future__ import annotations

import time
from contextlib import contextmanager
from typing import Iterator, NamedTuple

from car_interface.msg import Wheel

from waiting import NodeProcess

from .capture import WHEELS, Line, captured
from .driver import SONARS
from .effort import Effort
from .meters import CpuMeter
from .rows import MEDIAN, P99, WORST, Row, Summary, Target
from .stage import Stage, TimedSubscriber

PAUSE_S = (0.004, 0.02)
UNCOUNTED = 3  # the first frames, while the connections may not be complete
EVERYTHING = ("odom", "/tf", "joint_states", "teensy_clock", "teensy_sensor_hub/link", "/diagnostics",
              *(f"sonar/{name}" for name in SONARS))
RAW, ALL = "raw", "everything"
FLOORS = {RAW: "floor_of_raw", ALL: "floor_of_everything"}  # bare rospy with the same messages, ready-made
KINDS = (*FLOORS.values(), RAW, ALL)  # also their namespaces
CPU_RATIOS = {RAW: 1.2, ALL: 1.35}  # to bare rospy


def hub(stage: Stage, port: str, namespace: str = "", *arguments: str) -> NodeProcess:
    stage.load(f"{namespace}/teensy_sensor_hub", "teensy_sensor_hub.yaml", "sonars.yaml")
    process = stage.node("teensy_sensor_hub", f"_port:={port}", f"__ns:={namespace}", *arguments)
    process.wait_for_info("the Teensy's port is open")
    return process


def measure_serial(effort: Effort, stage: Stage) -> Iterator[Row]:
    """Measure captured wheel reports one by one, in turns with a node that publishes a ready message for each."""
    ports = stage.path("serial_hub"), stage.path("serial_pipe")
    lines = [Line(port) for port in ports]
    with stage.running(hub(stage, ports[0]), stage.actor("pipe", ports[1], "__ns:=bench")):
        subscribers = [TimedSubscriber(topic, Wheel).connected() for topic in ("/teensy_wheel", "/bench/teensy_wheel")]
        frames = list(captured(WHEELS))
        delays_ms: tuple[list[float], list[float]] = ([], [])
        for index in range(effort.frames + UNCOUNTED):
            for line, subscriber, delays in zip(lines, subscribers, delays_ms):
                time.sleep(stage.random.uniform(*PAUSE_S))
                sent_ns = time.monotonic_ns()
                line.send(frames[index % len(frames)])
                delays.append((subscriber.first(since_ns=sent_ns) - sent_ns) / 1e6)
                line.drain()
    yield Row("serial", "serial: last byte on the pty → subscriber's callback", "ms",
              Summary.of(delays_ms[0][UNCOUNTED:]),
              (Target(MEDIAN, max_ratio=1.3), Target(P99, max_ratio=1.5), Target(WORST)),
              Summary.of(delays_ms[1][UNCOUNTED:]), note="bare rospy: reads a pty, publishes a ready-made message")


class Load(NamedTuple):
    cpu_percent: float
    lost: int  # frames that did not arrive at their subscriber
    sent_per_s: float  # frames


def measure_line(effort: Effort, stage: Stage) -> Iterator[Row]:
    """Measure the hub with ``raw_only``, the hub with subscribers to all of its topics, and a bare node for each.

    In turns, with the capture's reports repeated: 368 a second at 115200 baud, and ten times.
    """
    with readers(stage) as by_kind:
        for factor in (1, 10):  # × 115200 baud
            rounds = [{kind: load(effort.line_s / effort.line_rounds, *processes, factor)
                       for kind, processes in by_kind.items()} for _ in range(effort.line_rounds)]
            loads = {kind: mean([loads[kind] for loads in rounds]) for kind in by_kind}
            yield from line_rows(factor, loads)


def line_rows(factor: int, loads: dict[str, Load]) -> Iterator[Row]:
    rate = "full line" if factor == 1 else f"{factor} × the line rate"
    for kind, what in ((RAW, "raw topics only"), (ALL, "everything on")):
        measured, floor = loads[kind], loads[FLOORS[kind]]
        void = f"{measured.lost} frames were lost" if measured.lost else ""
        yield Row("line", f"{rate}: CPU of the hub, {what}", "% of core", Summary.of([measured.cpu_percent]),
                  (Target(max_ratio=CPU_RATIOS[kind]),), Summary.of([floor.cpu_percent]),
                  f"{measured.sent_per_s:.0f} frames a second were sent", void=void)
        yield Row("line", f"{rate}: frames lost, {what}", "frames", Summary.of([measured.lost]),
                  (Target(high=0),), Summary.of([floor.lost]))


@contextmanager
def readers(stage: Stage) -> Iterator[dict[str, tuple[NodeProcess, ...]]]:
    """Start of each kind a node, its line and its subscribers; nothing is sent yet."""
    ports = {kind: stage.path(f"line_{kind}") for kind in KINDS}
    everything = {ALL: EVERYTHING, FLOORS[ALL]: EVERYTHING}
    actors = stage.actors(*(("line", port) for port in ports.values()),
                          *(("count", *everything.get(kind, ()), f"__ns:={kind}") for kind in KINDS))
    lines, counts = actors[:len(KINDS)], actors[len(KINDS):]
    nodes = (*stage.actors(("pipe", ports[FLOORS[RAW]], f"__ns:={FLOORS[RAW]}"),
                           ("pipe", ports[FLOORS[ALL]], "50", f"__ns:={FLOORS[ALL]}")),  # the hub's odom_rate
             hub(stage, ports[RAW], f"/{RAW}", "_raw_only:=true"), hub(stage, ports[ALL], f"/{ALL}"))
    with stage.running(*actors, *nodes):
        for count in counts:
            count.tell("connected")
        for count in counts:
            count.wait_for_info("^connected")
        yield dict(zip(ports, zip(nodes, lines, counts)))


def mean(loads: list[Load]) -> Load:
    cpu_percents, lost, rates = zip(*loads)
    return Load(sum(cpu_percents) / len(loads), sum(lost), sum(rates) / len(loads))


def load(lasts_s: float, node: NodeProcess, line: NodeProcess, count: NodeProcess, factor: int) -> Load:
    sent_mark, counted_mark = line.stdout.mark(), count.stdout.mark()
    begun_s = time.monotonic()
    line.tell(f"go {factor}")
    time.sleep(0.3)
    meter = CpuMeter(node.pid)
    time.sleep(lasts_s)
    used = meter.percent()
    line.tell("stop")
    lasted_s = time.monotonic() - begun_s
    sent = line.stdout.wait_for(lambda text: text.startswith("sent"), sent_mark).what
    count.tell("report")
    counted = count.stdout.wait_for(lambda text: text.startswith("counted"), counted_mark).what
    frames, arrived = (int(text.split()[1]) for text in (sent, counted))
    return Load(used, frames - arrived, frames / lasted_s)
