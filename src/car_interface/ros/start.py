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
import signal
import sys
from pathlib import Path

from car_interface.common import memory_limit
from car_interface.common.errors import CarInterfaceError
from car_interface.common.library_warnings import hide_warnings

NODES = "nodes."
# Of address space, with memory_limit.adapt. In the demo car_nodes took 348 MiB (VmPeak; 55 threads), each other node
# 282 at most.
NEEDED_MIB = 380
WITH_ROSPY = (NODES, "tools.doctor.")
# The nodes with options of their own, and the module whose parse() reads them.
OPTIONS = {"nodes.calibration_drive": "tools.calibration.drive.config"}


def start(module: str) -> None:
    """Run ``main`` of ``car_interface.<module>``; for a node with -h or --help print its usage instead."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    if module.startswith(NODES) and {"-h", "--help"} & set(sys.argv[1:]):
        if module in OPTIONS:
            importlib.import_module(f"car_interface.{OPTIONS[module]}").parse(["--help"])
        print(usage(module))
        return
    try:
        hide_warnings()
        memory_limit.adapt(NEEDED_MIB if module.startswith(WITH_ROSPY) else 0)
        main = importlib.import_module(full_name(module)).main
        memory_limit.reserve_blas()
        main()
    except Exception as error:
        line = memory_limit.describe_shortage(error) or (str(error) if isinstance(error, CarInterfaceError) else None)
        if line is None:
            raise
        with contextlib.suppress(OSError, ValueError):
            print(f"{os.path.basename(sys.argv[0])}: {line}", file=sys.stderr, flush=True)
        os._exit(1)  # threads of rospy that have been started already would keep the process


def full_name(module: str) -> str:
    """Return what to import for a module of the package; a node with files of its own is a folder with a node.py."""
    name = f"car_interface.{module}"
    return f"{name}.node" if importlib.util.find_spec(name).submodule_search_locations else name


def usage(module: str) -> str:
    """A node's usage, with the first paragraph of its module's docstring."""
    source = Path(importlib.util.find_spec(full_name(module)).origin).read_text(encoding="utf-8")
    purpose = ast.get_docstring(ast.parse(source)).split("\n\n")[0]
    name = module[len(NODES):]
    return (f"usage: rosrun car_interface {name} [-h] [_PARAMETER:=VALUE ...] [TOPIC:=NEW_NAME ...]\n\n{purpose}\n\n"
            "docs/nodes.md of the package lists its parameters, topics and services.")
