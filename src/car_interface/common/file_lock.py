"""Locks bytes of a file by POSIX locks: the driver of a device holds one, and the kernel drops it when that dies.

A chip on a bus is locked by the byte of its address. Each of its guards locks a byte by its time of start, so that an
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


class LockedChip:
    """What the locks of a chip tell its guard; ``lock_fd`` returns the file that they are on.

    Args:
        address: of the chip, 7 bits and above 0. A lock on this byte is its node's.
    """

    def __init__(self, path: str, address: int):
        self._path = path
        self._address = address

    def lock_holder(self) -> int:
        """Return the process that has locked this chip, or ``NOBODY``."""
        return lock_holder(self.lock_fd(), self._address)

    def claim(self, generation: int) -> None:
        """Show older guards of this chip that there is a newer one; generations are 0..MAX_GENERATION − 1."""
        lock_byte(self.lock_fd(), self._address * MAX_GENERATION + generation)

    def successor(self, generation: int) -> int:
        """Return the process of a newer guard, or ``NOBODY``."""
        first = self._address * MAX_GENERATION + generation + 1
        return lock_holder(self.lock_fd(), first, MAX_GENERATION - generation - 1)
