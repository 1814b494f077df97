"""Causes and remedies of bus errors."""
from __future__ import annotations

import errno
import os

import pytest

from car_interface.pca9685.board import BoardMismatch, explain


@pytest.mark.parametrize("number, cause, remedy", [
    pytest.param(errno.EAGAIN, "another pca9685 node has this board", "rosnode list", id="locked"),
    pytest.param(errno.EACCES, "no permission to open it", "setup_hardware", id="permission"),
    pytest.param(errno.ENOTTY, "this is not an I2C bus", "ls /dev/i2c-", id="another_device"),
    pytest.param(errno.EISDIR, "this is not an I2C bus", "ls /dev/i2c-", id="folder"),
    pytest.param(errno.EREMOTEIO, "nothing answers at this address", "i2cdetect -y 7", id="no_acknowledge"),
    pytest.param(errno.ETIMEDOUT, "nothing answers at this address", "power, SDA and SCL", id="timeout"),
    pytest.param(errno.EBUSY, "a kernel driver has this address", "~address", id="kernel_driver"),
    pytest.param(errno.EPROTO, "the bus failed", "i2cdetect -y 7", id="any_other"),
])
def test_error_has_cause_and_remedy(number, cause, remedy):
    found = explain(OSError(number, os.strerror(number)), "/dev/i2c-7", bus_exists=True)
    assert found[0].startswith(cause) and remedy in found[1]


def test_absent_bus_is_named_whatever_the_error():
    assert explain(OSError(errno.ENOENT, "x"), "/dev/i2c-7", bus_exists=False)[0] == "there is no such bus"


def test_mismatch_is_a_chip_that_was_reset():
    cause, remedy = explain(BoardMismatch("MODE1 is 0x11"), "/dev/i2c-7", bus_exists=True)
    assert "MODE1 is 0x11" in cause and "power" in remedy
