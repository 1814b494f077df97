"""The gamepad_joy node: a gamepad's events as joy messages, with the numbers that joy_node gives to axes and buttons.

It reads the event device, which every Linux has, and leaves it to other programs, too. Nothing is published while there
is no gamepad, so that teleop_logi releases the deadman; a wireless gamepad that is out of range isn't gone: its
receiver is still there, and what it sent last is repeated. After the first gamepad no other one is read.

Publishes:
    joy (sensor_msgs/Joy): at once when a button changes, for axes after ~coalesce_interval, and ~autorepeat_rate times
        a second without a change. Its frame_id names the gamepad, for teleop_logi.
"""
from __future__ import annotations

import math

import rospy
from sensor_msgs.msg import Joy

from car_interface.common.declared import read_all
from car_interface.common.errors import DeviceError
from car_interface.common.units import NS_PER_S
from car_interface.ros.diagnostics import ERROR, OK, Diagnostics
from car_interface.ros.logs import ThrottledWarnings
from car_interface.ros.runtime import run
from car_interface.ros.topics import advertise
from car_interface.teleop.gamepad import DRIVER_REPORT
from car_interface.teleop.gamepad_device import GamepadDevice
from car_interface.teleop.input_devices import Pad, choose_pad, find_pads
from car_interface.teleop.joystick import Joystick, JoystickConfig
from car_interface.teleop.mappings import frame_of, model_of

RETRY_NS = NS_PER_S // 2
OPTION = "joy_device:="  # of the launch files


class GamepadJoy:
    """Read the gamepad and publish its state.

    Args:
        find, open_device: as ``find_pads`` and ``GamepadDevice``.
    """

    def __init__(self, params, inbox, find=find_pads, open_device=GamepadDevice):
        self._config = read_all(params, JoystickConfig)
        self._inbox, self._clocks = inbox, inbox.clocks
        self._find, self._open_device = find, open_device
        self._pad: Pad | None = None  # the one that was read first
        self._device: GamepadDevice | None = None
        self._joystick = Joystick([], {})
        self._coalesce_ns = round(self._config.coalesce_s * NS_PER_S)
        self._repeat_ns = NS_PER_S / self._config.autorepeat_hz if self._config.autorepeat_hz else math.inf
        self._due_ns = math.inf  # of the next message; inf = there is nothing to publish
        self._warnings = ThrottledWarnings(inbox.clocks)
        self._fault: DeviceError | None = None  # while there is no device; the first step tries to open one
        now_ns = self._clocks.now_ns()
        self._retry_ns = now_ns
        self._diagnostics = Diagnostics(inbox, self._config.dev, {DRIVER_REPORT: self._report}, now_ns)
        self._publisher = advertise("joy", Joy, inbox)

    def step(self, now_ns):
        """Read what has arrived; publish what is due."""
        try:
            if self._device is None and now_ns >= self._retry_ns:
                self._retry_ns = now_ns + RETRY_NS
                self._open(now_ns)
            if self._device is not None:
                self._read(now_ns)
        except DeviceError as error:
            self._close()
            self._fault = error
            self._warnings.warn(error.cause, f"{error} (no joy message until then)")
        if now_ns >= self._due_ns:
            self._publish(self._joystick.axes, self._joystick.buttons, now_ns)
        self._diagnostics.step(now_ns)
        self._inbox.dispatch()
        return min(self._due_ns, self._diagnostics.due_ns,
                   self._retry_ns if self._device is None else self._diagnostics.due_ns)

    def shut_down(self):
        self._close()

    def _open(self, now_ns):
        pad = choose_pad(self._find(), self._config.dev, OPTION, self._pad)
        self._device = self._open_device(pad)
        self._inbox.watch("gamepad", self._device.fileno())
        self._joystick = Joystick(self._device.keys, self._device.ranges, self._config.deadzone)
        self._read_axes(now_ns)
        self._pad, self._fault = pad, None
        rospy.loginfo("gamepad on %s: %s", pad.path, self._model())

    def _read(self, now_ns):
        for change in self._joystick.receive(self._device.read()):
            if change.is_urgent:
                self._publish(change.axes, change.buttons, now_ns)
            else:
                self._publish_soon(now_ns)
        if self._joystick.is_lost:
            self._read_axes(now_ns)

    def _read_axes(self, now_ns):
        self._joystick.read_axes(self._device.positions())
        self._publish_soon(now_ns)

    def _publish_soon(self, now_ns):
        self._due_ns = min(self._due_ns, now_ns + self._coalesce_ns)

    def _close(self):
        self._due_ns = math.inf
        if self._device is not None:
            self._inbox.watch("gamepad", None)
            self._device.close()
            self._device = None

    def _publish(self, axes, buttons, now_ns):
        message = Joy(axes=list(axes), buttons=list(buttons))
        message.header.stamp, message.header.frame_id = self._clocks.ros_now(), frame_of(self._pad.name)
        self._publisher.publish(message)
        self._due_ns = now_ns + self._repeat_ns

    def _model(self):
        return model_of(frame_of(self._pad.name), len(self._joystick.axes), len(self._joystick.buttons))

    def _report(self, status):
        """Report whether the gamepad is there."""
        if self._device is not None:
            status.summary(OK, self._model())
        else:
            status.summary(ERROR, f"{self._fault.what}: {self._fault.cause}")
            status.add("remedy", self._fault.remedy)
        status.add("times that events were lost", self._joystick.losses)


def main():
    run("gamepad_joy", GamepadJoy)
