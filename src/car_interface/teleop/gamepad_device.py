"""Opens a gamepad by evdev, and reads it without waiting and without grabbing it."""
from __future__ import annotations

import errno
import select
from typing import Callable

from evdev import InputDevice, InputEvent, ecodes

from car_interface.common.devices import explain_denial
from car_interface.common.errors import DeviceError
from car_interface.teleop.input_devices import MISSING_REMEDY, Pad

CONTAINER_REMEDY = "The kernel lists it: a container must be given /dev/input"


class GamepadDevice:
    """An open gamepad, with the codes of its keys, and evdev.AbsInfo of each axis, by code.

    Raises:
        DeviceError: it can't be opened.
    """

    def __init__(self, pad: Pad, open_device: Callable = InputDevice):
        self.pad = pad
        try:
            self._device = open_device(pad.path)
        except OSError as error:
            raise self._error(error) from error
        capabilities = self._device.capabilities()
        self.keys = capabilities.get(ecodes.EV_KEY, [])
        self.ranges = dict(capabilities.get(ecodes.EV_ABS, []))

    def fileno(self) -> int:
        """Return the file descriptor, for the inbox to watch."""
        return self._device.fd

    def read(self) -> list[InputEvent]:
        """Return the events that have arrived.

        Raises:
            DeviceError: the gamepad is gone.
        """
        # Before version 1.4, which Ubuntu 20.04 lacks, evdev loses memory with each read that finds nothing.
        if not select.select([self._device.fd], [], [], 0)[0]:
            return []
        try:
            events = list(self._device.read())
        except BlockingIOError:
            return []
        except OSError as error:
            raise self._error(error) from error
        if not events:
            raise DeviceError(str(self.pad), "the gamepad is gone", MISSING_REMEDY)
        return events

    def positions(self) -> dict[int, int]:
        """Return where each axis is now, by code.

        Raises:
            DeviceError: the gamepad is gone.
        """
        try:
            return {code: self._device.absinfo(code).value for code in self.ranges}
        except OSError as error:
            raise self._error(error) from error

    def close(self) -> None:
        """Give it back."""
        self._device.close()

    def _error(self, error):
        if error.errno in (errno.EACCES, errno.EPERM):
            return DeviceError(str(self.pad), *explain_denial(self.pad.path))
        if error.errno == errno.ENOENT:
            return DeviceError(str(self.pad), "there is no such device here", CONTAINER_REMEDY)
        if error.errno in (errno.ENXIO, errno.ENODEV):
            return DeviceError(str(self.pad), "the gamepad is gone", MISSING_REMEDY)
        return DeviceError(str(self.pad), error.strerror, MISSING_REMEDY)
