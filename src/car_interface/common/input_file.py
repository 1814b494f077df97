"""Reads files that people write. A file that is too large, or not a regular file, is refused before it is read."""
from __future__ import annotations

import errno
import math
import os
import stat

MEGABYTE = 1_000_000
KINDS = ((stat.S_ISFIFO, "a pipe"), (stat.S_ISCHR, "a device"), (stat.S_ISBLK, "a device"), (stat.S_ISSOCK, "a socket"))


def read_file(path: str, max_bytes: int) -> bytes:
    """Read a regular file.

    Args:
        path: a link is followed.
        max_bytes: the largest accepted size.

    Raises:
        OSError: it can't be read, is no regular file or is larger. ``strerror`` says which.
    """
    check_kind(os.stat(path))  # before it is opened: opening a pipe waits, and opening a device may do anything
    fd = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)
    with open(fd, "rb") as file:
        status = os.fstat(fd)
        check_kind(status)  # it may be another file by now
        if status.st_size > max_bytes:
            raise _too_large(f"it has {status.st_size / MEGABYTE:,.1f} MB", max_bytes)
        data = file.read(max_bytes + 1)  # it may still grow, and files in /proc have a size of 0
    if len(data) > max_bytes:
        raise _too_large("it has no end in sight", max_bytes)
    return data


def check_kind(status: os.stat_result) -> None:
    """Check that a status belongs to a regular file.

    Raises:
        OSError: naming its kind.
    """
    if stat.S_ISDIR(status.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    if not stat.S_ISREG(status.st_mode):
        kind = next((name for is_kind, name in KINDS if is_kind(status.st_mode)), "no regular file")
        raise OSError(errno.EINVAL, f"it is {kind}")


def finite_number(text: str) -> float | None:
    """Return the finite number that a decimal text such as ``12``, ``-0.5`` or ``1e-3`` stands for, or ``None``.

    Python would also take ``1_0`` and the digits of all scripts. In a table they are more likely to be damage.
    """
    try:
        number = float(text) if _is_plain(text) else math.nan
    except ValueError:
        return None
    return number if math.isfinite(number) else None


def integer(text: str) -> int | None:
    """Return the integer that a text such as ``64`` or ``0x40`` stands for, or ``None``."""
    try:
        return int(text, 0) if _is_plain(text) else None
    except ValueError:
        return None


def _is_plain(text):
    return text.isascii() and "_" not in text


def _too_large(found, max_bytes):
    return OSError(errno.EFBIG, f"{found}, more than {max_bytes / MEGABYTE:g} MB")
