"""Detects log-in consoles on the Teensy's port, and explains how to remove them.

A console reads the bytes that are meant for the hub. It gives its port to root and the group tty with mode 0620, so
that no group lets a user read it; and it only ends for good with its service and the kernel's ``console=``.
"""
from __future__ import annotations

import glob
import os
import stat

from car_interface.common.device_access import group_name
from car_interface.common.header import read_header

CONSOLES_GROUP = "tty"
PROGRAMS = ("agetty", "getty")
PSEUDO_TERMINALS = "/dev/pts/"


def is_consoles(path: str) -> bool:
    """Return whether a port has the owner and mode that a log-in console gives it. Pseudo-terminals always have them,
    and are excluded.

    Raises:
        OSError: there is no such port.
    """
    status = os.stat(path)
    return (not status.st_mode & stat.S_IRGRP and group_name(status.st_gid) == CONSOLES_GROUP
            and not os.path.realpath(path).startswith(PSEUDO_TERMINALS))


def consoles(path: str, proc: str = "/proc") -> list[tuple[int, str]]:
    """Return the log-in consoles that were started for a port, as (process, name); any user may see these.

    Args:
        path: of the port; links are followed.
        proc: the folder to search.
    """
    wanted, found = os.path.realpath(path), []
    for file in glob.glob(os.path.join(proc, "[0-9]*", "cmdline")):
        program, *arguments = _command(file)
        if program in PROGRAMS and any(os.path.realpath(os.path.join("/dev", name)) == wanted for name in arguments):
            found.append((int(os.path.basename(os.path.dirname(file))), program))
    return sorted(found)


def removal_remedy(path: str) -> str:
    return read_header().console_remedy.format(port=os.path.basename(os.path.realpath(path)))


def _command(path):
    """Return program and arguments; the program's name is empty if the process has ended, or is the kernel's."""
    try:
        with open(path, "rb") as file:
            program, *arguments = file.read().decode(errors="replace").split("\0")
    except OSError:
        return [""]
    return [os.path.basename(program), *filter(None, arguments)]
