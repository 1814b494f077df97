"""Keyboards of the kernel, as named pipes with the bytes that it sends."""
import os
import sys

import pytest
from evdev import InputDevice, ecodes

from car_interface.nodes.keyboard_drive import Keyboards

# What /dev/input/event* of a 64-bit computer gives for W pressed, repeated and released, each with its scan code (type
# 4) before it and a report (type 0) behind it: as a C program that includes linux/input.h has them in memory. The time
# is 2023-11-14 22:13:20.5 UTC.
TIME = bytes.fromhex("00f15365 00000000 20a10700 00000000")
SCAN, REPORT = TIME + bytes.fromhex("0400 0400 11000000"), TIME + bytes.fromhex("0000 0000 00000000")
PRESSED, REPEATED, RELEASED = (TIME + bytes.fromhex(text) for text in (
    "0100 1100 01000000", "0100 1100 02000000", "0100 1100 00000000"))
DROPPED = TIME + bytes.fromhex("0000 0300 00000000")
CODE_W = 17
KEYBOARD = {ecodes.EV_SYN: [0, 1, 4], ecodes.EV_KEY: list(range(1, 128)), ecodes.EV_MSC: [4]}
MOUSE = {ecodes.EV_KEY: [ecodes.BTN_LEFT, ecodes.BTN_RIGHT], ecodes.EV_REL: [0, 1, 8]}

needs_64_bits = pytest.mark.skipif(sys.maxsize < 2 ** 32, reason="the bytes are a 64-bit computer's")


@pytest.fixture(name="device")
def fixture_device(tmp_path):
    """A keyboard's path, and what writes to it."""
    path = tmp_path / "event0"
    os.mkfifo(str(path))
    reader = os.open(str(path), os.O_RDONLY | os.O_NONBLOCK)
    writer = os.open(str(path), os.O_WRONLY)
    yield str(tmp_path / "event*"), writer
    os.close(reader)
    try:
        os.close(writer)
    except OSError:
        pass  # the test has unplugged it


class Pipe(InputDevice):
    """The library's device on a named pipe, which can be read as one, but answers no ioctl."""

    def __init__(self, path, capabilities):
        self.path, self.fd, self._rawcapabilities = path, os.open(path, os.O_RDONLY | os.O_NONBLOCK), capabilities


def opened(pattern, capabilities=KEYBOARD):
    return Keyboards(pattern, lambda path: Pipe(path, capabilities))


@pytest.fixture(name="keyboards")
def fixture_keyboards(device):
    made = opened(device[0])
    yield made
    made.close()


@needs_64_bits
def test_presses_and_releases_are_read_and_repeats_are_not(device, keyboards):
    assert keyboards.read() == []
    os.write(device[1], (SCAN + PRESSED + REPORT + REPEATED + REPORT + SCAN + RELEASED + REPORT) * 100)
    assert keyboards.read() == [(CODE_W, True), (CODE_W, False)] * 100
    assert keyboards.read() == []


def test_a_keyboard_on_which_nothing_was_pressed_is_not_read(keyboards, monkeypatch):
    monkeypatch.setattr(Pipe, "read", lambda self: pytest.fail("it was read"))
    assert keyboards.read() == []


@needs_64_bits
def test_lost_events_are_reported_as_such(device, keyboards):
    """Among them may be a release."""
    os.write(device[1], PRESSED + REPORT + DROPPED)
    assert keyboards.read() is None
    assert keyboards.read() == []


def test_keyboard_that_is_unplugged_is_reported_once_and_closed(device):
    pipes = []
    keyboards = Keyboards(device[0], lambda path: pipes.append(Pipe(path, KEYBOARD)) or pipes[0])
    os.close(device[1])
    assert keyboards.read() is None
    assert keyboards.read() == [] and len(keyboards) == 0 and pipes[0].fd < 0


@pytest.mark.parametrize("capabilities, found", [(KEYBOARD, 1), (MOUSE, 0), ({ecodes.EV_SYN: [0]}, 0)],
                         ids=["keyboard", "mouse", "device_without_keys"])
def test_only_keyboards_are_read_and_no_other_device_stays_open(device, capabilities, found):
    pipes = []
    keyboards = Keyboards(device[0], lambda path: pipes.append(Pipe(path, capabilities)) or pipes[0])
    assert (len(keyboards), pipes[0].fd >= 0) == (found, found == 1)
    keyboards.close()
    assert len(Keyboards(device[0])) == 0  # the real ioctl on a pipe fails


@pytest.mark.parametrize("pattern", ["", "/nowhere/event*"])
def test_without_devices_there_are_no_keyboards(pattern):
    assert len(Keyboards(pattern)) == 0 and Keyboards(pattern).read() == []
