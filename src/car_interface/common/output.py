"""Writes a command's results. A path that can't be written is refused before the work; no file is ever half written.

A link stays a link, and its target is written. A file that is replaced keeps its mode and its owner. A device or pipe,
such as /dev/stdout, is written to as it is. A recording is never overwritten.
"""
from __future__ import annotations

import os
import stat
import sys
from typing import Iterable

from car_interface.common.atomic_file import is_write_protected, replace
from car_interface.common.errors import CarInterfaceError

RECORDING_BEGINS = (b"#ROSBAG", b"SQLite format 3", b"\x89MCAP")
STREAMS = {"/dev/stdout": 1, "/dev/stderr": 2}  # opened by name they would truncate a file that they are redirected to


def check(path: str, recordings: Iterable[str] = ()) -> None:
    """Check that an output can be written, before the work for it.

    Args:
        path: as its owner wrote it.
        recordings: the paths that the command reads.

    Raises:
        CarInterfaceError: naming ``path`` and why it can't.
    """
    real = os.path.realpath(path)
    folder = os.path.dirname(real)
    if real in map(os.path.realpath, recordings):
        raise CarInterfaceError(f"{path} is an input: give the output another name")
    if is_stream(path):
        return
    if os.path.isdir(real) or not os.path.basename(path):
        raise CarInterfaceError(f"{path} is a folder: name a file for the output")
    if not os.path.isdir(folder):
        raise CarInterfaceError(f"{path} can't be written: there is no folder {folder}")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise CarInterfaceError(f"{path} can't be written: no permission in the folder {folder}")
    if os.path.exists(real):
        if is_write_protected(real):
            raise CarInterfaceError(f"{path} can't be written: it is write-protected")
        if _is_recording(real):
            raise CarInterfaceError(f"{path} is a recording, and would be lost: give the output another name")


def write(path: str, content: str | bytes, keeps_old: bool = False) -> str | None:
    """Write the content, all of it or nothing.

    Args:
        path: as ``check`` takes it.
        content: a text is written as UTF-8.
        keeps_old: a file that is replaced is kept beside it, under a name with the time.

    Returns:
        The path of the old file, if one is kept.

    Raises:
        CarInterfaceError: naming ``path`` and why it can't be written.
    """
    data = content.encode("utf-8") if isinstance(content, str) else content
    try:
        if is_stream(path):
            sys.stdout.flush()
            handle = os.dup(STREAMS[path]) if path in STREAMS else os.open(path, os.O_WRONLY)
            with open(handle, "wb") as file:
                file.write(data)
            return None
        return replace(os.path.realpath(path), data, keeps_old)
    except BrokenPipeError:
        raise
    except OSError as error:
        raise CarInterfaceError(f"{path} can't be written: {error.strerror}") from error


def written_text(path: str, backup_path: str | None) -> str:
    """Return the line that says what was written, and where the old file is now."""
    return f"written: {path}" + (f"; the old one is {backup_path}" if backup_path else "")


def is_stream(path: str) -> bool:
    """Return whether the path is a device or a pipe."""
    return path in STREAMS or os.path.exists(path) and not os.path.isdir(path) and \
        not stat.S_ISREG(os.stat(path).st_mode)


def _is_recording(path):
    try:
        with open(path, "rb") as file:
            return file.read(16).startswith(RECORDING_BEGINS)
    except OSError:  # it can't be read, and may still be replaced
        return False
