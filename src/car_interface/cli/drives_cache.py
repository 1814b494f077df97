"""Keeps the rows of recordings that were read before, so that only what is new is read again.

The file lies in the folder of the recordings, or, where that can't be written, in the user's cache folder. Its first
line is the checksum of the second one: a damaged file is no error, all recordings are read again.
"""
from __future__ import annotations

import hashlib
import json
import os
from typing import Iterable

from car_interface.common.atomic_file import replace
from car_interface.recordings.folder import Fingerprint
from car_interface.report.drives_row import Row

NAME = ".car_interface_drives.json"


class Cache:
    """The rows of a folder's recordings.

    Args:
        folder: of the recordings.
        version: of rows; those of another version, such as with other options, are not used.

    Attributes:
        problem: why an existing file wasn't used, as the end of a sentence; empty: it was, or there is none.
    """

    def __init__(self, folder: str, version: str):
        self._version = version
        self._paths = (os.path.join(folder, NAME), _elsewhere(folder))
        self._rows: dict = {}  # (fingerprint, row) by path
        self.problem = ""
        path = next((path for path in self._paths if os.path.exists(path)), None)
        if path is not None:
            self._load(path)

    def row(self, path: str, state: Fingerprint) -> Row | None:
        """The row of a recording that hasn't changed since."""
        before, row = self._rows.get(path, (None, None))
        return row if before == state else None

    def add(self, state: Fingerprint, row: Row) -> None:
        """Keep a row. One with an error is not kept: what prevents reading may be gone the next time."""
        if not row.error:
            self._rows[row.path] = (state, row)

    def save(self, paths: Iterable[str]) -> str:
        """Write the file, with the rows of ``paths`` only.

        Returns:
            Why it can't be written; empty: it was.
        """
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
            with open(path, encoding="ascii") as file:
                checksum, body = file.read().split("\n")[:2]
            if checksum != _checksum(body):
                raise ValueError
            content = json.loads(body)
        except OSError as error:
            self.problem = f"{path} can't be read ({error.strerror})"
            return
        except ValueError:
            self.problem = f"{path} is damaged"
            return
        if content["version"] == self._version:
            self._rows = {path: (Fingerprint(*state), Row(*row)) for path, (state, row) in content["rows"].items()}


def _elsewhere(folder):
    """The file's path for a folder that can't be written."""
    cache = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    name = hashlib.sha256(os.path.realpath(folder).encode("utf-8", "surrogateescape")).hexdigest()[:16]
    return os.path.join(cache, "car_interface", f"drives-{name}.json")


def _checksum(body):
    return hashlib.sha256(body.encode("ascii")).hexdigest()
