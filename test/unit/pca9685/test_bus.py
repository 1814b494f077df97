"""The bus that the board is on, and causes and remedies of a bus's errors; the chips are simulated ones."""

import errno
import os

import pytest
from i2c_computer import Computer, Ina3221

from car_interface.common.devices import UNKNOWN, header_of
from car_interface.pca9685.board import BoardMismatch
from car_interface.pca9685.bus import BoardNotFound, choose_bus, explain, is_pca9685
from car_interface.sim.pca9685_chip import VirtualPca9685

ORIN = header_of("NVIDIA Jetson Orin Nano Developer Kit")
PI = header_of("Raspberry Pi 4 Model B Rev 1.5")
MAIN, OTHER = "/dev/i2c-7", "/dev/i2c-1"


def chips(*addresses):
    return {address: VirtualPca9685() for address in addresses}


def choose(buses, taken=(), address=0x40):
    computer = Computer(buses, taken)
    try:
        return choose_bus(ORIN, address, computer.make_bus)
    finally:
        assert computer.open == set() and computer.written == []


# --- the header's bus ---

@pytest.mark.parametrize("buses, taken, address, found", [
    # Bus 1 of an Orin Nano has a power monitor at 0x40, which i2cdetect shows as UU.
    ({MAIN: chips(0x40), OTHER: {0x40: Ina3221()}}, [(OTHER, 0x40)], 0x40, MAIN),
    ({MAIN: chips(0x40), OTHER: errno.EACCES}, (), 0x40, MAIN),
    ({MAIN: chips(0x41), OTHER: chips(0x60)}, (), 0x60, OTHER),
], ids=["beside_what_a_driver_has_on_the_other", "whatever_is_wrong_with_the_other", "on_pins_27_and_28"])
def test_board_is_found_on_the_bus_where_it_answers_at_its_address(buses, taken, address, found):
    assert choose(buses, taken, address) == found


def test_boards_on_both_buses_are_named_and_neither_is_taken():
    with pytest.raises(BoardNotFound) as caught:
        choose({MAIN: chips(0x40), OTHER: chips(0x40)})
    assert caught.value.is_ambiguous and caught.value.errno == errno.ENODEV
    assert explain(caught.value, "", True, ORIN) == (f"there is one on {MAIN} and on {OTHER}",
                                                     f"Choose the car's: i2c:={MAIN}")


@pytest.mark.parametrize("header, path", [(UNKNOWN, "/dev/i2c-1"), (PI, "/dev/i2c-1")], ids=["unknown", "one_bus"])
def test_single_bus_is_taken_without_asking_any_chip(header, path):
    computer = Computer({path: chips(0x40), "/dev/i2c-7": chips(0x40)})
    assert choose_bus(header, 0x40, computer.make_bus) == path and computer.asked == []


@pytest.mark.parametrize("buses, taken, cause, remedy", [
    ({MAIN: {}, OTHER: {}}, (), "no PCA9685 answers at this address on /dev/i2c-7 or /dev/i2c-1", "i2cdetect -y 7"),
    ({MAIN: {}, OTHER: {}}, (), "the buses of the header of a Jetson Orin", "doctor --probe"),
    ({MAIN: {0x40: Ina3221()}, OTHER: errno.ENOENT}, (), "no PCA9685 answers", "power, SDA and SCL"),
    ({MAIN: errno.ENOENT, OTHER: {}}, (), "/dev/i2c-7: there is no such bus", "modprobe i2c-dev"),
    ({MAIN: chips(0x40), OTHER: {}}, [(MAIN, 0x40)], "/dev/i2c-7: a kernel driver has this address", "solder pads"),
    ({MAIN: errno.EACCES, OTHER: {}}, (), "/dev/i2c-7: no permission", "setup_hardware"),
    ({MAIN: {}, OTHER: errno.EACCES}, (), "/dev/i2c-1: no permission", "setup_hardware"),
    ({MAIN: errno.ETIMEDOUT, OTHER: chips(0x40)}, (), "/dev/i2c-7: something holds the bus down", "short"),
], ids=["nothing", "nothing_names_the_computer", "another_chip", "no_bus", "taken_by_a_driver", "denied",
         "other_denied", "held_and_a_board_on_the_other"])
def test_board_that_is_not_found_is_told_by_the_first_cause(buses, taken, cause, remedy):
    with pytest.raises(BoardNotFound) as caught:
        choose(buses, taken)
    assert cause in caught.value.cause and remedy in caught.value.remedy and not caught.value.is_ambiguous


def test_board_is_marked_whatever_it_does_and_other_kinds_are_asked_for_one_register():
    chip = VirtualPca9685()
    chip.write(0x00, [0x20])
    chip.write(0x06, [0, 0, 0, 1])
    computer = Computer({MAIN: {0x40: chip, 0x41: Ina3221()}})
    bus = computer.make_bus()
    bus.open(MAIN)
    assert is_pca9685(bus, 0x40)
    computer.asked.clear()
    assert not is_pca9685(bus, 0x41) and len(computer.asked) == 1


@pytest.mark.parametrize("register", [0x02, 0x03, 0x04, 0x05])
def test_chip_one_of_whose_further_addresses_was_changed_is_no_pca9685(register):
    chip = VirtualPca9685()
    chip.write(register, [0x10])
    bus = Computer({MAIN: {0x40: chip}}).make_bus()
    bus.open(MAIN)
    assert not is_pca9685(bus, 0x40)


# --- errors ---

@pytest.mark.parametrize("number, cause, remedy", [
    pytest.param(errno.EAGAIN, "another pca9685 node has this board", "rosnode list", id="locked"),
    pytest.param(errno.EACCES, "no permission to open it", "setup_hardware", id="permission"),
    pytest.param(errno.ENOTTY, "this is not an I2C bus", "ls /dev/i2c-", id="another_device"),
    pytest.param(errno.EISDIR, "this is not an I2C bus", "ls /dev/i2c-", id="folder"),
    pytest.param(errno.EREMOTEIO, "nothing answers at this address", "i2cdetect -y 7", id="no_acknowledge"),
    pytest.param(errno.ETIMEDOUT, "something holds the bus down", "short", id="held"),
    pytest.param(errno.EBUSY, "a kernel driver has this address (i2cdetect: UU)", "address:=", id="kernel_driver"),
    pytest.param(errno.EPROTO, "the bus failed", "i2cdetect -y 7", id="any_other"),
])
def test_error_has_cause_and_remedy(number, cause, remedy):
    found = explain(OSError(number, os.strerror(number)), "/dev/i2c-7", True, UNKNOWN)
    assert found[0].startswith(cause) and remedy in found[1]


@pytest.mark.parametrize("header, device, remedy", [
    (ORIN, "/dev/i2c-0", "Pins 3 and 5 of a Jetson Orin are bus 7: i2c:=/dev/i2c-7"),
    (PI, "/dev/i2c-1", "Switch I2C on: sudo raspi-config nonint do_i2c 0"),
    (UNKNOWN, "/dev/i2c-1", "See which there are: ls /dev/i2c-*. Without any: sudo modprobe i2c-dev"),
], ids=["another_than_the_header_s", "switched_off", "unknown"])
def test_absent_bus_is_named_whatever_the_error_with_the_remedy_of_its_computer(header, device, remedy):
    assert explain(OSError(errno.ENOENT, "x"), device, False, header) == ("there is no such bus", remedy)


@pytest.mark.parametrize("header, device, remedy", [
    (ORIN, "/dev/i2c-1", "Leave that chip alone: it is the computer's own. Pins 3 and 5 of a Jetson Orin are bus 7"),
    (ORIN, "/dev/i2c-7", "another address by its solder pads"),
    (UNKNOWN, "/dev/i2c-1", "another address by its solder pads"),
], ids=["wrong_bus", "header_s_bus", "unknown"])
def test_address_that_a_driver_has_is_left_to_it(header, device, remedy):
    found = explain(OSError(errno.EBUSY, "x"), device, True, header)[1]
    assert remedy in found and "nbind" not in found


def test_mismatch_is_a_chip_that_was_reset():
    cause, remedy = explain(BoardMismatch("MODE1 is 0x11"), "/dev/i2c-7", True, UNKNOWN)
    assert "MODE1 is 0x11" in cause and "power" in remedy
