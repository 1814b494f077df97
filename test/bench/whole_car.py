"""Whole cars by demo.launch, one, two and four on one master: the CPU of their nodes, without simulators."""
from __future__ import annotations

import time
import xmlrpc.client
from typing import Iterator, NamedTuple

import rosgraph
import rospy

from waiting import NodeProcess, eventually

from .effort import Effort
from .rows import Row, Summary, Target
from .stage import CpuMeter, Ear, IdleMeter, Stage

FOUR = ("turn_arb", "pca9685", "teensy_sensor_hub", "generic_value_converter")
OTHERS = ("teleop_logi", "car_sim")
PATIENCE_S = 60
SETTLED_S = 1.0
SPEED_MPS = 3.0  # at which the wheels' pulses make the most reports, one in 5 ms
LINEAR = 1.05  # 4 cars ≤ 4.2 × one
FULL_RATE_HZ = 180  # from here on it's the full rate
SATURATED_PERCENT = 10  # idle, below which the machine itself is what is measured
LAUNCH = '''<launch>{}</launch>'''
CAR = '''<include file="$(find car_interface)/launch/demo.launch">
  <arg name="ns" value="{ns}"/><arg name="port" value="{port}"/><arg name="drive" value="false"/>{more}</include>'''


class Drive(NamedTuple):
    """What so many cars took."""

    percents: list[float]  # of a core, for each car its four nodes
    by_node: str  # in words
    reports_hz: float  # of the wheels, of the car with the fewest
    idle_percent: float  # of the machine

    def __str__(self) -> str:
        rate = f"{self.reports_hz:.0f} reports of the wheels a second"
        slow = "" if self.reports_hz > FULL_RATE_HZ else ", not the full rate"
        return (f"a car's nodes: {self.by_node}; {rate}{slow}; "
                f"{self.idle_percent:.0f} % of the machine were idle"
                f"{'' if self.idle_percent > SATURATED_PERCENT else ': it was saturated'}")


def measure_car(effort: Effort, stage: Stage) -> Iterator[Row]:
    """Every car in a circle by its planner, so fast that its wheels report as often as the Teensy does at all.

    Cars join those that drive already.
    """
    namespaces: list[str] = []
    processes: list[NodeProcess] = []
    one = None
    try:
        for count in effort.cars:
            new = [f"/bench{index + 1}" for index in range(len(namespaces), count)]
            namespaces += new
            processes += join(stage, new)
            drive = watch(effort.drive_s, namespaces)
            name = "1 car" if count == 1 else f"{count} cars"
            yield Row("car", f"{name}: CPU of the four nodes, of each car", "% of core", Summary.of(drive.percents),
                      (Target("max", high=25),), note=str(drive))
            total = sum(drive.percents)
            if one is None:
                one = total
            else:
                yield Row("car", f"{name}: CPU of all, × one car", "×", Summary.of([total / one]),
                          (Target(high=LINEAR * count),))
    finally:
        stage.end(*processes)


def join(stage: Stage, namespaces: list[str], nodes=(*FOUR, *OTHERS), arguments: dict | None = None
         ) -> list[NodeProcess]:
    """Launch cars, with these arguments besides, and have them drive."""
    more = "".join(f'<arg name="{name}" value="{value}"/>' for name, value in (arguments or {}).items())
    path = stage.path(f"{namespaces[0][1:]}.launch")
    with open(path, "w", encoding="utf-8") as file:
        file.write(LAUNCH.format("".join(CAR.format(ns=ns, port=stage.path(f"teensy{ns[1:]}"), more=more)
                                         for ns in namespaces)))
    launch = stage.start("roslaunch", path)
    eventually(lambda: all(pid_of(f"{ns}/{node}") for ns in namespaces for node in nodes), "the cars",
               PATIENCE_S)
    drivers = stage.actors(*(("drive", str(SPEED_MPS), f"__ns:={ns}") for ns in namespaces))
    for driver in drivers:
        driver.stdout.wait_for(lambda line: line == "drives", within_s=PATIENCE_S)
    time.sleep(SETTLED_S)
    return [*drivers, launch]


def watch(drive_s: float, namespaces: list[str]) -> Drive:
    """Measure cars that drive."""
    reports = [Ear(f"{ns}/teensy_wheel", rospy.AnyMsg, lambda message: None).connected() for ns in namespaces]
    meters = {(ns, node): CpuMeter(pid_of(f"{ns}/{node}")) for ns in namespaces for node in (*FOUR, *OTHERS)}
    idle = IdleMeter()
    for ear in reports:
        ear.all()
    time.sleep(drive_s)
    used = {key: meter.percent() for key, meter in meters.items()}
    idle_percent, reports_hz = idle.percent(), min(len(ear.all()) for ear in reports) / drive_s
    for ear in reports:
        ear.close()
    means = {node: sum(used[ns, node] for ns in namespaces) / len(namespaces) for node in (*FOUR, *OTHERS)}
    return Drive([sum(used[ns, node] for node in FOUR) for ns in namespaces],
                 ", ".join(f"{node} {percent:.1f}" for node, percent in means.items()), reports_hz, idle_percent)


def pid_of(node: str) -> int | None:
    """A node's process, by asking the node; None while it isn't there."""
    try:
        uri = rosgraph.Master("/bench").lookupNode(node)
        return xmlrpc.client.ServerProxy(uri).getPid("/bench")[2]
    except (rosgraph.MasterException, OSError):
        return None
