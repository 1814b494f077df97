"""CPU of the nodes of whole cars by demo.launch, one, two and four on one master, without the simulators."""
from __future__ import annotations

import time
import xmlrpc.client
from typing import Iterator, NamedTuple

import rosgraph
import rospy

from waiting import NodeProcess, eventually

from .effort import Effort
from .meters import CpuMeter, IdleMeter
from .rows import Row, Summary, Target
from .stage import Stage, TimedSubscriber

FOUR = ("turn_arb", "pca9685", "teensy_sensor_hub", "generic_value_converter")
OTHERS = ("throttle_arb", "teleop_logi", "car_sim")
PATIENCE_S = 60
SETTLED_S = 1.0
SPEED_MPS = 3.0  # at which the wheels' pulses cause the highest rate of reports, one in 5 ms
LINEAR = 1.05  # 4 cars ≤ 4.2 × one
FULL_RATE_HZ = 180  # above it, it is the full rate
SATURATED_PERCENT = 10  # idle; below it the machine itself is measured
CAR = '''<include file="$(find car_interface)/launch/demo.launch">
  <arg name="ns" value="{ns}"/><arg name="port" value="{port}"/><arg name="drive" value="false"/>{more}</include>'''


class Drive(NamedTuple):
    """The CPU time of several cars."""

    percents: list[float]  # of a core, for each car its four nodes
    by_node: str  # for the note
    reports_hz: float  # of the wheels, of the car with the fewest
    idle_percent: float  # of the machine

    def __str__(self) -> str:
        rate = f"{self.reports_hz:.0f} reports of the wheels a second"
        slow = "" if self.reports_hz > FULL_RATE_HZ else ", not the full rate"
        return (f"a car's nodes: {self.by_node}; {rate}{slow}; "
                f"{self.idle_percent:.0f} % of the machine were idle"
                f"{'' if self.idle_percent > SATURATED_PERCENT else ': it was saturated'}")


def measure_car(effort: Effort, stage: Stage) -> Iterator[Row]:
    """Measure cars that drive circles, at a speed at which the wheels report at the Teensy's highest rate.

    One drives, then more are launched beside it.
    """
    namespaces: list[str] = []
    processes: list[NodeProcess] = []
    one = None
    try:
        for count in effort.cars:
            new = [f"/bench{index + 1}" for index in range(len(namespaces), count)]
            namespaces += new
            processes += launch_cars(stage, new)
            drive = measure_drive(effort.drive_s, namespaces)
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


def launch_cars(stage: Stage, namespaces: list[str], nodes=(*FOUR, *OTHERS), arguments: dict | None = None,
                steering: tuple[str, ...] = ()) -> list[NodeProcess]:
    """Launch cars, with these arguments of demo.launch, and wait until they drive; ``steering``: of the role drive."""
    more = "".join(f'<arg name="{name}" value="{value}"/>' for name, value in (arguments or {}).items())
    path = stage.path(f"{namespaces[0][1:]}.launch")
    with open(path, "w", encoding="utf-8") as file:
        cars = [CAR.format(ns=ns, port=stage.path(f"teensy{ns[1:]}"), more=more) for ns in namespaces]
        file.write(f"<launch>{''.join(cars)}</launch>")
    launch = stage.start("roslaunch", path)
    eventually(lambda: all(pid_of(f"{ns}/{node}") for ns in namespaces for node in nodes), "the cars",
               PATIENCE_S)
    drivers = stage.actors(*(("drive", str(SPEED_MPS), *steering, f"__ns:={ns}") for ns in namespaces))
    for driver in drivers:
        driver.stdout.wait_for(lambda line: line == "drives", within_s=PATIENCE_S)
    time.sleep(SETTLED_S)
    return [*drivers, launch]


def measure_drive(drive_s: float, namespaces: list[str]) -> Drive:
    """Measure cars that drive."""
    reports = [TimedSubscriber(f"{ns}/teensy_wheel", rospy.AnyMsg, lambda message: None).connected()
               for ns in namespaces]
    meters = {(ns, node): CpuMeter(pid_of(f"{ns}/{node}")) for ns in namespaces for node in (*FOUR, *OTHERS)}
    idle = IdleMeter()
    for report in reports:
        report.drain()
    time.sleep(drive_s)
    used = {key: meter.percent() for key, meter in meters.items()}
    idle_percent, reports_hz = idle.percent(), min(len(report.drain()) for report in reports) / drive_s
    for report in reports:
        report.close()
    means = {node: sum(used[ns, node] for ns in namespaces) / len(namespaces) for node in (*FOUR, *OTHERS)}
    return Drive([sum(used[ns, node] for node in FOUR) for ns in namespaces],
                 ", ".join(f"{node} {percent:.1f}" for node, percent in means.items()), reports_hz, idle_percent)


def pid_of(node: str) -> int | None:
    """Return the id of a node's process, or None while it is not registered or does not answer."""
    try:
        uri = rosgraph.Master("/bench").lookupNode(node)
        return xmlrpc.client.ServerProxy(uri).getPid("/bench")[2]
    except (rosgraph.MasterException, OSError):
        return None
