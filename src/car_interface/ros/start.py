"""How a script starts its node: without a traceback on an early Ctrl-C, and with an answer to --help.

Importing rospy takes a few tenths of a second. Until ``ros.runtime.run`` installs its own handlers, a Ctrl-C ends the
process silently. The usage of a node is printed without importing rospy, and needs no ROS master.

Where the address space is too small for rospy and a node's threads nothing is started, and one line says so: a node
that couldn't start a thread any more would drive on without its newest connection.
"""
from __future__ import annotations

import ast
import contextlib
import importlib
import importlib.util
import os
import re
import signal
import sys
from pathlib import Path

from car_interface.common import process_setup
from car_interface.common.errors import CarInterfaceError

NODES = "nodes."
# Of address space, with process_setup.prepare. In the demo car_nodes took 348 MiB (VmPeak; 55 threads), each other node
# 282 at most.
NEEDED_MIB = 380
WITH_ROSPY = (NODES, "tools.doctor.")
# The nodes that calculate with arrays. genpy imports numpy, 15 MB and a quarter of a node's start, only to take its
# numbers for fields of messages: the other nodes have none, and go without.
WITH_NUMPY = ("nodes.calibration_drive", "nodes.first_check")
# The nodes with options of their own, and the module whose parse() reads them.
OPTIONS = {"nodes.calibration_drive": "tools.calibration.drive.config"}
# Where the parameters of each node are declared: classes that can be imported without rospy.
CONFIGS = {
    "turn_arb": "steering.config.TurnArbConfig",
    "throttle_arb": "throttle.config.ThrottleConfig",
    "pca9685": "pca9685.config.Pca9685Config",
    "teensy_sensor_hub": "nodes.teensy_sensor_hub.config.HubConfig",
    "generic_value_converter": "throttle.converter.ConverterConfig",
    "planner_interface": "nodes.planner_interface.config.PlannerInterfaceConfig",
    "teleop_logi": "teleop.gamepad.GamepadConfig",
    "gamepad_joy": "teleop.joystick.JoystickConfig",
    "keyboard_drive": "teleop.keyboard.KeyboardConfig",
    "phone_drive": "nodes.phone_drive.config.PhoneDriveConfig",
    "black_box": "common.black_box_folder.BlackBoxConfig",
    "car_nodes": "common.fixed_parameters.CarNodesConfig",
    "car_display": "nodes.teensy_sensor_hub.config.CarDisplayConfig",
    "car_sim": "nodes.car_sim.config.CarSimConfig",
}


def start(module: str) -> None:
    """Run ``main`` of ``car_interface.<module>``; for a node with -h or --help print its usage instead."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    if module.startswith(NODES) and {"-h", "--help"} & set(sys.argv[1:]):
        if module in OPTIONS:
            importlib.import_module(f"car_interface.{OPTIONS[module]}").parse(["--help"])
        signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # `| head` may have read enough
        print(usage(module))
        return
    try:
        if module.startswith(NODES) and module not in WITH_NUMPY:
            sys.modules["numpy"] = None
        process_setup.prepare(NEEDED_MIB if module.startswith(WITH_ROSPY) else 0)
        main = importlib.import_module(full_name(module)).main
        process_setup.reserve_blas()
        main()
    except Exception as error:
        line = process_setup.describe_shortage(error) or (str(error) if isinstance(error, CarInterfaceError) else None)
        if line is None:
            raise
        with contextlib.suppress(OSError, ValueError):
            print(f"{os.path.basename(sys.argv[0])}: {line}", file=sys.stderr, flush=True)
        os._exit(1)  # threads of rospy that have been started already would keep the process


def full_name(module: str) -> str:
    """Return what to import for a module of the package; a node with files of its own is a folder with a node.py."""
    name = f"car_interface.{module}"
    return f"{name}.node" if importlib.util.find_spec(name).submodule_search_locations else name


def config_class(node: str) -> type | None:
    """Return the class that declares a node's parameters; ``None`` = it has none."""
    module, _, name = CONFIGS.get(node, "").rpartition(".")
    return getattr(importlib.import_module(f"car_interface.{module}"), name) if module else None


def usage(module: str) -> str:
    """Return a node's usage: the first paragraph of its module's docstring, and its parameters."""
    from car_interface.common.declared import rows  # here: a node that runs, and a tool, do without
    source = Path(importlib.util.find_spec(full_name(module)).origin).read_text(encoding="utf-8")
    purpose = ast.get_docstring(ast.parse(source)).split("\n\n")[0]
    name = module[len(NODES):]
    config = config_class(name)
    parameters = "" if config is None else "\n\nparameters:\n" + "\n".join(map(_usage_of, rows(config)))
    return (f"usage: rosrun car_interface {name} [-h] [_PARAMETER:=VALUE ...] [TOPIC:=NEW_NAME ...]\n\n{purpose}"
            f"{parameters}\n\ndocs/nodes.md of the package lists its topics and services.")


def _usage_of(row):
    """Return a parameter's lines, without the links and the quotes that are for docs/nodes.md."""
    facts = "; ".join(filter(None, (row.default, row.range)))
    meaning = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", row.text)
    return f"  {row.name} ({facts})\n      {meaning}".replace("`", "")
