"""Detects log-in consoles on the Teensy's port, and explains how to remove them.

A console reads the bytes that are meant for the hub. It gives its port to root and the group tty with mode 0620, so
that no group lets a user read it; and it only ends for good with its service and the kernel's ``console=``.
"""
from __future__ import annotations

import glob
import os
import stat

from car_interface.common.devices import command_line, group_name, read_header

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
    """Return the log-in consoles that were started for a port, as (process, name); links to it are followed.

    Any user may see these.
    """
    wanted, found = os.path.realpath(path), []
    for folder in glob.glob(os.path.join(proc, "[0-9]*")):
        pid = int(os.path.basename(folder))
        program, *arguments = command_line(pid, proc) or [""]
        name = os.path.basename(program)
        if name in PROGRAMS and any(os.path.realpath(os.path.join("/dev", tty)) == wanted for tty in arguments):
            found.append((pid, name))
    return sorted(found)


def removal_remedy(path: str) -> str:
    return read_header().console_remedy.format(port=os.path.basename(os.path.realpath(path)))
