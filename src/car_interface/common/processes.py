"""Which processes have a device open, as far as /proc tells: other users' are seen by root only."""
from __future__ import annotations

import os

INTERPRETERS = ("python", "bash", "sh", "perl")


def openers(path: str, proc: str = "/proc") -> list[tuple[int, str]]:
    """Who has a file open, as (process, name), without this process itself.

    Args:
        path: of the file; links are followed.
        proc: where to look.
    """
    wanted, found = os.path.realpath(path), []
    for pid in filter(str.isdigit, _names_in(proc)):
        if int(pid) != os.getpid() and any(_target(link) == wanted for link in _links(os.path.join(proc, pid, "fd"))):
            found.append((int(pid), process_name(int(pid), proc)))
    return sorted(found)


def process_name(pid: int, proc: str = "/proc") -> str:
    """The program's name; of a script the script's."""
    try:
        with open(os.path.join(proc, str(pid), "cmdline"), "rb") as file:
            words = [os.path.basename(word) for word in file.read().decode(errors="replace").split("\0") if word]
    except OSError:
        return "unknown"
    scripts = [word for word in words[1:] if not word.startswith("-")]
    if words and words[0].startswith(INTERPRETERS) and scripts:
        return scripts[0]
    return words[0].rstrip(":") if words else "unknown"


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
