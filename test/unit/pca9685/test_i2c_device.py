"""A chip by the kernel's SMBus calls: what they are given, by linux/i2c.h and linux/i2c-dev.h, and who has the bus."""

import ctypes
import errno
import fcntl
import os
import struct
import subprocess
import sys

import pytest

from car_interface.pca9685.i2c_device import I2cDevice

ADDRESS = 0x41
REQUEST = struct.Struct("BBIP")  # struct i2c_smbus_ioctl_data, with the padding of C
HOLD = """
import os, sys
from car_interface.common.file_lock import MAX_GENERATION, lock_byte, lock_holder
fd = os.open(sys.argv[1], os.O_RDWR)
lock_byte(fd, 0x41)
lock_byte(fd, 0x41 * MAX_GENERATION + 5000)
print("locked", flush=True)
sys.stdin.readline()
print(lock_holder(fd, 0x41 * MAX_GENERATION + 6000))
"""


class Kernel:
    """Takes the calls of a bus: it keeps the registers that are written, and reads them."""

    def __init__(self):
        self.calls = []
        self.registers = bytearray(range(256))

    def ioctl(self, fd, request, argument):
        assert os.fstat(fd)
        if request == 0x0703:
            self.calls.append(("address", argument))
            return
        assert request == 0x0720
        direction, register, size, pointer = REQUEST.unpack(argument)
        length = ctypes.string_at(pointer, 1)[0]
        self.calls.append((("write", "read")[direction], register, size, length))
        if direction:
            ctypes.memmove(pointer + 1, bytes(self.registers[register: register + length]), length)
        else:
            self.registers[register: register + length] = ctypes.string_at(pointer + 1, length)


@pytest.fixture
def path(tmp_path):
    (tmp_path / "i2c-1").touch()
    return str(tmp_path / "i2c-1")


@pytest.fixture
def kernel(monkeypatch):
    made = Kernel()
    monkeypatch.setattr(fcntl, "ioctl", made.ioctl)
    return made


@pytest.fixture
def device(path, kernel):
    made = I2cDevice(path, ADDRESS)
    made.open()
    yield made
    made.close()


def open_files():
    return len(os.listdir("/proc/self/fd"))


def test_bus_is_opened_once_for_its_chip_until_it_is_closed(path, kernel):
    before, device = open_files(), I2cDevice(path, ADDRESS)
    device.close()
    for _ in range(2):
        device.open()
        device.open()
        assert open_files() == before + 1
        device.close()
        device.close()
        assert open_files() == before
    assert kernel.calls == [("address", ADDRESS)] * 2


def test_bus_gets_descriptor_0_too(path, kernel):
    saved = os.dup(0)
    os.close(0)
    try:
        device = I2cDevice(path, ADDRESS)
        device.open()
        device.open()
        assert kernel.calls == [("address", ADDRESS)] and os.path.samestat(os.fstat(0), os.stat(path))
        device.close()
        with pytest.raises(OSError, match="Bad file descriptor"):
            os.fstat(0)
    finally:
        os.dup2(saved, 0)
        os.close(saved)


def test_file_that_is_no_bus_is_an_error_and_left_closed(path):
    before = open_files()
    with pytest.raises(OSError, match="Inappropriate ioctl") as caught:
        I2cDevice(path, ADDRESS).open()
    assert caught.value.errno == errno.ENOTTY and open_files() == before


@pytest.mark.parametrize("length", [1, 32])
def test_registers_are_read_and_written_in_one_transfer_of_so_many_bytes(device, kernel, length):
    assert device.read(0x06, length) == bytes(range(6, 6 + length))
    device.write(0x06, bytes(range(200, 200 + length)))
    assert device.read(0x06, length) == bytes(range(200, 200 + length))
    assert kernel.registers[5] == 5 and kernel.registers[6 + length] == 6 + length
    assert kernel.calls[1:] == [("read", 6, 8, length), ("write", 6, 8, length), ("read", 6, 8, length)]


def test_locks_are_those_of_the_chip_s_address_and_a_bus_may_always_come_back(path, device):
    assert (device.lock_holder(), device.successor(4999)) == (0, 0)
    with subprocess.Popen([sys.executable, "-c", HOLD, path], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                          text=True) as other:
        assert other.stdout.readline() == "locked\n"
        assert (device.lock_holder(), device.successor(4999), device.successor(5000)) == (other.pid, other.pid, 0)
        device.claim(6000)
        assert other.communicate("\n", 60)[0] == f"{os.getpid()}\n"
    assert not device.is_gone(OSError(errno.ENODEV, "No such device"))
