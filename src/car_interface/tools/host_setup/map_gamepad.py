"""rosrun car_interface map_gamepad FOLDER: asks for each control of a gamepad, and writes what it does into a folder.

The gamepad is read as gamepad_joy does, which may go on. Nothing is written unless all controls were shown.
"""
from __future__ import annotations

import argparse
import math
import os
import select
import sys
from typing import NamedTuple

from car_interface.common import output
from car_interface.common.errors import CarInterfaceError
from car_interface.common.package_files import is_package_file
from car_interface.common.yaml_file import read_yaml
from car_interface.teleop.gamepad import NONE
from car_interface.teleop.gamepad_device import GamepadDevice
from car_interface.teleop.input_devices import ANY, choose_pad, find_pads
from car_interface.teleop.joystick import Joystick
from car_interface.teleop.mappings import FILE, frame_of, model_of, with_entry

ABS_HAT0X, ABS_HAT3Y = 0x10, 0x17  # the axes of crosses: linux/input-event-codes.h
PUSHED, AT_REST = 0.7, 0.3  # of an axis, from its rest; a trigger's rest is at 1


class Step(NamedTuple):
    """A control to be shown."""

    parameter: str  # of teleop_logi
    text: str
    scale: str = ""  # the parameter for an axis's sign; empty: it is a button
    may_lack: bool = False  # the gamepad may do without


STEPS = (
    Step("steer_axis", "Push the stick that steers to the left", "steer_scale"),
    Step("throttle_axis", "Push the stick that drives forward", "throttle_scale", may_lack=True),
    Step("manual_button", "Press the button that you hold while you drive yourself"),
    Step("autonomous_button", "Press the button that you hold while the planner drives"),
    Step("faster_button", "Press the button that makes driving by hand faster", may_lack=True),
    Step("slower_button", "Press the button that makes it slower", may_lack=True),
)


def ask(device: GamepadDevice, joystick: Joystick, keyboard, report=print) -> dict[str, float]:
    """Ask for each control, and return the entry of gamepads.yaml.

    Args:
        keyboard: a file on which Enter says that the gamepad lacks a control.
        report: called with each line for the person.

    Raises:
        DeviceError: the gamepad is gone.
    """
    joystick.read_axes(device.positions())
    rest = tuple(joystick.axes)  # while nobody touches it
    # A third deadman of the folder's teleop_logi.yaml would be just any button of this gamepad.
    entry: dict[str, float] = {"third_button": NONE}
    inputs, is_at_rest = _inputs(device, joystick, keyboard), False  # since a control was shown
    for step in STEPS:
        report(f"{step.text}{', or type Enter if there is none' if step.may_lack else ''}; then let go.")
        for axes, buttons in inputs:
            if axes is None:  # Enter
                if step.may_lack:
                    entry[step.parameter] = NONE
                    break
                continue
            offsets = [abs(value - at_rest) for value, at_rest in zip(axes, rest)]
            number, why = _axis(offsets, rest, device, entry) if step.scale else _button(buttons, entry)
            if not is_at_rest:
                is_at_rest = not any(buttons) and max(offsets, default=0.0) < AT_REST
            elif why:
                report(why)
                is_at_rest = False
            elif number is not None:
                entry[step.parameter], is_at_rest = number, False
                if step.scale:
                    entry[step.scale] = math.copysign(1.0, axes[number])
                break
    return entry


def _inputs(device, joystick, keyboard):
    """Yield the axes and buttons now and after each change; and ``None`` for both when Enter is typed."""
    files = [device, keyboard]
    yield joystick.axes, joystick.buttons
    while True:
        ready, _, _ = select.select(files, [], [])
        if keyboard in ready and not keyboard.readline():
            files.remove(keyboard)  # it was closed
        elif keyboard in ready:
            yield None, None
        if device in ready:
            changes = joystick.receive(device.read())
            if joystick.is_lost:
                changes.append(joystick.read_axes(device.positions()))
            for change in changes:
                yield change.axes, change.buttons


def _axis(offsets, rest, device, entry):
    """Return the number of the axis that is pushed, ``None`` = none is, and why it won't do; empty: it does."""
    number = max(range(len(offsets)), key=offsets.__getitem__, default=None)
    if number is None or offsets[number] < PUSHED:
        return None, ""
    if ABS_HAT0X <= sorted(device.ranges)[number] <= ABS_HAT3Y:
        return number, "that is the cross: use a stick"
    if abs(rest[number]) > AT_REST:
        return number, "that axis rests at its end, as a trigger does: use a stick"
    return number, "that axis steers already" if entry.get("steer_axis") == number else ""


def _button(buttons, entry):
    """Return the number of the button that is pressed, likewise."""
    number = next((number for number, is_pressed in enumerate(buttons) if is_pressed), None)
    taken = [name for name, value in entry.items() if name.endswith("_button") and value == number]
    return number, f"that is {taken[0]} already: press another one" if taken else ""


def main():
    """Ask for each control, and write the entry.

    Raises:
        CarInterfaceError: the folder isn't the car's, or the entry can't be written.
    """
    parser = argparse.ArgumentParser(prog="map_gamepad", description="Asks for each control of a gamepad, and writes "
                                     f"what it does into {FILE} of your car's folder.")
    parser.add_argument("folder", help="your car's folder, which config:= names")
    parser.add_argument("--device", default=ANY, help="the gamepad's device, if there are several")
    options = parser.parse_args([argument for argument in sys.argv[1:] if ":=" not in argument])
    folder, path = options.folder, os.path.join(options.folder, FILE)
    if not os.path.isdir(folder):
        raise CarInterfaceError(f"there is no folder {folder}: give your car's, which config:= names")
    if is_package_file(path):
        raise CarInterfaceError(f"{folder} is the package's own: give a folder of your car's, a copy of it, and launch "
                                "with config:=")
    device = GamepadDevice(choose_pad(find_pads(), options.device, "--device "))
    joystick = Joystick(device.keys, device.ranges)
    model = model_of(frame_of(device.pad.name), len(joystick.axes), len(joystick.buttons))
    print(f"{model}\nLet go of everything.", flush=True)
    entry = ask(device, joystick, sys.stdin)
    before = read_yaml(path) if os.path.exists(path) else ""
    output.write(path, with_entry(before, path, model, entry), keeps_old=True)
    print(f"written: {path}. It counts from the next launch with config:={os.path.abspath(folder)}; see teleop_logi's "
          "state while you try it, wheels in the air.")
