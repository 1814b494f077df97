"""Whether a window can be shown on this computer: a reason in words instead of Qt's abort."""
from __future__ import annotations

import os
import re
import socket
from typing import Mapping

DISPLAY = re.compile(r"^(?:(?P<protocol>\w+)/)?(?P<host>[^:/]*):(?P<number>\d+)(?:\.\d+)?$")
TCP_PORT = 6000  # of display 0; X(7)
CONNECT_S = 2.0


def screen_problem(environment: Mapping[str, str], folder: str = "/tmp/.X11-unix") -> str:
    """Why a program with a window can't be started here; empty = it can.

    Args:
        environment: of the program.
        folder: of the X server's sockets.
    """
    if environment.get("QT_QPA_PLATFORM"):  # somebody has chosen how Qt draws, maybe without any screen
        return ""
    display = environment.get("DISPLAY", "")
    if not display:
        return "there is no screen (DISPLAY isn't set)"
    parts = DISPLAY.match(display)
    if parts is None:
        return ""  # a form that only the X library knows
    try:
        _connect(parts.group("host"), int(parts.group("number")), folder)
    except OSError as error:
        return f"the screen that DISPLAY names, {display}, can't be reached ({error.strerror or error})"
    return ""


def _connect(host, number, folder):
    if host not in ("", "unix"):
        socket.create_connection((host, TCP_PORT + number), CONNECT_S).close()
        return
    with socket.socket(socket.AF_UNIX) as probe:
        probe.settimeout(CONNECT_S)
        path = os.path.join(folder, f"X{number}")
        try:
            probe.connect("\0" + path)  # Linux: X servers also listen on the abstract name
        except OSError:
            probe.connect(path)
