"""The rviz_window program: starts rviz, or logs in one line why there is none. It becomes rviz, with its arguments.

The car drives with it and without it: it ends with exit code 0 where there is no screen, or no rviz.
"""
from __future__ import annotations

import os
import sys

from roslib.packages import find_node
from rospkg import ResourceNotFound

from car_interface.ros.screen import screen_problem

REMEDY = ("The car's markers are published all the same: on a computer with a screen and this master, roslaunch "
          "car_interface display.launch")
INSTALL = "sudo apt install rviz (on Ubuntu 20.04: ros-noetic-rviz)"


def main():
    """Become rviz."""
    problem = screen_problem(os.environ)
    if problem:
        _end(f"{problem}. {REMEDY}")
    try:
        found = find_node("rviz", "rviz")
    except ResourceNotFound:
        found = []
    if not found:
        _end(f"it isn't installed: {INSTALL}. {REMEDY}")
    os.execv(found[0], [found[0], *sys.argv[1:]])


def _end(text):
    print(f"[WARN] no rviz: {text}", file=sys.stderr, flush=True)
    sys.exit(0)
