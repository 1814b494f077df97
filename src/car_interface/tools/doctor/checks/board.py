"""The servo board: its bus, and what the chip's registers say. They are only read; nothing that drives is disturbed."""
from __future__ import annotations

import errno
from typing import NamedTuple, Sequence

from car_interface.common.device_access import SETUP_REMEDY
from car_interface.pca9685.board import AUTO_INCREMENT, EXTCLK, MODE1, PRE_SCALE, SLEEP
from car_interface.pca9685.registers import PRESCALE_MIN, frequency_for
from car_interface.tools.doctor.checks.findings import BAD, OK, WARN, Finding

ADDRESSES = range(0x40, 0x80)  # that the six pins can choose (data sheet 7.1)
# Where others are looked for: what three pins choose. Who reads a register writes its number first, and chips of other
# kinds take that for an order: at 0x70 to 0x77 a multiplexer switches its channels, from 0x48 on a PCF8591 its inputs.
NEIGHBOURS = range(0x40, 0x48)
SUB_ADDRESSES = 0x0E  # bits of MODE1 that servo drivers leave at 0
RESET_MODE1, RESET_PRESCALE = 0x11, 0x1E  # after power-up (data sheet 7.3.1, 7.3.5)
SERVO_HZ = (40.0, 400.0)  # what servos and ESCs understand, digital ones included
NOT_ACKNOWLEDGED = (errno.EREMOTEIO, errno.ENXIO, errno.EIO)  # how adapters say that no chip acknowledged


class Bus(NamedTuple):
    """What's known of a bus without using it."""

    path: str  # of the device
    exists: bool  # whether there is anything at that path
    is_i2c: bool  # whether that is an I²C bus
    usable: bool  # whether this process may read and write it
    group: str  # its group's name
    others: tuple = ()  # the I²C buses that there are


def check_bus(bus: Bus) -> list[Finding]:
    """Check whether it's there, an I²C bus, and open to this user."""
    others = f"; there are {', '.join(bus.others)}" if bus.others else ""
    if not bus.exists:
        remedy = (f"Use one of these: --i2c {bus.others[0]}" if bus.others else
                "Switch I2C on: sudo raspi-config, interfaces (on a Jetson: sudo modprobe i2c-dev); then ls /dev/i2c-*")
        return [Finding(BAD, "bus", f"{bus.path}: there is no such bus{others}", remedy)]
    if not bus.is_i2c:
        return [Finding(BAD, "bus", f"{bus.path} is not an I2C bus{others}", "See which there are: ls /dev/i2c-*")]
    if not bus.usable:
        return [Finding(BAD, "bus", f"{bus.path}: no permission to use it; its group is {bus.group}", SETUP_REMEDY)]
    return [Finding(OK, "bus", bus.path)]


class Registers(NamedTuple):
    """Two of a PCA9685's registers; other chips answer with something else."""

    mode1: int
    prescale: int

    @property
    def plausible(self) -> bool:
        """Whether a PCA9685 can hold these."""
        return (not self.mode1 & SUB_ADDRESSES and self.prescale >= PRESCALE_MIN
                and (self.mode1, self.prescale) != (0xFF, 0xFF))

    def __str__(self):
        return f"MODE1 0x{self.mode1:02x}, PRE_SCALE {self.prescale}"


def read_registers(bus, address: int) -> Registers:
    """Ask a chip.

    Args:
        bus: has smbus2's ``read_byte_data(address, register)``.
        address: of the chip.

    Raises:
        OSError: when it doesn't answer.
    """
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
    """Judge what the registers say.

    Args:
        name: of the chip: its address and bus.
        registers: what it answered.
        prescale: what the pca9685 node's parameters ask for; ``None`` when there are none.
        driven: whether that node runs.
        oscillator_hz: the chip's clock.
    """
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
    """Return the finding about a chip that can't be read.

    Args:
        name: of the chip: its address and bus.
        error: of the transfer.
        others: what answers at other addresses, as ``find_others`` returns it.
    """
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
