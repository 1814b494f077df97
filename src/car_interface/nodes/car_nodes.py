"""The car_nodes process: turn_arb, pca9685, teensy_sensor_hub, generic_value_converter, throttle_arb and
planner_interface in one, which saves memory.

Each is the same node class as in a process of its own, with the same topics, services, parameters and diagnostics under
its own name, and with a thread that decides and publishes. They share one interpreter and one name on the ROS graph.

A node that ends by an error is shut down, taken off the graph and started again after a second, as roslaunch's respawn
does; the others go on. A parameter that a node refuses at its first start ends the process, likewise a device that is
required and missing.

It has the parameters of each node below that one's own name, too.
Arguments, by a launch file: --throttle, --planner, and those of pca9685 and teensy_sensor_hub.
"""
from __future__ import annotations

import gc
import logging
import math
import sys
import threading
from typing import Callable

import rospy

from car_interface.common.declared import read_all
from car_interface.common.errors import CarInterfaceError
from car_interface.common.fixed_parameters import CarNodesConfig, fixed_parameters
from car_interface.common.units import NS_PER_S
from car_interface.nodes.generic_value_converter import GenericValueConverter
from car_interface.nodes.pca9685.node import Pca9685
from car_interface.nodes.planner_interface.node import PlannerInterface
from car_interface.nodes.teensy_sensor_hub.node import TeensySensorHub
from car_interface.nodes.throttle_arb import ThrottleArb
from car_interface.nodes.turn_arb import TurnArb
from car_interface.ros.graph import ROS
from car_interface.ros.inbox import Inbox
from car_interface.ros.runtime import describe_error, run, spin

PROCESS = "car_nodes"
NODES = {"turn_arb": TurnArb, "pca9685": Pca9685, "teensy_sensor_hub": TeensySensorHub,
         "generic_value_converter": GenericValueConverter, "throttle_arb": ThrottleArb,
         "planner_interface": PlannerInterface}
ON_REQUEST = {"throttle_arb": "throttle", "planner_interface": "planner"}  # by the parameter that has it
PAUSE_NS = NS_PER_S
END_WITHIN_NS = 5 * NS_PER_S  # pca9685 tries for two seconds to reach its chip
POLL_S = 0.005  # Thread.join with a timeout follows the settable clock before Python 3.11


class Part:
    """One of the nodes. Each run of it has a thread of its own.

    Args:
        name: the node's, without its namespace.
        node_class: as ``runtime.spin`` takes it.
        on_end: called in that thread when a run has ended.
    """

    def __init__(self, name: str, node_class: Callable, on_end: Callable[[Part], None]):
        self.name = name
        self.was_refused = False  # its first start failed, by a parameter or a device
        self._node_class = node_class
        self._on_end = on_end
        self._has_started = self._is_final = False
        self.start()

    def start(self) -> None:
        """Start it, at first or again."""
        gc.collect()  # closes the files of rospy's old connections
        self.fault = ""  # what ended the run
        self._inbox = Inbox(f"{ROS.namespace()}{self.name}")
        self._thread = threading.Thread(target=self._run, name=self.name, daemon=True)
        self._thread.start()

    def end(self) -> None:
        """Have it shut down."""
        self._is_final = True
        self._inbox.end()

    def join(self, within_s: float) -> None:
        """Wait until it has shut down."""
        if not self._inbox.clocks.wait_for(lambda: not self._thread.is_alive(), within_s, POLL_S):
            self.fault = "it hangs and can't be shut down"

    def _run(self):
        try:
            spin(self._build, self._inbox,
                 read_fixed=lambda: fixed_parameters(self.name, sys.argv[1:], process=PROCESS))
            self.fault = "" if self._is_final else "it ended"
        except Exception as error:
            self.fault = describe_error(error)
            self.was_refused = isinstance(error, CarInterfaceError) and not self._has_started
        finally:
            if not self._is_final:  # at the process's end rospy does that
                self._inbox.close()
            self._on_end(self)

    def _build(self, params, inbox):
        node = self._node_class(params, inbox)
        self._has_started = True
        return node


class CarNodes:
    """Start the nodes, and restart those that an error has ended."""

    def __init__(self, params, inbox):
        config = read_all(params, CarNodesConfig)
        nodes = {name: node_class for name, node_class in NODES.items()
                 if name not in ON_REQUEST or getattr(config, ON_REQUEST[name])}
        self._inbox = inbox
        self._due_ns: dict[Part, int] = {}  # of those that wait for their restart
        logging.getLogger("rosout").addFilter(_name_part)
        self._parts = [Part(name, node_class, lambda part: inbox.put(self._on_end, part))
                       for name, node_class in nodes.items()]

    def step(self, now_ns):
        """Restart the nodes that are due."""
        self._inbox.dispatch()
        for part in [part for part, due_ns in self._due_ns.items() if now_ns >= due_ns]:
            del self._due_ns[part]
            part.start()
        return min(self._due_ns.values(), default=math.inf)

    def shut_down(self):
        """End all nodes at the same time."""
        for part in self._parts:
            part.end()
        deadline_ns = self._inbox.clocks.now_ns() + END_WITHIN_NS
        for part in self._parts:
            part.join((deadline_ns - self._inbox.clocks.now_ns()) / NS_PER_S)
        faults = [f"{part.name}: {part.fault}" for part in self._parts if part.fault and part not in self._due_ns]
        if faults:
            raise CarInterfaceError("; ".join(faults))

    def _on_end(self, part, now_ns):
        if part.was_refused:
            raise CarInterfaceError(f"{part.name}: {part.fault}")
        rospy.logfatal("%s: %s. Starting it anew", part.name, part.fault)
        self._due_ns[part] = now_ns + PAUSE_NS


def _name_part(record):
    """Prefix a log line with the name of its node."""
    if record.threadName in NODES:
        record.msg = f"{record.threadName}: {record.msg}"
    return True


def main():
    run(PROCESS, CarNodes)
