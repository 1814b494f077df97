"""Decides what the doctor looks at, in which order, and for how long.

All probes run at the same time, each in a ``Task``; their findings come in the order in which they're best remedied.
"""
from __future__ import annotations

import os
import threading
import time
from argparse import Namespace
from typing import Any, Callable, Iterator

from car_interface.common.black_box_folder import default_folder, newest
from car_interface.common.device_access import STABLE_PORT
from car_interface.common.errors import ConfigError
from car_interface.common.package_files import package_file
from car_interface.common.params import Params
from car_interface.pca9685.config import AUTO, VIRTUAL
from car_interface.pca9685.registers import prescale_for
from car_interface.teensy.link.health import CLOCK_REPORT, LINK_REPORT
from car_interface.teleop.gamepad import REPORT as GAMEPAD_REPORT
from car_interface.tools.doctor import car as checks
from car_interface.tools.doctor.board import BoardSettings, probe_board
from car_interface.tools.doctor.car import ABSENT, SILENT, SIMULATOR, Node, find_cars
from car_interface.tools.doctor.computer import probe_clock, probe_groups, probe_packages, probe_versions
from car_interface.tools.doctor.findings import BAD, OK, WARN, Finding, first, worst
from car_interface.tools.doctor.gamepad import check_gamepad, probe_driver
from car_interface.tools.doctor.master import NODES, REPORTING, Graph, Master, read_files, read_parameters
from car_interface.tools.doctor.network import probe_network
from car_interface.tools.doctor.port import check_link, check_virtual_port, is_pseudo_terminal, probe_port

USUAL_PORT, USUAL_BAUD, USUAL_ADDRESS = "/dev/ttyAMA0", 115200, 0x40
# Names and addresses, then the nodes, then all the rest at the same time: 9 s at most.
NETWORK_S, SURVEY_S, PROBES_S = 2.0, 2.0, 4.5
NO_GRAPH = Graph({}, frozenset())
BOARD_REPORT = "servo board"  # the pca9685 node's on /diagnostics
TICK_S = 0.02


class PaceWatch:
    """Notices whether this computer is too busy for the doctor's time limits to mean anything."""

    def __init__(self):
        self._start_s = time.monotonic()
        self._ticks = 0
        threading.Thread(target=self._count, name="pace", daemon=True).start()

    def _count(self):
        while True:
            time.sleep(TICK_S)
            self._ticks += 1

    def is_busy(self) -> bool:
        """Return whether a thread that sleeps got less than half of its turns."""
        return 2 * TICK_S * self._ticks < time.monotonic() - self._start_s - TICK_S


class Task:
    """Runs ``probe(*arguments)`` in a thread, so that it may hang; a finding about ``subject`` says that it does."""

    def __init__(self, subject: str, probe: Callable[..., Any], *arguments: Any):
        self._subject = subject
        self._result: Any = None
        self._fault: Exception | None = None
        self._ended = threading.Event()
        threading.Thread(target=self._run, args=(probe, arguments), name=subject, daemon=True).start()

    def _run(self, probe, arguments):
        try:
            self._result = probe(*arguments)
        except Exception as error:  # no fault of one probe may end the others
            self._fault = error
        self._ended.set()

    def wait(self, deadline_s: float, default: Any = None) -> tuple[Any, list[Finding]]:
        """Return the result, or ``default`` and what went wrong, by a deadline of the monotonic clock."""
        while not self._ended.wait(0.02):
            if time.monotonic() >= deadline_s:
                return default, [Finding(BAD, self._subject, "no answer in time: given up",
                                         "See whether a device hangs: dmesg", by_silence=True)]
        if self._fault is not None:
            return default, [Finding(BAD, self._subject, f"the doctor couldn't look at it: {type(self._fault).__name__}"
                                                         f": {self._fault}", "See the line of the versions first")]
        return self._result, []

    def findings(self, deadline_s: float) -> list[Finding]:
        """Return the result of a probe that returns findings, or what went wrong."""
        result, trouble = self.wait(deadline_s)
        return trouble or result


class Car:
    """What the master knows of the car, and the devices that it goes by: those of the parameters, else the usual ones.

    Args:
        master: ``None`` = none answers.

    Attributes:
        was_chosen: False = there are several cars, and no namespace was given.
        port_is_the_nodes: the port is the one that the hub uses.
        port_is_virtual: it's the one that car_sim makes.
    """

    def __init__(self, master: Master | None, options: Namespace):
        self.master = master
        graph = master.graph() if master else NO_GRAPH
        cars = find_cars(graph.nodes)
        self.namespace = options.namespace or (cars[0] if len(cars) == 1 else "/")
        self.others = [car for car in cars if car != self.namespace]  # the namespaces of other cars
        self.was_chosen = options.namespace is not None or self.namespace in cars or not cars
        tasks = [Task("nodes", master.node, name, self.namespace, graph) for name in NODES] if master else []
        nodes = [task.wait(time.monotonic() + SURVEY_S)[0] for task in tasks]
        self.nodes: list[Node] = [node for node in nodes if node is not None]
        self.uses_sim_time = bool(master and master.parameter("/use_sim_time"))
        hub, board = self.parameters("teensy_sensor_hub"), self.parameters("pca9685")
        of_hub = _known(hub.text, "port")
        self.port = options.port or of_hub or (STABLE_PORT if os.path.exists(STABLE_PORT) else USUAL_PORT)
        self.baud = _known(hub.integer, "baud", USUAL_BAUD)
        self.port_is_the_nodes = bool(of_hub) and os.path.realpath(self.port) == os.path.realpath(of_hub)
        self.port_is_virtual = self.port == _known(self.parameters(SIMULATOR).text, "port")
        self.bus = _bus(options.bus) if options.bus else _bus_of(board)
        prescale, oscillator_hz = _prescale(board)
        self.board = BoardSettings(options.address or _known(board.integer, "address", USUAL_ADDRESS), prescale,
                                   self.runs("pca9685") is not None, oscillator_hz)

    def parameters(self, name: str) -> Params:
        """Return a node's; what its launch file gave to its process goes before what the server holds by now."""
        values = self.master.parameter(f"{self.namespace.rstrip('/')}/{name}") if self.master else None
        fixed = [self.master.fixed_parameters(node) for node in self.nodes if node.name == name]
        given = {key: value for values in fixed for key, value in values.items() if value is not None}
        return Params({**(values if isinstance(values, dict) else {}), **given})

    def runs(self, name: str) -> Node | None:
        """Return a node that is there and answers."""
        return next((node for node in self.nodes if node.name == name and node.runs), None)

    def state(self, name: str) -> str:
        """Return what a node does."""
        return next((node.state for node in self.nodes if node.name == name), ABSENT)

    @property
    def lacks_simulator(self) -> bool:
        """Return whether the port is a virtual Teensy's, but car_sim makes none."""
        return (self.port_is_virtual and self.runs(SIMULATOR) is None
                and (self.state(SIMULATOR) == SILENT or not os.path.exists(self.port)))


def _known(read, name, default=None):
    """Return a parameter, or the default where there is none or nonsense, which ``check_parameters`` reports."""
    try:
        return read(name, None) or default
    except ConfigError:
        return default


def _bus_of(board):
    """Return the bus of the pca9685 node's parameters: what they name, or AUTO has found."""
    device = _known(board.text, "device") or _known(board.integer, "device", AUTO)
    return _known(board.text, "auto_device", AUTO) if device == AUTO else _bus(device)


def _bus(device):
    return f"/dev/i2c-{device}" if str(device).isdigit() else device


def _prescale(board):
    """Return the PRE_SCALE and the oscillator that the pca9685 node's parameters ask for; ``None`` = nobody asks."""
    try:
        oscillator_hz = board.number("oscillator_hz", 25e6, low=1e6, high=50e6)
        prescale = board.integer("prescale", None)
        if prescale is None:
            prescale = prescale_for(board.number("frequency", 50.0, above=0.0), oscillator_hz)
        return prescale, oscillator_hz
    except ConfigError:
        return None, 25e6


def examine(options: Namespace) -> Iterator[Finding]:
    """Yield all findings, in the order in which they're best remedied."""
    pace = PaceWatch()
    for finding in _examine(options):
        yield finding.on_busy_computer() if pace.is_busy() else finding


def _examine(options):
    uri = os.environ.get("ROS_MASTER_URI", "")
    master = Master(uri)
    own = [Task("versions", probe_versions)]  # about this computer itself
    network = Task("master", probe_network, uri, master.trouble)
    (of_master, of_address, is_there), trouble = network.wait(time.monotonic() + NETWORK_S, ([], [], False))
    of_network = trouble + of_master + of_address
    car, survey_trouble = Task("nodes", Car, master if is_there else None, options).wait(time.monotonic() + SURVEY_S)
    car = car or Car(None, options)
    deadline_s = time.monotonic() + PROBES_S
    if not car.was_chosen:
        yield from own[0].findings(deadline_s)
        yield from of_network + checks.check_several(car.others)
        return
    virtual_port, virtual_bus = car.port_is_virtual or is_pseudo_terminal(car.port), car.bus == VIRTUAL
    own += [Task("packages", probe_packages),
            Task("groups", probe_groups, car.port, car.bus, virtual_port, virtual_bus),
            Task("gamepad", probe_driver), Task("clock", probe_clock, car.uses_sim_time)]
    parameters = Task("parameters", _check_all_parameters, car) if car.master else None
    black_box = Task("black box", _check_newest_recording, car)
    hub = car.runs("teensy_sensor_hub") if car.port_is_the_nodes else None
    port = None if hub or car.lacks_simulator else Task("port", probe_port, car.port, car.baud)
    board = None if virtual_bus else Task("bus", probe_board, car.bus, car.board, options.probe)
    reporting = [node.path for node in map(car.runs, REPORTING) if node]
    topics = Task("topics", _listen_to_topics, car, hub, reporting) if reporting else None

    for task in own:
        yield from task.findings(deadline_s)
    yield from of_network + survey_trouble
    if parameters:
        yield from checks.check_nodes(car.nodes, car.namespace, car.others)
        yield from parameters.findings(deadline_s)
    heard, topics_trouble = topics.wait(deadline_s) if topics else (None, [])
    if car.lacks_simulator:
        yield from check_virtual_port(car.port, car.state(SIMULATOR), hub is not None)
    elif port:
        yield from port.findings(deadline_s)
    elif heard:
        yield from check_link(heard.link, car.port, hub)
    of_board = board.findings(deadline_s) if board else _virtual_board(car)
    yield from of_board + topics_trouble
    if heard:
        yield from _check_heard(car, hub, heard, reporting, worst(of_board) == BAD)
    yield from black_box.findings(deadline_s)


def _check_heard(car, hub, heard, reporting, board_is_bad):
    """Yield the findings about who drives, gamepad and reports; a fault that another finding tells is left out."""
    told = []
    if car.runs("turn_arb"):
        yield from checks.check_steering(heard.steering, car.runs("turn_arb"))
    reports = checks.reports_of(heard.reports, car.namespace)
    yield from checks.check_command_topics(reports)
    yield from checks.check_battery(reports)
    if hub and heard.link:
        told += [(hub.path, LINK_REPORT)] + [(hub.path, CLOCK_REPORT)] * (heard.link.level != OK)
    if car.runs("pca9685") and board_is_bad:
        told.append((car.runs("pca9685").path, BOARD_REPORT))
    covered = []
    if heard.gamepad:
        yield from check_gamepad(heard.gamepad)
        told.append((heard.gamepad.node, GAMEPAD_REPORT))
        covered = [heard.gamepad.driver.name] if heard.gamepad.driver else []
    covered += [f"{path.strip('/')}: {name}" for path, name in told]
    yield from checks.check_diagnostics(reports, reporting, covered)


def _check_all_parameters(car):
    readings = [reading for reading in (read_parameters(car.master, node) for node in car.nodes) if reading is not None]
    is_virtual, usual = _known(car.parameters("pca9685").text, "device") == VIRTUAL, package_file("config")
    return (checks.check_parameters(readings) + checks.check_folders(readings, os.path.realpath(usual), is_virtual)
            + checks.check_files(read_files(car.master, car.nodes)))


def _check_newest_recording(car):
    folder = _known(car.parameters("black_box").text, "folder")
    return checks.check_black_box(newest(folder or default_folder()), time.time())


def _listen_to_topics(car, hub, reporting):
    from car_interface.tools.doctor.topics import GamepadListener, listen  # they need rospy, which may be missing
    turn_arb, teleop_logi = car.runs("turn_arb"), car.runs("teleop_logi")
    return listen(hub and hub.path, turn_arb and turn_arb.path, reporting,
                  teleop_logi and GamepadListener(car.master, teleop_logi))


def _virtual_board(car):
    node, chip = car.runs("pca9685"), "virtual: the chip is a piece of software"
    return first(
        "bus",
        (not car.master, OK, f"{chip}; whether it runs only a master can tell"),
        (node, OK, f"{chip} that {node and node.path} writes to"),
        (car.state("pca9685") != ABSENT, WARN, f"{chip}, and the pca9685 node doesn't answer", "See the nodes above"),
        (True, WARN, f"{chip}, and the pca9685 node that starts it doesn't run",
         "roslaunch car_interface demo.launch; or give the real bus by --i2c"))
