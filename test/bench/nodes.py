"""Each node's time from its start to its first message, and its memory."""
from __future__ import annotations

import time
from typing import Callable, Iterator, NamedTuple

import rospy

from .effort import Effort
from .meters import rss_mb, with_guard
from .rows import MEDIAN, WORST, Row, Summary, Target
from .stage import PACKAGE, Stage, TimedSubscriber

BARE = "test/bench/bare.py"  # rosrun takes a path inside a package, too
INPUTS = ("human", "steering", "radius", "acceleration", "odometry", "joy", "twist")


class Subject(NamedTuple):
    """A node: the topic of its first message, and arguments and files in config/ as its launch file has them."""

    name: str
    topic: str
    arguments: Callable[[Stage], tuple] = lambda stage: ()
    config: tuple[str, ...] = ()


SUBJECTS = (
    Subject("turn_arb", "/servo/cmdVector", lambda stage: ("turn_arb/input/odometry:=odom",), ("turn_arb.yaml",)),
    Subject("throttle_arb", "/servo/cmdVector", lambda stage: (
        f"_csv_path_value_map:={PACKAGE}/config/value_map.csv", "throttle_arb/input/odometry:=odom",
        "throttle_arb/input/value:=generic_value_converter/output/value"), ("throttle.yaml", "sonar_hub/sonars.yaml")),
    Subject("pca9685", "/servo/output", lambda stage: ("_device:=virtual",),
            ("pca9685.yaml", "steering/turn_arb.yaml", "esc/throttle.yaml")),
    Subject("teensy_sensor_hub", "/teensy_wheel", lambda stage: (f"_port:={stage.path('teensy')}",),
            ("teensy_sensor_hub.yaml", "sonars.yaml")),
    Subject("generic_value_converter", "/generic_value_converter/output/value", lambda stage: (
        f"_csv_path_value_map:={PACKAGE}/config/value_map.csv",
        "generic_value_converter/input/control_cmd:=control/command/control_cmd",
        "generic_value_converter/input/odometry:=odom"), ("generic_value_converter.yaml",)),
    Subject("planner_interface", "/planner_interface/output/control_cmd", lambda stage: (
        "_source:=cmd_vel", "planner_interface/input/odometry:=odom"),
            ("planner_interface.yaml", "wheels/teensy_sensor_hub.yaml")),
    Subject("teleop_logi", "/teleop_logi/human_in_loop", config=("teleop_logi.yaml",)),
)
FLOOR = Subject(BARE, "/bare/timer")


def start_inputs(stage: Stage) -> list:
    """Start what the nodes receive: all their inputs at 50 Hz, and a full line."""
    line, inputs = stage.actors(("line", stage.path("teensy")), ("inputs", "turn_arb,throttle_arb", *INPUTS))
    line.tell("go 1")
    for subject in SUBJECTS:
        stage.load(f"/{subject.name}", *subject.config)
    return [line, inputs]


def start_node(stage: Stage, subject: Subject):
    subscriber = TimedSubscriber(subject.topic, rospy.AnyMsg, lambda message: message._connection_header["callerid"])
    time.sleep(0.1)
    begun_ns = time.monotonic_ns()
    process = stage.node(subject.name, *subject.arguments(stage))
    name = "/" + ("bare" if subject is FLOOR else subject.name)
    took_s = (subscriber.first(lambda caller: caller == name) - begun_ns) / 1e9
    subscriber.close()
    return process, took_s


def measure_start(effort: Effort, stage: Stage) -> Iterator[Row]:
    """Measure from rosrun to the callback of a waiting subscriber; the nodes in turns, a bare one among them."""
    times_s: dict = {subject: [] for subject in (FLOOR, *SUBJECTS)}
    with stage.running(*start_inputs(stage)):
        for _ in range(effort.starts):
            for subject, times in times_s.items():
                process, took_s = start_node(stage, subject)
                times.append(took_s)
                stage.end(process)
    floor = Summary.of(times_s.pop(FLOOR))
    for subject, times in times_s.items():
        yield Row("start", f"start: {subject.name}", "s", Summary.of(times),
                  (Target(MEDIAN, high=0.8), Target(WORST)), floor)


def measure_memory(effort: Effort, stage: Stage) -> Iterator[Row]:
    with stage.running(*start_inputs(stage)):
        processes = {subject: stage.node(subject.name, *subject.arguments(stage)) for subject in (FLOOR, *SUBJECTS)}
        with stage.running(*processes.values()):
            for subject in processes:
                TimedSubscriber(subject.topic, rospy.AnyMsg, lambda message: None).first()
            time.sleep(effort.memory_s)
            used_mb = {subject: rss_mb(process.pid) for subject, process in processes.items()}
            guard_mb = [rss_mb(pid) for process in processes.values() for pid in with_guard(process.pid)[1:]]
    floor_mb = used_mb.pop(FLOOR)
    for subject, mb in used_mb.items():
        yield Row("memory", f"memory: {subject.name} (RSS)", "MB", Summary.of([mb]),
                  (Target(max_ratio=1.2),), Summary.of([floor_mb]))
    yield Row("memory", "memory: pca9685's guard (RSS)", "MB", Summary.of(guard_mb) if guard_mb else None,
              note="it imports no rospy")
