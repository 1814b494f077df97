"""CPU of the nodes of whole cars by demo.launch, one, two and four on one master, without the simulators.

All that a car runs, but for the gamepad's driver: its messages come from an actor.
"""
from __future__ import annotations

import time
from typing import Iterator, NamedTuple

import rospy

from closing import pid_of
from waiting import NodeProcess, eventually

from .driver import RADIUS_M
from .effort import Effort
from .meters import CpuMeter, with_guard
from .rows import Row, Summary, Target
from .stage import Stage, TimedSubscriber

FOUR = ("turn_arb", "pca9685", "teensy_sensor_hub", "generic_value_converter")
ALL = ("turn_arb", "throttle_arb", "pca9685", "teensy_sensor_hub", "generic_value_converter", "teleop_logi")
SIMULATOR, GUARD = "car_sim", "the guard"
PLANNER = "planner_interface"
MAX_PERCENT, MAX_FOUR_PERCENT = 30, 25  # of a core, for a car
PATIENCE_S = 60
SETTLED_S = 1.0
SPEED_MPS = 3.0  # at which the wheels' pulses cause the highest rate of reports, one in 5 ms
LINEAR = 1.05  # 4 cars ≤ 4.2 × one
CAR = '''<include file="$(find car_interface)/launch/demo.launch">
  <arg name="ns" value="{ns}"/><arg name="port" value="{port}"/><arg name="drive" value="false"/>
  <arg name="collisions" value="false"/>{more}</include>
  <rosparam param="{ns}/car_sim/start">[0.0, -{radius_m}, 0.0]</rosparam>'''  # the circle is in the middle of the room


class Drive(NamedTuple):
    percents: list[float]  # of a core, for each car all of its nodes, and the guard
    four_percents: list[float]  # the four without throttle and gamepad
    by_node: str  # for the note
    reports_hz: float  # of the wheels, of the car with the fewest

    def __str__(self) -> str:
        slow = "" if self.reports_hz > 180 else ", not the full rate"
        return f"a car's processes: {self.by_node}; {self.reports_hz:.0f} reports of the wheels a second{slow}"


def measure_car(effort: Effort, stage: Stage) -> Iterator[Row]:
    """Measure cars that drive circles, at a speed at which the wheels report at the Teensy's highest rate.

    One drives, then more are launched beside it; then one whose planner drives by planner_interface.
    """
    namespaces: list[str] = []
    processes: list[NodeProcess] = []
    one = None
    try:
        for count in effort.cars:
            new = [f"/bench{index + 1}" for index in range(len(namespaces), count)]
            namespaces += new
            processes += launch_cars(stage, new, (*ALL, SIMULATOR))
            drive = measure_drive(effort.drive_s, namespaces, ALL)
            name = "1 car" if count == 1 else f"{count} cars"
            yield _row(f"{name}: CPU of all its nodes", drive.percents, MAX_PERCENT, str(drive))
            total = sum(drive.percents)
            if one is None:
                one = total
                yield _row(f"{name}: CPU of the four nodes without throttle", drive.four_percents, MAX_FOUR_PERCENT,
                           ", ".join(FOUR))
            else:
                yield Row("car", f"{name}: CPU of all, × one car", "×", Summary.of([total / one]),
                          (Target(high=LINEAR * count),))
    finally:
        stage.end(*processes)
    nodes, namespace = (*ALL, PLANNER), "/bench_planner"
    with stage.running(*launch_cars(stage, [namespace], (*nodes, SIMULATOR), {"planner": "cmd_vel"}, ("cmd_vel",))):
        drive = measure_drive(effort.drive_s, [namespace], nodes)
    yield _row(f"1 car, {PLANNER} too: CPU of all its nodes", drive.percents, MAX_PERCENT, str(drive))


def _row(what, percents, max_percent, note):
    cars = ", of each car" if len(percents) > 1 else ""
    return Row("car", what + cars, "% of core", Summary.of(percents), (Target("max", high=max_percent),), note=note)


def launch_cars(stage: Stage, namespaces: list[str], nodes: tuple[str, ...], arguments: dict | None = None,
                drive: tuple[str, ...] = ()) -> list[NodeProcess]:
    """Launch cars, with these arguments of demo.launch, and wait until they drive; ``drive``: options of that role."""
    more = "".join(f'<arg name="{name}" value="{value}"/>' for name, value in (arguments or {}).items())
    path = stage.path(f"{namespaces[0][1:]}.launch")
    with open(path, "w", encoding="utf-8") as file:
        cars = [CAR.format(ns=ns, port=stage.path(f"teensy{ns[1:]}"), more=more, radius_m=RADIUS_M)
                for ns in namespaces]
        file.write(f"<launch>{''.join(cars)}</launch>")
    launch = stage.start("roslaunch", path)
    eventually(lambda: all(pid_of(f"{ns}/{node}") for ns in namespaces for node in nodes), "the cars",
               PATIENCE_S)
    drivers = stage.actors(*(("drive", str(SPEED_MPS), *drive, f"__ns:={ns}") for ns in namespaces))
    for driver in drivers:
        driver.stdout.wait_for(lambda line: line == "drives", within_s=PATIENCE_S)
    time.sleep(SETTLED_S)
    return [*drivers, launch]


def measure_drive(drive_s: float, namespaces: list[str], nodes: tuple[str, ...]) -> Drive:
    reports = [TimedSubscriber(f"{ns}/teensy_wheel", rospy.AnyMsg, lambda message: None).connected()
               for ns in namespaces]
    pids = {(ns, node): with_guard(pid_of(f"{ns}/{node}")) for ns in namespaces for node in (*nodes, SIMULATOR)}
    parts = {(ns, name): part for (ns, node), found in pids.items()
             for name, part in ((node, found[:1]), (GUARD, found[1:])) if part}
    meters = {key: CpuMeter(*part) for key, part in parts.items()}
    for report in reports:
        report.drain()
    time.sleep(drive_s)
    used = {key: meter.percent() for key, meter in meters.items()}
    reports_hz = min(len(report.drain()) for report in reports) / drive_s
    for report in reports:
        report.close()

    def of_each_car(names):
        return [sum(used.get((ns, name), 0.0) for name in names) for ns in namespaces]
    means = {name: sum(of_each_car([name])) / len(namespaces) for name in (*nodes, GUARD, SIMULATOR)}
    return Drive(of_each_car((*nodes, GUARD)), of_each_car(FOUR),
                 ", ".join(f"{name} {percent:.1f}" for name, percent in means.items()), reports_hz)
