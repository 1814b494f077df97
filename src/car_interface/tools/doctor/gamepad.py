"""Examines the gamepad: whether its messages come, often enough and with the axes and buttons that are configured."""
from __future__ import annotations

import glob
import math
import os
from typing import NamedTuple, Sequence

from car_interface.common import causes
from car_interface.teleop.gamepad import GamepadConfig, is_d_mode_cross, missing_index, remedy
from car_interface.teleop.handover import PHONE_PREFIX
from car_interface.tools.doctor.car import Report
from car_interface.tools.doctor.findings import BAD, OK, WARN, Finding, first

SUBJECT = "gamepad"
MISSED = 2  # messages in a row that may be lost before the deadman is released, at least
AUTOREPEAT = "Set its driver's autorepeat_rate to 20, as launching with gamepad:=true does: {joy} must come at 20 Hz"
# Class, subclass and protocol of an Xbox gamepad's first interface, and of a Logitech's in X mode: Linux,
# drivers/input/joystick/xpad.c. An Xbox One's gamepad has others that look alike and need no driver.
XBOX_INTERFACES = (("ff", "5d", "01"), ("ff", "5d", "81"), ("ff", "47", "d0"))
NO_XPAD_REMEDY = ("sudo modprobe xpad. If there is no such module, as on a Jetson: set the switch of a Logitech at D, "
                  "connect an Xbox gamepad by Bluetooth, or build xpad")
D_MODE = ", as a Logitech gamepad has in D mode: axes 4 and 5 are its cross then, not a stick"
LAUNCH_IT = ("Launch the car with gamepad:=true, which starts its driver, or with phone:=true. With the virtual car: "
             "rosrun car_interface keyboard_drive")
LET_GO = "Let go of both deadman buttons once, then hold one"


class GamepadFacts(NamedTuple):
    """What is known of the gamepad, and of the messages that came on its topic while the doctor listened."""

    node: str  # teleop_logi's path
    topic: str  # that it subscribes to
    publishers: Sequence[str]  # the nodes that publish on it
    # What teleop_logi takes its axes and buttons for; ``None`` = its parameters are bad, as another finding says, or
    # the gamepad is in no gamepads.yaml.
    config: GamepadConfig | None
    messages: int
    period_s: float  # the mean time between them; after a single one, the time since then; inf: none came
    axes: int  # of the newest one
    buttons: int
    odd: dict  # the newest values that aren't finite, by index of the axis
    cause: str  # teleop_logi's own, as is the reason; empty = it published nothing
    reason: str
    stick_cause: str  # NOT_AT_REST where teleop_logi ignores an axis
    driver: Report | None  # what gamepad_joy reports, where it has no gamepad


def check_gamepad(gamepad: GamepadFacts) -> list[Finding]:
    """Return one finding: the first thing that keeps a deadman from being held, or that all is well."""
    topic, cause, reason, driver = gamepad.topic, gamepad.cause, gamepad.reason, gamepad.driver
    is_silent, is_lost = not gamepad.messages, cause in causes.LOSSES
    by_phone = is_silent and reason.startswith(PHONE_PREFIX)
    return first(
        SUBJECT,
        (by_phone and is_lost, WARN, f"there is none; {reason}",
         "Lift the thumbs from the phone's page, then touch it again"),
        (by_phone, OK, f"there is none; {reason}"),
        (is_silent and not gamepad.publishers, WARN,
         f"no node publishes {topic}, so that no deadman can be held" + (f" ({reason})" if reason else ""), LAUNCH_IT),
        (is_silent and driver, WARN, driver and driver.message, driver and driver.remedy),
        (is_silent, WARN, f"{', '.join(gamepad.publishers)} publishes {topic}, but nothing came",
         f"{remedy(causes.JOY_NEVER_RECEIVED, topic)}. {AUTOREPEAT.format(joy=topic)}, also while nothing moves"),
        (cause == causes.JOY_NEVER_RECEIVED, BAD, f"{topic} comes here, but {gamepad.node} says: {reason}",
         f"See whether they reach each other: rosnode info {gamepad.node}; ROS_IP; then start it again"),
        (cause == causes.JOY_UNMAPPED, BAD, reason, remedy(cause, topic)),
        *(_faults(gamepad) if gamepad.config else ()),
        (is_lost, WARN, reason, remedy(cause, topic) or LET_GO),
        (gamepad.stick_cause, WARN, reason, remedy(gamepad.stick_cause, topic)),
        (True, OK, f"{topic}: {gamepad.axes} axes, {gamepad.buttons} buttons, {_rate_text(gamepad)}"
         + (f"; {reason}" if reason else "")))


def _faults(gamepad):
    """Return the cases of what can be wrong with the messages."""
    config, topic, shape = gamepad.config, gamepad.topic, (gamepad.axes, gamepad.buttons)
    missing, timeout_s = missing_index(config, *shape), config.joy_timeout_s or math.inf
    sticks = {name: getattr(config, name) for name in ("steer_axis", "throttle_axis")}
    is_d_mode = any(is_d_mode_cross(index, *shape) for index in sticks.values())
    comes, autorepeat = f"{topic} comes {_rate_text(gamepad)}", AUTOREPEAT.format(joy=topic)
    return [
        (missing, BAD, missing and missing[1], remedy(causes.JOY_INCOMPLETE, topic)),
        *((index in gamepad.odd, BAD, f"the gamepad's {name} {index} is {gamepad.odd.get(index)}, no number to act on",
           remedy(causes.JOY_NOT_FINITE, topic)) for name, index in sticks.items()),
        (gamepad.period_s > timeout_s, BAD,
         f"{comes}, too seldom for a joy_timeout of {timeout_s:g} s: the deadman is released again and again",
         autorepeat),
        (gamepad.period_s * MISSED > timeout_s, WARN,
         f"{comes}: with a joy_timeout of {timeout_s:g} s one message that is late releases the deadman", autorepeat),
        (is_d_mode, WARN, f"{gamepad.axes} axes and {gamepad.buttons} buttons{D_MODE}",
         remedy(causes.JOY_INCOMPLETE, topic))]


def _rate_text(gamepad):
    if gamepad.messages < 2:
        return f"once in {gamepad.period_s:.1f} s"
    return f"{1 / gamepad.period_s:.1f} times a second"


def probe_driver(folder: str = "/sys/bus/usb/devices") -> list[Finding]:
    """Look for Xbox gamepads on USB, and others that are like them, for which this computer has no driver.

    Args:
        folder: where the kernel lists USB devices: Linux, Documentation/ABI/testing/sysfs-bus-usb.
    """
    found = []
    for interface in sorted(glob.glob(f"{folder}/*:1.0")):
        kind = tuple(_read_word(interface, f"bInterface{name}") for name in ("Class", "SubClass", "Protocol"))
        if kind in XBOX_INTERFACES and not os.path.exists(f"{interface}/driver"):
            device = interface.partition(":")[0]
            numbers = f"{_read_word(device, 'idVendor')}:{_read_word(device, 'idProduct')}"
            name = _read_word(device, "product") or "a gamepad"
            what = f"{name} ({numbers}) is plugged in, but no driver has it: no xpad"
            found.append(Finding(WARN, SUBJECT, what, NO_XPAD_REMEDY))
    return found


def _read_word(folder, name):
    """Return what a file of sysfs has; empty: there is none."""
    try:
        with open(os.path.join(folder, name), encoding="utf-8", errors="replace") as file:
            return file.read().strip()
    except OSError:
        return ""
