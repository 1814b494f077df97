"""Bus and chip, as the doctor judges them; the chip is the simulated one."""
from __future__ import annotations

import errno
import os
import sys
import types

import pytest

from car_interface.sim.pca9685_chip import VirtualBus, VirtualPca9685
from car_interface.tools.doctor import board
from car_interface.tools.doctor.findings import BAD, OK, WARN

# --- the bus ---

def bus(exists=True, is_i2c=True, usable=True, others=()):
    return board.check_bus("/dev/i2c-1", exists, is_i2c, usable, "i2c", others)


@pytest.mark.parametrize("findings, level, words, remedy", [
    (bus(), OK, "/dev/i2c-1", ""),
    (bus(exists=False, is_i2c=False), BAD, "there is no such bus", "raspi-config"),
    (bus(exists=False, others=("/dev/i2c-7", "/dev/i2c-8")), BAD, "there are /dev/i2c-7, /dev/i2c-8", "/dev/i2c-7"),
    (bus(is_i2c=False), BAD, "not an I2C bus", "ls /dev/i2c-*"),
    (bus(usable=False), BAD, "its group is i2c", "setup_hardware"),
], ids=["fine", "absent", "absent_among_others", "no_bus", "no_permission"])
def test_bus(findings, level, words, remedy):
    found, = findings
    assert (found.subject, found.level) == ("bus", level) and words in found.what and remedy in found.remedy


# --- the chip ---

FRESH, DRIVEN = board.Registers(0x11, 0x1E), board.Registers(0x20, 121)


@pytest.mark.parametrize("registers, prescale, driven, level, words", [
    (FRESH, 121, False, OK, "fresh from power-up"),
    (DRIVEN, 121, True, OK, "driven at 50.0 Hz"),
    (FRESH, 121, True, BAD, "doesn't run as"),
    (board.Registers(0x20, 122), 121, True, BAD, "doesn't run as"),
    (board.Registers(0x01, 121), 121, True, BAD, "doesn't run as"),
    (board.Registers(0x21, 121), None, False, OK, "left so by another program"),
    (board.Registers(0x31, 121), None, False, OK, "sleeps"),
    (board.Registers(0x21, 5), None, False, WARN, "which no servo takes"),
    (board.Registers(0x60, 121), None, False, BAD, "EXTCLK"),
    (board.Registers(0x00, 0), None, False, BAD, "not as a PCA9685"),
    (board.Registers(0xFF, 0xFF), None, False, BAD, "not as a PCA9685"),
], ids=["fresh", "driven", "lost_power", "other_prescale", "no_auto_increment", "left_running", "asleep", "too_fast",
         "external_clock", "zeros", "ones"])
def test_chip_is_judged_by_its_registers(registers, prescale, driven, level, words):
    found, = board.check_chip("0x40 on /dev/i2c-1", registers, prescale, driven)
    assert found.level == level and words in found.what and bool(found.remedy) == (level != OK)


def test_chip_at_another_address_is_found_and_nothing_is_written():
    written = []
    virtual = VirtualBus({0x41: VirtualPca9685()}, on_write=lambda *write: written.append(write))
    with pytest.raises(OSError) as caught:
        board.read_registers(virtual, 0x40)
    others = board.find_others(virtual, 0x40)
    assert others == [(0x41, FRESH)]
    found, = board.check_no_answer("0x40 on /dev/i2c-1", caught.value, others)
    assert found.level == BAD and "something like it at 0x41" in found.what and "0x41" in found.remedy
    assert written == []


@pytest.mark.parametrize("address, error, expected", [
    (0x40, errno.EREMOTEIO, range(0x41, 0x48)), (0x60, errno.EREMOTEIO, range(0x40, 0x48)),
    (0x40, errno.ETIMEDOUT, [0x41])], ids=["all_others", "from_another_kind_s_address", "until_the_bus_fails"])
def test_chips_of_other_kinds_are_not_asked_for_the_question_is_a_write_to_them(address, error, expected):
    """At 0x71, say, a TCA9548A takes a register's number for the channels that it shall connect."""
    asked = []

    class EmptyBus:
        def read_byte_data(self, address, register):
            asked.append(address)
            raise OSError(error, "nobody")

    assert board.find_others(EmptyBus(), address) == []
    assert list(dict.fromkeys(asked)) == list(expected)


@pytest.mark.parametrize("number, words, remedy", [
    (errno.EREMOTEIO, "nothing answers at 0x40", "i2cdetect -y 1"),
    (errno.ENXIO, "nothing answers at 0x40", "power, SDA and SCL"),
    (errno.EBUSY, "a kernel driver", "--address"),
    (errno.ETIMEDOUT, "holds the bus down", "short"),
    (errno.EAGAIN, "the bus failed", "power"),
])
def test_chip_that_can_not_be_read_is_told(number, words, remedy):
    found, = board.check_no_answer("0x40 on /dev/i2c-1", OSError(number, os.strerror(number)), [])
    assert (found.subject, found.level) == ("chip", BAD) and words in found.what and remedy in found.remedy


# --- both ---

@pytest.fixture
def smbus2(monkeypatch):
    """A bus that is there and usable, with a smbus2 that opens it; what was opened, and still is."""
    module = types.SimpleNamespace(chips={0x40: VirtualPca9685()}, opened=[], refuses=None)

    class SMBus(VirtualBus):
        def __init__(self):
            super().__init__(module.chips)

        def open(self, device):
            if module.refuses is not None:
                raise module.refuses
            module.opened.append(device)

        def close(self):
            module.opened.clear()

    module.SMBus = SMBus
    monkeypatch.setitem(sys.modules, "smbus2", module)
    monkeypatch.setattr(board, "_probe_bus", lambda device: bus())
    return module


def levels_and_words(address=0x40, driven=False):
    found = board.probe_board("/dev/i2c-1", address, 121, driven, 25e6)
    return [(finding.subject, finding.level) for finding in found], found[-1].what


def test_bus_and_chip_are_ok_unless_the_chip_lost_its_power_under_the_node(smbus2):
    assert levels_and_words() == ([("bus", OK), ("chip", OK)],
                                  "0x40 on /dev/i2c-1 is fresh from power-up: MODE1 0x11, PRE_SCALE 30")
    assert levels_and_words(address=0x60) == ([("bus", OK), ("chip", BAD)],
                                              "nothing answers at 0x60 on /dev/i2c-1, but something like it at 0x40")
    assert smbus2.opened == []
    assert levels_and_words(driven=True)[0] == [("bus", OK), ("chip", BAD)]


def test_bus_that_can_not_be_opened_is_bad(smbus2):
    smbus2.refuses = PermissionError(errno.EACCES, "Permission denied")
    levels, words = levels_and_words()
    assert levels == [("bus", BAD)] and "Permission denied" in words
