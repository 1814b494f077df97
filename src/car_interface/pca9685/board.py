"""Reads and writes the registers of a PCA9685, over any object with the methods of smbus2's ``SMBus``.

It opens no bus and calls no clock. Errors of the bus (OSError) pass through to the caller.
"""
from __future__ import annotations

from typing import Callable

from car_interface.common.servo_channels import CHANNELS
from car_interface.pca9685.channels import blocks
from car_interface.pca9685.registers import COUNTS, frequency_for, register_bytes

MODE1, MODE2, LED0_ON_L, ALL_LED_OFF_H, PRE_SCALE = 0x00, 0x01, 0x06, 0xFD, 0xFE
RESTART, EXTCLK, AUTO_INCREMENT, SLEEP = 0x80, 0x40, 0x20, 0x10  # MODE1 bits (data sheet 7.3.1)
TOTEM_POLE = 0x04  # MODE2: outputs drive both ways, not inverted (data sheet 7.3.2)
FULL_OFF = 0x10
OSCILLATOR_START_S = 500e-6  # after SLEEP is cleared (data sheet 7.3.1.1)
CHANNELS_PER_BLOCK = 32 // 4  # an SMBus block write carries at most 32 bytes


class BoardMismatch(OSError):
    """The chip answers, but its registers were changed: it lost its power, or another program writes to it."""


class Board:
    """One PCA9685.

    Args:
        bus: has ``read_byte_data(address, register)``, ``write_byte_data(address, register, value)`` and
            ``write_i2c_block_data(address, register, values)``.
        address: 7-bit I²C address, 0x40..0x7f.
        prescale: PRE_SCALE, 3..255.
        oscillator_hz: the chip's clock, nominally 25 MHz.
        pause: called with seconds where the chip needs time.
    """

    def __init__(self, bus, address: int, prescale: int, oscillator_hz: float, pause: Callable[[float], None]):
        self._bus = bus
        self._address = address
        self._prescale = prescale
        self._pause = pause
        self.period_s = 1.0 / frequency_for(prescale, oscillator_hz)
        self._held: list[int | None] = [None] * CHANNELS

    @property
    def held(self) -> list[int | None]:
        """The counts last written to each channel; ``None`` = unknown."""
        return list(self._held)

    def initialise(self) -> None:
        """Set frequency and auto-increment.

        A chip that already runs so is not put to sleep, so that a node restarted while driving interrupts no pulse.
        Otherwise every output is switched off and the last pulse ends before the chip sleeps: the prescale can only be
        written asleep (data sheet 7.3.5), and a SLEEP in the middle of a pulse makes an ESC jump.

        Raises:
            BoardMismatch: it doesn't read back as written.
        """
        self._held = [None] * CHANNELS
        self._start()
        self.check()

    def check(self) -> None:
        """Read back whether the chip still runs as ``initialise`` left it.

        Raises:
            BoardMismatch: it doesn't.
        """
        mode1, prescale = self._read(MODE1), self._read(PRE_SCALE)
        # EXTCLK stays set until the power is off; RESTART is cleared by the first write to a channel.
        if mode1 & ~(RESTART | EXTCLK) != AUTO_INCREMENT or prescale != self._prescale:
            raise BoardMismatch(f"MODE1 is 0x{mode1:02x} and PRE_SCALE {prescale}, "
                                f"not 0x{AUTO_INCREMENT:02x} and {self._prescale}")

    def _start(self):
        mode1 = self._read(MODE1)
        if not (mode1 & SLEEP or self._read(PRE_SCALE) != self._prescale):
            self._write(MODE1, AUTO_INCREMENT)
            self._write(MODE2, TOTEM_POLE)
            return
        if not mode1 & SLEEP:
            self.all_off()
            self._pause(self._max_period_s())
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
        self._write(ALL_LED_OFF_H, FULL_OFF)
        self._held = [0] * CHANNELS

    def _max_period_s(self):
        return COUNTS * 256 / 23e6  # at the largest prescale and the slowest oscillator

    def _read(self, register):
        return self._bus.read_byte_data(self._address, register)

    def _write(self, register, value):
        self._bus.write_byte_data(self._address, register, value)
