"""Opens, reads and writes the serial port, and explains its faults. Only this module imports pyserial.

Reading never blocks: a node waits on ``fileno()`` together with its other inputs.
"""
from __future__ import annotations

import errno
import glob
import os
import select
import termios
from contextlib import suppress

import serial

from car_interface.common.devices import (
    SETUP_COMMAND,
    STABLE_PORT,
    explain_denial,
    openers,
    port_note,
    process_name,
    read_header,
)
from car_interface.common.errors import DeviceError
from car_interface.teensy.link.console import is_consoles, removal_remedy
from car_interface.teensy.link.health import ABSENT, BUSY, FAILING, NO_PERMISSION, NO_PORT

READ_SIZE = 4096
WRITE_WITHIN_MS = 500  # 5.8 kB at 115200 baud: more than the driver's buffer of 4 kB


class PortError(DeviceError):
    """A port that can't be opened or was lost; ``state`` is one of the faults in ``health``."""

    def __init__(self, path: str, state: str, cause: str, remedy: str):
        self.state = state
        super().__init__(f"Teensy on {path}", cause, remedy)


class SerialLink:
    """One serial port, 8N1, locked against a second opener; ``baud`` is in bits per second."""

    def __init__(self, port: str, baud: int):
        self._path = port
        self._baud = baud
        self._serial = None  # pyserial's, while it's open

    @property
    def is_open(self) -> bool:
        return self._serial is not None

    def fileno(self) -> int:
        """Return the open port's file descriptor, for select or poll.

        Raises:
            PortError: it isn't open.
        """
        if self._serial is None:
            raise PortError(self._path, FAILING, "the port is not open", "It is opened again as soon as that works")
        return self._serial.fileno()

    def open(self) -> None:
        """Open the port, and discard what arrived before.

        Raises:
            PortError: with cause and remedy.
        """
        try:
            self._serial = serial.Serial(self._path, self._baud, timeout=0, exclusive=True)
            _distinguish_silence_from_hangup(self._serial.fileno())
        except (OSError, ValueError, termios.error) as error:
            self.close()
            raise PortError(self._path, *self._explain(error)) from error

    def read(self) -> bytes:
        """Return what has arrived, up to 4 KiB; may be empty.

        Raises:
            PortError: the port is gone, and was closed.
        """
        fd = self.fileno()
        try:
            data = os.read(fd, READ_SIZE)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise self._close_failed(error) from error
        if not data:
            raise self._close_failed("the line hung up")
        return data

    def write(self, data: bytes) -> None:
        """Send bytes; this may wait up to WRITE_WITHIN_MS.

        Raises:
            PortError: the port is gone or takes nothing, and was closed.
        """
        fd = self.fileno()
        poll = select.poll()
        poll.register(fd, select.POLLOUT)
        while data:
            # Not pyserial's write: against a port that is full it spins until its timeout.
            if not poll.poll(WRITE_WITHIN_MS):
                raise self._close_failed("write timeout: it takes nothing")
            try:
                data = data[os.write(fd, data):]
            except BlockingIOError:
                continue
            except OSError as error:
                raise self._close_failed(error) from error

    def close(self) -> None:
        if self._serial is not None:
            with suppress(OSError):  # it was pulled out; there is nothing left to close
                self._serial.close()
            self._serial = None

    def _close_failed(self, error):
        with suppress(OSError, termios.error):  # it was pulled out, and has no unsent bytes
            # Close would wait for unsent bytes, with some drivers for half a minute.
            termios.tcflush(self._serial.fileno(), termios.TCOFLUSH)
        self.close()
        return PortError(self._path, FAILING, f"the port was lost ({error})",
                         "Check its cable and power; it is opened again as soon as it is back")

    def _explain(self, error):
        """Return state, cause and remedy of a failed open, by the path and the error's number."""
        path, number = self._path, getattr(error, "errno", None)
        if os.path.isdir(path):
            return NO_PORT, "this is a directory, not a serial port", ("Set ~port to the port's own path: "
                                                                       "ls /dev/serial/by-id")
        if number == errno.ENOENT or not os.path.exists(path):
            return ABSENT, "there is no such port", _absence_remedy(path)
        if number in (errno.EACCES, errno.EPERM):
            if is_consoles(path):  # whose port is open to no group
                return NO_PERMISSION, "no permission to open it: a log-in console has it", removal_remedy(path)
            return (NO_PERMISSION, *explain_denial(path))
        if number in (errno.EAGAIN, errno.EWOULDBLOCK, errno.EBUSY) or "lock" in str(error):
            return (BUSY, *self._explain_busy())
        if number == errno.ENOTTY or "configure" in str(error):
            return NO_PORT, "this is not a serial port", "Set ~port to the Teensy's port: ls /dev/serial/by-id"
        return FAILING, f"it can't be opened ({error})", "Check ~port and ~baud"

    def _explain_busy(self):
        names = ", ".join(f"{name} (process {pid})" for pid, name in _holders(self._path))
        cause = "another program has it open" + (f": {names}" if names else "")
        if "ModemManager" in names:
            return cause, f"It tries every new port; this keeps it off: {SETUP_COMMAND}"
        return cause, f"See which one, and end it: fuser -v {self._path}"


def _distinguish_silence_from_hangup(fd):
    """Set VMIN to 1, so that an empty read means that the device left; with pyserial's 0 it may also be silence."""
    attributes = termios.tcgetattr(fd)
    attributes[6][termios.VMIN] = 1
    termios.tcsetattr(fd, termios.TCSANOW, attributes)


def _absence_remedy(path):
    plugged_in = sorted(glob.glob("/dev/serial/by-id/*Teensy*"))
    if plugged_in and path == STABLE_PORT:
        return f"A Teensy is plugged in; the udev rule that names it so comes by {SETUP_COMMAND}"
    if plugged_in:
        return f"A Teensy is plugged in: port:={plugged_in[0]}"
    if path == STABLE_PORT:
        return f"Plug the Teensy in. It has this name on USB alone, after {SETUP_COMMAND}"
    note = port_note(path, read_header())
    return note and f"{path}: {note}" or ("Plug the Teensy in and see what it is called: "
                                          "ls /dev/serial/by-id /dev/ttyA*")


def _holders(path):
    """Return who has a port open, as (process, name), by /proc: its lock's owner, or else all that hold it open."""
    try:
        owners = [pid for pid in _lock_owners(os.stat(path)) if pid != os.getpid()]
    except OSError:
        return []
    return [(pid, process_name(pid)) for pid in owners] or openers(path)


def _lock_owners(status):
    """Return owners of a file's locks by /proc/locks: ``1: FLOCK ADVISORY WRITE pid major:minor:inode start end``."""
    wanted = f"{os.major(status.st_dev):02x}:{os.minor(status.st_dev):02x}:{status.st_ino}"
    with open("/proc/locks", encoding="ascii") as file:
        locks = [line.split() for line in file]
    return sorted({int(lock[4]) for lock in locks if len(lock) > 5 and lock[5] == wanted and int(lock[4]) > 0})
