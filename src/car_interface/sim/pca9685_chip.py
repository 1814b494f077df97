"""Models a PCA9685 at register level.

Modelled from the data sheet (NXP PCA9685, rev. 4), not from the driver that it tests: MODE1 with SLEEP, RESTART and
auto-increment, PRE_SCALE that takes a value only asleep, the ALL_LED registers, full-on and full-off bits.
"""
from __future__ import annotations

from typing import Iterable

MODE1, _MODE2, _SUBADR1, LED0, _LED15_END, _ALL_LED, _PRE_SCALE, _TEST = 0, 1, 2, 6, 69, 250, 254, 255
_RESTART, _EXTCLK, _AI, SLEEP = 0x80, 0x40, 0x20, 0x10  # MODE1 bits (data sheet 7.3.1)
_FULL = 0x10  # full on, full off (data sheet 7.3.3)
_CHANNELS = 16


class VirtualPca9685:
    """The chip's registers, and the state of its pins."""

    def __init__(self):
        self._registers = bytearray(256)
        self.power_up()

    def power_up(self) -> None:
        """Set every register to its reset value (data sheet 7.3, table 4): asleep, all outputs full off, 200 Hz."""
        self._registers[:] = bytes(256)
        self._registers[MODE1] = SLEEP | 0x01
        self._registers[_MODE2] = 0x04
        self._registers[_SUBADR1:LED0] = bytes((0xE2, 0xE4, 0xE8, 0xE0))
        for channel in range(_CHANNELS):
            self._registers[LED0 + 4 * channel + 3] = _FULL
        self._registers[_PRE_SCALE] = 0x1E

    def write(self, register: int, data: Iterable[int]) -> None:
        """Take a write transfer: a register address, then data bytes."""
        for value in data:
            self._store(register, value)
            if self._registers[MODE1] & _AI:
                register = self._after(register)

    def read(self, register: int, length: int) -> list[int]:
        """Return the bytes of a read transfer."""
        data = []
        for _ in range(length):
            data.append(self._registers[register])
            if self._registers[MODE1] & _AI:
                register = self._after(register)
        return data

    @staticmethod
    def _after(register):
        return 0 if register in (_LED15_END, _PRE_SCALE, _TEST) else register + 1  # data sheet 7.3, table 4

    def _store(self, register, value):
        registers = self._registers
        asleep = bool(registers[MODE1] & SLEEP)
        if register == MODE1:
            self._store_mode1(value)
        elif register == _PRE_SCALE:
            if asleep:
                registers[_PRE_SCALE] = max(3, value)
        elif LED0 <= register <= _LED15_END:
            registers[register] = value & (0x1F if (register - LED0) % 2 else 0xFF)
            registers[MODE1] &= ~_RESTART & 0xFF
        elif _ALL_LED <= register < _PRE_SCALE:
            for channel in range(_CHANNELS):
                self._store(LED0 + 4 * channel + register - _ALL_LED, value)
        elif register < LED0:
            registers[register] = value

    def _store_mode1(self, value):
        before = self._registers[MODE1]
        restart = before & _RESTART
        if value & SLEEP and not before & SLEEP and any(map(self.high_counts, range(_CHANNELS))):
            restart = _RESTART  # put to sleep with pulses running
        if value & _RESTART and not value & SLEEP:
            restart = 0  # writing a 1 restarts the channels and clears the bit
        extclk = (before | value) & _EXTCLK  # only a power cycle clears it
        self._registers[MODE1] = value & 0x3F | extclk | restart

    def high_counts(self, channel: int) -> int:
        """Return for how many of 4096 counts the pin of a channel is high; 0 asleep or waiting for a restart."""
        if self._registers[MODE1] & (SLEEP | _RESTART):
            return 0
        start = LED0 + 4 * channel
        on_l, on_h, off_l, off_h = self._registers[start: start + 4]
        if off_h & _FULL:
            return 0
        if on_h & _FULL:
            return 4096
        return ((off_h % 16 * 256 + off_l) - (on_h % 16 * 256 + on_l)) % 4096
