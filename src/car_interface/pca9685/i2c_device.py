"""Talks to one chip on an I²C bus of Linux by the kernel's SMBus calls, for the guard: without smbus2 and ctypes.

smbus2 makes the same calls for the node, so the guard works on every adapter that the node works on.
"""
from __future__ import annotations

import fcntl
import os
import struct
from array import array

from car_interface.common.file_lock import LockedChip

I2C_SLAVE, I2C_SMBUS = 0x0703, 0x0720  # linux/i2c-dev.h
_WRITE, _READ = 0, 1  # linux/i2c.h
_BLOCK_DATA = 8  # I2C_SMBUS_I2C_BLOCK_DATA: the first byte is the number of the others
_REQUEST = struct.Struct("BBIP")  # struct i2c_smbus_ioctl_data: direction, register, size, pointer to the data
_DATA_SIZE = 34  # union i2c_smbus_data: a length, up to 32 bytes, and one more


class I2cDevice(LockedChip):
    """A chip on a bus; opened when it is first needed, and again after ``close``. Its locks are on the bus's file."""

    def __init__(self, path: str, address: int):
        super().__init__(path, address)
        self._fd = -1

    def open(self) -> None:
        """Open the bus, unless it is open.

        Raises:
            OSError: it can't be opened, or is no I²C bus.
        """
        if self._fd >= 0:
            return
        self._fd = os.open(self._path, os.O_RDWR | os.O_CLOEXEC)
        try:
            fcntl.ioctl(self._fd, I2C_SLAVE, self._address)
        except OSError:
            self.close()
            raise

    def close(self) -> None:
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def lock_fd(self) -> int:
        return self._fd

    def is_gone(self, error: OSError) -> bool:
        """Return whether an error means that the chip is gone for good: never, as a bus on USB may come back."""
        return False

    def read(self, register: int, length: int) -> bytes:
        """Read 1..32 registers, in one transfer."""
        data = array("B", bytes((length,)).ljust(_DATA_SIZE, b"\0"))
        self._transfer(_READ, register, data)
        return data[1: 1 + length].tobytes()

    def write(self, register: int, values: bytes) -> None:
        """Write 1..32 registers, in one transfer."""
        data = array("B", (bytes((len(values),)) + values).ljust(_DATA_SIZE, b"\0"))
        self._transfer(_WRITE, register, data)

    def _transfer(self, direction, register, data):
        fcntl.ioctl(self._fd, I2C_SMBUS, _REQUEST.pack(direction, register, _BLOCK_DATA, data.buffer_info()[0]))
