"""Reads and writes the registers of a PCA9685, over any object with the methods of smbus2's ``SMBus``.

It opens no bus and calls no clock. Errors of the bus (OSError) pass through to the caller.
"""
from __future__ import annotations

from typing import Callable, Iterable

from car_interface.common.units import CHANNELS
from car_interface.pca9685.channels import blocks
from car_interface.pca9685.registers import (
    ALL_LED_OFF_H,
    AUTO_INCREMENT,
    COUNTS,
    EXTCLK,
    FULL_BIT,
    LED0_ON_L,
    MODE1,
    MODE2,
    PRE_SCALE,
    RESTART,
    SLEEP,
    counts_of_registers,
    register_bytes,
)

TOTEM_POLE = 0x04  # MODE2: outputs drive both ways, not inverted (data sheet 7.3.2)
OSCILLATOR_START_S = 500e-6  # after SLEEP is cleared (data sheet 7.3.1.1)
MAX_PERIOD_S = COUNTS * 256 / 23e6  # at the largest prescale and the slowest oscillator
CHANNELS_PER_BLOCK = 32 // 4  # an SMBus block transfer carries at most 32 bytes
UNUSED_PER_CHECK = 4  # channels that are off: all sixteen within four checks, 2 s


class BoardMismatch(OSError):
    """The chip answers, but its registers were changed: it lost its power, or another program writes to it."""


class ForeignWrite(BoardMismatch):
    """Channels hold values that this node didn't write: its guard did, or another program."""


class Board:
    """One PCA9685.

    Args:
        bus: has ``read_i2c_block_data(address, register, length)`` and ``write_i2c_block_data(address, register,
            values)``, and ``close``. On the wire a block of one is what a byte is.
        address: 7-bit I²C address, 0x40..0x7f.
        prescale: PRE_SCALE, 3..255.
        pause: called with seconds where the chip needs time.
    """

    def __init__(self, bus, address: int, prescale: int, pause: Callable[[float], None]):
        self._bus, self._address, self._prescale, self._pause = bus, address, prescale, pause
        self._held: list[int | None] = [None] * CHANNELS
        self._next_unused = 0  # of the channels that are off: the one at which the next check begins

    @property
    def held(self) -> list[int | None]:
        """Return the counts last written to or read from each channel; ``None`` = unknown."""
        return list(self._held)

    def initialise(self) -> None:
        """Set frequency and auto-increment.

        A chip that already runs so is not put to sleep, so that a node restarted while driving interrupts no pulse; its
        channels are read back. Otherwise every output is switched off, and the last pulse ends before the chip sleeps:
        the prescale can only be written asleep (data sheet 7.3.5), and a SLEEP in the middle of a pulse makes an ESC
        jump.

        Raises:
            BoardMismatch: the chip doesn't read back as written.
        """
        self._held = [None] * CHANNELS
        self._start()
        self._check_mode()
        self.read_back()

    def check(self) -> None:
        """Read back whether the chip runs as ``initialise`` left it, and whether its channels hold the written values.

        Channels that are on are read each time, and four of the others: no command is written while the bus is read,
        and 32 bytes take 3 ms at 100 kHz.

        Raises:
            BoardMismatch: it doesn't run so.
            ForeignWrite: a channel holds another value, which ``held`` then has.
        """
        self._check_mode()
        before = self.held
        used = [channel for channel, counts in enumerate(before) if counts]
        unused = [channel for channel, counts in enumerate(before) if not counts]
        turn = sorted(unused, key=lambda channel: (channel < self._next_unused, channel))[:UNUSED_PER_CHECK]
        if turn:
            self._next_unused = (turn[-1] + 1) % CHANNELS
        self.read_back([*used, *turn])
        foreign = [f"channel {channel} holds {found} counts, not {written}"
                   for channel, (written, found) in enumerate(zip(before, self._held)) if written not in (None, found)]
        if foreign:
            raise ForeignWrite("; ".join(foreign))

    def read_back(self, channels: Iterable[int] = range(CHANNELS)) -> None:
        for run in blocks(set(channels), CHANNELS_PER_BLOCK):
            data = self._bus.read_i2c_block_data(self._address, LED0_ON_L + 4 * run[0], 4 * len(run))
            for index, channel in enumerate(run):
                self._held[channel] = counts_of_registers(data[4 * index: 4 * index + 4])

    def _check_mode(self):
        mode1, prescale = self._read(MODE1), self._read(PRE_SCALE)
        # EXTCLK stays set until the power is off; RESTART is cleared by the first write to a channel.
        if mode1 & ~(RESTART | EXTCLK) != AUTO_INCREMENT or prescale != self._prescale:
            raise BoardMismatch(f"MODE1 is 0x{mode1:02x} and PRE_SCALE {prescale}, "
                                f"not 0x{AUTO_INCREMENT:02x} and {self._prescale}")

    def _start(self):
        mode1 = self._read(MODE1)
        if not mode1 & SLEEP and self._read(PRE_SCALE) == self._prescale:
            self._write(MODE1, AUTO_INCREMENT)
            self._write(MODE2, TOTEM_POLE)
            return
        if not mode1 & SLEEP:
            self.all_off()
            self._pause(MAX_PERIOD_S)
        self._write(MODE1, AUTO_INCREMENT | SLEEP)
        self._write(PRE_SCALE, self._prescale)
        self._write(MODE2, TOTEM_POLE)
        self.all_off()  # a restart would bring the old pulses back
        self._write(MODE1, AUTO_INCREMENT)
        self._pause(OSCILLATOR_START_S)

    def write(self, changes: dict[int, int]) -> None:
        """Write channels' counts; neighbours in one auto-increment block, so that no pulse mixes old and new bytes."""
        for run in blocks(changes, CHANNELS_PER_BLOCK):
            data = b"".join(register_bytes(changes[channel]) for channel in run)
            for channel in run:
                self._held[channel] = None  # until the transfer is known to have worked
            self._bus.write_i2c_block_data(self._address, LED0_ON_L + 4 * run[0], list(data))
            for channel in run:
                self._held[channel] = changes[channel]

    def all_off(self) -> None:
        """Set the full-off bit of all channels in one transfer; the current pulse still ends regularly (7.3.3)."""
        self._held = [None] * CHANNELS  # until the transfer is known to have worked
        self._write(ALL_LED_OFF_H, FULL_BIT)
        self._held = [0] * CHANNELS

    def close(self) -> None:
        """Close the bus; the chip continues with its registers."""
        self._bus.close()

    def _read(self, register):
        return self._bus.read_i2c_block_data(self._address, register, 1)[0]

    def _write(self, register, value):
        self._bus.write_i2c_block_data(self._address, register, [value])
