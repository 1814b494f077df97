"""rosrun car_interface doctor: what is wrong with this car, and what to do about it.

It looks at this computer, the devices, the master and the nodes; each line is ok, warn or bad, with the remedy, and the
exit code is the worst of them: 0, 1 or 2. It changes nothing, needs neither a master nor hardware, and leaves devices
alone that a node or another program uses.

Options:
    --port, --i2c, --address: the devices; by default those that the nodes' parameters name, else those of car.launch.
    --ns: the car's namespace; by default ROS_NAMESPACE.
"""
from __future__ import annotations

import argparse
import io
import os
import shutil
import sys
import threading
import time
from typing import Any, Callable, Iterator, NamedTuple

from car_interface.common.errors import ConfigError
from car_interface.common.params import Params
from car_interface.doctor.checks.board import ADDRESSES
from car_interface.doctor.checks.car import Node, check_diagnostics, check_nodes, check_parameters, check_steering
from car_interface.doctor.checks.findings import BAD, OK, WARN, Finding, render, summarise, worst
from car_interface.doctor.checks.port import check_link
from car_interface.doctor.probes.computer import probe_clock, probe_groups, probe_network, probe_versions
from car_interface.doctor.probes.devices import is_pseudo_terminal, probe_board, probe_port
from car_interface.doctor.probes.master import NODES, Master, read_parameters
from car_interface.pca9685.registers import prescale_for
from car_interface.teensy.link.health import LINK_REPORT

VIRTUAL = "virtual"
STABLE_PORT, USUAL_PORT, USUAL_BUS, USUAL_ADDRESS = "/dev/teensy_sensor_hub", "/dev/ttyAMA0", "/dev/i2c-1", 0x40
USUAL_BAUD = 115200
# Names and addresses, then the nodes, then all the rest at the same time: 9 s at most.
NETWORK_S, SURVEY_S, LOOK_S, LEAVE_S = 2.0, 2.0, 4.5, 0.5
REPORTING = ("turn_arb", "pca9685", "teensy_sensor_hub", "generic_value_converter")


def read_options(arguments: list[str]) -> argparse.Namespace:
    """The command line; remappings, which roslaunch adds, are left out."""
    parser = argparse.ArgumentParser(
        prog="doctor", description="Looks for what is wrong with this car. Exit code: 0 ok, 1 warnings, 2 bad.")
    parser.add_argument("--port", help="the Teensy's serial port")
    parser.add_argument("--i2c", help=f"the servo board's bus: a path, a number, or {VIRTUAL}")
    parser.add_argument("--address", type=lambda text: int(text, 0), help="the servo board's address, such as 0x40")
    parser.add_argument("--ns", default=os.environ.get("ROS_NAMESPACE", "/"), help="the car's namespace")
    options = parser.parse_args([argument for argument in arguments if ":=" not in argument])
    options.ns = "/" + options.ns.strip("/")
    if options.address is not None and options.address not in ADDRESSES:
        parser.error(f"--address is 0x{options.address:02x}; accepted: 0x{ADDRESSES[0]:02x} to 0x{ADDRESSES[-1]:02x}")
    return options


class Task:
    """A look at something, in a thread of its own: whatever hangs there, the doctor goes on.

    Args:
        subject: for the finding when it hangs or fails.
        look: returns the result.
        arguments: what ``look`` takes.
    """

    def __init__(self, subject: str, look: Callable[..., Any], *arguments: Any):
        self._subject = subject
        self._result: Any = None
        self._fault: Exception | None = None
        self._look = lambda: look(*arguments)
        self._ended = threading.Event()
        threading.Thread(target=self._run, name=subject, daemon=True).start()

    def _run(self):
        try:
            self._result = self._look()
        except Exception as error:  # no fault of one look may end the others
            self._fault = error
        self._ended.set()

    def wait(self, deadline_s: float) -> tuple[Any, list[Finding]]:
        """The result, or ``None`` and what went wrong, at the latest when the monotonic clock reaches the deadline."""
        while not self._ended.wait(0.02):
            if time.monotonic() >= deadline_s:
                return None, [Finding(BAD, self._subject, "no answer in time: given up",
                                      "See whether this computer is overloaded or a device hangs: top, dmesg")]
        if self._fault is not None:
            return None, [Finding(BAD, self._subject, f"the doctor couldn't look at it: {type(self._fault).__name__}: "
                                                      f"{self._fault}", "See the line of the versions first")]
        return self._result, []

    def findings(self, deadline_s: float) -> list[Finding]:
        """Of a look that returns findings."""
        result, trouble = self.wait(deadline_s)
        return trouble or result


class Car(NamedTuple):
    """What the master knows of the car, and the devices that it goes by."""

    nodes: list
    uses_sim_time: bool
    port: str
    baud: int
    bus: str
    address: int
    prescale: int | None
    oscillator_hz: float
    port_is_the_nodes: bool  # whether the port is the one that the hub uses

    def runs(self, name: str) -> Node | None:
        """A node that is there and answers."""
        return next((node for node in self.nodes if node.name == name and node.answers), None)


def survey(master: Master | None, options: argparse.Namespace) -> Car:
    """Ask the master for nodes and for the devices' parameters; without one, the usual ones."""
    tasks = [Task("nodes", master.node, name, options.ns) for name in NODES] if master else []
    hub = _parameters(master, options.ns, "teensy_sensor_hub")
    board = _parameters(master, options.ns, "pca9685")
    of_hub = _text(hub, "port")
    port = options.port or of_hub or (STABLE_PORT if os.path.exists(STABLE_PORT) else USUAL_PORT)
    prescale, oscillator_hz = _prescale(board)
    answers = [task.wait(time.monotonic() + SURVEY_S)[0] for task in tasks]
    return Car(
        nodes=[node for node in answers if node is not None],
        uses_sim_time=bool(master and master.parameter("/use_sim_time")),
        port=port, baud=_number(hub, "baud", USUAL_BAUD),
        bus=_bus(options.i2c or _text(board, "device") or _number(board, "device", USUAL_BUS)),
        address=options.address or _number(board, "address", USUAL_ADDRESS),
        prescale=prescale, oscillator_hz=oscillator_hz,
        port_is_the_nodes=bool(of_hub) and os.path.realpath(port) == os.path.realpath(of_hub))


def _parameters(master, namespace, node):
    values = master.parameter(f"{namespace.rstrip('/')}/{node}") if master else None
    return Params(values if isinstance(values, dict) else {})


def _text(params, name):
    """A text among the parameters; ``None`` when there is none, or nonsense: that is told as a bad parameter."""
    try:
        return params.text(name, None)
    except ConfigError:
        return None


def _number(params, name, default):
    try:
        return params.integer(name, None) or default
    except ConfigError:
        return default


def _bus(device):
    return f"/dev/i2c-{device}" if str(device).isdigit() else device


def _prescale(board):
    """The PRE_SCALE and the oscillator that the pca9685 node's parameters ask for; ``None`` = nobody asks."""
    try:
        oscillator_hz = board.number("oscillator_hz", 25e6, low=1e6, high=50e6)
        prescale = board.integer("prescale", None)
        if prescale is None:
            prescale = prescale_for(board.number("frequency", 50.0, above=0.0), oscillator_hz)
        return prescale, oscillator_hz
    except ConfigError:
        return None, 25e6


def examine(options: argparse.Namespace) -> Iterator[Finding]:
    """All findings, in the order in which they're best cured."""
    uri = os.environ.get("ROS_MASTER_URI", "")
    master = Master(uri)
    versions = Task("versions", probe_versions)
    network = Task("master", probe_network, uri, master.trouble)
    (of_master, of_address, is_there), trouble = _or(network.wait(time.monotonic() + NETWORK_S), ([], [], False))
    car, survey_trouble = Task("nodes", survey, master if is_there else None, options).wait(time.monotonic() + SURVEY_S)
    if car is None:
        is_there, car = False, survey(None, options)
    deadline_s = time.monotonic() + LOOK_S
    virtual_port, virtual_bus = is_pseudo_terminal(car.port), car.bus == VIRTUAL
    groups = Task("groups", probe_groups, car.port, car.bus, virtual_port, virtual_bus)
    clock = Task("clock", probe_clock, car.uses_sim_time)
    parameters = Task("parameters", _read_all, master, car) if is_there else None
    hub = car.runs("teensy_sensor_hub") if car.port_is_the_nodes else None
    port = None if hub else Task("port", probe_port, car.port, car.baud)
    board = None if virtual_bus else Task("bus", probe_board, car.bus, car.address, car.prescale,
                                          car.runs("pca9685") is not None, car.oscillator_hz)
    reporting = [node.path for node in map(car.runs, REPORTING) if node]
    topics = Task("topics", _listen, car, hub, reporting) if reporting else None

    yield from versions.findings(deadline_s)
    yield from groups.findings(deadline_s)
    yield from clock.findings(deadline_s)
    yield from trouble + of_master + of_address + survey_trouble
    if is_there:
        yield from check_nodes(car.nodes, options.ns)
    if parameters:
        yield from parameters.findings(deadline_s)
    if hub:
        yield Finding(OK, "port", f"{car.port} is {hub.path}'s")
    else:
        yield from port.findings(deadline_s)
    heard, topics_trouble = topics.wait(deadline_s) if topics else (None, [])
    if heard and hub:
        yield from check_link(heard.link, hub.path)
    yield from board.findings(deadline_s) if board else [_virtual_board(car)]
    yield from topics_trouble
    if heard:
        if car.runs("turn_arb"):
            yield from check_steering(heard.steering, car.runs("turn_arb").path)
        yield from check_diagnostics(heard.reports, options.ns, reporting,
                                     told=[f"{hub.path.strip('/')}: {LINK_REPORT}"] if hub and heard.link else [])


def _or(result_and_trouble, default):
    result, trouble = result_and_trouble
    return (default if result is None else result), trouble


def _read_all(master, car):
    readings = (read_parameters(master, node) for node in car.nodes)
    return check_parameters([reading for reading in readings if reading is not None])


def _listen(car, hub, reporting):
    from car_interface.doctor.probes.topics import listen  # it needs rospy, which may be what is missing
    turn_arb = car.runs("turn_arb")
    return listen(hub and hub.path, turn_arb and turn_arb.path, reporting)


def _virtual_board(car):
    node = car.runs("pca9685")
    if node:
        return Finding(OK, "bus", f"virtual: the chip is a piece of software in {node.path}")
    return Finding(WARN, "bus", "virtual: the chip is a piece of software, and the pca9685 node that it's part of "
                                "doesn't run", "roslaunch car_interface demo.launch; or give the real bus by --i2c")


def show(findings: Iterator[Finding]) -> int:
    """Print each finding as soon as it's there, and the sum; returns the worst level."""
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
    if "car_interface.doctor.probes.topics" in sys.modules:
        Task("topics", sys.modules["car_interface.doctor.probes.topics"].leave).wait(time.monotonic() + LEAVE_S)
    os._exit(code)  # a look that still hangs must not keep the doctor from ending
