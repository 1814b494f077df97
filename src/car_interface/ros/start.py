"""How a script starts its node: without a traceback on an early Ctrl-C, and with an answer to --help.

Importing rospy takes a few tenths of a second. Until ``ros.runtime.run`` installs its own handlers, a Ctrl-C ends the
process silently. The usage of a node is printed without importing rospy, and needs no ROS master.
"""
from __future__ import annotations

import ast
import importlib
import importlib.util
import signal
import sys
from pathlib import Path

NODES = "nodes."
OPTIONS = {"nodes.calibration_drive": "calibration.drive.options"}  # of nodes that have some: a module with parse()


def start(module: str) -> None:
    """Run ``main`` of ``car_interface.<module>``; for a node with -h or --help print its usage instead."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    if module.startswith(NODES) and {"-h", "--help"} & set(sys.argv[1:]):
        if module in OPTIONS:
            importlib.import_module(f"car_interface.{OPTIONS[module]}").parse(["--help"])
        print(usage(module))
        return
    importlib.import_module(f"car_interface.{module}").main()


def usage(module: str) -> str:
    """A node's usage, with the first paragraph of its module's docstring."""
    source = Path(importlib.util.find_spec(f"car_interface.{module}").origin).read_text(encoding="utf-8")
    purpose = ast.get_docstring(ast.parse(source)).split("\n\n")[0]
    name = module[len(NODES):]
    return (f"usage: rosrun car_interface {name} [-h] [_PARAMETER:=VALUE ...] [TOPIC:=NEW_NAME ...]\n\n{purpose}\n\n"
            "docs/nodes.md of the package lists its parameters, topics and services.")
