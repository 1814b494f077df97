"""Locks bytes of a file by POSIX locks: the driver of a device holds one, and the kernel drops it when that dies.

A device on a bus is locked by the byte of its address. Each of its guards locks a byte by its time of start, so that an
older guard finds a newer one. A process loses its locks when it closes any of its descriptors of that file. Each of the
functions raises OSError where the file can't be locked.
"""
from __future__ import annotations

import fcntl
import os
import struct

NOBODY = 0
MAX_GENERATION = 1 << 44  # ms: 550 years
_FLOCK = struct.Struct("hhqqi")  # struct flock with 64-bit offsets: type, whence, start, length, pid


def lock_byte(fd: int, offset: int) -> None:
    """Lock one byte.

    Raises:
        OSError: EAGAIN or EACCES: another process has it.
    """
    fcntl.lockf(fd, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, offset)


def lock_holder(fd: int, offset: int, length: int = 1) -> int:
    """Return a process that has locked one of the bytes; ``NOBODY`` also where the caller itself has."""
    wanted = _FLOCK.pack(fcntl.F_WRLCK, os.SEEK_SET, offset, length, 0)
    lock_type, _, _, _, pid = _FLOCK.unpack(fcntl.fcntl(fd, fcntl.F_GETLK, wanted))
    return NOBODY if lock_type == fcntl.F_UNLCK else pid


def lock_generation(fd: int, address: int, generation: int) -> None:
    """Lock the byte of a generation, 0..MAX_GENERATION − 1, at an address above 0."""
    lock_byte(fd, address * MAX_GENERATION + generation)


def newer_generation(fd: int, address: int, generation: int) -> int:
    """Return a process that has locked a newer generation at an address, or ``NOBODY``."""
    return lock_holder(fd, address * MAX_GENERATION + generation + 1, MAX_GENERATION - generation - 1)
