"""What each node takes: to its first message, and in memory."""
from __future__ import annotations

import time
from typing import Callable, Iterator, NamedTuple

import rospy

from .effort import Effort
from .rows import MEDIAN, WORST, Row, Summary, Target
from .stage import PACKAGE, Ear, Stage, rss_mb

BARE = "test/bench/bare.py"  # rosrun takes a path inside a package, too
INPUTS = ("human", "steering", "radius", "acceleration", "odometry", "joy")


class Subject(NamedTuple):
    """A node: how to start it, and where its first message comes."""

    name: str
    topic: str
    arguments: Callable[[Stage], tuple] = lambda stage: ()
    config: tuple[str, ...] = ()


SUBJECTS = (
    Subject("turn_arb", "/servo/cmdVector", config=("turn_arb.yaml",)),
    Subject("pca9685", "/servo/output", lambda stage: ("_device:=virtual",), ("pca9685.yaml",)),
    Subject("teensy_sensor_hub", "/teensy_wheel", lambda stage: (f"_port:={stage.path('teensy')}",),
            ("teensy_sensor_hub.yaml", "sonars.yaml")),
    Subject("generic_value_converter", "/generic_value_converter/output/value", lambda stage: (
        f"_csv_path_value_map:={PACKAGE}/config/value_map.csv",
        "generic_value_converter/input/control_cmd:=control/command/control_cmd",
        "generic_value_converter/input/odometry:=odom"), ("generic_value_converter.yaml",)),
    Subject("teleop_logi", "/teleop_logi/human_in_loop", config=("teleop_logi.yaml",)),
)
FLOOR = Subject(BARE, "/bare/beat")


def surroundings(stage: Stage) -> list:
    """What the nodes hear: everything that they listen to at 50 Hz, and a full line."""
    line, inputs = stage.actors(("line", stage.path("teensy")), ("inputs", *INPUTS))
    line.tell("go 1")
    for subject in SUBJECTS:
        stage.load(f"/{subject.name}", *subject.config)
    return [line, inputs]


def begin(stage: Stage, subject: Subject):
    """Start a node; it, and the seconds until its first message was heard."""
    ear = Ear(subject.topic, rospy.AnyMsg, lambda message: message._connection_header["callerid"])
    time.sleep(0.1)
    begun_ns = time.monotonic_ns()
    process = stage.node(subject.name, *subject.arguments(stage))
    own = "/" + ("bare" if subject is FLOOR else subject.name)
    took_s = (ear.first(lambda caller: caller == own) - begun_ns) / 1e9
    ear.close()
    return process, took_s


def measure_start(effort: Effort, stage: Stage) -> Iterator[Row]:
    """From rosrun to the callback of a subscriber that waits for it; the nodes by turns, a bare one among them."""
    times_s: dict = {subject: [] for subject in (FLOOR, *SUBJECTS)}
    with stage.running(*surroundings(stage)):
        for _ in range(effort.starts):
            for subject, times in times_s.items():
                process, took_s = begin(stage, subject)
                times.append(took_s)
                stage.end(process)
    floor = Summary.of(times_s.pop(FLOOR))
    for subject, times in times_s.items():
        yield Row("start", f"start: {subject.name}", "s", Summary.of(times),
                  (Target(MEDIAN, high=0.8), Target(WORST)), floor)


def measure_memory(effort: Effort, stage: Stage) -> Iterator[Row]:
    """All nodes at once with everything that they listen to; then what each has in memory."""
    with stage.running(*surroundings(stage)):
        processes = {subject: stage.node(subject.name, *subject.arguments(stage)) for subject in (FLOOR, *SUBJECTS)}
        with stage.running(*processes.values()):
            ears = [Ear(subject.topic, rospy.AnyMsg, lambda message: None) for subject in processes]
            for ear in ears:
                ear.first()
            time.sleep(effort.memory_s)
            used_mb = {subject: rss_mb(process.pid) for subject, process in processes.items()}
            for ear in ears:
                ear.close()
    floor_mb = used_mb.pop(FLOOR)
    for subject, mb in used_mb.items():
        yield Row("memory", f"memory: {subject.name} (RSS)", "MB", Summary.of([mb]),
                  (Target(high=round(1.2 * floor_mb, 1)),), Summary.of([floor_mb]), "the target is 1.2 × bare rospy's")
