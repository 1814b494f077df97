"""Finds which processes have a device open, and how one was started, by /proc. Only root sees other users' files."""
from __future__ import annotations

import os

INTERPRETERS = ("python", "bash", "sh", "perl")


def openers(path: str, proc: str = "/proc") -> list[tuple[int, str]]:
    """Return the other processes that have a file open, as (process id, name).

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
    """Return the name of a program; for an interpreter the name of its script."""
    names = [os.path.basename(part) for part in _command_line(pid, proc) if part]
    if not names:
        return "unknown"
    scripts = [name for name in names[1:] if not name.startswith("-")]
    if names and names[0].startswith(INTERPRETERS) and scripts:
        return scripts[0]
    return names[0].rstrip(":")


def script_arguments(pid: int, script: str, proc: str = "/proc") -> list[str]:
    """Return the arguments of a process that runs a script of this name; empty: it runs something else or has ended."""
    words = _command_line(pid, proc)
    places = [place for place, word in enumerate(words) if os.path.basename(word) == script]
    return words[places[0] + 1:] if places else []


def _command_line(pid, proc):
    try:
        with open(os.path.join(proc, str(pid), "cmdline"), "rb") as file:
            return file.read().decode(errors="replace").split("\0")[:-1]
    except OSError:
        return []


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
