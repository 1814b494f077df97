"""Finds the bus that the servo board is on, and explains what is wrong with a bus.

A PCA9685 has no register that names it. What marks it are the four registers of its further addresses, which hold
their reset values unless a program gives the chip other addresses; no servo driver does. Registers are only read.
"""
from __future__ import annotations

import errno
from typing import Any, Callable

from car_interface.common.devices import Header, explain_denial
from car_interface.common.own_files import UnsafeFile
from car_interface.pca9685.board import BoardMismatch

MARKS = {0x02: 0xE2, 0x03: 0xE4, 0x04: 0xE8, 0x05: 0xE0}  # SUBADR1..3, ALLCALLADR (data sheet 7.3.6, 7.3.7)
NOT_ACKNOWLEDGED = (errno.EREMOTEIO, errno.ENXIO, errno.EIO)  # how adapters say that no chip acknowledged
PROBE = "rosrun car_interface doctor --probe asks all buses"


class BoardNotFound(OSError):
    """Which bus the board is on is not known.

    Args:
        cause, remedy: as ``explain`` returns them.
        is_ambiguous: there are several boards.
    """

    def __init__(self, cause: str, remedy: str, is_ambiguous: bool = False):
        super().__init__(errno.ENODEV, cause)
        self.cause, self.remedy, self.is_ambiguous = cause, remedy, is_ambiguous


def is_pca9685(bus: Any, address: int) -> bool:
    """Return whether the chip at an address is marked as a PCA9685; another kind is asked for one register only.

    Raises:
        OSError: nothing answers, or a kernel driver has the address.
    """
    return all(bus.read_byte_data(address, register) == value for register, value in MARKS.items())


def choose_bus(header: Header, address: int, make_bus: Callable[[], Any]) -> str:
    """Return the path of the header's bus on which the board is; where there is but one, without asking.

    Args:
        make_bus: makes a closed bus, as ``smbus2.SMBus``.

    Raises:
        BoardNotFound: none answers, or several do.
    """
    paths = header.bus_paths
    if len(paths) == 1:
        return paths[0]
    found, fault = [], None
    for path in paths:
        bus = make_bus()
        try:
            bus.open(path)
            if is_pca9685(bus, address):
                found.append(path)
        except OSError as error:
            # On pins 27 and 28 there may be no bus, and a chip of the computer's own at this address.
            usual = NOT_ACKNOWLEDGED if path == paths[0] else (*NOT_ACKNOWLEDGED, errno.EBUSY, errno.ENOENT)
            if error.errno not in usual and fault is None:
                fault = (path, error)
        finally:
            bus.close()
    if len(found) > 1:
        listed = " and on ".join(found)
        raise BoardNotFound(f"there is one on {listed}", f"Choose the car's: i2c:={found[0]}", is_ambiguous=True)
    # The car's board may be on the first bus, which can't be used now, and another car's on the second.
    if fault is not None and (not found or fault[0] == paths[0]):
        path, error = fault
        cause, remedy = explain(error, path, error.errno != errno.ENOENT, header)
        raise BoardNotFound(f"{path}: {cause}", remedy) from error
    if found:
        return found[0]
    raise BoardNotFound(f"no PCA9685 answers at this address on {' or '.join(paths)}, the buses of the header of a "
                        f"{header.computer}", f"Check power, SDA and SCL: i2cdetect -y {header.buses[0]}. {PROBE}")


def explain(error: OSError, device: str, bus_exists: bool, header: Header) -> tuple[str, str]:
    """Return cause and remedy of a failed open or transfer.

    Args:
        error: of the bus, or BoardMismatch.
        bus_exists: there is a file at that path.
    """
    bus = device.rsplit("-", 1)[-1]
    pins = ""  # which bus the header's is, if this is another one
    if header.computer and device != header.bus_paths[0]:
        pins = f"Pins 3 and 5 of a {header.computer} are bus {header.buses[0]}: i2c:={header.bus_paths[0]}"
    if isinstance(error, BoardMismatch):
        return (f"it answers, but does not keep what it is told ({error})",
                "See whether another chip has this address, and whether its power holds")
    if isinstance(error, (UnsafeFile, BoardNotFound)):
        return error.cause, error.remedy
    if not bus_exists:
        return "there is no such bus", pins or header.bus_remedy
    if error.errno == errno.EAGAIN:
        return "another pca9685 node has this board", "See which: rosnode list"
    if error.errno in (errno.EACCES, errno.EPERM):
        return explain_denial(device)
    if error.errno in (errno.ENOTTY, errno.EISDIR, errno.EINVAL):
        return "this is not an I2C bus", "Give one of these by i2c:= : ls /dev/i2c-*"
    if error.errno in NOT_ACKNOWLEDGED:
        return (f"nothing answers at this address ({error.strerror})",
                f"Check power, SDA and SCL, and see what is on the bus: i2cdetect -y {bus}")
    if error.errno == errno.ETIMEDOUT:
        return (f"something holds the bus down ({error.strerror})",
                "Check SDA and SCL for a short; power all that is on the bus off and on")
    if error.errno == errno.EBUSY:
        # On another bus that is a chip of the computer's own.
        remedy = (f"Leave that chip alone: it is the computer's own. {pins}" if pins else
                  "Is it the board, by a device-tree overlay? Remove that. Or another chip? Give the board another "
                  "address by its solder pads, and address:=0x41")
        return "a kernel driver has this address (i2cdetect: UU)", remedy
    return f"the bus failed ({error})", f"See what is on the bus: i2cdetect -y {bus}"
