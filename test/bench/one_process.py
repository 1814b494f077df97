"""The four nodes as four processes and as one, by turns: memory and CPU of a car that drives, reaction to the chip."""
from __future__ import annotations

import time
from typing import Iterator

import rospy

from virtual_car import Chip

from .effort import Effort
from .reaction import COUNTS, LEFT, Person, arm, steps
from .rows import MEDIAN, P99, WORST, Row, Summary, Target
from .stage import PACKAGE, CpuMeter, Ear, Stage, pss_mb, rss_mb
from .whole_car import FOUR, OTHERS, join, pid_of

ONE = ("car_nodes",)
SHAPES = {"four processes": FOUR, "one process": ONE}
HALF = 0.5  # of the memory must be saved, or the one process isn't worth having
ROUNDS = 3


def measure_one_process(effort: Effort, stage: Stage) -> Iterator[Row]:
    """A round is a whole car by demo.launch, then the reaction of the nodes alone, in one shape and in the other."""
    rounds = ROUNDS if effort.drive_s > 5 else 1
    used: dict = {shape: {"RSS": [], "PSS": [], "CPU": []} for shape in SHAPES}
    times_ms: dict = {shape: {} for shape in SHAPES}
    for index in range(rounds):
        for shape, nodes in SHAPES.items():
            drive(effort, stage, f"/shape{index}{len(nodes)}", nodes, used[shape])
            react(max(10, effort.chip_reactions // rounds), stage, nodes, times_ms[shape])
    four, one = used.values()
    for what, unit in (("RSS", "MB"), ("PSS", "MB"), ("CPU", "% of core")):
        for shape, values in (("four processes", four[what]), ("one process", one[what])):
            bound = HALF * Summary.of(four[what]).median if what != "CPU" and shape == "one process" else None
            yield Row("one_process", f"car that drives, {shape}: {what}", unit, Summary.of(values),
                      (Target(MEDIAN, high=bound and round(bound, 1)),))
    for shape, kinds in times_ms.items():
        for what, values in kinds.items():
            yield Row("one_process", f"{shape}: {what} → register write", "ms", Summary.of(values),
                      (Target(MEDIAN), Target(P99), Target(WORST)))


def drive(effort: Effort, stage: Stage, namespace: str, nodes: tuple, used: dict) -> None:
    """One car in circles, at the full rate of its wheels' reports."""
    one_process = {"one_process": str(nodes is ONE).lower()}
    processes = join(stage, [namespace], (*nodes, *OTHERS), one_process)
    try:
        pids = [pid_of(f"{namespace}/{node}") for node in nodes]
        meters = [CpuMeter(pid) for pid in pids]
        time.sleep(effort.drive_s)
        used["CPU"].append(sum(meter.percent() for meter in meters))
        used["RSS"].append(sum(map(rss_mb, pids)))
        used["PSS"].append(sum(map(pss_mb, pids)))
    finally:
        stage.end(*processes)


def react(count: int, stage: Stage, nodes: tuple, times_ms: dict) -> None:
    """The four nodes and a full line, and nobody who listens but they."""
    log, port = stage.path(f"chip{len(nodes)}"), stage.path("teensy")
    for node, *files in (("turn_arb", "turn_arb.yaml"), ("pca9685", "pca9685.yaml"),
                         ("teensy_sensor_hub", "teensy_sensor_hub.yaml", "sonars.yaml"),
                         ("generic_value_converter", "generic_value_converter.yaml", "throttle.yaml")):
        stage.load(f"/{node}", *files)
    for name, value in (("pca9685/device", "virtual"), ("pca9685/virtual_log", log), ("teensy_sensor_hub/port", port),
                        ("generic_value_converter/csv_path_value_map", f"{PACKAGE}/config/value_map.csv")):
        rospy.set_param(name, value)
    line = stage.actor("line", port)
    line.tell("go 1")
    with stage.running(line, *(stage.node(node) for node in nodes)):
        chip, person = Chip(log), Person(stage.random)
        wheels = Ear("/teensy_wheel", rospy.AnyMsg, lambda message: None).connected()
        wheels.first()
        arm(person, lambda: chip.counts(0) == COUNTS[LEFT])
        for what, kind in steps():
            for index in range(count + 1):  # the first isn't counted
                step = kind[index % len(kind)]
                ready_ns = time.monotonic_ns()
                person.prepare(step)
                chip.wait_for(0, lambda counts, step=step: counts == COUNTS[step.duties[0]], ready_ns)
                person.pause()
                sent_ns = person.say(*step.trigger)
                at_ns = chip.wait_for(0, lambda counts, step=step: counts == COUNTS[step.duties[1]], sent_ns)
                if index:
                    times_ms.setdefault(what, []).append((at_ns - sent_ns) / 1e6)
        person.close()
        wheels.close()
