"""Models a PCA9685 at register level, behind an I²C bus with smbus2's methods.

Modelled from the data sheet (NXP PCA9685, rev. 4), not from the driver that it tests: MODE1 with SLEEP, RESTART and
auto-increment, PRE_SCALE that takes a value only asleep, the ALL_LED registers, full-on and full-off bits.
"""
from __future__ import annotations

import errno
from typing import Callable, Sequence

_MODE1, _MODE2, _SUBADR1, _LED0, _LED15_END, _ALL_LED, _PRE_SCALE, _TEST = 0, 1, 2, 6, 69, 250, 254, 255
_RESTART, _EXTCLK, _AI, _SLEEP = 0x80, 0x40, 0x20, 0x10  # MODE1 bits (data sheet 7.3.1)
_FULL = 0x10  # full on, full off (data sheet 7.3.3)
_CHANNELS = 16
_KERNEL_TIMEOUT_S = 1.0  # of an I2C adapter on Linux, unless its driver says otherwise


class VirtualPca9685:
    """The chip's registers, and the state of its pins."""

    def __init__(self):
        self._registers = bytearray(256)
        self.power_up()

    def power_up(self) -> None:
        """Set every register to its reset value (data sheet 7.3, table 4): asleep, all outputs full off, 200 Hz."""
        self._registers[:] = bytes(256)
        self._registers[_MODE1] = _SLEEP | 0x01
        self._registers[_MODE2] = 0x04
        self._registers[_SUBADR1:_LED0] = bytes((0xE2, 0xE4, 0xE8, 0xE0))
        for channel in range(_CHANNELS):
            self._registers[_LED0 + 4 * channel + 3] = _FULL
        self._registers[_PRE_SCALE] = 0x1E

    def write(self, register: int, data: list[int]) -> None:
        """Take a write transfer: a register address, then data bytes."""
        for value in data:
            self._store(register, value)
            if self._registers[_MODE1] & _AI:
                register = self._after(register)

    def read(self, register: int, length: int) -> list[int]:
        """Return the bytes of a read transfer."""
        data = []
        for _ in range(length):
            data.append(self._registers[register])
            if self._registers[_MODE1] & _AI:
                register = self._after(register)
        return data

    @staticmethod
    def _after(register):
        return 0 if register in (_LED15_END, _PRE_SCALE, _TEST) else register + 1  # data sheet 7.3, table 4

    def _store(self, register, value):
        registers = self._registers
        asleep = bool(registers[_MODE1] & _SLEEP)
        if register == _MODE1:
            self._store_mode1(value)
        elif register == _PRE_SCALE:
            if asleep:
                registers[_PRE_SCALE] = max(3, value)
        elif _LED0 <= register <= _LED15_END:
            registers[register] = value & (0x1F if (register - _LED0) % 2 else 0xFF)
            registers[_MODE1] &= ~_RESTART & 0xFF
        elif _ALL_LED <= register < _PRE_SCALE:
            for channel in range(_CHANNELS):
                self._store(_LED0 + 4 * channel + register - _ALL_LED, value)
        elif register < _LED0:
            registers[register] = value

    def _store_mode1(self, value):
        before = self._registers[_MODE1]
        restart = before & _RESTART
        if value & _SLEEP and not before & _SLEEP and any(map(self.high_counts, range(_CHANNELS))):
            restart = _RESTART  # put to sleep with pulses running
        if value & _RESTART and not value & _SLEEP:
            restart = 0  # writing a 1 restarts the channels and clears the bit
        extclk = (before | value) & _EXTCLK  # only a power cycle clears it
        self._registers[_MODE1] = value & 0x3F | extclk | restart

    def high_counts(self, channel: int) -> int:
        """Return for how many of 4096 counts the pin of a channel is high; 0 asleep or waiting for a restart."""
        if self._registers[_MODE1] & (_SLEEP | _RESTART):
            return 0
        start = _LED0 + 4 * channel
        on_l, on_h, off_l, off_h = self._registers[start: start + 4]
        if off_h & _FULL:
            return 0
        if on_h & _FULL:
            return 4096
        return ((off_h % 16 * 256 + off_l) - (on_h % 16 * 256 + on_l)) % 4096


class VirtualBus:
    """An I²C bus with virtual chips on it, to be used in place of ``smbus2.SMBus``, with the faults of a real one.

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

    def write_byte_data(self, address: int, register: int, value: int) -> None:
        self.write_i2c_block_data(address, register, [value])

    def write_i2c_block_data(self, address: int, register: int, data: list[int]) -> None:
        """Write at most 32 registers, as smbus2."""
        _checked_length(len(data))
        self._chip(address).write(register, data)
        self._on_write(address, register, data)

    def close(self) -> None:
        """Close as smbus2; the chips keep their power."""

    def _chip(self, address):
        if self.held:
            self._pause(_KERNEL_TIMEOUT_S)
            raise OSError(errno.ETIMEDOUT, "Connection timed out")
        nack, self.nacks_left = self.nacks_left > 0, max(0, self.nacks_left - 1)
        if nack or address not in self.chips:
            raise OSError(errno.EREMOTEIO, "Remote I/O error")
        return self.chips[address]


def _checked_length(length):
    if length > 32:
        raise ValueError(f"Data length cannot exceed 32 bytes, got {length}")
    return length
