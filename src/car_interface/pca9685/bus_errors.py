"""Explains errors of the I²C bus by their cause and remedy."""
from __future__ import annotations

import errno

from car_interface.common.device_access import explain_denial
from car_interface.common.own_files import UnsafeFile
from car_interface.pca9685.board import BoardMismatch


def explain(error: OSError, device: str, bus_exists: bool) -> tuple[str, str]:
    """Return cause and remedy of a failed open or transfer.

    Args:
        error: of the bus, or BoardMismatch.
        device: the bus's path.
        bus_exists: there is a file at that path.
    """
    bus = device.rsplit("-", 1)[-1]
    if isinstance(error, BoardMismatch):
        return (f"it answers, but does not keep what it is told ({error})",
                "See whether another chip has this address, and whether its power holds")
    if isinstance(error, UnsafeFile):
        return error.cause, error.remedy
    if not bus_exists:
        return "there is no such bus", ("Switch I2C on (sudo raspi-config; on a Jetson it is on, under another number) "
                                        "and see which buses there are: ls /dev/i2c-*")
    if error.errno == errno.EAGAIN:
        return "another pca9685 node has this board", "See which: rosnode list"
    if error.errno in (errno.EACCES, errno.EPERM):
        return explain_denial(device)
    if error.errno in (errno.ENOTTY, errno.EISDIR, errno.EINVAL):
        return "this is not an I2C bus", "Set ~device to one of: ls /dev/i2c-*"
    if error.errno in (errno.EREMOTEIO, errno.ENXIO, errno.EIO, errno.ETIMEDOUT):
        return (f"nothing answers at this address ({error.strerror})",
                f"Check power, SDA and SCL, and see what is on the bus: i2cdetect -y {bus}")
    if error.errno == errno.EBUSY:
        return "a kernel driver has this address", "Unbind it, or set ~address to the board's own"
    return f"the bus failed ({error})", f"See what is on the bus: i2cdetect -y {bus}"
