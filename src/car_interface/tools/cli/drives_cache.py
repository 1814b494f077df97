"""Finds the recordings in a folder, and keeps the rows of those that were read before: only what is new is read again.

The file lies in the folder of the recordings, or, where that can't be written, in the user's cache folder. Its first
line is the checksum of the second one. A damaged file is no error: all recordings are read again. The checksum can be
right and the content wrong, after somebody has edited it: only rows of the structure that ``drives_row`` declares are
used, and what has another one is read again.
"""
from __future__ import annotations

import hashlib
import json
import os
from typing import Any, Mapping, NamedTuple

from car_interface.common.input_file import read_file
from car_interface.common.output import replace
from car_interface.tools.recordings.recording import METADATA, ROS2_SUFFIXES
from car_interface.tools.report.drives_row import Row, stored_row

# A bag that is being recorded, or whose recorder was killed, has the second one.
ROS1_SUFFIXES = (".bag", ".bag.active")
ORIGINAL = ".orig"  # rosbag reindex keeps a damaged a.bag as a.orig.bag
NAME = ".car_interface_drives.json"
MAX_BYTES = 64_000_000  # a row has about 1 kB: 60,000 recordings


class Fingerprint(NamedTuple):
    """A recording with another one has changed."""

    size: int  # bytes
    mtime_ns: int


def find_recordings(folder: str) -> list[str]:
    """Return the paths of all recordings in a folder and below it, relative to it, in order.

    A ROS 2 bag is its folder, or a file that lies in no such folder. Left out are hidden folders, and what rosbag
    reindex has kept of a recording that it repaired.

    Raises:
        OSError: the folder can't be read.
    """
    found = []
    os.scandir(folder).close()  # os.walk leaves out what it can't read, also the first
    for place, folders, files in os.walk(folder):
        if METADATA in files and any(name.endswith(ROS2_SUFFIXES) for name in files):
            found.append(os.path.relpath(place, folder))
            folders.clear()
            continue
        folders[:] = [name for name in folders if not name.startswith(".")]
        found += [os.path.relpath(os.path.join(place, name), folder) for name in files
                  if name.endswith((*ROS1_SUFFIXES, *ROS2_SUFFIXES)) and not _is_original(name, files)]
    return sorted(found)


def _is_original(name, files):
    """Return whether the repaired recording lies beside it."""
    stem, suffix = os.path.splitext(name)
    return stem.endswith(ORIGINAL) and stem[:-len(ORIGINAL)] + suffix in files


def fingerprint(path: str) -> Fingerprint | None:
    """Return size and time of change of a recording, of a folder those of all its files together; ``None``: it is gone.
    """
    try:
        paths = [os.path.join(path, name) for name in os.listdir(path)] if os.path.isdir(path) else [path]
        stats = [os.stat(one) for one in paths]
    except OSError:
        return None
    return Fingerprint(sum(one.st_size for one in stats), max((one.st_mtime_ns for one in stats), default=0))


def load_rows(folder: str, version: str) -> tuple[dict, str]:
    """Return the rows that were kept of a folder's recordings; those of another version, as with other options, aren't.

    Returns:
        (Fingerprint, Row) by path, and in words what can't be used; empty: nothing is wrong.
    """
    path = next(filter(os.path.exists, _paths(folder)), None)
    if path is None:
        return {}, ""
    try:
        checksum, body = read_file(path, MAX_BYTES).decode("ascii").split("\n")[:2]
        content = json.loads(body)
        kept_version, entries = content["version"], content["rows"]
        if checksum != _checksum(body) or not isinstance(kept_version, str) or not isinstance(entries, dict):
            raise ValueError
    except OSError as error:
        return {}, f"{path} can't be read ({error.strerror}): all recordings are read again"
    except (ValueError, TypeError, KeyError, RecursionError):
        return {}, f"{path} is damaged: all recordings are read again"
    if kept_version != version:
        return {}, ""
    rows = {name: row for name, row in ((name, _stored(name, entry)) for name, entry in entries.items()) if row}
    damaged = len(entries) - len(rows)
    return rows, f"{path} has damaged rows ({damaged}): their recordings are read again" if damaged else ""


def save_rows(folder: str, version: str, rows: Mapping[str, tuple[Fingerprint | None, Row]]) -> str:
    """Keep the rows, as ``load_rows`` returns them; return why they can't be written, or an empty text."""
    body = json.dumps({"version": version, "rows": rows}, ensure_ascii=True)
    problem = ""
    for path in _paths(folder):
        try:
            os.makedirs(os.path.dirname(path), exist_ok=True)
            replace(path, f"{_checksum(body)}\n{body}\n".encode("ascii"), keeps_old=False)
            return ""
        except OSError as error:
            problem = problem or f"{path}: {error.strerror}"
    return problem


def _stored(path: str, entry: Any) -> tuple[Fingerprint, Row] | None:
    """Return state and row of an entry; ``None``: it has another structure."""
    if not isinstance(entry, list) or len(entry) != 2:
        return None
    state, row = entry[0], stored_row(entry[1], path)
    if row is None or not isinstance(state, list) or [type(number) for number in state] != [int, int]:
        return None
    return Fingerprint(*state), row


def _paths(folder):
    """Return where the file may be: in the folder, or, where that can't be written, in the user's cache folder."""
    cache = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    name = hashlib.sha256(os.path.realpath(folder).encode("utf-8", "surrogateescape")).hexdigest()[:16]
    return os.path.join(folder, NAME), os.path.join(cache, "car_interface", f"drives-{name}.json")


def _checksum(body):
    return hashlib.sha256(body.encode("ascii")).hexdigest()
