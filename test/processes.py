"""Ends everything that a run has started, whatever became of it.

roslaunch gives each node a session of its own, so that neither a process group nor a session holds all of a run's
processes. But a run is their "child subreaper" (prctl(2)): a process whose parent has ended becomes the run's child.
So the run's descendants are all that it has started, and no other process is among them.

    python3 test/processes.py [--limit SECONDS] [--left-behind FILE] COMMAND...

runs a command like this, until it ends, the time limit is over (exit code 124), a signal comes (128 + its number), or
the process that started this one ends. Then it ends what is left. When the command ended by itself and processes were
left, it writes their number to the file.
"""
from __future__ import annotations

import argparse
import ctypes
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections import defaultdict
from pathlib import Path
from typing import Callable

PR_SET_PDEATHSIG, PR_SET_CHILD_SUBREAPER = 1, 36  # linux/prctl.h
TIMEOUT_EXIT_CODE = 124  # as timeout(1)
ENDS = (signal.SIGHUP, signal.SIGINT, signal.SIGPIPE, signal.SIGTERM)
POLL_S = 0.1
# In which what a command has started may end after it: a virtual chip in 3 s, a guard in 10, its relay 5 s later, and
# more on a busy computer.
GRACE_S = 40.0


def adopt_descendants(end_with_parent: bool = False) -> None:
    """Make this process the subreaper of all that it starts, and have a signal raise SystemExit, once.

    With ``end_with_parent`` the end of the process that started this one is such a signal too.
    """
    prctl = ctypes.CDLL(None, use_errno=True).prctl
    if prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0):
        raise OSError(ctypes.get_errno(), "prctl(PR_SET_CHILD_SUBREAPER)")
    for number in ENDS:
        signal.signal(number, _exit)
    if end_with_parent:
        prctl(PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)


def _exit(number, _):
    for each in ENDS:
        signal.signal(each, signal.SIG_IGN)  # the end itself is not interrupted
    if number == signal.SIGPIPE:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # what is still buffered has no reader
    raise SystemExit(128 + number)


def descendants(root: int | None = None) -> list[int]:
    """Return the ids of the living processes below one; None is this process."""
    children = defaultdict(list)
    for name in filter(str.isdigit, os.listdir("/proc")):
        try:
            with open(f"/proc/{name}/stat", encoding="utf-8", errors="replace") as file:
                state, parent = file.read().rpartition(")")[2].split()[:2]  # after the name, which may hold anything
        except OSError:
            continue  # it has just ended
        if state not in "ZX":
            children[int(parent)].append(int(name))
    found = list(children[os.getpid() if root is None else root])
    for pid in found:
        found += children[pid]
    return found


def start(*command: str, **options) -> subprocess.Popen:
    """Start a program in a session of its own: a Ctrl-C on the terminal reaches it only through this process."""
    return subprocess.Popen(command, start_new_session=True, **options)


def wait_until(condition: Callable[[], object], within_s: float) -> bool:
    deadline_s = time.monotonic() + within_s
    while not condition():
        if time.monotonic() > deadline_s:
            return False
        time.sleep(POLL_S)
    return True


def interrupt(process: subprocess.Popen, within_s: float) -> None:
    """Send SIGINT to a started program's session, and give it so much time to end."""
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGINT)
        wait_until(lambda: process.poll() is not None, within_s)


def end_descendants() -> None:
    for number, within_s in ((signal.SIGINT, 3), (signal.SIGTERM, 2), (signal.SIGKILL, 2)):
        for pid in descendants():
            try:
                os.kill(pid, number)
            except ProcessLookupError:
                pass
        if wait_until(lambda: not descendants(), within_s):
            return


def free_port() -> int:
    """Return a TCP port for a ROS master that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def answers(port: int) -> bool:
    """Return whether anybody listens on a port of this machine."""
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def end_of_log(path: Path, count: int) -> str:
    """Return the last lines of a log, indented and without colours, and where all of it is."""
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines() if path.exists() else []
    return "\n".join([*(re.sub(r"\033\[[0-9;]*m", "", f"  | {line}") for line in lines[-count:]),
                      f"  (all of it: {path})"])


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("--limit", type=float, metavar="SECONDS")
    parser.add_argument("--left-behind", type=Path, metavar="FILE")
    parser.add_argument("command", nargs=argparse.REMAINDER)
    arguments = parser.parse_args()
    adopt_descendants(end_with_parent=True)
    try:
        code = start(*arguments.command).wait(arguments.limit)
        if arguments.left_behind and not wait_until(lambda: not descendants(), GRACE_S):
            arguments.left_behind.write_text(str(len(descendants())), encoding="ascii")
        return code if code >= 0 else 128 - code
    except subprocess.TimeoutExpired:
        return TIMEOUT_EXIT_CODE
    finally:
        end_descendants()


if __name__ == "__main__":
    sys.exit(main())
