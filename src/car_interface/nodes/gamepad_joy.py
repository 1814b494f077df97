"""The gamepad_joy node: a gamepad's events as joy messages, where the ROS package joy is not installed.

It behaves as that package's joy_node, and stops publishing when the device is gone: teleop_logi then releases the
deadman. A wireless gamepad that is out of range isn't: its receiver is still there, and what it sent last is repeated.

Publishes:
    joy (sensor_msgs/Joy): at once when a button changes, for axes after ~coalesce_interval, and ~autorepeat_rate times
        a second without a change.
"""
from __future__ import annotations

import errno
import fcntl
import os
import stat

import rospy
from sensor_msgs.msg import Joy

from car_interface.common.declared import read_all
from car_interface.common.device_access import explain_denial
from car_interface.common.errors import DeviceError
from car_interface.common.units import NS_PER_S
from car_interface.ros.diagnostics import ERROR, OK, Diagnostics
from car_interface.ros.logs import ThrottledWarnings
from car_interface.ros.runtime import run
from car_interface.ros.topics import advertise
from car_interface.teleop.joystick import Joystick, JoystickConfig, Pacing

RETRY_NS = NS_PER_S // 2
READ_SIZE = 4096
# linux/joystick.h: JSIOCGVERSION = _IOR('j', 0x01, __u32), JSIOCGNAME(len) = _IOC(_IOC_READ, 'j', 0x13, len)
GET_VERSION, GET_NAME = 0x80046A01, 0x80006A13
NAME_SIZE = 128
PTY_MAJORS = range(136, 144)  # Linux, Documentation/admin-guide/devices.txt: Unix98 pseudo-terminals
MISSING_REMEDY = ("Plug in the gamepad or its receiver, then ls /dev/input/js*; another one: "
                  "joy_device:=/dev/input/js1. None at all: sudo modprobe joydev")


class JoystickDevice:
    """A gamepad's device, /dev/input/js*: opened and read without waiting, and checked to be one.

    Bytes of another device would be taken for buttons, and a deadman is a button. A named pipe or a pseudo-terminal may
    stand for one.

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


class GamepadJoy:
    """Reads the gamepad and publishes its state."""

    def __init__(self, params, inbox):
        self._config = read_all(params, JoystickConfig)
        self._inbox = inbox
        self._device: JoystickDevice | None = None
        self._joystick = Joystick(self._config.deadzone)
        self._pacing = Pacing(self._config.coalesce_s, self._config.autorepeat_hz)
        self._warnings = ThrottledWarnings(inbox.clocks)
        self._fault = "it was not opened yet"
        self._clocks = inbox.clocks
        now_ns = self._clocks.now_ns()
        self._retry_ns = now_ns
        self._diagnostics = Diagnostics(inbox, self._config.dev, {"gamepad device": self._report}, now_ns)
        self._publisher = advertise("joy", Joy, inbox)

    def step(self, now_ns):
        """Read what has arrived; publish what is due."""
        if self._device is None and now_ns >= self._retry_ns:
            self._open(now_ns)
        if self._device is not None:
            self._read(now_ns)
        if now_ns >= self._pacing.due_ns:
            self._publish(self._joystick.axes, self._joystick.buttons, now_ns)
        self._diagnostics.step(now_ns)
        self._inbox.dispatch()
        return min(self._pacing.due_ns, self._diagnostics.due_ns,
                   self._retry_ns if self._device is None else self._diagnostics.due_ns)

    def shut_down(self):
        """Give the device back."""
        self._close()

    def _open(self, now_ns):
        self._retry_ns = now_ns + RETRY_NS
        try:
            self._device = JoystickDevice(self._config.dev)
        except DeviceError as error:
            self._fail(error)
            return
        self._fault = ""
        self._joystick = Joystick(self._config.deadzone)
        self._inbox.watch(self._device.fileno())
        rospy.loginfo("gamepad on %s: %s", self._config.dev, self._device.name)

    def _read(self, now_ns):
        try:
            data = self._device.read()
        except DeviceError as error:
            self._close()
            self._fail(error)
            return
        for change in self._joystick.receive(data):
            if change.is_urgent:
                self._publish(change.axes, change.buttons, now_ns)
            else:
                self._pacing.changed(now_ns)

    def _close(self):
        self._pacing.stop()
        if self._device is not None:
            self._inbox.unwatch(self._device.fileno())
            self._device.close()
            self._device = None

    def _fail(self, error):
        self._fault = str(error)
        self._warnings.warn(error.cause, f"{error} (no joy message until then)")

    def _publish(self, axes, buttons, now_ns):
        message = Joy(axes=list(axes), buttons=list(buttons))
        message.header.stamp, message.header.frame_id = self._clocks.ros_now(), self._config.dev
        self._publisher.publish(message)
        self._pacing.published(now_ns)

    def _report(self, status):
        """Whether the gamepad is there, for /diagnostics."""
        if self._device is None:
            status.summary(ERROR, self._fault)
        else:
            status.summary(OK, f"{self._device.name}: {len(self._joystick.axes)} axes, "
                               f"{len(self._joystick.buttons)} buttons")
        status.add("events ignored", self._joystick.ignored)
        return status


def main():
    """Run the node."""
    run("gamepad_joy", GamepadJoy)
