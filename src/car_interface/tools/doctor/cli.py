"""rosrun car_interface doctor: what is wrong with this car, and what to do about it.

It looks at this computer, the devices, the master and the nodes; each line is ok, warn or bad, with the remedy, and the
exit code is the worst of them: 0, 1 or 2. It changes nothing, needs neither a master nor hardware, and leaves devices
alone that a node or another program uses. All looks run at the same time, each in a ``Task``; their findings come in
the order in which they're best remedied.

Options:
    --port, --i2c, --address: the devices; by default those that the nodes' parameters name, else those of car.launch.
    --ns: the car's namespace; by default ROS_NAMESPACE, else that of the car that runs.
    --probe: look for a servo board on the other I²C buses of this computer, too.
"""
from __future__ import annotations

import argparse
import io
import os
import shutil
import sys
import time
from importlib import import_module
from typing import Iterator

from car_interface.common.black_box_folder import default_folder
from car_interface.pca9685.config import AUTO, VIRTUAL
from car_interface.teensy.link.health import CLOCK_REPORT, LINK_REPORT
from car_interface.teleop.gamepad import DRIVER_REPORT
from car_interface.teleop.gamepad import REPORT as GAMEPAD_REPORT
from car_interface.tools.doctor import car as checks
from car_interface.tools.doctor import computer, devices
from car_interface.tools.doctor.car import ABSENT, SIMULATOR
from car_interface.tools.doctor.findings import BAD, OK, WARN, Finding, PaceWatch, Task, first, render, summarise, worst
from car_interface.tools.doctor.master import REPORTING, SURVEY_S, Car, Master, check_files, check_parameters

TOPICS = "car_interface.tools.doctor.topics"  # imported only when there is a master: it needs rospy
# Names and addresses, then the nodes (SURVEY_S), then all the rest at the same time: 9 s at most.
NETWORK_S, PROBES_S = 2.0, 4.5
LEAVE_S = 0.5
BOARD_REPORT = "servo board"  # the pca9685 node's on /diagnostics


def read_options(arguments: list[str]) -> argparse.Namespace:
    """Return the command line; remappings, which roslaunch adds, are left out."""
    parser = argparse.ArgumentParser(
        prog="doctor", description="Looks for what is wrong with this car. Exit code: 0 ok, 1 warnings, 2 bad.")
    parser.add_argument("--port", help="the Teensy's serial port")
    parser.add_argument("--i2c", dest="bus", help=f"the servo board's bus: a path, a number, {AUTO}, or {VIRTUAL}")
    parser.add_argument("--address", type=lambda text: int(text, 0), help="the servo board's address, such as 0x40")
    parser.add_argument("--ns", dest="namespace", type=lambda text: "/" + text.strip("/"),
                        default=os.environ.get("ROS_NAMESPACE"),
                        help="the car's namespace; by default that of the car that runs")
    parser.add_argument("--probe", action="store_true",
                        help="look for a servo board on all I2C buses; chips of the computer's own are asked, too")
    options = parser.parse_args([argument for argument in arguments if ":=" not in argument])
    if options.address is not None and options.address not in devices.ADDRESSES:
        parser.error(f"--address is 0x{options.address:02x}; accepted: 0x{devices.ADDRESSES[0]:02x} to "
                     f"0x{devices.ADDRESSES[-1]:02x}")
    return options


def examine(options: argparse.Namespace) -> Iterator[Finding]:
    """Yield all findings, in the order in which they're best remedied."""
    uri = os.environ.get("ROS_MASTER_URI", "")
    master = Master(uri)
    own = [Task("versions", computer.probe_versions)]  # about this computer itself
    result, of_network = Task("master", computer.probe_network, uri, master.trouble).wait(time.monotonic() + NETWORK_S)
    found, is_there = result or ([], False)
    car, survey_trouble = Task("nodes", Car, master if is_there else None, options).wait(time.monotonic() + SURVEY_S)
    car = car or Car(None, options)
    of_network += found + survey_trouble
    deadline_s = time.monotonic() + PROBES_S
    if not car.was_chosen:
        yield from own[0].findings(deadline_s)
        yield from of_network + checks.check_several(car.others)
        return
    virtual_port, virtual_bus = car.port_is_virtual or devices.is_pseudo_terminal(car.port), car.bus == VIRTUAL
    own += [Task("packages", computer.probe_packages),
            Task("groups", computer.probe_groups, car.port, car.bus, virtual_port, virtual_bus),
            Task("gamepad", computer.probe_driver), Task("clock", computer.probe_clock, car.uses_sim_time)]
    parameters = Task("parameters", lambda: check_parameters(car) + check_files(car)) if car.master else None
    black_box = Task("black box", lambda: checks.check_black_box(car.known_text("black_box", "folder")
                                                                 or default_folder()))
    hub = car.runs("teensy_sensor_hub") if car.port_is_the_nodes else None
    port = None if hub or car.lacks_simulator else Task("port", devices.probe_port, car.port, car.baud)
    board = None if virtual_bus else Task("bus", devices.probe_board, car, options.probe)
    reporting = [node.path for node in map(car.runs, REPORTING) if node]
    topics = Task("topics", lambda: import_module(TOPICS).listen(car, hub, reporting)) if reporting else None

    for task in own:
        yield from task.findings(deadline_s)
    yield from of_network
    if parameters:
        yield from checks.check_nodes(car.nodes.values(), car.namespace, car.others)
        yield from parameters.findings(deadline_s)
    heard, topics_trouble = topics.wait(deadline_s) if topics else (None, [])
    if car.lacks_simulator:
        yield from devices.check_virtual_port(car.port, car.state(SIMULATOR), hub is not None)
    elif port:
        yield from port.findings(deadline_s)
    elif heard:
        yield from devices.check_link(heard.link, car.port, hub)
    of_board = board.findings(deadline_s) if board else _virtual_board(car)
    yield from of_board + topics_trouble
    if heard:
        yield from _check_heard(car, heard, reporting, worst(of_board) == BAD)
    yield from black_box.findings(deadline_s)


def _check_heard(car, heard, reporting, board_is_bad):
    """Yield the findings about who drives, gamepad and reports; a fault that another finding tells is left out."""
    link, gamepad = heard.link, heard.gamepad
    if car.runs("turn_arb"):
        yield from checks.check_steering(heard.steering, car.nodes["turn_arb"])
    reports = checks.reports_of(heard.reports, car.namespace)
    yield from checks.check_command_topics(reports)
    yield from checks.check_battery(reports)
    if gamepad:
        yield from checks.check_gamepad(gamepad)
    yield from checks.check_diagnostics(reports, reporting, {about for is_told, about in (
        (link, LINK_REPORT), (link and link.level != OK, CLOCK_REPORT),
        (board_is_bad and car.runs("pca9685"), BOARD_REPORT),
        (gamepad, GAMEPAD_REPORT), (gamepad and gamepad.driver, DRIVER_REPORT)) if is_told})


def _virtual_board(car):
    node, chip = car.runs("pca9685"), "virtual: the chip is a piece of software"
    return first(
        "bus",
        (not car.master, OK, f"{chip}; whether it runs only a master can tell"),
        (node, OK, f"{chip} that {node and node.path} writes to"),
        (car.state("pca9685") != ABSENT, WARN, f"{chip}, and the pca9685 node doesn't answer", "See the nodes above"),
        (True, WARN, f"{chip}, and the pca9685 node that starts it doesn't run",
         "roslaunch car_interface demo.launch; or give the real bus by --i2c"))


def show(findings: Iterator[Finding]) -> int:
    """Print each finding as soon as it's there, and their count; return the worst level.

    On a busy computer an answer that didn't come in time says nothing.
    """
    pace = PaceWatch()
    is_terminal = sys.stdout.isatty()
    width = shutil.get_terminal_size((100, 24)).columns if is_terminal else None
    colour = is_terminal and "NO_COLOR" not in os.environ and os.environ.get("TERM", "dumb") != "dumb"
    found: list[Finding] = []
    for finding in findings:
        found.append(finding if not (finding.by_silence and pace.is_busy()) else Finding(
            WARN, finding.subject, f"couldn't check, as this computer is busy: {finding.what}",
            "See what keeps it busy (top), and run the doctor again"))
        print(render(found[-1], width, colour), flush=True)
    print(summarise(found, colour), flush=True)
    return worst(found)


def main():
    """Run the doctor."""
    options = read_options(sys.argv[1:])
    if sys.stdout is None:  # it was closed at start
        sys.stdout = io.StringIO()
    else:
        sys.stdout.reconfigure(errors="replace")
    try:
        code = show(examine(options))
    except OSError:
        code = BAD  # nobody reads any more, or the disk is full
    leave = getattr(sys.modules.get(TOPICS), "leave", None)  # None too while a thread is still importing the module
    if leave is not None:
        Task("topics", leave).wait(time.monotonic() + LEAVE_S)
    os._exit(code)  # a look that still hangs must not keep the doctor from ending
