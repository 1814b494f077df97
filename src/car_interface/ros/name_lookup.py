"""Waits before a node registers, while another node of its name runs: see ``common.name_wait``. Needs no rospy."""
from __future__ import annotations

import logging
import socket
import xmlrpc.client
from typing import Sequence
from urllib.parse import urlsplit

import rosgraph
from rosgraph.network import is_local_address
from rosgraph.roslogging import RosStreamHandler

from car_interface.common.name_wait import FREE, NO_MASTER, RUNNING, SILENT, STARTING, Holder, NameWait
from car_interface.ros.clocks import SYSTEM
from car_interface.ros.xmlrpc_calls import call

POLL_S = 0.5
MAX_ADDRESS = 108  # characters of a Unix socket's address: unix(7)


def wait_for_name(name: str) -> socket.socket:
    """Return when a node may register this name: at once unless another node has it and runs.

    A line about the wait goes to standard error in the format of ROS: rospy can't log before it has registered.

    Args:
        name: with its namespace.

    Returns:
        The claim to the name. To be closed when the node has registered.
    """
    wait, lookup = NameWait(name), NameLookup(name, rosgraph.get_master_uri())
    while True:
        claim = _claim(name)
        holder = lookup.holder()
        if holder.state == FREE and claim is None:
            holder = Holder(STARTING, "this computer")
        line = wait.update(holder, SYSTEM.now_ns())
        if line:
            log_warning(line)
        if wait.may_register:
            return claim or socket.socket(socket.AF_UNIX)
        if claim is not None:
            claim.close()
        SYSTEM.sleep(POLL_S)


def _claim(name):
    """A socket that one process of this computer can have at a time, for a name at a master; ``None``: another has it.

    Between two nodes that start at the same moment the master can't decide: each registers several things, and each
    registration has the other node shut down, until neither is left.
    """
    claim = socket.socket(socket.AF_UNIX)
    try:
        claim.bind(f"\0car_interface {rosgraph.get_master_uri()} {name}"[:MAX_ADDRESS])
    except OSError:
        claim.close()
        return None
    return claim


def own_name(default: str, arguments: Sequence[str]) -> str:
    """The name of a node with its namespace, by ROS_NAMESPACE and its arguments ``__ns:=`` and ``__name:=``."""
    name = rosgraph.names.load_mappings(arguments).get("__name", default)
    return rosgraph.names.ns_join(rosgraph.names.get_ros_namespace(argv=arguments), name)


class NameLookup:
    """Asks who has a name, over and over.

    Args:
        name: the node's, with its namespace.
        master_uri: the ROS master's.
    """

    def __init__(self, name: str, master_uri: str):
        self._name = name
        self._master_uri = master_uri
        self._node_uri = ""  # of the last one that the master named

    def holder(self) -> Holder:
        """What has the name now."""
        try:
            code, _, uri = call(self._master_uri, "lookupNode", self._name, self._name)
        except Exception:  # no usable answer, for whatever reason
            holder = self._ask(self._node_uri) if self._node_uri else Holder(FREE)
            return Holder(NO_MASTER) if holder.state == FREE else holder
        self._node_uri = uri if code == 1 else ""
        return self._ask(uri) if code == 1 else Holder(FREE)

    def _ask(self, uri):
        """Whether the node of this name is at an address."""
        try:
            if self._is_another(uri):
                return Holder(FREE)
            pid = call(uri, "getPid", self._name)[2]
        except ConnectionRefusedError:  # its process has ended without a word to the master
            return Holder(FREE)
        except Exception:
            return Holder(SILENT, _machine(uri))
        return Holder(RUNNING, _machine(uri), pid)

    def _is_another(self, uri):
        """Whether a node of another name has got the port of one that was killed. Only rospy's nodes tell."""
        try:
            return call(uri, "getName", self._name)[2] != self._name
        except xmlrpc.client.Fault:
            return False


def _machine(uri):
    host = urlsplit(uri).hostname or uri
    return f"{host} (this computer)" if is_local_address(host) else host


def log_warning(text: str) -> None:
    """Log a warning to standard error in the format of ROS."""
    RosStreamHandler().emit(logging.makeLogRecord({"name": "rosout", "levelno": logging.WARNING, "levelname": "WARNING",
                                                   "msg": text}))
