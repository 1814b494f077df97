"""Presses and releases of this computer's keyboards, from the kernel's input devices (linux/input.h).

They are reported whichever program the keys are meant for.
"""
from __future__ import annotations

import fcntl
import glob
import os
import struct
from typing import Callable

EVENT = struct.Struct("@llHHi")  # struct input_event: the time's seconds and microseconds, type, code, value
EV_SYN, EV_KEY = 0, 1  # types
SYN_DROPPED = 3  # a code of EV_SYN: events were lost
RELEASED, PRESSED = 0, 1  # values of EV_KEY; 2 is a repeat
BATCH = 64  # events in one read
KEY_BITS_SIZE = 96  # bytes: KEY_MAX is 0x2ff
EVIOCGBIT_KEY = 2 << 30 | KEY_BITS_SIZE << 16 | ord("E") << 8 | 0x20 + EV_KEY  # _IOC(_IOC_READ, 'E', 0x20 + EV_KEY, …)
LETTERS = range(16, 26)  # KEY_Q to KEY_P: whatever has these is a keyboard, not a power button or a mouse
SPACE = 57  # KEY_SPACE


def is_keyboard(key_bits: bytes) -> bool:
    """Whether a device with these bits, as EVIOCGBIT returns them, has letters and a space bar."""
    return all(key_bits[code // 8] >> code % 8 & 1 for code in (*LETTERS, SPACE))


class Keyboards:
    """The keyboards that this process may read.

    Args:
        pattern: of the paths of input devices.
        ioctl: as ``fcntl.ioctl``.
    """

    def __init__(self, pattern: str, ioctl: Callable = fcntl.ioctl):
        self._fds = [fd for path in sorted(glob.glob(pattern)) for fd in _opened(path, ioctl)]

    def __len__(self) -> int:
        return len(self._fds)

    def read(self) -> list[tuple[int, bool]] | None:
        """(code, whether it is pressed) since the last call; ``None`` = some were lost, or a keyboard was unplugged."""
        found: list[tuple[int, bool]] = []
        was_lost = False
        for fd in list(self._fds):
            for event_type, code, value in self._read(fd):
                was_lost |= event_type == EV_SYN and code == SYN_DROPPED
                if event_type == EV_KEY and value in (RELEASED, PRESSED):
                    found.append((code, value == PRESSED))
            was_lost |= fd not in self._fds
        return None if was_lost else found

    def close(self) -> None:
        """Close the devices."""
        for fd in self._fds:
            os.close(fd)
        self._fds.clear()

    def _read(self, fd):
        while True:
            try:
                data = os.read(fd, EVENT.size * BATCH)
            except BlockingIOError:
                return
            except OSError:
                data = b""
            if not data:  # it was unplugged
                os.close(fd)
                self._fds.remove(fd)
                return
            yield from (event[2:] for event in EVENT.iter_unpack(data[:len(data) // EVENT.size * EVENT.size]))


def _opened(path, ioctl):
    """A device's file descriptor, in a list; none if it is no keyboard or may not be read."""
    try:
        fd = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError:
        return []
    try:
        bits = ioctl(fd, EVIOCGBIT_KEY, bytes(KEY_BITS_SIZE))
    except OSError:
        bits = bytes(KEY_BITS_SIZE)
    if is_keyboard(bits):
        return [fd]
    os.close(fd)
    return []
