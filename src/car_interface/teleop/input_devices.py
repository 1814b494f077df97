"""Finds gamepads among the kernel's input devices, by what they can do. No device is opened for that.

/proc/bus/input/devices lists all devices for every user: name (N), place (P), unique number (U), handlers (H) and the
codes of their keys and axes as bits (B), in hexadecimal words of a C long with the highest word first. Sources: Linux,
drivers/input/input.c, input_devices_seq_show, and include/uapi/linux/input-event-codes.h.
"""
from __future__ import annotations

import os
import re
import struct
from typing import NamedTuple, Sequence

from car_interface.common.errors import DeviceError

DEVICES = "/proc/bus/input/devices"
ANY = "auto"  # as a device: the only gamepad that there is
WORD_BITS = 8 * struct.calcsize("l")  # a 32-bit process gets 32-bit words
LINE = re.compile(r"^[NPUHB]: (\w+)=(.*)$", re.M)

BTN_TRIGGER, BTN_SOUTH = 0x120, 0x130  # the first button of a joystick, and of a gamepad
ABS_X, ABS_Y, ABS_Z, ABS_RX, ABS_RY, ABS_RZ = range(6)
LEFT_STICK, RIGHT_STICKS = {ABS_X, ABS_Y}, ({ABS_RX, ABS_RY}, {ABS_Z, ABS_RZ})

MISSING_REMEDY = ("Plug in the gamepad or its receiver, and switch it on. If it is: rosrun car_interface doctor tells "
                  "whether a driver is missing")


class Pad(NamedTuple):
    """A gamepad, as the kernel lists it."""

    name: str
    place: str  # the USB port or the Bluetooth adapter
    number: str  # its own, such as a Bluetooth address; most on USB have none
    handlers: tuple[str, ...]  # such as event5 and js0
    keys: frozenset[int]  # codes
    axes: frozenset[int]

    @property
    def path(self) -> str:
        return f"/dev/input/{next(handler for handler in self.handlers if handler.startswith('event'))}"

    @property
    def identity(self) -> tuple[str, str]:
        """Return what stays when it is plugged in again: the name, and its own number or else its place."""
        return self.name, self.number or self.place

    def __str__(self):
        return f"{self.path} ({self.name})"


def find_pads() -> list[Pad]:
    """Return the gamepads that this computer has; none where it has no list of input devices."""
    try:
        with open(DEVICES, encoding="utf-8", errors="replace") as file:
            return parse_pads(file.read())
    except OSError:
        return []


def parse_pads(text: str, word_bits: int = WORD_BITS) -> list[Pad]:
    """Return the gamepads in the text of /proc/bus/input/devices."""
    found = []
    for block in text.split("\n\n"):
        fields = dict(LINE.findall(block))
        pad = Pad(fields.get("Name", "").strip('"'), fields.get("Phys", ""), fields.get("Uniq", ""),
                  tuple(fields.get("Handlers", "").split()), _codes(fields.get("KEY", ""), word_bits),
                  _codes(fields.get("ABS", ""), word_bits))
        if _is_gamepad(pad):
            found.append(pad)
    return found


def choose_pad(pads: Sequence[Pad], device: str, option: str, known: Pad | None = None) -> Pad:
    """Return the gamepad to read.

    Args:
        pads: those that there are.
        device: path of its event or js device, or of a link to one; ANY = the only one.
        option: what a person types before the path, to choose the device.
        known: the one that was read before: no other will do, and it may have another path by now.

    Raises:
        DeviceError: there is none, there are several, or it is another one.
    """
    fitting = list(pads)
    if known is not None:
        fitting = [pad for pad in pads if pad.identity == known.identity]
    elif device != ANY:
        wanted = os.path.basename(os.path.realpath(device))
        fitting = [pad for pad in pads if wanted in pad.handlers]
    listed = ", ".join(map(str, pads))
    if len(fitting) == 1:
        return fitting[0]
    if not pads:
        raise DeviceError("gamepad", "there is none", MISSING_REMEDY)
    if len(fitting) > 1:
        raise DeviceError("gamepad", f"there are several: {listed}", f"Leave one plugged in, or choose it: {option}"
                                                                     f"{fitting[0].path}")
    if known is not None:
        raise DeviceError("gamepad", f"{known.name} ({known.identity[1]}), which was read before, is gone; there is "
                                     f"{listed}", "Plug it in at the same place, with its switch as it was; to change "
                                                  "gamepads start this node again")
    raise DeviceError("gamepad", f"{device} is none; there is {listed}", f"Choose it: {option}{pads[0].path}")


def _codes(words, word_bits):
    """Return the numbers of the bits that are set."""
    bits = 0
    for word in words.split():
        bits = bits << word_bits | int(word, 16)
    return frozenset(code for code in range(bits.bit_length()) if bits >> code & 1)


def _is_gamepad(pad):
    """Return whether it has a gamepad's buttons and two sticks. A touchpad and a motion sensor lack the buttons."""
    return (bool(pad.keys & {BTN_TRIGGER, BTN_SOUTH}) and pad.axes >= LEFT_STICK
            and any(pad.axes >= stick for stick in RIGHT_STICKS)
            and any(handler.startswith("event") for handler in pad.handlers))
