"""A gamepad's device, as a named pipe with the bytes that the kernel sends."""
import errno
import os
import sys

import pytest
from evdev import AbsInfo
from pads import ABS, DUALSENSE, F710_X, KEY, REPORT, SYN, TL, Computer, X

from car_interface.common.errors import DeviceError
from car_interface.teleop.gamepad_device import GamepadDevice

# As a C program that includes linux/input.h has it in memory on a 64-bit computer: LB pressed, the stick to the left,
# the report's end. The time is 2023-11-14 22:13:20.5 UTC.
TIME = bytes.fromhex("00f15365 00000000 20a10700 00000000")
BYTES = b"".join(TIME + bytes.fromhex(text) for text in (
    "0100 3601 01000000", "0300 0000 0080ffff", "0000 0000 00000000"))
needs_64_bits = pytest.mark.skipif(sys.maxsize < 2 ** 32, reason="the bytes are a 64-bit computer's")


@pytest.fixture(name="computer")
def fixture_computer(tmp_path):
    return Computer(tmp_path)


def opened(computer):
    (pad,) = computer.find()
    return computer.open(pad)


@needs_64_bits
def test_events_are_read_from_the_kernels_bytes_and_nothing_is_grabbed(computer):
    plugged = computer.plug_in(F710_X)
    device = opened(computer)
    assert device.read() == []
    os.write(plugged._writer, BYTES * 10)
    events = [(event.type, event.code, event.value) for event in device.read()]
    assert events == [(KEY, TL, 1), (ABS, X, -32768), (SYN, REPORT, 0)] * 10
    device.close()


def test_ranges_and_positions_are_those_of_the_device(computer):
    plugged = computer.plug_in(DUALSENSE)
    device = opened(computer)
    assert (len(device.keys), device.ranges[X]) == (13, AbsInfo(128, 0, 255, 0, 0, 0))
    plugged.send((ABS, X, 200))
    assert device.positions()[X] == 200
    device.close()


def test_what_has_not_arrived_is_not_waited_for(computer, monkeypatch):
    plugged = computer.plug_in(F710_X)
    device = opened(computer)
    waits = []
    with monkeypatch.context() as patch:
        patch.setattr("select.select", lambda *args: waits.append(args) or ([], [], []))
        assert device.read() == []
    assert waits == [([device.fileno()], [], [], 0)]

    def read():
        raise BlockingIOError
    device._device.read = read
    plugged.send((KEY, TL, 1))
    assert device.read() == []
    device.close()
    with pytest.raises(OSError):
        os.fstat(waits[0][0][0])


def test_gamepad_that_is_unplugged_is_gone(computer):
    plugged = computer.plug_in(F710_X)
    device = opened(computer)
    computer.unplug(plugged)
    with pytest.raises(DeviceError, match=r"event5 \(Logitech Gamepad F710\): the gamepad is gone\. Plug in"):
        device.read()
    device.close()


@pytest.mark.parametrize("number, text", [
    (errno.EACCES, "no permission to open it"), (errno.ENOENT, "there is no such device here. The kernel lists it: a"),
    (errno.ENODEV, "the gamepad is gone"), (errno.EIO, "Input/output error")])
def test_device_that_can_not_be_opened_or_read_says_why(computer, number, text):
    plugged = computer.plug_in(F710_X)

    def refuse(path):
        raise OSError(number, os.strerror(number))
    with pytest.raises(DeviceError, match=text):
        GamepadDevice(computer.find()[0], refuse)
    device = opened(computer)
    device._device.absinfo = refuse
    with pytest.raises(DeviceError):
        device.positions()
    plugged.unplug()
