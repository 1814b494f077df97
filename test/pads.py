"""Gamepads as the kernel shows them: its list of input devices, and event devices on named pipes.

What each gamepad has is from listings of real ones (jstest, evtest, /proc/bus/input/devices); the list's layout from
input_devices_seq_show in Linux, drivers/input/input.c; an event's bytes are struct input_event of linux/input.h.
"""
from __future__ import annotations

import os
import struct
from pathlib import Path
from typing import NamedTuple

from evdev import AbsInfo, InputDevice

from car_interface.teleop.gamepad_device import GamepadDevice
from car_interface.teleop.input_devices import Pad, parse_pads

EVENT = struct.Struct("@llHHi")  # struct timeval time; __u16 type, code; __s32 value
SYN, KEY, ABS = 0, 1, 3
REPORT, DROPPED = 0, 3
X, Y, Z, RX, RY, RZ, GAS, BRAKE, HAT_X, HAT_Y = 0, 1, 2, 3, 4, 5, 9, 10, 16, 17
SOUTH, EAST, NORTH, WEST, TL, TR, TL2, TR2 = 0x130, 0x131, 0x133, 0x134, 0x136, 0x137, 0x138, 0x139
XPAD_STICK, BYTE_STICK, WORD_STICK = (-32768, 32767, 128), (0, 255, 15), (0, 65535, 4095)  # least, greatest, flat
CROSS = {HAT_X: (-1, 1, 0), HAT_Y: (-1, 1, 0)}


class Model(NamedTuple):
    """A kind of gamepad; keys and axes are as the kernel writes them."""

    name: str
    keys: str
    axes: str
    ranges: dict


F710_X = Model("Logitech Gamepad F710", "7cdb000000000000 0 0 0 0", "3003f", {
    X: XPAD_STICK, Y: XPAD_STICK, Z: (0, 255, 0), RX: XPAD_STICK, RY: XPAD_STICK, RZ: (0, 255, 0), **CROSS})
F710_D = Model("Logitech Logitech Cordless RumblePad 2", "fff000000000000 0 0 0 0", "30027", {
    X: BYTE_STICK, Y: BYTE_STICK, Z: BYTE_STICK, RZ: BYTE_STICK, **CROSS})
F310_D = F710_D._replace(name="Logitech Logitech Dual Action", keys="fff00000000 0 0 0 0")  # BTN_TRIGGER and on
XBOX_BLUETOOTH = Model("Xbox Wireless Controller", "7fff000000000000 0 0 0 0", "30627", {
    X: WORD_STICK, Y: WORD_STICK, Z: WORD_STICK, RZ: WORD_STICK, GAS: (0, 1023, 63), BRAKE: (0, 1023, 63), **CROSS})
DUALSENSE = Model("DualSense Wireless Controller", "7fdb000000000000 0 0 0 0", "3003f", {
    **dict.fromkeys(range(6), (0, 255, 0)), **CROSS})
MOTION_SENSORS = Model("DualSense Wireless Controller Motion Sensors", "", "3f", {})
TOUCHPAD = Model("DualSense Wireless Controller Touchpad", "e520 10000 0 0 0 0", "260800000000003", {})
KEYBOARD = Model("AT keyboard", "402000000 3803078f800d001 feffffdfffefffff fffffffffffffffe", "", {})
UNKNOWN = F710_X._replace(name="Nobody's Pad")


def listed(model: Model, event: int, place: str = "usb-0000:00:14.0-2/input0", number: str = "", more: str = "") -> str:
    """Returns a device's lines in /proc/bus/input/devices."""
    return (f'I: Bus=0003 Vendor=046d Product=c21f Version=0305\nN: Name="{model.name}"\nP: Phys={place}\n'
            f"S: Sysfs=/devices/pci0000:00/0000:00:14.0/usb1/1-2/1-2:1.0/input/input{event + 9}\nU: Uniq={number}\n"
            f"H: Handlers=event{event} {more}\nB: PROP=0\nB: EV=20000b\n"
            + (f"B: KEY={model.keys}\n" if model.keys else "") + (f"B: ABS={model.axes}\n\n" if model.axes else "\n"))


class PipedDevice(InputDevice):
    """The library's device on a named pipe, which can be read as one, but answers no ioctl."""

    def __init__(self, path, pad):
        self.path, self.fd, self._pad = path, os.open(path, os.O_RDONLY | os.O_NONBLOCK), pad

    def capabilities(self, verbose=False, absinfo=True):
        codes = parse_pads(self._pad.lines(), 64)[0]
        return {KEY: sorted(codes.keys), ABS: [(code, self.absinfo(code)) for code in sorted(codes.axes)]}

    def absinfo(self, axis_num):
        low, high, flat = self._pad.model.ranges[axis_num]
        return AbsInfo(self._pad.positions[axis_num], low, high, 0, flat, 0)

    def grab(self):
        raise AssertionError("other programs read it, too")


class Plugged:
    """A gamepad that is plugged in: what its user does with it."""

    def __init__(self, folder: Path, model: Model, event: int, place: str, number: str):
        self.model, self._listed = model, (model, event, place, number)
        self.path = str(folder / f"event{event}")
        self.positions = {code: low if low == 0 and code in (Z, RZ) and model is F710_X else (low + high + 1) // 2
                          for code, (low, high, _) in model.ranges.items()}
        os.mkfifo(self.path)
        self._reader = os.open(self.path, os.O_RDONLY | os.O_NONBLOCK)
        self._writer = os.open(self.path, os.O_WRONLY)

    def lines(self) -> str:
        return listed(*self._listed)

    def send(self, *events: tuple[int, int, int]) -> None:
        """A report: (type, code, value) of each event."""
        self.positions.update({code: value for kind, code, value in events if kind == ABS})
        os.write(self._writer, b"".join(EVENT.pack(1_700_000_000, 500_000, *event)
                                        for event in (*events, (SYN, REPORT, 0))))

    def lose(self, *events: tuple[int, int, int]) -> None:
        """What happened while nobody read: the kernel drops it, says so, and goes on in the middle of a report."""
        self.positions.update({code: value for kind, code, value in events if kind == ABS})
        self.send((SYN, DROPPED, 0), events[-1])

    def unplug(self) -> None:
        os.unlink(self.path)
        os.close(self._writer)
        os.close(self._reader)


class Computer:
    """What is plugged into a computer."""

    def __init__(self, folder: Path):
        self._folder = folder
        self.plugged: list[Plugged] = []

    def plug_in(self, model: Model, event: int = 5, place: str = "usb-1", number: str = "") -> Plugged:
        self.plugged.append(Plugged(self._folder, model, event, place, number))
        return self.plugged[-1]

    def unplug(self, plugged: Plugged) -> None:
        self.plugged.remove(plugged)
        plugged.unplug()

    def find(self) -> list[Pad]:
        return parse_pads("".join(plugged.lines() for plugged in self.plugged), 64)

    def open(self, pad: Pad) -> GamepadDevice:
        """Opens a gamepad as GamepadDevice does."""
        def open_device(path):
            path = str(self._folder / os.path.basename(path))
            plugged = next((plugged for plugged in self.plugged if plugged.path == path), None)
            if plugged is None:
                raise FileNotFoundError(2, "No such file or directory", path)
            return PipedDevice(path, plugged)
        return GamepadDevice(pad, open_device)
