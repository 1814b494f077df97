"""Examines the servo board: its bus, and what the chip's registers say. Registers are only read, never written."""
from __future__ import annotations

import errno
import glob
import os
from contextlib import closing
from typing import Any, Callable, Sequence

from car_interface.common.device_access import explain_denial
from car_interface.common.header import Header, read_header
from car_interface.pca9685.bus import NOT_ACKNOWLEDGED, PROBE, BoardNotFound, choose_bus, explain, is_pca9685
from car_interface.pca9685.config import AUTO
from car_interface.pca9685.registers import AUTO_INCREMENT, EXTCLK, MODE1, PRE_SCALE, SLEEP, frequency_for
from car_interface.tools.doctor.computer import device_number
from car_interface.tools.doctor.findings import BAD, OK, WARN, Finding, first
from car_interface.tools.doctor.master import Car

ADDRESSES = range(0x40, 0x80)  # that the six pins can choose (data sheet 7.1)
# Where others are looked for: what three pins choose. Who reads a register writes its number first, and chips of other
# kinds take that for an order: at 0x70 to 0x77 a multiplexer switches its channels, from 0x48 on a PCF8591 its inputs.
NEIGHBOURS = range(0x40, 0x48)
RESET_MODE1, RESET_PRESCALE = 0x11, 0x1E  # after power-up (data sheet 7.3.1, 7.3.5)
SERVO_HZ = (40.0, 400.0)  # what servos and ESCs understand, digital ones included
I2C_MAJOR = 89  # Documentation/admin-guide/devices.txt of the kernel


def probe_board(car: Car, asks_all: bool) -> list[Finding]:
    """Read registers of the chip; look for others where it doesn't answer.

    Args:
        asks_all: look for boards on all other buses, too.
    """
    header, there, found = read_header(), _buses(), []
    import smbus2  # it may be what is missing
    device = car.bus
    if device == AUTO:  # the header's, as the pca9685 node finds it
        device = header.bus_paths[0]
        try:
            device = choose_bus(header, car.address, smbus2.SMBus)
        except BoardNotFound as error:
            if error.is_ambiguous:
                found = [Finding(BAD, "bus", error.cause, error.remedy)]
    if not found:
        found = [check_bus(device, header, there)]
        if found[0].level == OK:
            found += _probe_chip(device, header, car, smbus2.SMBus())
    others = [path for path in there if os.path.realpath(path) != os.path.realpath(device)]
    return found + (ask_buses(others, smbus2.SMBus) if asks_all else [])


def _probe_chip(device, header, car, bus):
    address, name = car.address, f"0x{car.address:02x} on {device}"
    with closing(bus):
        try:
            bus.open(device)
        except OSError as error:
            return [Finding(BAD, "bus", f"{device} can't be opened ({error.strerror})",
                            "See what it is: ls -l /dev/i2c-*")]
        try:
            mode1, prescale = (bus.read_byte_data(address, register) for register in (MODE1, PRE_SCALE))
            return check_chip(name, mode1, prescale, is_pca9685(bus, address), car)
        except OSError as error:
            return check_no_answer(name, error, device, header, find_others(bus, address))


def _buses():
    """Return the paths of the I²C buses, each once, whatever links lead to it."""
    paths = {os.path.realpath(path): path for path in sorted(glob.glob("/dev/i2c-*"), reverse=True) if _is_i2c(path)}
    return sorted(paths.values())


def _is_i2c(path):
    return (device_number(path) or (None,))[0] == I2C_MAJOR


def check_bus(path: str, header: Header, there: Sequence[str]) -> Finding:
    """Check whether a bus is there, an I²C bus, and open to this user; ``there`` are those that are."""
    exists, denial = os.path.exists(path), None
    if not (exists and _is_i2c(path)):
        cause, remedy = explain(OSError(errno.ENOTTY if exists else errno.ENOENT, ""), path, exists, header)
        denial = cause + (f"; there are {', '.join(there)}" if there else ""), remedy
    elif not os.access(path, os.R_OK | os.W_OK, effective_ids=True):
        denial = explain_denial(path)
    if denial:
        return Finding(BAD, "bus", f"{path}: {denial[0]}", denial[1])
    pins = f", pins 3 and 5 of this {header.computer}" if header.computer and path == header.bus_paths[0] else ""
    return Finding(OK, "bus", f"{path}{pins}")


def find_others(bus: Any, address: int | None) -> list[int]:
    """Return where PCA9685s answer at the other ``NEIGHBOURS``; stops where the bus itself fails."""
    found = []
    for other in NEIGHBOURS:
        try:
            if other != address and is_pca9685(bus, other):
                found.append(other)
        except OSError as error:
            if error.errno not in (*NOT_ACKNOWLEDGED, errno.EBUSY):
                break
    return found


def ask_buses(paths: Sequence[str], make_bus: Callable[[], Any]) -> list[Finding]:
    """Return one finding for each bus with PCA9685s, and one for those that have none or can't be asked."""
    found, empty = [], []
    for path in paths:
        with closing(make_bus()) as bus:
            try:
                bus.open(path)
            except OSError as error:
                empty.append(f"{path} ({error.strerror})")
                continue
            boards = find_others(bus, None)
        found += [Finding(WARN, "bus", f"a PCA9685 answers at 0x{address:02x} on {path}",
                          f"If that is the car's: i2c:={path} address:=0x{address:02x}") for address in boards]
        if not boards:
            empty.append(path)
    return found + ([Finding(OK, "bus", f"no PCA9685 on {', '.join(empty)}")] if empty else [])


def check_chip(name: str, mode1: int, prescale: int, is_marked: bool, car: Car) -> list[Finding]:
    """Judge what a chip's registers say; ``is_marked``: see ``is_pca9685``."""
    registers = f"MODE1 0x{mode1:02x}, PRE_SCALE {prescale}"
    frequency_hz, driven = frequency_for(prescale, car.oscillator_hz), car.runs("pca9685")
    is_reset = (mode1, prescale) == (RESET_MODE1, RESET_PRESCALE)
    is_as_set = mode1 & AUTO_INCREMENT and not mode1 & SLEEP and car.prescale in (None, prescale)
    return first(
        "chip",
        (not is_marked, BAD, f"{name} answers, but not as a PCA9685 does: {registers}",
         "See which chip that is: an INA sensor also likes 0x40; move one of them by its solder pads"),
        (mode1 & EXTCLK, BAD, f"{name} waits for a clock at its EXTCLK pin: {registers}",
         "Cut its power for a moment: this bit can't be cleared"),
        (driven and not is_as_set, BAD, f"{name} doesn't run as the pca9685 node set it: {registers}",
         "See who else writes to it, and whether its power holds"),
        (driven, OK, f"{name} is driven at {frequency_hz:.1f} Hz: {registers}"),
        (is_reset, OK, f"{name} is fresh from power-up: {registers}"),
        (mode1 & SLEEP, OK, f"{name} sleeps: {registers}"),
        (not SERVO_HZ[0] <= frequency_hz <= SERVO_HZ[1], WARN,
         f"{name} runs at {frequency_hz:.1f} Hz, which no servo takes: {registers}",
         "Nothing, if another program left it so: the pca9685 node sets it"),
        (True, OK, f"{name} runs at {frequency_hz:.1f} Hz, left so by another program: {registers}"))


def check_no_answer(name: str, error: OSError, device: str, header: Header, others: Sequence[int]) -> list[Finding]:
    """Return the finding about a chip that can't be read; ``others`` are what ``find_others`` found."""
    if error.errno in NOT_ACKNOWLEDGED and others:
        listed = ", ".join(f"0x{address:02x}" for address in others)
        return [Finding(BAD, "chip", f"nothing answers at {name}, but a PCA9685 at {listed}",
                        f"If that is your board: address:=0x{others[0]:02x}")]
    cause, remedy = explain(error, device, True, header)
    wider = f". {PROBE}" if error.errno in NOT_ACKNOWLEDGED else ""
    return [Finding(BAD, "chip", f"{name}: {cause}", remedy + wider)]
