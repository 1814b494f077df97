"""Acts on the chip for a guard, over any device with ``read(register, length)`` and ``write(register, data)``.

Functions that write return what the channels are known to have held, as tuples of 16 counts, oldest first. Errors of
the bus (OSError) pass through to the caller. A guard never wakes or initialises a chip: a chip that sleeps, as after a
loss of power, sends no pulse.
"""
from __future__ import annotations

import errno

from car_interface.common.units import CHANNELS
from car_interface.pca9685.registers import (
    ALL_LED_OFF_H,
    AUTO_INCREMENT,
    FULL_BIT,
    LED0_ON_L,
    MODE1,
    RESTART,
    SLEEP,
    counts_of_registers,
    register_bytes,
)

BLOCK = 32  # bytes that an SMBus block transfer carries: eight channels
CHANNELS_PER_BLOCK = BLOCK // 4
OFF = (0,) * CHANNELS


def probe(device) -> None:
    device.read(MODE1, 1)


def write_counts(device, counts) -> list:
    """Bring every channel to its counts, 0..4096, and verify that by reading back.

    Raises:
        OSError: of the bus; EIO: the chip doesn't hold the written values.
    """
    if not _is_awake(device):
        return [OFF]
    _write_all(device, counts)
    return [_verified(device, counts)]


def keep_counts(device, counts) -> list:
    """Bring the channels to these counts as ``write_counts``; if they held others, these come first in the result."""
    if not _is_awake(device):
        return [OFF]
    found = _read_all(device)
    if found == tuple(counts):
        return [found]
    _write_all(device, counts)
    return [found, _verified(device, counts)]


def switch_off(device) -> list:
    """Set the full-off bit of all channels, unless they are off, and verify it as ``write_counts``."""
    if _is_awake(device) and _read_all(device) != OFF:
        device.write(ALL_LED_OFF_H, bytes((FULL_BIT,)))
        _verified(device, OFF)
    return [OFF]


def _is_awake(device):
    """Return whether the chip is awake; if so, set auto-increment, which block transfers need."""
    mode1 = device.read(MODE1, 1)[0]
    if mode1 & SLEEP:
        return False
    if not mode1 & AUTO_INCREMENT:
        device.write(MODE1, bytes((mode1 & ~RESTART | AUTO_INCREMENT,)))
    return True


def _write_all(device, counts):
    for first in range(0, CHANNELS, CHANNELS_PER_BLOCK):
        block = counts[first: first + CHANNELS_PER_BLOCK]
        device.write(LED0_ON_L + 4 * first, b"".join(register_bytes(each) for each in block))


def _read_all(device):
    registers = b"".join(bytes(device.read(LED0_ON_L + 4 * first, BLOCK))
                         for first in range(0, CHANNELS, CHANNELS_PER_BLOCK))
    return tuple(counts_of_registers(registers[4 * channel: 4 * channel + 4]) for channel in range(CHANNELS))


def _verified(device, counts):
    if _read_all(device) != tuple(counts):
        raise OSError(errno.EIO, "the chip doesn't hold what was written")
    return tuple(counts)
