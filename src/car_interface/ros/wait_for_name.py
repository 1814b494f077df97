"""Waits before a node registers with the ROS master, while another node of its name runs. Needs no rospy.

The master gives a name to whoever registers it last and has the node before it shut down. Two nodes of a name, each of
them restarted by roslaunch when it ends, would replace each other for ever. So a node asks who has its name first.

- Nobody, or a node that refuses connections: a registration that a killed process left behind. It may register at once.
- A node that answers. It waits, however long that one runs.
- A node that doesn't answer, on a computer that may not answer either. It waits for ``MAX_SILENCE_S``. A node that
  drives a car on a busy computer answers within that time; one that is frozen for longer doesn't drive it.
- One that is about to register. It waits as long for that one to answer.

The nodes of this package wait by themselves. For a node that doesn't there is the command wait_for_name, which a launch
file gives to it as its launch-prefix.
"""
from __future__ import annotations

import logging
import os
import signal
import socket
import sys
import xmlrpc.client
from contextlib import suppress
from typing import NamedTuple, Sequence
from urllib.parse import urlsplit

import rosgraph
from rosgraph.network import is_local_address
from rosgraph.roslogging import RosStreamHandler

from car_interface.common.units import NS_PER_S
from car_interface.ros.clocks import SYSTEM
from car_interface.ros.xmlrpc_calls import call

FREE, STARTING, RUNNING, SILENT, NO_MASTER = "free", "starting", "running", "silent", "no master"
POLL_S = 0.5
MAX_SILENCE_S = 10
LOG_PERIOD_S = 10
MAX_ADDRESS = 108  # characters of a Unix socket's address: unix(7)
USAGE = """usage: wait_for_name [-h] COMMAND [ARGUMENT ...] __name:=NAME

Runs a ROS node, by its command, as soon as no other node of its name runs. Without it the ROS master would end that
other node, and roslaunch start it again. For a launch file: launch-prefix="rosrun car_interface wait_for_name".
"""


def main() -> None:
    """Wait, and become the command."""
    command = sys.argv[1:]
    name = own_name("", command)
    if command[:1] in (["-h"], ["--help"]):
        print(USAGE, end="")
        return
    if not command or name.endswith("/"):
        print(USAGE, end="", file=sys.stderr)
        sys.exit(2)
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    wait_for_name(name).set_inheritable(True)  # the command has it until it ends
    try:
        os.execvp(command[0], command)
    except OSError as error:
        sys.exit(f"{command[0]}: {error.strerror}")


def wait_for_name(name: str) -> socket.socket:
    """Return when a node may register this name, with its namespace: at once unless another node has it and runs.

    A line about the wait goes to standard error in the format of ROS: rospy can't log before it has registered.

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
            RosStreamHandler().emit(logging.makeLogRecord(
                {"name": "rosout", "levelno": logging.WARNING, "levelname": "WARNING", "msg": line}))
        if wait.may_register:
            return claim or socket.socket(socket.AF_UNIX)
        if claim is not None:
            claim.close()
        SYSTEM.sleep(POLL_S)


def _claim(name):
    """Return a socket that one process of this computer can have at a time; ``None`` = another one has it.

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
    """Return a node's name with its namespace, by ROS_NAMESPACE and its arguments ``__ns:=`` and ``__name:=``."""
    name = rosgraph.names.load_mappings(arguments).get("__name", default)
    return rosgraph.names.ns_join(rosgraph.names.get_ros_namespace(argv=arguments), name)


class Holder(NamedTuple):
    """What has a node's name."""

    # FREE, STARTING (about to register, on this computer), RUNNING (it answers), SILENT (it is registered and doesn't
    # answer), or NO_MASTER (which doesn't answer; a node that was found before has ended).
    state: str
    machine: str = ""  # where, for RUNNING and SILENT, e.g. ``127.0.0.1 (this computer)``
    pid: int = 0  # there; 0 where unknown

    def __str__(self) -> str:
        return f"on {self.machine}" + (f", process {self.pid}" if self.pid else "")


class NameWait:
    """Waits for the name of a node, with its namespace."""

    def __init__(self, name: str):
        self._name = name
        self._found: Holder | None = None  # the newest that was registered
        self._began_ns = self._log_ns = 0
        self._silent_since_ns: int | None = None
        self._reported_state = ""
        self.may_register = False

    def update(self, holder: Holder, now_ns: int) -> str:
        """Decide whether the node may register now; a line for the log, or an empty one."""
        state, found = holder.state, self._found
        if state == FREE or state == NO_MASTER and found is None:
            self.may_register = True
            return "" if found is None else f"{self._name} {found} has ended: taking over"
        if state in (RUNNING, SILENT):
            if found is None:
                self._began_ns = now_ns
            elif state == SILENT and found.machine == holder.machine:
                holder = holder._replace(pid=found.pid)  # of an earlier answer
            self._found = holder
        if state in (RUNNING, NO_MASTER):
            self._silent_since_ns = None
        elif self._silent_since_ns is None:
            self._silent_since_ns = now_ns
        elif now_ns - self._silent_since_ns >= MAX_SILENCE_S * NS_PER_S:
            self.may_register = True
            return (f"{self._name} {self._found or holder} hasn't answered for {MAX_SILENCE_S} s: taking over. If it "
                    "is only frozen, the ROS master ends it when it wakes")
        if state == STARTING or state == self._reported_state and now_ns < self._log_ns:
            return ""
        self._reported_state, self._log_ns = state, now_ns + LOG_PERIOD_S * NS_PER_S
        return f"{self._name} {self._waiting_text(state, now_ns)}"

    def _waiting_text(self, state, now_ns):
        if state == NO_MASTER:
            return (f"{self._found} has ended, and so has the ROS master. This node waits for a master; end its launch "
                    "file and start it again")
        if state == SILENT:
            return (f"is registered {self._found}, and doesn't answer. This node takes over if it doesn't for "
                    f"{MAX_SILENCE_S} s")
        waited_s = (now_ns - self._began_ns) // NS_PER_S
        since = f"; waiting for {waited_s} s so far" if waited_s else ""
        return (f"is already running {self._found}. This node waits, and sends nothing, until that one ends; then it "
                f"takes over. If a launch file was started twice, end one of the two{since}")


class NameLookup:
    """Asks who has a name, over and over."""

    def __init__(self, name: str, master_uri: str):
        self._name = name
        self._master_uri = master_uri
        self._node_uri = ""  # of the last one that the master named

    def holder(self) -> Holder:
        """Return what has the name now."""
        absent = FREE
        try:
            code, _, uri = call(self._master_uri, "lookupNode", self._name, self._name)
            self._node_uri = uri if code == 1 else ""
        except Exception:  # no usable answer, for whatever reason
            absent = NO_MASTER
        holder = self._ask(self._node_uri) if self._node_uri else None
        return holder or Holder(absent)

    def _ask(self, uri):
        """Return what is at an address; ``None`` = nothing that has the name."""
        try:
            with suppress(xmlrpc.client.Fault):  # only rospy's nodes tell their names
                if call(uri, "getName", self._name)[2] != self._name:
                    return None  # another node has got the port of one that was killed
            return Holder(RUNNING, _machine(uri), call(uri, "getPid", self._name)[2])
        except ConnectionRefusedError:  # its process has ended without a word to the master
            return None
        except Exception:
            return Holder(SILENT, _machine(uri))


def _machine(uri):
    host = urlsplit(uri).hostname or uri
    return f"{host} (this computer)" if is_local_address(host) else host
