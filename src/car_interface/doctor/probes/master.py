"""What the doctor asks the ROS master and the nodes, each question with a time limit; it works without rospy."""
from __future__ import annotations

import importlib
import xmlrpc.client
from typing import Any

from car_interface.common.errors import CarInterfaceError
from car_interface.common.params import Params
from car_interface.doctor.checks.car import Node, Reading

CALLER = "/doctor"
ANSWER_WITHIN_S = 1.0
# These may be parts of one process, which the master then knows by this name alone.
PARTS = ("turn_arb", "pca9685", "teensy_sensor_hub", "generic_value_converter", "throttle_arb")
ONE_PROCESS = "car_nodes"
NODES = (*PARTS, "teleop_logi", "car_sim")


class Master:
    """The master at a URI.

    Args:
        uri: ROS_MASTER_URI.
    """

    def __init__(self, uri: str):
        self._uri = uri

    def trouble(self) -> str:
        """Why it doesn't answer; empty when it does."""
        try:
            self.ask("getPid")
        except xmlrpc.client.ProtocolError as error:
            return f"{error.errcode} {error.errmsg}"
        except Exception as error:  # whatever listens there may answer with anything
            return getattr(error, "strerror", None) or str(error) or type(error).__name__
        return ""

    def ask(self, question: str, *arguments: Any, caller: str = CALLER) -> Any:
        """The value of an answer.

        Raises:
            LookupError: when the master says no.
        """
        code, message, value = ask(self._uri, question, caller, *arguments)
        if code != 1:
            raise LookupError(message)
        return value

    def parameter(self, path: str) -> Any:
        """A parameter's value; ``None`` when there is none."""
        try:
            return self.ask("getParam", path)
        except LookupError:
            return None

    def node(self, name: str, namespace: str) -> Node:
        """Whether a node is registered, and whether it answers."""
        path = f"{namespace.rstrip('/')}/{name}"
        uri = self._uri_of(path)
        if uri is None and name in PARTS and (name != "throttle_arb" or self._drives_esc(namespace)):
            uri = self._uri_of(f"{namespace.rstrip('/')}/{ONE_PROCESS}")
        if uri is None:
            return Node(name, path, False, False)
        try:
            ask(uri, "getPid", CALLER)
        except Exception:  # whatever is wrong with the answer: there is none
            return Node(name, path, True, False)
        return Node(name, path, True, True)

    def _drives_esc(self, namespace):
        """Whether the one process has throttle_arb, which is there on request only."""
        return self.parameter(f"{namespace.rstrip('/')}/{ONE_PROCESS}/throttle") is True

    def _uri_of(self, path):
        """A node's, ``None`` when there is no such node."""
        try:
            return self.ask("lookupNode", path)
        except LookupError:
            return None

    def search_parents(self, path: str, name: str) -> Any:
        """A parameter from the nearest of the namespaces around a node; ``None`` when none has it."""
        try:
            return self.parameter(self.ask("searchParam", name, caller=path))
        except LookupError:
            return None


def ask(uri: str, question: str, *arguments: Any) -> Any:
    """Any XML-RPC server's answer."""
    with xmlrpc.client.ServerProxy(uri, transport=_HastyTransport()) as server:
        return getattr(server, question)(*arguments)


class _HastyTransport(xmlrpc.client.Transport):
    def make_connection(self, host: Any):
        connection = super().make_connection(host)
        connection.timeout = ANSWER_WITHIN_S
        return connection


def read_parameters(master: Master, node: Node) -> Reading | None:
    """Read what the server holds for a node as the node does; ``None`` when that is nothing and it doesn't run."""
    private = master.parameter(node.path)
    if not isinstance(private, dict):
        if not node.registered:
            return None
        private = {}
    try:
        module = importlib.import_module(f"car_interface.nodes.{node.name}")
        module.read_config(Params(private, lambda name: master.search_parents(node.path, name)))
    except CarInterfaceError as error:
        return Reading(node.path, str(error), node.registered)
    except ImportError as error:
        return Reading(node.path, f"it can't be imported ({error})", node.registered)
    return Reading(node.path, "", node.registered)
