"""A gamepad's device, /dev/input/js*: opened without waiting, read without waiting, and checked to be one.

Bytes of another device would be taken for buttons, and a deadman is a button.
"""
from __future__ import annotations

import errno
import fcntl
import os
import stat

from car_interface.common.device_access import explain_denial
from car_interface.common.errors import DeviceError

READ_SIZE = 4096
# linux/joystick.h: JSIOCGVERSION = _IOR('j', 0x01, __u32), JSIOCGNAME(len) = _IOC(_IOC_READ, 'j', 0x13, len)
GET_VERSION, GET_NAME = 0x80046A01, 0x80006A13
NAME_SIZE = 128
PTY_MAJORS = range(136, 144)  # Linux, Documentation/admin-guide/devices.txt: Unix98 pseudo-terminals
MISSING_REMEDY = ("Plug in the gamepad or its receiver, then ls /dev/input/js*; another one: "
                  "joy_device:=/dev/input/js1. None at all: sudo modprobe joydev")


class JoystickDevice:
    """An open joystick. A named pipe or a pseudo-terminal may stand for one.

    Args:
        path: of the device.

    Attributes:
        name: what the gamepad calls itself.

    Raises:
        DeviceError: it can't be opened, or is no joystick.
    """

    def __init__(self, path: str):
        self._path = path
        try:
            self._fd = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)
        except OSError as error:
            raise self._error(error) from error
        try:
            self.name = self._identify()
        except OSError as error:
            os.close(self._fd)
            raise DeviceError(path, "it is no joystick", "A gamepad is /dev/input/js0 or the like, not .../event*: "
                              "ls /dev/input/js*") from error

    def fileno(self) -> int:
        """For the inbox to watch."""
        return self._fd

    def read(self) -> bytes:
        """What has arrived; empty: nothing.

        Raises:
            DeviceError: the gamepad is gone.
        """
        try:
            data = os.read(self._fd, READ_SIZE)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise self._error(error) from error
        if not data:
            raise DeviceError(self._path, "the gamepad is gone", MISSING_REMEDY)
        return data

    def close(self) -> None:
        """Give it back."""
        os.close(self._fd)

    def _identify(self):
        status = os.fstat(self._fd)
        if stat.S_ISFIFO(status.st_mode) or (stat.S_ISCHR(status.st_mode) and os.major(status.st_rdev) in PTY_MAJORS):
            return "no gamepad, but a program that writes its events"
        fcntl.ioctl(self._fd, GET_VERSION, bytes(4))
        name = fcntl.ioctl(self._fd, GET_NAME | NAME_SIZE << 16, bytes(NAME_SIZE))
        return name.split(b"\0")[0].decode(errors="replace") or "without a name"

    def _error(self, error):
        if error.errno in (errno.EACCES, errno.EPERM):
            return DeviceError(self._path, *explain_denial(self._path))
        if error.errno in (errno.ENOENT, errno.ENXIO, errno.ENODEV):
            missing = "there is no such device" if error.errno == errno.ENOENT else "the gamepad is gone"
            return DeviceError(self._path, missing, MISSING_REMEDY)
        return DeviceError(self._path, error.strerror, MISSING_REMEDY)
