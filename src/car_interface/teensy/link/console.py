"""Log-in consoles on the Teensy's port: how to detect and how to remove them.

A console reads the bytes that the hub wants. It makes its port root's and the group tty's with mode 0620, so that no
group lets a user read it; and it can't be ended for good but with its service and the kernel's ``console=``.
"""
from __future__ import annotations

import glob
import os
import stat

from car_interface.common.device_access import group_name

CONSOLES_GROUP = "tty"
PROGRAMS = ("agetty", "getty")
PSEUDO_TERMINALS = "/dev/pts/"


def is_consoles(path: str) -> bool:
    """Whether a port is as a log-in console leaves it. Pseudo-terminals, which are so by themselves, don't count.

    Raises:
        OSError: when there is no such port.
    """
    status = os.stat(path)
    return (not status.st_mode & stat.S_IRGRP and group_name(status.st_gid) == CONSOLES_GROUP
            and not os.path.realpath(path).startswith(PSEUDO_TERMINALS))


def consoles(path: str, proc: str = "/proc") -> list[tuple[int, str]]:
    """The log-in consoles that were started for a port, as (process, name); these anybody may see.

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
    """The remedy for a console on this port."""
    return (f"sudo systemctl disable --now serial-getty@{os.path.basename(os.path.realpath(path))} (on a Jetson: "
            "nvgetty), take console= out of the kernel's command line, and reboot. Raspberry Pi: raspi-config does it")


def _command(path):
    """Program and arguments; the program's name is empty when the process has ended, or is the kernel's."""
    try:
        with open(path, "rb") as file:
            program, *arguments = file.read().decode(errors="replace").split("\0")
    except OSError:
        return [""]
    return [os.path.basename(program), *filter(None, arguments)]
