"""The command wait_for_name: runs another package's node, once no other node of its name runs.

The nodes of this package wait by themselves. A launch file gives this one to a node that doesn't as its launch-prefix.
"""
from __future__ import annotations

import os
import signal
import sys

from car_interface.ros.name_lookup import own_name, wait_for_name

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
