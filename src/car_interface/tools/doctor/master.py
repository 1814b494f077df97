"""Asks the ROS master and the nodes for the doctor, each question with a time limit; it works without rospy.

``Master`` asks; ``Car`` is what became known of the car. Its nodes' parameters and files are judged here, too.
"""
from __future__ import annotations

import os
import time
import xmlrpc.client
from argparse import Namespace
from functools import partial
from typing import Any
from urllib.parse import urlsplit

from car_interface.common.declared import read, read_all
from car_interface.common.devices import STABLE_PORT, script_arguments
from car_interface.common.errors import CarInterfaceError, ConfigError
from car_interface.common.fixed_parameters import fixed_parameters
from car_interface.common.package_files import package_file
from car_interface.common.params import CONFIG_FOLDER, Params
from car_interface.common.yaml_file import compose_yaml, read_yaml
from car_interface.pca9685.config import AUTO, VIRTUAL, Pca9685Config
from car_interface.ros.start import config_class
from car_interface.ros.xmlrpc_calls import call
from car_interface.tools.doctor.car import ABSENT, KILLED, ONE_PROCESS, RUNNING, SILENT, SIMULATOR, Node, find_cars
from car_interface.tools.doctor.computer import leads_here
from car_interface.tools.doctor.findings import BAD, OK, WARN, Finding, Task, all_of, first

CALLER = "/doctor"
USUAL_PORT, USUAL_BAUD, USUAL_ADDRESS = "/dev/ttyAMA0", 115200, 0x40
MISSPELT = "roslaunch ignores an argument that is misspelt"
SURVEY_S = 2.0  # for the nodes
# These may be parts of ONE_PROCESS.
PARTS = ("turn_arb", "pca9685", "teensy_sensor_hub", "generic_value_converter", "throttle_arb", "planner_interface")
REPORTING = (*PARTS, "teleop_logi")  # on /diagnostics
NODES = (*REPORTING, SIMULATOR)
ON_REQUEST = ("throttle_arb", "planner_interface")  # those of them that ONE_PROCESS may be without


class Master:
    """The master at a URI, as in ROS_MASTER_URI."""

    def __init__(self, uri: str):
        self._uri = uri

    def trouble(self) -> str:
        """Return why it doesn't answer; empty when it does."""
        try:
            self.ask("getPid")
        except xmlrpc.client.ProtocolError as error:
            return f"{error.errcode} {error.errmsg}"
        except Exception as error:  # whatever listens there may answer with anything
            return getattr(error, "strerror", None) or str(error) or type(error).__name__
        return ""

    def ask(self, question: str, *arguments: Any, caller: str = CALLER) -> Any:
        """Return the value of an answer.

        Raises:
            LookupError: when the master says no.
        """
        code, message, value = call(self._uri, question, caller, *arguments)
        if code != 1:
            raise LookupError(message)
        return value

    def parameter(self, path: str) -> Any:
        """Return a parameter's value; ``None`` when there is none."""
        try:
            return self.ask("getParam", path)
        except LookupError:
            return None

    def graph(self) -> tuple[dict[str, tuple], frozenset]:
        """Return the names of the nodes that publish, by topic, and of all that publish, subscribe or serve."""
        publishers, *others = ([(name, tuple(nodes)) for name, nodes in kind] for kind in self.ask("getSystemState"))
        everybody = (nodes for kind in (publishers, *others) for _, nodes in kind)
        return dict(publishers), frozenset(node for nodes in everybody for node in nodes)

    def node(self, name: str, namespace: str, publishers: dict[str, tuple], known: frozenset) -> Node:
        """Return what a node does. Where it isn't itself, ONE_PROCESS may be it."""
        path = f"{namespace.rstrip('/')}/{name}"
        own = Node(name, path, self._state(path, known), path)
        if own.runs or name not in PARTS or name in ON_REQUEST and f"{path}/state" not in publishers:
            return own
        process = f"{namespace.rstrip('/')}/{ONE_PROCESS}"
        state = self._state(process, known)
        return own if state == ABSENT else Node(name, path, state, process)

    def _state(self, path, known):
        """Return the state of a process.

        The master also remembers nodes that have ended, by a subscription to a parameter that they made when they
        logged their last line: what counts is the graph.
        """
        if path not in known:
            return ABSENT
        try:
            call(self.ask("lookupNode", path), "getPid", CALLER)
        except LookupError:  # it has ended since
            return ABSENT
        except ConnectionRefusedError:
            return KILLED
        except Exception:  # whatever is wrong with the answer: there is none
            return SILENT
        return RUNNING

    def fixed_parameters(self, node: Node) -> dict:
        """Return what a launch file gave to the process of a node on this computer; of others nothing is known."""
        if not node.runs:
            return {}
        process = node.process.rpartition("/")[2]
        try:
            uri = self.ask("lookupNode", node.process)
            if not leads_here(urlsplit(uri).hostname):
                return {}
            _, _, pid = call(uri, "getPid", CALLER)
            return fixed_parameters(node.name, script_arguments(pid, process), process)
        except Exception:  # it has ended since, or was started with arguments that it refuses and reports
            return {}

    def search_parents(self, path: str, name: str) -> Any:
        """Return a parameter from the nearest of the namespaces around a node; ``None`` when none has it."""
        try:
            return self.parameter(self.ask("searchParam", name, caller=path))
        except LookupError:
            return None


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
        publishers, known = master.graph() if master else ({}, frozenset())
        cars = find_cars(known)
        self.namespace = options.namespace or (cars[0] if len(cars) == 1 else "/")
        self.others = [car for car in cars if car != self.namespace]  # the namespaces of other cars
        self.was_chosen = options.namespace is not None or self.namespace in cars or not cars
        tasks = [Task("nodes", master.node, name, self.namespace, publishers, known) for name in NODES if master]
        nodes = [task.wait(time.monotonic() + SURVEY_S)[0] for task in tasks]
        self.nodes: dict[str, Node] = {node.name: node for node in nodes if node is not None}
        self.uses_sim_time = bool(master and master.parameter("/use_sim_time"))
        hub, board = self.parameters("teensy_sensor_hub"), self.parameters("pca9685")
        of_hub = _known(hub.text, "port")
        self.port = options.port or of_hub or (STABLE_PORT if os.path.exists(STABLE_PORT) else USUAL_PORT)
        self.baud = _known(hub.integer, "baud", USUAL_BAUD)
        self.port_is_the_nodes = bool(of_hub) and os.path.realpath(self.port) == os.path.realpath(of_hub)
        self.port_is_virtual = self.port == self.known_text(SIMULATOR, "port")
        self.bus = _bus(options.bus) if options.bus else _bus_of(board)
        self.address = options.address or _known(board.integer, "address", USUAL_ADDRESS)
        self.prescale, self.oscillator_hz = _clock_of(board)

    def parameters(self, name: str) -> Params:
        """Return a node's; what its launch file gave to its process goes before what the server holds by now."""
        values = self.master.parameter(f"{self.namespace.rstrip('/')}/{name}") if self.master else None
        fixed = self.master.fixed_parameters(self.nodes[name]) if name in self.nodes else {}
        given = {key: value for key, value in fixed.items() if value is not None}
        return Params({**(values if isinstance(values, dict) else {}), **given})

    def known_text(self, name: str, parameter: str) -> str | None:
        """Return a node's parameter; ``None`` where there is none or nonsense, which ``check_parameters`` reports."""
        return _known(self.parameters(name).text, parameter)

    def runs(self, name: str) -> Node | None:
        """Return a node that is there and answers."""
        node = self.nodes.get(name)
        return node if node and node.runs else None

    def state(self, name: str) -> str:
        """Return what a node does."""
        return self.nodes[name].state if name in self.nodes else ABSENT

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


def _clock_of(board):
    """Return the PRE_SCALE and the oscillator by the pca9685 node's parameters; ``None`` = not known, they are bad."""
    try:
        config = read(board, Pca9685Config)
        return config.prescale, config.oscillator_hz
    except ConfigError:
        return None, Pca9685Config.oscillator_hz


def check_files(car: Car) -> list[Finding]:
    """Return what is wrong with the YAML files of the car, of which the server names those that ~save writes.

    Files in the same folders that are named like the package's own are read, too; what isn't on this computer is not.
    """
    named = (car.master.parameter(f"{node.path}/save_to") for node in car.nodes.values())
    saved = [path for path in named if isinstance(path, str) and os.path.isabs(path)]
    usual = sorted(path.name for path in package_file("config").glob("*.yaml"))
    paths = dict.fromkeys([*saved, *(os.path.join(os.path.dirname(path), name) for path in saved for name in usual)])
    found = []
    for path in filter(os.path.lexists, paths):
        try:
            compose_yaml(read_yaml(path), path)  # not built: tags such as !degrees are ROS's
        except ConfigError as error:
            found.append(Finding(WARN, "files", str(error),
                                 "Correct the file, and start again: roslaunch takes the last of two values without a "
                                 "word, and ~save refuses the file"))
    return found


def check_parameters(car: Car) -> list[Finding]:
    """Return a finding for all nodes that take what the server holds for them, one for each that doesn't, and one about
    the folders of files that they were launched with.
    """
    good, bad, folders = [], [], {}
    for node in car.nodes.values():
        private = car.master.parameter(node.path)
        if not isinstance(private, dict) and node.state == ABSENT:
            continue
        private = private if isinstance(private, dict) else {}
        if isinstance(private.get(CONFIG_FOLDER), str):
            folders.setdefault(os.path.realpath(private[CONFIG_FOLDER]), []).append(node.path)
        params = Params(private, partial(car.master.search_parents, node.path), car.master.fixed_parameters(node))
        try:
            read_all(params, config_class(node.name))
            good.append(node.path)
        except CarInterfaceError as error:
            later = "it can't start with these" if node.state == ABSENT else "it will not start again with these"
            bad.append((True, BAD, f"{node.path}: {later}: {error}",
                        "Correct the YAML file or the launch file, and start again"))
    return all_of("parameters", (not good and not bad, OK, "none on the server; launch files bring them"),
                  (good, OK, f"those of {', '.join(good)} are good"), *bad
                  ) + _check_folders(folders, car.known_text("pca9685", "device") == VIRTUAL)


def _check_folders(folders, is_virtual):
    """Return whether the nodes were launched with one folder of files, and a car's own; by folder, they are."""
    usual = os.path.realpath(package_file("config"))
    taken = "; ".join(f"{', '.join(paths)}: {folder}" for folder, paths in folders.items())
    return [] if not folders else first(
        "files",
        (len(folders) > 1, WARN, f"the nodes were launched with different folders: {taken}",
         f"Launch them with one config:=FOLDER; {MISSPELT}"),
        (usual in folders and not is_virtual, WARN, f"the nodes were launched with the package's own files, {usual}",
         f"Copy them for your car (cp -r {usual} ~/my_car) and launch with config:=$HOME/my_car; {MISSPELT}"),
        (True, OK, f"all nodes were launched with {next(iter(folders))}"))
