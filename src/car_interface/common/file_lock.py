"""POSIX locks on single bytes of a file: whoever drives a device holds one, and the kernel drops it when he dies.

A process loses its lock when it closes any of its descriptors of that file.
"""
from __future__ import annotations

import fcntl
import os
import struct

NOBODY = 0
_FLOCK = struct.Struct("hhqqi")  # struct flock with 64-bit offsets: type, whence, start, length, pid


def lock_byte(fd: int, offset: int) -> None:
    """Lock one byte.

    Raises:
        OSError: EAGAIN or EACCES: another process has it.
    """
    fcntl.lockf(fd, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, offset)


def lock_holder(fd: int, offset: int) -> int:
    """The process that has locked a byte; ``NOBODY``, too, for the one that asks.

    Raises:
        OSError: the file can't be locked.
    """
    wanted = _FLOCK.pack(fcntl.F_WRLCK, os.SEEK_SET, offset, 1, 0)
    lock_type, _, _, _, pid = _FLOCK.unpack(fcntl.fcntl(fd, fcntl.F_GETLK, wanted))
    return NOBODY if lock_type == fcntl.F_UNLCK else pid
