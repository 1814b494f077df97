"""Asks the ROS master and the nodes for the doctor, each question with a time limit; it works without rospy."""
from __future__ import annotations

import os
import xmlrpc.client
from functools import partial
from typing import Any, NamedTuple, Sequence
from urllib.parse import urlsplit

from car_interface.common.declared import read_all
from car_interface.common.device_access import script_arguments
from car_interface.common.errors import CarInterfaceError, ConfigError
from car_interface.common.fixed_parameters import fixed_parameters
from car_interface.common.package_files import package_file
from car_interface.common.params import CONFIG_FOLDER, Params
from car_interface.common.yaml_file import compose_yaml, read_yaml
from car_interface.ros.start import config_class
from car_interface.ros.xmlrpc_calls import call
from car_interface.tools.doctor.car import ABSENT, KILLED, ONE_PROCESS, RUNNING, SILENT, SIMULATOR, Node, Reading
from car_interface.tools.doctor.network import leads_here

CALLER = "/doctor"
# These may be parts of ONE_PROCESS.
PARTS = ("turn_arb", "pca9685", "teensy_sensor_hub", "generic_value_converter", "throttle_arb", "planner_interface")
REPORTING = (*PARTS, "teleop_logi")  # on /diagnostics
NODES = (*REPORTING, SIMULATOR)
ON_REQUEST = ("throttle_arb", "planner_interface")  # those of them that ONE_PROCESS may be without


class Graph(NamedTuple):
    """The ROS graph."""

    publishers: dict  # the names of the nodes that publish, by topic
    nodes: frozenset  # the names of all nodes that publish, subscribe or serve


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

    def graph(self) -> Graph:
        """Return who publishes, subscribes and serves."""
        publishers, *others = ([(name, tuple(nodes)) for name, nodes in kind] for kind in self.ask("getSystemState"))
        everybody = (nodes for kind in (publishers, *others) for _, nodes in kind)
        return Graph(dict(publishers), frozenset(node for nodes in everybody for node in nodes))

    def node(self, name: str, namespace: str, graph: Graph) -> Node:
        """Return what a node does. Where it isn't itself, ONE_PROCESS may be it."""
        path = f"{namespace.rstrip('/')}/{name}"
        own = Node(name, path, self._state(path, graph), path)
        if own.runs or name not in PARTS or name in ON_REQUEST and f"{path}/state" not in graph.publishers:
            return own
        process = f"{namespace.rstrip('/')}/{ONE_PROCESS}"
        state = self._state(process, graph)
        return own if state == ABSENT else Node(name, path, state, process)

    def _state(self, path, graph):
        """Return the state of a process.

        The master also remembers nodes that have ended, by a subscription to a parameter that they made when they
        logged their last line: what counts is the graph.
        """
        if path not in graph.nodes:
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


def read_files(master: Master, nodes: Sequence[Node]) -> list[str]:
    """Return what is wrong with the YAML files of the car, of which the server names those that ~save writes.

    Files in the same folders that are named like the package's own are read, too; what isn't on this computer is not.
    """
    named = (master.parameter(f"{node.path}/save_to") for node in nodes)
    saved = [path for path in named if isinstance(path, str) and os.path.isabs(path)]
    usual = sorted(path.name for path in package_file("config").glob("*.yaml"))
    paths = dict.fromkeys([*saved, *(os.path.join(os.path.dirname(path), name) for path in saved for name in usual)])
    faults = []
    for path in filter(os.path.lexists, paths):
        try:
            compose_yaml(read_yaml(path), path)  # not built: tags such as !degrees are ROS's
        except ConfigError as error:
            faults.append(str(error))
    return faults


def read_parameters(master: Master, node: Node) -> Reading | None:
    """Read what the server holds for a node as the node does; ``None`` when that is nothing and it doesn't run."""
    private = master.parameter(node.path)
    if not isinstance(private, dict):
        if node.state == ABSENT:
            return None
        private = {}
    folder = private.get(CONFIG_FOLDER)
    read = partial(Reading, node.path, runs=node.state != ABSENT,
                   folder=os.path.realpath(folder) if isinstance(folder, str) else "")
    try:
        read_all(Params(private, lambda name: master.search_parents(node.path, name), master.fixed_parameters(node)),
                 config_class(node.name))
    except CarInterfaceError as error:
        return read(fault=str(error))
    return read(fault="")
