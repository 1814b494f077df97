"""rosrun car_interface doctor: what is wrong with this car, and what to do about it.

It looks at this computer, the devices, the master and the nodes; each line is ok, warn or bad, with the remedy, and the
exit code is the worst of them: 0, 1 or 2. It changes nothing, needs neither a master nor hardware, and leaves devices
alone that a node or another program uses.

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
from typing import Iterator

from car_interface.pca9685.config import AUTO, VIRTUAL
from car_interface.tools.doctor.board import ADDRESSES
from car_interface.tools.doctor.examination import Task, examine
from car_interface.tools.doctor.findings import BAD, Finding, render, summarise, worst

TOPICS = "car_interface.tools.doctor.topics"  # imported only when there is a master: it imports rospy
LEAVE_S = 0.5


def read_options(arguments: list[str]) -> argparse.Namespace:
    """Return the command line; remappings, which roslaunch adds, are left out."""
    parser = argparse.ArgumentParser(
        prog="doctor", description="Looks for what is wrong with this car. Exit code: 0 ok, 1 warnings, 2 bad.")
    parser.add_argument("--port", help="the Teensy's serial port")
    parser.add_argument("--i2c", dest="bus", help=f"the servo board's bus: a path, a number, {AUTO}, or {VIRTUAL}")
    parser.add_argument("--address", type=lambda text: int(text, 0), help="the servo board's address, such as 0x40")
    parser.add_argument("--ns", dest="namespace", default=os.environ.get("ROS_NAMESPACE"),
                        help="the car's namespace; by default that of the car that runs")
    parser.add_argument("--probe", action="store_true",
                        help="look for a servo board on all I2C buses; chips of the computer's own are asked, too")
    options = parser.parse_args([argument for argument in arguments if ":=" not in argument])
    if options.address is not None and options.address not in ADDRESSES:
        parser.error(f"--address is 0x{options.address:02x}; accepted: 0x{ADDRESSES[0]:02x} to 0x{ADDRESSES[-1]:02x}")
    if options.namespace is not None:
        options.namespace = "/" + options.namespace.strip("/")
    return options


def show(findings: Iterator[Finding]) -> int:
    """Print each finding as soon as it's there, and their count; return the worst level."""
    is_terminal = sys.stdout.isatty()
    width = shutil.get_terminal_size((100, 24)).columns if is_terminal else None
    colour = is_terminal and "NO_COLOR" not in os.environ and os.environ.get("TERM", "dumb") != "dumb"
    found = []
    for finding in findings:
        found.append(finding)
        print(render(finding, width, colour), flush=True)
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
