"""Which processes have a device open, by /proc. Those of other users are visible to root only."""
from __future__ import annotations

import os

INTERPRETERS = ("python", "bash", "sh", "perl")


def openers(path: str, proc: str = "/proc") -> list[tuple[int, str]]:
    """The other processes that have a file open, as (process id, name).

    Args:
        path: of the file; links are followed.
        proc: the proc file system.
    """
    wanted, found = os.path.realpath(path), []
    for pid in filter(str.isdigit, _names_in(proc)):
        if int(pid) != os.getpid() and any(_target(link) == wanted for link in _links(os.path.join(proc, pid, "fd"))):
            found.append((int(pid), process_name(int(pid), proc)))
    return sorted(found)


def process_name(pid: int, proc: str = "/proc") -> str:
    """The name of a program; for an interpreter that of its script."""
    try:
        with open(os.path.join(proc, str(pid), "cmdline"), "rb") as file:
            names = [os.path.basename(part) for part in file.read().decode(errors="replace").split("\0") if part]
    except OSError:
        return "unknown"
    scripts = [name for name in names[1:] if not name.startswith("-")]
    if names and names[0].startswith(INTERPRETERS) and scripts:
        return scripts[0]
    return names[0].rstrip(":") if names else "unknown"


def _names_in(folder):
    try:
        return os.listdir(folder)
    except OSError:
        return []  # another user's, or it has ended


def _links(folder):
    return [os.path.join(folder, name) for name in _names_in(folder)]


def _target(link):
    try:
        return os.readlink(link)
    except OSError:
        return None
