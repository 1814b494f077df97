"""Bus and chip, as the doctor judges them; the chip is the simulated one."""
import errno
import os
import sys
import types

import pytest
from i2c_computer import Computer, Ina3221

from car_interface.common.devices import UNKNOWN, header_of
from car_interface.pca9685.config import AUTO
from car_interface.sim.pca9685_chip import VirtualPca9685
from car_interface.tools.doctor import devices as board
from car_interface.tools.doctor.findings import BAD, OK, WARN, Finding

ORIN = header_of("NVIDIA Jetson Orin Nano Developer Kit")
MAIN, OTHER = "/dev/i2c-7", "/dev/i2c-1"


def car(bus=OTHER, address=0x40, prescale=121, driven=False):
    return types.SimpleNamespace(bus=bus, address=address, prescale=prescale, oscillator_hz=25e6,
                                 runs=lambda name: driven and name == "pca9685")


# --- the bus ---

@pytest.mark.parametrize("exists, is_i2c, denial, header, there, level, words, remedy", [
    (True, True, None, UNKNOWN, (), OK, "/dev/i2c-1", ""),
    (True, True, None, header_of("Raspberry Pi 5 Model B"), (), OK,
     "/dev/i2c-1, pins 3 and 5 of this Raspberry Pi 5", ""),
    (False, False, None, UNKNOWN, (), BAD, "there is no such bus", "modprobe i2c-dev"),
    (False, False, None, header_of("Raspberry Pi 4 Model B"), (), BAD, "there is no such bus", "raspi-config"),
    (False, False, None, ORIN, (), BAD, "there is no such bus", "Pins 3 and 5 of a Jetson Orin are bus 7"),
    (False, False, None, UNKNOWN, ("/dev/i2c-7", "/dev/i2c-8"), BAD, "there are /dev/i2c-7, /dev/i2c-8",
     "ls /dev/i2c-*"),
    (True, False, None, UNKNOWN, (), BAD, "not an I2C bus", "ls /dev/i2c-*"),
    (True, True, ("no permission", "setup_hardware"), UNKNOWN, (), BAD, "/dev/i2c-1: no permission", "setup_hardware"),
], ids=["fine", "header_s", "absent", "switched_off", "another_number", "absent_among_others", "no_bus",
         "no_permission"])
def test_bus(exists, is_i2c, denial, header, there, level, words, remedy, monkeypatch):
    monkeypatch.setattr(board.os.path, "exists", lambda path: exists)
    monkeypatch.setattr(board, "_is_i2c", lambda path: is_i2c)
    monkeypatch.setattr(board.os, "access", lambda path, mode, effective_ids: denial is None)
    monkeypatch.setattr(board, "explain_denial", lambda path: denial)
    found = board.check_bus("/dev/i2c-1", header, there)
    assert (found.subject, found.level) == ("bus", level) and words in found.what and remedy in found.remedy


def test_buses_are_listed_once_each_whatever_links_lead_to_them(monkeypatch):
    links = {"/dev/i2c-servo": "/dev/i2c-1"}
    monkeypatch.setattr(board.glob, "glob", lambda pattern: ["/dev/i2c-servo", "/dev/i2c-1", "/dev/i2c-7"])
    monkeypatch.setattr(board.os.path, "realpath", lambda path: links.get(path, path))
    monkeypatch.setattr(board, "_is_i2c", lambda path: True)
    assert board._buses() == ["/dev/i2c-1", "/dev/i2c-7"]


# --- the chip ---

FRESH, DRIVEN = (0x11, 0x1E, True), (0x20, 121, True)  # MODE1, PRE_SCALE, and whether it is marked as a PCA9685


@pytest.mark.parametrize("registers, prescale, driven, level, words", [
    (FRESH, 121, False, OK, "fresh from power-up"),
    (DRIVEN, 121, True, OK, "driven at 50.0 Hz"),
    (FRESH, 121, True, BAD, "doesn't run as"),
    ((0x20, 122, True), 121, True, BAD, "doesn't run as"),
    ((0x01, 121, True), 121, True, BAD, "doesn't run as"),
    ((0x21, 121, True), None, False, OK, "left so by another program"),
    ((0x31, 121, True), None, False, OK, "sleeps"),
    ((0x21, 5, True), None, False, WARN, "which no servo takes"),
    ((0x60, 121, True), None, False, BAD, "EXTCLK"),
    ((0x71, 0x54, False), None, False, BAD, "not as a PCA9685"),
], ids=["fresh", "driven", "lost_power", "other_prescale", "no_auto_increment", "left_running", "asleep", "too_fast",
         "external_clock", "another_kind"])
def test_chip_is_judged_by_its_registers(registers, prescale, driven, level, words):
    found, = board.check_chip("0x40 on /dev/i2c-1", *registers, car(prescale=prescale, driven=driven))
    assert found.level == level and words in found.what and bool(found.remedy) == (level != OK)


def no_answer(error, others=(), header=UNKNOWN, device=OTHER):
    found, = board.check_no_answer(f"0x40 on {device}", error, device, header, others)
    assert (found.subject, found.level) == ("chip", BAD)
    return found


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
    (errno.EREMOTEIO, "nothing answers at this address", "i2cdetect -y 1. rosrun car_interface doctor --probe"),
    (errno.ENXIO, "nothing answers at this address", "power, SDA and SCL"),
    (errno.EBUSY, "a kernel driver", "address:="),
    (errno.ETIMEDOUT, "holds the bus down", "short"),
    (errno.EAGAIN, "another pca9685 node", "rosnode"),
])
def test_chip_that_can_not_be_read_is_told_as_the_node_tells_it(number, words, remedy):
    found = no_answer(OSError(number, os.strerror(number)))
    assert words in found.what and remedy in found.remedy


def test_address_that_a_driver_has_on_a_jetson_s_inner_bus_leads_to_the_header_s():
    found = no_answer(OSError(errno.EBUSY, "busy"), header=ORIN)
    assert found.what == "0x40 on /dev/i2c-1: a kernel driver has this address (i2cdetect: UU)"
    assert found.remedy.endswith("Pins 3 and 5 of a Jetson Orin are bus 7: i2c:=/dev/i2c-7")


# --- both ---

@pytest.fixture
def computer(monkeypatch):
    """A computer whose buses are all usable, of no known kind; smbus2 opens them."""
    computer = Computer({OTHER: {0x40: VirtualPca9685()}})
    monkeypatch.setitem(sys.modules, "smbus2", types.SimpleNamespace(SMBus=computer.make_bus))
    monkeypatch.setattr(board, "check_bus", lambda device, header, there: Finding(OK, "bus", device))
    monkeypatch.setattr(board, "_buses", lambda: sorted(computer.buses))
    yield computer
    assert computer.written == [] and computer.open == set()


@pytest.fixture
def jetson(computer, monkeypatch):
    """A Jetson Orin Nano with the board on pins 3 and 5, and a power monitor of its own on bus 1."""
    computer.buses.update({MAIN: {0x40: VirtualPca9685()}, OTHER: {0x40: Ina3221()}})
    computer.taken = [(OTHER, 0x40)]
    monkeypatch.setattr(board, "read_header", lambda: ORIN)
    return computer


def examine(device=OTHER, asks_all=False, **how):
    found = board.probe_board(car(device, **how), asks_all)
    return [(finding.subject, finding.level) for finding in found], found[-1].what


def test_bus_and_chip_are_ok_unless_the_chip_lost_its_power_under_the_node_or_the_bus_can_t_be_opened(computer):
    assert examine() == ([("bus", OK), ("chip", OK)],
                         "0x40 on /dev/i2c-1 is fresh from power-up: MODE1 0x11, PRE_SCALE 30")
    computer.buses[OTHER][0x42] = Ina3221()  # which is none
    found = board.probe_board(car(address=0x60), False)[-1]
    assert (found.level, found.what) == (BAD, "nothing answers at 0x60 on /dev/i2c-1, but a PCA9685 at 0x40")
    assert "address:=0x40" in found.remedy
    assert examine(driven=True)[0] == [("bus", OK), ("chip", BAD)]
    computer.buses[OTHER] = errno.EACCES
    levels, words = examine()
    assert levels == [("bus", OK), ("bus", BAD)] and "Permission denied" in words


def test_auto_is_the_header_s_bus_as_for_the_node(jetson):
    assert examine(AUTO) == ([("bus", OK), ("chip", OK)],
                             "0x40 on /dev/i2c-7 is fresh from power-up: MODE1 0x11, PRE_SCALE 30")
    jetson.buses[MAIN] = {}
    assert examine(AUTO)[1] == "0x40 on /dev/i2c-7: nothing answers at this address (Remote I/O error)"
    jetson.buses.update({MAIN: {0x40: VirtualPca9685()}, OTHER: {0x40: VirtualPca9685()}})
    jetson.taken = []
    assert examine(AUTO) == ([("bus", BAD)], "there is one on /dev/i2c-7 and on /dev/i2c-1")


def test_other_buses_are_asked_only_when_a_person_wants_that(jetson):
    jetson.buses.update({"/dev/i2c-0": errno.EACCES, "/dev/i2c-9": {0x43: VirtualPca9685()}})
    examine(AUTO)
    assert {path for path, *_ in jetson.asked} == {MAIN, OTHER}
    found = board.probe_board(car(AUTO), asks_all=True)[2:]
    assert [(one.level, one.what) for one in found] == [
        (WARN, "a PCA9685 answers at 0x43 on /dev/i2c-9"),
        (OK, "no PCA9685 on /dev/i2c-0 (Permission denied), /dev/i2c-1")]
    assert found[0].remedy == "If that is the car's: i2c:=/dev/i2c-9 address:=0x43"
