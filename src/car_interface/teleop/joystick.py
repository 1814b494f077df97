"""Converts a gamepad's input events to its axes and buttons, as the kernel's joystick interface numbers them.

That interface (joydev) isn't built on every computer. Users' configurations have its numbers: axes by ascending code;
buttons likewise, but those from BTN_JOYSTICK on first. Sources: Linux, drivers/input/joydev.c, joydev_connect and
joydev_correct, for numbers and scale; Documentation/input/event-codes.rst for SYN_DROPPED; the ROS package joy for
sign, dead zone and pacing of the messages.
"""
from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Iterable, Mapping, NamedTuple

from car_interface.common import declared
from car_interface.common.errors import require
from car_interface.teleop.input_devices import ANY

EV_SYN, EV_KEY, EV_ABS = 0, 1, 3  # linux/input-event-codes.h
SYN_REPORT, SYN_DROPPED = 0, 3
BTN_MISC, BTN_JOYSTICK = 0x100, 0x120
RELEASED, PRESSED = 0, 1  # values of EV_KEY; 2 is a repeat


@dataclass(frozen=True)
class JoystickConfig:
    """The gamepad, and how its state is published."""

    dev: str = declared.text("dev", ANY, "path of the gamepad's device; `auto` = the only gamepad that there is")
    deadzone: float = declared.number("deadzone", 0.05, "so far from its middle an axis is 0", low=0, high=0.9)
    autorepeat_hz: float = declared.number(
        "autorepeat_rate", 20.0, "messages without a change, which teleop_logi needs; 0 = none", "Hz", low=0, high=1000)
    coalesce_s: float = declared.number(
        "coalesce_interval", 0.001, "an axis waits so long for others", "s", low=0, high=1)

    def __post_init__(self):
        require(self.dev == ANY or self.dev.startswith("/"), "dev", self.dev,
                f"{ANY}, or a path such as /dev/input/event5")


class Change(NamedTuple):
    """The gamepad's state after a report."""

    axes: tuple[float, ...]
    buttons: tuple[int, ...]
    is_urgent: bool  # a button has changed: it must be published at once; an axis waits for others


class Joystick:
    """The state of a gamepad.

    A button counts from its next press on: one that is held at the start, or was while events were lost, first has to
    be released.

    Args:
        keys: the codes of its keys.
        ranges: evdev.AbsInfo of each axis, by code, in the device's units; within ``flat`` of its middle an axis is 0.
        deadzone: within this distance of its middle an axis is 0, 0 to less than 1; beyond it the axis rises from 0.
    """

    def __init__(self, keys: Iterable[int], ranges: Mapping[int, Any], deadzone: float = 0.05):
        buttons = sorted((code for code in keys if code >= BTN_MISC), key=lambda code: (code < BTN_JOYSTICK, code))
        self._buttons = {code: number for number, code in enumerate(buttons)}
        self._axes = {code: number for number, code in enumerate(sorted(ranges))}
        self._ranges = ranges
        self._deadzone = deadzone
        self.axes = [0.0] * len(ranges)  # −1..1; left and forward are positive, as in messages of the package joy
        self.buttons = [0] * len(buttons)
        self.losses = 0  # how often the kernel dropped events, as this was read too late
        # ``is_lost``: events were dropped, and the positions of the axes must be read: ``read_axes``.
        self.is_lost = self._is_dropping = self._has_button = self._has_axis = False

    def read_axes(self, positions: Mapping[int, int]) -> Change:
        """Take the positions of all axes, by code, as they are now."""
        self.is_lost = False
        for code, position in positions.items():
            self.axes[self._axes[code]] = self._scaled(code, position)
        return self._change(is_urgent=False)

    def receive(self, events: Iterable[Any]) -> list[Change]:
        """Return the changes by all evdev.InputEvent that were read at once, a report each."""
        changes = []
        for event in events:
            if event.type == EV_SYN and event.code == SYN_DROPPED:
                changes.append(self._drop())
            elif event.type == EV_SYN and event.code == SYN_REPORT:
                changes += self._report()
            elif not self._is_dropping and not self.is_lost:
                self._take(event)
        return changes

    def _drop(self):
        """Release everything: what was dropped may have been a release. The rest of this report is incomplete."""
        self._is_dropping, self._has_button, self._has_axis = True, False, False
        self.losses += 1
        self.buttons = [0] * len(self.buttons)
        return self._change(is_urgent=True)

    def _report(self):
        if self._is_dropping:
            self._is_dropping, self.is_lost = False, True
        changes = [self._change(self._has_button)] if self._has_button or self._has_axis else []
        self._has_button = self._has_axis = False
        return changes

    def _take(self, event):
        if event.type == EV_KEY and event.code in self._buttons and event.value in (RELEASED, PRESSED):
            self.buttons[self._buttons[event.code]] = event.value
            self._has_button = True
        elif event.type == EV_ABS and event.code in self._axes:
            self.axes[self._axes[event.code]] = self._scaled(event.code, event.value)
            self._has_axis = True

    def _change(self, is_urgent):
        return Change(tuple(self.axes), tuple(self.buttons), is_urgent)

    def _scaled(self, code, position):
        """Return an axis's value; the kernel's are negative to the left and forward."""
        axis = self._ranges[code]
        middle, half = int((axis.min + axis.max) / 2), (axis.max - axis.min) // 2 - 2 * axis.flat
        if half <= 0:
            return 0.0
        ratio = min(max(0, abs(position - middle) - axis.flat) / half, 1.0)
        beyond = max(0.0, ratio - self._deadzone) / (1.0 - self._deadzone)
        return math.copysign(beyond, middle - position) if beyond else 0.0
