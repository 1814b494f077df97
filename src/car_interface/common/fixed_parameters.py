"""Reads the parameters that a launch file also gives to the node's process, so that they can't be lost or exchanged.

Parameters on the server vanish with the ROS master, and anybody can delete or change them. A node that is restarted
after that would take its defaults: a virtual car would drive the servos of a real one. So the launch files also pass
the parameters that name a device as arguments of the process, and ``common.params`` refuses a parameter that is
missing or differs. A process without these arguments, as rosrun starts it, takes its parameters as they are. Pure.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import Sequence

from car_interface.common import declared
from car_interface.common.errors import ConfigError, require


@dataclass(frozen=True)
class CarNodesConfig:
    """The nodes that car_nodes has on request."""

    throttle: bool = declared.flag("throttle", False, "true = with throttle_arb")
    planner: bool = declared.flag("planner", False, "true = with planner_interface")


# By node: its devices, and the parts that car_nodes has on request. The option of virtual_chip is --virtual-chip.
FIXED = {"pca9685": ("device", "address", "virtual_chip"), "teensy_sensor_hub": ("port",),
         "car_sim": ("port", "virtual_chip"), "car_nodes": ("throttle", "planner")}
PARTS = {"car_nodes": ("car_nodes", "pca9685", "teensy_sensor_hub")}  # the nodes in a process of several
# The argument where the parameter must not be set: its default depends on this node and this master.
AUTO = {"virtual_chip": "auto"}
REMAPPING = ":="  # in the arguments that ROS takes


def fixed_parameters(node: str, arguments: Sequence[str], process: str | None = None) -> dict[str, str | None]:
    """Return the parameters of a node that the arguments of its process fix, as texts; ``None`` = it must not be set.

    Args:
        node: the node, by the name of its program.
        arguments: the process's, without its program's name.
        process: the program, where that is not the node's own.

    Raises:
        ConfigError: an argument is unknown, or has no value.
    """
    nodes = PARTS.get(process or node, (process or node,))
    given = _parse(arguments, {f"--{name}".replace("_", "-"): name for each in nodes for name in FIXED.get(each, ())})
    return {name: None if given[name] == AUTO.get(name) else given[name]
            for name in FIXED.get(node, ()) if name in given}


def _parse(arguments, names):
    """Return the values by the parameters' names; ``names`` maps options to these names."""
    if not names:
        return {}  # a program with no such option may have others
    found = {}
    rest = iter(arguments)
    for argument in rest:
        if argument in names:
            value = next(rest, None)
            require(value is not None, f"argument {argument}", None, "a value after it", "has no value")
            found[names[argument]] = value
        elif REMAPPING not in argument:
            raise ConfigError(f"argument {argument}", None, ", ".join(f"{option} VALUE" for option in names),
                              "is unknown")
    return found
