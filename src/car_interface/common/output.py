"""Replaces files in one step, and writes a command's results: a path that can't be written is refused before the work.

A reader sees the old content or the new one, never a part of either. The new content is written beside the file, under
a hidden name, and renamed when it is complete. A process that is killed before that leaves it behind, and the next
replacement of the file removes it: the name has the writer's number.

Of a command's results a link stays a link, and its target is written. A device or pipe, such as /dev/stdout, is written
to as it is. A recording is never overwritten.
"""
from __future__ import annotations

import errno
import glob
import os
import re
import secrets
import stat
import sys
import time
from contextlib import suppress
from typing import Iterable

from car_interface.common.errors import CarInterfaceError

WRITE_BITS = 0o222
NEW = re.compile(r"\.new-(\d+)-[0-9a-f]{8}$")  # ends the name of a file that isn't in place yet
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


def is_write_protected(path: str) -> bool:
    """Return whether a file is write-protected. To replace it takes access to its folder only, and root always may."""
    return not os.access(path, os.W_OK) or not os.stat(path).st_mode & WRITE_BITS


def replace(path: str, data: bytes, keeps_old: bool) -> str | None:
    """Replace a file, with the old one's mode and, as far as that is allowed, owner.

    Args:
        path: of the file; a link is replaced itself.
        keeps_old: keep the old file in the same folder, under a name with the time.

    Returns:
        The backup's path, if there is one.

    Raises:
        OSError: nothing was changed, and nothing is left behind.
    """
    _remove_leftovers(path)
    try:
        old = os.stat(path)
    except FileNotFoundError:
        old = None
    folder, name = os.path.split(path)
    new_path, backup_path = os.path.join(folder, f".{name}.new-{os.getpid()}-{secrets.token_hex(4)}"), None
    _write_new(new_path, data, old)
    try:
        if old is not None and keeps_old:
            backup_path = _back_up(path, old)
            os.utime(backup_path, ns=(old.st_atime_ns, old.st_mtime_ns))
        os.replace(new_path, path)
    except BaseException:
        for left_path in filter(None, (new_path, backup_path)):
            os.unlink(left_path)
        raise
    _sync_folder(folder or ".")
    return backup_path


def _write_new(path, data, old):
    """Write a file that isn't there yet, with the mode and the owner of an old one."""
    fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666 if old is None else 0o600)
    try:
        with open(fd, "wb") as file:
            file.write(data)
            file.flush()
            if old is not None:
                with suppress(PermissionError):  # only root may give files away
                    os.fchown(fd, old.st_uid, old.st_gid)
                os.fchmod(fd, stat.S_IMODE(old.st_mode))
            os.fsync(fd)
    except BaseException:
        os.unlink(path)
        raise


def _remove_leftovers(path):
    """Remove what killed processes left behind when they replaced this file."""
    folder, name = map(glob.escape, os.path.split(path))
    for left_path in glob.iglob(os.path.join(folder, f".{name}.new-*")):
        writer = NEW.search(left_path)
        if writer and not os.path.exists(f"/proc/{writer[1]}"):
            with suppress(OSError):  # it is gone, no file, or somebody else's
                os.unlink(left_path)


def _back_up(path, old):
    """Copy the file under a name with the time, and return that; an existing file is never overwritten."""
    with open(path, "rb") as file:
        content = file.read()
    stem = f"{path}.bak-{time.strftime('%Y%m%d-%H%M%S')}"
    for attempt in range(1, 1000):
        backup_path = stem if attempt == 1 else f"{stem}-{attempt}"
        with suppress(FileExistsError):
            _write_new(backup_path, content, old)
            return backup_path
    raise FileExistsError(errno.EEXIST, f"too many files named {stem}")


def _sync_folder(folder):
    """Let the new names survive a power failure, too, where the file system can."""
    with suppress(OSError):
        fd = os.open(folder, os.O_RDONLY | os.O_CLOEXEC)
        try:
            os.fsync(fd)
        finally:
            os.close(fd)
