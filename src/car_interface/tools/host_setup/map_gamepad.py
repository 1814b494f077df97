"""rosrun car_interface map_gamepad FOLDER: asks for each control of a gamepad, and writes what it does into a folder.

The gamepad is read as gamepad_joy does, which may go on. Nothing is written unless all controls were shown.
"""
from __future__ import annotations

import argparse
import math
import os
import select
import sys
from typing import Iterable, NamedTuple, Sequence

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


class GamepadMap:
    """Finds which control a person shows.

    Args:
        rest: the axes while nobody touches the gamepad.
        crosses: the numbers of the axes that are crosses.

    Attributes:
        step: what is to be shown; ``None`` = all was.
    """

    def __init__(self, rest: Sequence[float], crosses: Iterable[int]):
        # A third deadman of the folder's teleop_logi.yaml would be just any button of this gamepad.
        self.entry: dict[str, float] = {"third_button": NONE}  # what was found, as gamepads.yaml has it
        self._rest, self._crosses = tuple(rest), frozenset(crosses)
        self._steps = list(STEPS)
        self._is_at_rest = False  # since the step began

    @property
    def step(self) -> Step | None:
        """Return what is to be shown."""
        return self._steps[0] if self._steps else None

    def skip(self) -> None:
        """Note that the gamepad lacks the control, if it may."""
        if self.step.may_lack:
            self.entry[self.step.parameter] = NONE
            del self._steps[0]

    def take(self, axes: Sequence[float], buttons: Sequence[int]) -> str:
        """Take the gamepad's state, and return why a control that is shown won't do; empty: it does, or none is."""
        step = self.step
        if step is None:
            return ""
        offsets = [abs(value - rest) for value, rest in zip(axes, self._rest)]
        if not self._is_at_rest:
            self._is_at_rest = not any(buttons) and max(offsets, default=0.0) < AT_REST
            return ""
        number, why = self._axis(offsets) if step.scale else self._button(buttons)
        if number is None:
            return ""
        self._is_at_rest = False
        if not why:
            self.entry[step.parameter] = number
            if step.scale:
                self.entry[step.scale] = math.copysign(1.0, axes[number])
            del self._steps[0]
        return why

    def _axis(self, offsets):
        """Return the number of the axis that is pushed, ``None`` = none is, and why it won't do."""
        number = max(range(len(offsets)), key=offsets.__getitem__, default=None)
        if number is None or offsets[number] < PUSHED:
            return None, ""
        if number in self._crosses:
            return number, "that is the cross: use a stick"
        if abs(self._rest[number]) > AT_REST:
            return number, "that axis rests at its end, as a trigger does: use a stick"
        return number, "that axis steers already" if self.entry.get("steer_axis") == number else ""

    def _button(self, buttons):
        """Return the number of the button that is pressed, likewise."""
        number = next((number for number, is_pressed in enumerate(buttons) if is_pressed), None)
        taken = [name for name, value in self.entry.items() if name.endswith("_button") and value == number]
        return number, f"that is {taken[0]} already: press another one" if taken else ""


def ask(device: GamepadDevice, joystick: Joystick, keyboard, report=print) -> dict[str, float]:
    """Ask for each control, and return the entry of gamepads.yaml.

    Args:
        keyboard: a file on which Enter says that the gamepad lacks a control.
        report: called with each line for the person.

    Raises:
        DeviceError: the gamepad is gone.
    """
    joystick.read_axes(device.positions())
    codes = sorted(device.ranges)
    found = GamepadMap(joystick.axes, [codes.index(code) for code in codes if ABS_HAT0X <= code <= ABS_HAT3Y])
    asked, files = None, [device, keyboard]
    found.take(joystick.axes, joystick.buttons)
    while found.step is not None:
        if found.step != asked:
            asked = found.step
            report(f"{asked.text}{', or type Enter if there is none' if asked.may_lack else ''}; then let go.")
        ready, _, _ = select.select(files, [], [])
        if keyboard in ready and not keyboard.readline():
            files.remove(keyboard)  # it was closed
        elif keyboard in ready:
            found.skip()
        if device in ready:
            changes = joystick.receive(device.read())
            if joystick.is_lost:
                changes.append(joystick.read_axes(device.positions()))
            for change in changes:
                why = found.take(change.axes, change.buttons)
                if why:
                    report(why)
    return found.entry


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
    text = with_entry(read_yaml(path) if os.path.exists(path) else "", path, model, entry)
    output.write(path, text, keeps_old=True)
    print(f"written: {path}. It counts from the next launch with config:={os.path.abspath(folder)}; see teleop_logi's "
          "state while you try it, wheels in the air.")
