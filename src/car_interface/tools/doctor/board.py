"""Examines the servo board: its bus, and what the chip's registers say. Registers are only read, never written."""
from __future__ import annotations

import errno
import glob
import os
from typing import NamedTuple, Sequence

from car_interface.common.device_access import SETUP_REMEDY
from car_interface.pca9685.board import AUTO_INCREMENT, EXTCLK, MODE1, PRE_SCALE, SLEEP
from car_interface.pca9685.registers import PRESCALE_MIN, frequency_for
from car_interface.tools.doctor.computer import group_of, is_character_device
from car_interface.tools.doctor.findings import BAD, OK, WARN, Finding

ADDRESSES = range(0x40, 0x80)  # that the six pins can choose (data sheet 7.1)
# Where others are looked for: what three pins choose. Who reads a register writes its number first, and chips of other
# kinds take that for an order: at 0x70 to 0x77 a multiplexer switches its channels, from 0x48 on a PCF8591 its inputs.
NEIGHBOURS = range(0x40, 0x48)
SUB_ADDRESSES = 0x0E  # bits of MODE1 that servo drivers leave at 0
RESET_MODE1, RESET_PRESCALE = 0x11, 0x1E  # after power-up (data sheet 7.3.1, 7.3.5)
SERVO_HZ = (40.0, 400.0)  # what servos and ESCs understand, digital ones included
I2C_MAJOR = 89  # Documentation/admin-guide/devices.txt of the kernel
NOT_ACKNOWLEDGED = (errno.EREMOTEIO, errno.ENXIO, errno.EIO)  # how adapters say that no chip acknowledged


def probe_board(device: str, address: int, prescale: int | None, driven: bool, oscillator_hz: float) -> list[Finding]:
    """Read two registers of the chip; look for others where it doesn't answer.

    Args:
        prescale: what the pca9685 node's parameters ask for; ``None`` when there are none.
        driven: whether that node runs.
        oscillator_hz: the chip's clock.
    """
    name = f"0x{address:02x} on {device}"
    found = _probe_bus(device)
    if found[0].level != OK:
        return found
    import smbus2  # it may be what is missing
    bus = smbus2.SMBus()
    try:
        bus.open(device)
        try:
            return found + check_chip(name, read_registers(bus, address), prescale, driven, oscillator_hz)
        except OSError as error:
            return found + check_no_answer(name, error, find_others(bus, address))
    except OSError as error:
        return [Finding(BAD, "bus", f"{device} can't be opened ({error.strerror})", "See what it is: ls -l /dev/i2c-*")]
    finally:
        bus.close()


def _probe_bus(device):
    return check_bus(device, os.path.exists(device), _is_i2c(device),
                     os.access(device, os.R_OK | os.W_OK, effective_ids=True), group_of(device, "root"),
                     [path for path in sorted(glob.glob("/dev/i2c-*")) if path != device and _is_i2c(path)])


def _is_i2c(path):
    return is_character_device(path) and os.major(os.stat(path).st_rdev) == I2C_MAJOR


def check_bus(path: str, exists: bool, is_i2c: bool, usable: bool, group: str, others: Sequence[str] = ()
              ) -> list[Finding]:
    """Check whether a bus is there, an I²C bus, and open to this user, who may join ``group``; there are ``others``."""
    listed = f"; there are {', '.join(others)}" if others else ""
    if not exists:
        remedy = (f"Use one of these: --i2c {others[0]}" if others else
                "Switch I2C on: sudo raspi-config, interfaces (on a Jetson: sudo modprobe i2c-dev); then ls /dev/i2c-*")
        return [Finding(BAD, "bus", f"{path}: there is no such bus{listed}", remedy)]
    if not is_i2c:
        return [Finding(BAD, "bus", f"{path} is not an I2C bus{listed}", "See which there are: ls /dev/i2c-*")]
    if not usable:
        return [Finding(BAD, "bus", f"{path}: no permission to use it; its group is {group}", SETUP_REMEDY)]
    return [Finding(OK, "bus", path)]


class Registers(NamedTuple):
    """Two of a PCA9685's registers; other chips answer with something else."""

    mode1: int
    prescale: int

    @property
    def plausible(self) -> bool:
        """Return whether a PCA9685 can hold these."""
        return (not self.mode1 & SUB_ADDRESSES and self.prescale >= PRESCALE_MIN
                and (self.mode1, self.prescale) != (0xFF, 0xFF))

    def __str__(self):
        return f"MODE1 0x{self.mode1:02x}, PRE_SCALE {self.prescale}"


def read_registers(bus, address: int) -> Registers:
    """Ask a chip on a bus that has smbus2's ``read_byte_data(address, register)``; OSError when it doesn't answer."""
    return Registers(bus.read_byte_data(address, MODE1), bus.read_byte_data(address, PRE_SCALE))


def find_others(bus, address: int) -> list[tuple[int, Registers]]:
    """Return what answers like a PCA9685 at the other ``NEIGHBOURS``; stops where the bus itself fails."""
    found = []
    for other in NEIGHBOURS:
        if other == address:
            continue
        try:
            registers = read_registers(bus, other)
        except OSError as error:
            if error.errno in (*NOT_ACKNOWLEDGED, errno.EBUSY):
                continue
            break
        if registers.plausible:
            found.append((other, registers))
    return found


def check_chip(name: str, registers: Registers, prescale: int | None = None, driven: bool = False,
               oscillator_hz: float = 25e6) -> list[Finding]:
    """Judge what a chip's registers say; the arguments are those of ``probe_board``."""
    if not registers.plausible:
        return [Finding(BAD, "chip", f"{name} answers, but not as a PCA9685 does: {registers}",
                        "See which chip that is: an INA sensor also likes 0x40; move one of them by its solder pads")]
    if registers.mode1 & EXTCLK:
        return [Finding(BAD, "chip", f"{name} waits for a clock at its EXTCLK pin: {registers}",
                        "Cut its power for a moment: this bit can't be cleared. Or it's another chip, such as an INA")]
    frequency = f"{frequency_for(registers.prescale, oscillator_hz):.1f} Hz"
    if driven:
        runs = registers.mode1 & AUTO_INCREMENT and not registers.mode1 & SLEEP
        if not runs or prescale not in (None, registers.prescale):
            return [Finding(BAD, "chip", f"{name} doesn't run as the pca9685 node set it: {registers}",
                            "See who else writes to it, and whether its power holds")]
        return [Finding(OK, "chip", f"{name} is driven at {frequency}: {registers}")]
    if registers == (RESET_MODE1, RESET_PRESCALE):
        return [Finding(OK, "chip", f"{name} is fresh from power-up: {registers}")]
    if registers.mode1 & SLEEP:
        return [Finding(OK, "chip", f"{name} sleeps: {registers}")]
    if not SERVO_HZ[0] <= frequency_for(registers.prescale, oscillator_hz) <= SERVO_HZ[1]:
        return [Finding(WARN, "chip", f"{name} runs at {frequency}, which no servo takes: {registers}",
                        "Nothing, if another program left it so: the pca9685 node sets it")]
    return [Finding(OK, "chip", f"{name} runs at {frequency}, left so by another program: {registers}")]


def check_no_answer(name: str, error: OSError, others: Sequence[tuple[int, Registers]]) -> list[Finding]:
    """Return the finding about a chip that can't be read; ``others`` are what ``find_others`` found."""
    if error.errno == errno.EBUSY:
        return [Finding(BAD, "chip", f"{name}: a kernel driver has this address", "Unbind it, or give --address")]
    if error.errno in NOT_ACKNOWLEDGED:
        if others:
            listed = ", ".join(f"0x{address:02x}" for address, _ in others)
            return [Finding(BAD, "chip", f"nothing answers at {name}, but something like it at {listed}",
                            f"Set address to 0x{others[0][0]:02x}, if that is your board")]
        return [Finding(BAD, "chip", f"nothing answers at {name}",
                        "Check the board's power, SDA and SCL, and see what is on the bus: "
                        f"i2cdetect -y {name.rpartition('-')[2]}. Beside this address the doctor asks at "
                        f"0x{NEIGHBOURS[0]:02x} to 0x{NEIGHBOURS[-1]:02x} only")]
    if error.errno == errno.ETIMEDOUT:
        return [Finding(BAD, "chip", f"{name}: something holds the bus down",
                        "Check SDA and SCL for a short; power all that is on the bus off and on")]
    return [Finding(BAD, "chip", f"{name}: the bus failed ({error})", "Check the board's power, SDA and SCL")]
