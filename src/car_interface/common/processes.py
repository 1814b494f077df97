"""Finds which processes have a device open, and how one was started, by /proc. Only root sees other users' files."""
from __future__ import annotations

import glob
import os
from contextlib import suppress

INTERPRETERS = ("python", "bash", "sh", "perl")


def openers(path: str, proc: str = "/proc") -> list[tuple[int, str]]:
    """Return the other processes that have a file open, as (process id, name); links to the file are followed."""
    wanted, found = os.path.realpath(path), set()
    for link in glob.iglob(os.path.join(glob.escape(proc), "[0-9]*", "fd", "*")):  # it passes over what it can't read
        with suppress(OSError):  # it was closed just now
            if os.readlink(link) == wanted:
                found.add(int(link.split(os.sep)[-3]))
    return [(pid, process_name(pid, proc)) for pid in sorted(found - {os.getpid()})]


def process_name(pid: int, proc: str = "/proc") -> str:
    """Return the name of a program; for an interpreter the name of its script."""
    names = [os.path.basename(part) for part in command_line(pid, proc) if part]
    if not names:
        return "unknown"
    scripts = [name for name in names[1:] if not name.startswith("-")]
    if names[0].startswith(INTERPRETERS) and scripts:
        return scripts[0]
    return names[0].rstrip(":")


def script_arguments(pid: int, script: str, proc: str = "/proc") -> list[str]:
    """Return the arguments of a process that runs a script of this name; empty: it runs something else or has ended."""
    words = command_line(pid, proc)
    places = [place for place, word in enumerate(words) if os.path.basename(word) == script]
    return words[places[0] + 1:] if places else []


def command_line(pid: int, proc: str = "/proc") -> list[str]:
    """Return program and arguments; empty: the process has ended, or is the kernel's."""
    try:
        with open(os.path.join(proc, str(pid), "cmdline"), "rb") as file:
            return file.read().decode(errors="replace").split("\0")[:-1]
    except OSError:
        return []
