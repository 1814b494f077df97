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
from typing import Any, Iterable, NamedTuple

from car_interface.common.atomic_file import replace
from car_interface.common.input_file import read_file
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


class Cache:
    """The rows of a folder's recordings; those of another ``version``, such as with other options, are not used."""

    def __init__(self, folder: str, version: str):
        self._version = version
        self._paths = (os.path.join(folder, NAME), _elsewhere(folder))
        self._rows: dict = {}  # (fingerprint, row) by path
        self.problem = ""  # why an existing file wasn't used, as the end of a sentence
        self.damaged = 0  # how many of its rows aren't used since they are none
        self.path = next((path for path in self._paths if os.path.exists(path)), None)
        if self.path is not None:
            self._load(self.path)

    def row(self, path: str, state: Fingerprint | None) -> Row | None:
        """Return the row of a recording that hasn't changed since."""
        before, row = self._rows.get(path, (None, None))
        return row if before == state else None

    def add(self, state: Fingerprint | None, row: Row) -> None:
        """Keep a row. One with an error is not kept: what prevents reading may be gone the next time."""
        if not row.error:
            self._rows[row.path] = (state, row)

    def save(self, paths: Iterable[str]) -> str:
        """Write the file, with the rows of ``paths`` only; return why it can't be written, or an empty text."""
        kept = {path: [*self._rows[path]] for path in paths if path in self._rows}
        body = json.dumps({"version": self._version, "rows": kept}, ensure_ascii=True)
        text = f"{_checksum(body)}\n{body}\n"
        problem = ""
        for path in self._paths:
            try:
                os.makedirs(os.path.dirname(path), exist_ok=True)
                replace(path, text.encode("ascii"), keeps_old=False)
                return ""
            except OSError as error:
                problem = problem or f"{path}: {error.strerror}"
        return problem

    def _load(self, path):
        try:
            checksum, body = read_file(path, MAX_BYTES).decode("ascii").split("\n")[:2]
            content = json.loads(body)
            version, rows = content["version"], content["rows"]
            if checksum != _checksum(body) or not isinstance(version, str) or not isinstance(rows, dict):
                raise ValueError
        except OSError as error:
            self.problem = f"{path} can't be read ({error.strerror})"
            return
        except (ValueError, TypeError, KeyError, RecursionError):
            self.problem = f"{path} is damaged"
            return
        if version != self._version:
            return
        for name, entry in rows.items():
            found = _stored(name, entry)
            if found is None:
                self.damaged += 1
            else:
                self._rows[name] = found


def _stored(path: str, entry: Any) -> tuple[Fingerprint, Row] | None:
    """Return state and row of an entry; ``None``: it has another structure."""
    if not isinstance(entry, list) or len(entry) != 2:
        return None
    state, row = entry[0], stored_row(entry[1], path)
    if row is None or not isinstance(state, list) or [type(number) for number in state] != [int, int]:
        return None
    return Fingerprint(*state), row


def _elsewhere(folder):
    """Return the file's path for a folder that can't be written."""
    cache = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    name = hashlib.sha256(os.path.realpath(folder).encode("utf-8", "surrogateescape")).hexdigest()[:16]
    return os.path.join(cache, "car_interface", f"drives-{name}.json")


def _checksum(body):
    return hashlib.sha256(body.encode("ascii")).hexdigest()
