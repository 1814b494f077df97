"""Reads the Linux joystick interface (/dev/input/js*): bytes in, the state of a gamepad's axes and buttons out.

Sources: Linux, Documentation/input/joydev/joystick-api.rst and include/uapi/linux/joystick.h, for the events; the ROS
package joy, for scale, sign, dead zone and pacing of the messages.
"""
from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from typing import NamedTuple

from car_interface.common import declared
from car_interface.common.units import NS_PER_S

# struct js_event: __u32 time in ms; __s16 value; __u8 type; __u8 number, in the computer's own byte order.
EVENT = struct.Struct("=IhBB")
BUTTON, AXIS, INIT = 0x01, 0x02, 0x80  # INIT is added to the others' bits: the state when the device was opened
MAX_VALUE = 32767  # of an axis, to either side
MAX_INPUTS = 64  # axes or buttons: no gamepad has more, and a corrupt number must not make a message long


@dataclass(frozen=True)
class JoystickConfig:
    """The gamepad, and how its state is published."""

    dev: str = declared.path("dev", "/dev/input/js0", "the device")
    deadzone: float = declared.number("deadzone", 0.05, "so far from its middle an axis is 0", low=0, high=0.9)
    autorepeat_hz: float = declared.number(
        "autorepeat_rate", 20.0, "messages without a change, which teleop_logi needs; 0 = none, joy_node's own default",
        "Hz", low=0, high=1000)
    coalesce_s: float = declared.number(
        "coalesce_interval", 0.001, "an axis waits so long for others", "s", low=0, high=1)


class Change(NamedTuple):
    """The gamepad's state after a change, and whether it must be published at once."""

    axes: tuple[float, ...]
    buttons: tuple[int, ...]
    is_urgent: bool  # a button; an axis or the initial state waits for what comes with it


class Joystick:
    """The state of a gamepad.

    Args:
        deadzone: within this distance of its middle an axis is 0, 0 to less than 1; beyond it the axis rises from 0.

    Attributes:
        axes: −1..1; left and forward are positive, as in sensor_msgs/Joy of the package joy.
        buttons: 0 or 1.
        ignored: events of no known kind, or of an input with a number that no gamepad has.
    """

    def __init__(self, deadzone: float = 0.05):
        self.axes: list[float] = []
        self.buttons: list[int] = []
        self.ignored = 0
        self._deadzone = deadzone
        self._rest = b""  # the beginning of an event

    def receive(self, data: bytes) -> list[Change]:
        """Return the changes by bytes that were read, in order; an event may be split over two reads."""
        data = self._rest + data
        whole = len(data) - len(data) % EVENT.size
        self._rest = data[whole:]
        changes = []
        for _, value, bits, number in EVENT.iter_unpack(data[:whole]):
            is_initial, kind = bool(bits & INIT), bits & ~INIT
            if kind not in (BUTTON, AXIS) or number >= MAX_INPUTS:
                self.ignored += 1
                continue
            if kind == BUTTON:
                _put(self.buttons, number, int(value != 0), 0)
            else:
                _put(self.axes, number, self._scaled(value), 0.0)
            changes.append(Change(tuple(self.axes), tuple(self.buttons), kind == BUTTON and not is_initial))
        return changes

    def _scaled(self, value):
        """Return an axis's value; the kernel's are negative to the left and forward."""
        ratio = min(abs(value) / MAX_VALUE, 1.0)
        beyond = max(0.0, ratio - self._deadzone) / (1.0 - self._deadzone)
        return math.copysign(beyond, -value) if beyond else 0.0


class Pacing:
    """Decides when the state is published: a button at once, axes together after a moment, the same state repeatedly.

    Args:
        coalesce_s: an axis waits this long for others.
        autorepeat_hz: the state is published this often without a change; 0 = never.
    """

    def __init__(self, coalesce_s: float, autorepeat_hz: float):
        self._coalesce_ns = round(coalesce_s * NS_PER_S)
        self._repeat_ns = NS_PER_S / autorepeat_hz if autorepeat_hz else math.inf
        self.due_ns = math.inf  # of the next message; inf = there is nothing to publish

    def changed(self, now_ns: int) -> None:
        """Take note of a change that isn't urgent."""
        self.due_ns = min(self.due_ns, now_ns + self._coalesce_ns)

    def published(self, now_ns: int) -> None:
        """Take note that the state was published."""
        self.due_ns = now_ns + self._repeat_ns

    def stop(self) -> None:
        """Stop repeating the last state: the device is gone."""
        self.due_ns = math.inf


def _put(values, index, value, empty):
    """Set a value in a list that grows as far as needed."""
    values.extend([empty] * (index + 1 - len(values)))
    values[index] = value
