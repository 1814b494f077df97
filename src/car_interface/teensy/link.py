"""The serial port: open, read, write, and what's wrong with it in words. The only place that knows pyserial.

Reading never blocks: a node waits on ``fileno()`` together with whatever else it waits for.
"""
from __future__ import annotations

import errno
import os
import termios

import serial

from car_interface.errors import DeviceError

READ_SIZE = 4096


class SerialLink:
    """One serial port, 8N1, locked against a second opener.

    Args:
        port: the device's path.
        baud: bits per second; at 8N1 a byte takes ten of them.
    """

    def __init__(self, port: str, baud: int):
        self._path = port
        self._baud = baud
        self._serial = None

    @property
    def is_open(self) -> bool:
        """Whether it is open, as far as is known."""
        return self._serial is not None

    def fileno(self) -> int:
        """The open port's file descriptor, for select or poll."""
        return self._serial.fileno()

    def open(self) -> None:
        """Open the port, without what arrived before.

        Raises:
            DeviceError: with the cause and what to do about it.
        """
        try:
            self._serial = serial.Serial(self._path, self._baud, timeout=0, write_timeout=0.5, exclusive=True)
            _tell_silence_from_hangup(self._serial.fileno())
        except (OSError, ValueError, termios.error) as error:
            self.close()
            raise DeviceError(f"Teensy on {self._path}", *_explain(self._path, error)) from error

    def read(self) -> bytes:
        """What has arrived, up to 4 KiB; empty when nothing has.

        Raises:
            DeviceError: when the port is gone; it is closed then.
        """
        try:
            data = os.read(self._serial.fileno(), READ_SIZE)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise self._lost(error) from error
        if not data:
            raise self._lost("the line hung up")
        return data

    def write(self, data: bytes) -> None:
        """Send bytes.

        Raises:
            DeviceError: when the port is gone or takes nothing; it is closed then.
        """
        try:
            self._serial.write(data)
        except OSError as error:  # pyserial's own errors are OSErrors too
            raise self._lost(error) from error

    def close(self) -> None:
        """Close the port, if it is open."""
        if self._serial is not None:
            try:
                self._serial.close()
            except OSError:
                pass  # it was pulled out; there is nothing left to close
            self._serial = None

    def _lost(self, error):
        self.close()
        return DeviceError(f"Teensy on {self._path}", f"the port was lost ({error})",
                           "Check its cable and power; it is opened again as soon as it is back")


def _tell_silence_from_hangup(fd):
    """With VMIN 0, as pyserial leaves it, a read of nothing means either; with VMIN 1 it means that the device left."""
    attributes = termios.tcgetattr(fd)
    attributes[6][termios.VMIN] = 1
    termios.tcsetattr(fd, termios.TCSANOW, attributes)


def _explain(path, error):
    """Cause and cure of a failed open, from the path itself and from the error's number."""
    number = getattr(error, "errno", None)
    if os.path.isdir(path):
        return "this is a directory, not a serial port", "Set ~port to the port's own path: ls /dev/serial/by-id"
    if number == errno.ENOENT or not os.path.exists(path):
        return "there is no such port", "Plug the Teensy in and see what it is called: ls /dev/serial/by-id /dev/ttyA*"
    if number in (errno.EACCES, errno.EPERM):
        return "no permission to open it", "Join the port's group and log in anew: sudo usermod -aG dialout $USER"
    if number in (errno.EAGAIN, errno.EWOULDBLOCK, errno.EBUSY) or "lock" in str(error):
        return "another program has it open", f"See which one, and end it: fuser -v {path}"
    if number == errno.ENOTTY or "configure" in str(error):
        return "this is not a serial port", "Set ~port to the Teensy's port: ls /dev/serial/by-id"
    return f"it can't be opened ({error})", "Check ~port and ~baud"
