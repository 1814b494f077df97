"""The five nodes as five processes and as one, in turns: memory and CPU of a driving car, latency to the chip."""
from __future__ import annotations

import time
from typing import Iterator

import rospy

from closing import pid_of
from virtual_car import Chip

from .effort import Effort
from .meters import CpuMeter, pss_mb, rss_mb, with_guard
from .nodes import SUBJECTS
from .reaction import COUNTS, LEFT, TURN_ARB, ArbiterInputs, hold_deadman, reached, trials
from .rows import MEDIAN, P99, WORST, Row, Summary, Target
from .stage import PACKAGE, Stage, TimedSubscriber
from .whole_car import FOUR, launch_cars

ONE = ("car_nodes",)
FIVE = (*FOUR, "throttle_arb")  # with the guard of pca9685, which is a process of its own in both layouts
LAYOUTS = {"five processes": FIVE, "one process": ONE}
MAX_RATIO = 0.5  # of the memory of five processes
ROUNDS = 3


def measure_one_process(effort: Effort, stage: Stage) -> Iterator[Row]:
    """Measure rounds: a whole car by demo.launch, then the latency of the nodes alone, as five processes and as one."""
    rounds = ROUNDS if effort.drive_s > 5 else 1
    used: dict = {layout: {"RSS": [], "PSS": [], "CPU": []} for layout in LAYOUTS}
    times_ms: dict = {layout: {} for layout in LAYOUTS}
    for index in range(rounds):
        for layout, nodes in LAYOUTS.items():
            drive(effort, stage, f"/layout{index}{len(nodes)}", nodes, used[layout])
            react(max(10, effort.chip_reactions // rounds), stage, nodes, times_ms[layout])
    five, one = used.values()
    for what, unit in (("RSS", "MB"), ("PSS", "MB"), ("CPU", "% of core")):
        for layout, values in (("five processes", five[what]), ("one process", one[what])):
            is_bound = what != "CPU" and layout == "one process"
            bound = MAX_RATIO * Summary.of(five[what]).values[MEDIAN] if is_bound else None
            yield Row("one_process", f"car that drives, {layout}: {what}", unit, Summary.of(values),
                      (Target(MEDIAN, high=bound and round(bound, 1)),))
    for layout, kinds in times_ms.items():
        for what, values in kinds.items():
            yield Row("one_process", f"{layout}: {what} → register write", "ms", Summary.of(values),
                      (Target(MEDIAN), Target(P99), Target(WORST)))


def drive(effort: Effort, stage: Stage, namespace: str, nodes: tuple, used: dict) -> None:
    one_process = {"one_process": str(nodes is ONE).lower()}
    with stage.running(*launch_cars(stage, [namespace], (*nodes, "teleop_logi", "car_sim"), one_process)):
        pids = [pid for node in nodes for pid in with_guard(pid_of(f"{namespace}/{node}"))]
        meter = CpuMeter(*pids)
        time.sleep(effort.drive_s)
        used["CPU"].append(meter.percent())
        used["RSS"].append(sum(map(rss_mb, pids)))
        used["PSS"].append(sum(map(pss_mb, pids)))


def react(count: int, stage: Stage, nodes: tuple, times_ms: dict) -> None:
    """Measure the latency of the nodes with a full line, without other subscribers."""
    log, port = stage.path(f"chip{len(nodes)}"), stage.path("teensy")
    for subject in SUBJECTS:
        if subject.name in FIVE:
            stage.load(f"/{subject.name}", *subject.config)
    for name, value in (("pca9685/device", "virtual"), ("pca9685/virtual_log", log), ("teensy_sensor_hub/port", port),
                        ("car_nodes/throttle", True),
                        ("generic_value_converter/csv_path_value_map", f"{PACKAGE}/config/value_map.csv")):
        rospy.set_param(name, value)
    line = stage.actor("line", port)
    line.tell("go 1")
    with stage.running(line, *(stage.node(node) for node in nodes)):
        chip, inputs = Chip(log), ArbiterInputs(TURN_ARB, stage.random)
        TimedSubscriber("/teensy_wheel", rospy.AnyMsg, lambda message: None).first()
        hold_deadman(inputs, TURN_ARB.kinds[0][1][0], lambda: chip.counts(0) == COUNTS[LEFT])
        for what, kind in TURN_ARB.kinds:
            times_ms.setdefault(what, []).extend(trials(inputs, count, kind, reached(chip), lambda: 0.0)[0])
