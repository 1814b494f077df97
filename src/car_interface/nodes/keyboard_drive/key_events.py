"""Presses and releases of this computer's keyboards, from the kernel's input devices.

They are reported whichever program the keys are meant for.
"""
from __future__ import annotations

import glob
from typing import Callable

from evdev import InputDevice, ecodes

RELEASED, PRESSED = 0, 1  # values of EV_KEY; 2 is a repeat
# Whatever has these is a keyboard, not a power button or a mouse.
LETTERS_AND_SPACE = {*range(ecodes.KEY_Q, ecodes.KEY_P + 1), ecodes.KEY_SPACE}


class Keyboards:
    """The keyboards that this process may read.

    Args:
        pattern: of the paths of input devices.
    """

    def __init__(self, pattern: str, open_device: Callable = InputDevice):
        self._devices = [device for path in sorted(glob.glob(pattern)) for device in _opened(path, open_device)]

    def __len__(self) -> int:
        return len(self._devices)

    def read(self) -> list[tuple[int, bool]] | None:
        """Return each (code, is pressed) since the last call; ``None`` = some were lost or a keyboard was unplugged."""
        found: list[tuple[int, bool]] = []
        was_lost = False
        for device in list(self._devices):
            for event in self._read(device):
                was_lost |= event.type == ecodes.EV_SYN and event.code == ecodes.SYN_DROPPED
                if event.type == ecodes.EV_KEY and event.value in (RELEASED, PRESSED):
                    found.append((event.code, event.value == PRESSED))
            was_lost |= device not in self._devices
        return None if was_lost else found

    def close(self) -> None:
        for device in self._devices:
            device.close()
        self._devices.clear()

    def _read(self, device):
        while True:
            try:
                events = list(device.read())
            except BlockingIOError:
                return
            except OSError:
                events = []
            if not events:  # it was unplugged
                device.close()
                self._devices.remove(device)
                return
            yield from events


def _opened(path, open_device):
    """Return a device, in a list; none if it is no keyboard or may not be read."""
    try:
        device = open_device(path)
    except OSError:
        return []
    if LETTERS_AND_SPACE.issubset(device.capabilities().get(ecodes.EV_KEY, ())):
        return [device]
    device.close()
    return []
