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
from car_interface.tools.doctor.findings import BAD, OK, WARN, Finding

SUBJECT = "gamepad"
MISSED = 2  # messages in a row that may be lost before the deadman is released, at least
AUTOREPEAT = "Set its driver's autorepeat_rate to 20, as launching with gamepad:=true does: {joy} must come at 20 Hz"
# Class, subclass and protocol of an Xbox gamepad's first interface, and of a Logitech's in X mode: Linux,
# drivers/input/joystick/xpad.c. An Xbox One's gamepad has others that look alike and need no driver.
XBOX_INTERFACES = (("ff", "5d", "01"), ("ff", "5d", "81"), ("ff", "47", "d0"))
NO_XPAD_REMEDY = ("sudo modprobe xpad. If there is no such module, as on a Jetson: set the switch of a Logitech at D, "
                  "connect an Xbox gamepad by Bluetooth, or build xpad")
LET_GO = "Let go of both deadman buttons once, then hold one"


class JoySample(NamedTuple):
    """What came on the gamepad's topic while the doctor listened."""

    messages: int
    period_s: float  # the mean time between them; after a single one, the time since then; inf: none came
    axes: int  # of the newest one
    buttons: int
    values: dict  # the newest that isn't finite, by index of the axis


class GamepadFacts(NamedTuple):
    """What is known of the gamepad."""

    node: str  # teleop_logi's path
    topic: str  # that it subscribes to
    publishers: Sequence[str]  # the nodes that publish on it
    # What teleop_logi takes its axes and buttons for; ``None`` = its parameters are bad, as another finding says, or
    # the gamepad is in no gamepads.yaml.
    config: GamepadConfig | None
    sample: JoySample
    cause: str = ""  # teleop_logi's own, as is the reason; empty = it published nothing
    reason: str = ""
    stick_cause: str = ""  # NOT_AT_REST where teleop_logi ignores an axis
    driver: Report | None = None  # what gamepad_joy reports, where it has no gamepad


def check_gamepad(gamepad: GamepadFacts) -> list[Finding]:
    """Return one finding: the first thing that keeps a deadman from being held, or that all is well."""
    sample, topic = gamepad.sample, gamepad.topic
    if not sample.messages:
        return [_phone(gamepad) if gamepad.reason.startswith(PHONE_PREFIX) else _nothing_came(gamepad)]
    if gamepad.cause == causes.JOY_NEVER_RECEIVED:
        return [Finding(BAD, SUBJECT, f"{topic} comes here, but {gamepad.node} says: {gamepad.reason}",
                        f"See whether they reach each other: rosnode info {gamepad.node}; ROS_IP; then start it again")]
    if gamepad.cause == causes.JOY_UNMAPPED:
        return [Finding(BAD, SUBJECT, gamepad.reason, remedy(gamepad.cause, topic))]
    broken = _broken(gamepad) if gamepad.config else None
    if broken is not None:
        return [broken]
    if gamepad.cause in causes.LOSSES:
        return [Finding(WARN, SUBJECT, gamepad.reason, remedy(gamepad.cause, topic) or LET_GO)]
    if gamepad.stick_cause:
        return [Finding(WARN, SUBJECT, gamepad.reason, remedy(gamepad.stick_cause, topic))]
    said = f"; {gamepad.reason}" if gamepad.reason else ""
    return [Finding(OK, SUBJECT, f"{topic}: {sample.axes} axes, {sample.buttons} buttons, "
                                 f"{_rate_text(sample)}{said}")]


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


def _phone(gamepad):
    """Return how a car fares that only phones drive."""
    if gamepad.cause in causes.LOSSES:
        return Finding(WARN, SUBJECT, f"there is none; {gamepad.reason}",
                       "Lift the thumbs from the phone's page, then touch it again")
    return Finding(OK, SUBJECT, f"there is none; {gamepad.reason}")


def _nothing_came(gamepad):
    topic = gamepad.topic
    if not gamepad.publishers:
        said = f" ({gamepad.reason})" if gamepad.reason else ""
        return Finding(WARN, SUBJECT, f"no node publishes {topic}, so that no deadman can be held{said}",
                       "Launch the car with gamepad:=true, which starts its driver, or with phone:=true. With the "
                       "virtual car: rosrun car_interface keyboard_drive")
    if gamepad.driver:
        return Finding(WARN, SUBJECT, gamepad.driver.message, gamepad.driver.remedy)
    return Finding(WARN, SUBJECT, f"{', '.join(gamepad.publishers)} publishes {topic}, but nothing came",
                   f"{remedy(causes.JOY_NEVER_RECEIVED, topic)}. {AUTOREPEAT.format(joy=topic)}, also while nothing "
                   "moves")


def _broken(gamepad):
    """Return what is wrong with the messages, or ``None``."""
    sample, config, topic = gamepad.sample, gamepad.config, gamepad.topic
    missing = missing_index(config, sample.axes, sample.buttons)
    if missing is not None:
        return Finding(BAD, SUBJECT, missing[1], remedy(causes.JOY_INCOMPLETE, topic))
    for name in ("steer_axis", "throttle_axis"):
        index = getattr(config, name)
        if index in sample.values:
            return Finding(BAD, SUBJECT, f"the gamepad's {name} {index} is {sample.values[index]}, no number to act on",
                           remedy(causes.JOY_NOT_FINITE, topic))
    timeout_s = config.joy_timeout_s or math.inf
    if sample.period_s > timeout_s:
        return Finding(BAD, SUBJECT, f"{topic} comes {_rate_text(sample)}, too seldom for a joy_timeout of "
                                     f"{timeout_s:g} s: the deadman is released again and again",
                       AUTOREPEAT.format(joy=topic))
    if sample.period_s * MISSED > timeout_s:
        return Finding(WARN, SUBJECT, f"{topic} comes {_rate_text(sample)}: with a joy_timeout of {timeout_s:g} s one "
                                      "message that is late releases the deadman", AUTOREPEAT.format(joy=topic))
    if any(is_d_mode_cross(index, sample.axes, sample.buttons) for index in (config.steer_axis, config.throttle_axis)):
        return Finding(WARN, SUBJECT, f"{sample.axes} axes and {sample.buttons} buttons, as a Logitech gamepad has in "
                                      "D mode: axes 4 and 5 are its cross then, not a stick",
                       remedy(causes.JOY_INCOMPLETE, topic))
    return None


def _rate_text(sample):
    if sample.messages < 2:
        return f"once in {sample.period_s:.1f} s"
    return f"{1 / sample.period_s:.1f} times a second"
