"""An I²C bus with virtual chips on it, in place of ``smbus2.SMBus``, with the faults of a real one."""
from __future__ import annotations

import errno
from typing import Callable, Sequence

from car_interface.sim.pca9685_chip import VirtualPca9685

KERNEL_TIMEOUT_S = 1.0  # of an I2C adapter on Linux, unless its driver says otherwise


class VirtualBus:
    """The methods of smbus2 that the package uses.

    Args:
        chips: by 7-bit address. Any other address answers as an empty one does on Linux: OSError 121 (EREMOTEIO).
        pause: called with seconds while the bus is held and the kernel waits for it in vain.
        on_write: called with (address, register, data) after each write that a chip took.
    """

    def __init__(self, chips: dict[int, VirtualPca9685], pause: Callable[[float], None] = lambda seconds: None,
                 on_write: Callable[[int, int, Sequence[int]], None] = lambda address, register, data: None):
        self.nacks_left = 0  # how many of the next transfers are not acknowledged
        self.held = False  # somebody holds the bus down: every transfer times out
        self.chips = dict(chips)  # those that are on the bus now
        self._pause = pause
        self._on_write = on_write

    def read_byte_data(self, address: int, register: int) -> int:
        return self.read_i2c_block_data(address, register, 1)[0]

    def read_i2c_block_data(self, address: int, register: int, length: int) -> list[int]:
        """Read at most 32 registers, as smbus2."""
        return self._chip(address).read(register, _checked_length(length))

    def write_i2c_block_data(self, address: int, register: int, data: list[int]) -> None:
        """Write at most 32 registers, as smbus2."""
        _checked_length(len(data))
        self._chip(address).write(register, data)
        self._on_write(address, register, data)

    def close(self) -> None:
        """Close as smbus2; the chips keep their power."""

    def _chip(self, address):
        if self.held:
            self._pause(KERNEL_TIMEOUT_S)
            raise OSError(errno.ETIMEDOUT, "Connection timed out")
        nack, self.nacks_left = self.nacks_left > 0, max(0, self.nacks_left - 1)
        if nack or address not in self.chips:
            raise OSError(errno.EREMOTEIO, "Remote I/O error")
        return self.chips[address]


def _checked_length(length):
    if length > 32:
        raise ValueError(f"Data length cannot exceed 32 bytes, got {length}")
    return length
