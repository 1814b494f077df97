"""Which axis and button of which gamepad does what: gamepads.yaml, by the gamepad's name and its numbers of inputs.

gamepad_joy's messages name the gamepad in their frame_id. An entry has what differs from teleop_logi's parameters; the
car's folder goes before the package's. A gamepad that is in neither drives nothing. Messages that name none, such as
joy_node's, go by the parameters alone.
"""
from __future__ import annotations

import json
import os
from contextlib import suppress
from typing import Any, Mapping

from car_interface.common.declared import read_all
from car_interface.common.errors import ConfigError, require, within
from car_interface.common.package_files import package_file
from car_interface.common.params import Params
from car_interface.common.yaml_file import load_yaml
from car_interface.teleop.gamepad import GamepadConfig

FILE = "gamepads.yaml"
FRAME = "gamepad: "  # before the gamepad's name
KEYBOARD_FRAME = "keyboard"  # the frame_id of keyboard_drive's messages
# What is printed on the buttons 0, 1, …, by how the model begins. Their order is SDL's gamecontrollerdb.txt for Linux.
LABELS = {
    "Logitech Gamepad": "A B X Y LB RB", "Logitech Logitech": "X A B Y LB RB", "Microsoft": "A B X Y LB RB",
    "Xbox Wireless Controller": "A B - X Y - LB RB", "Sony": "cross circle triangle square L1 R1",
    "Wireless Controller": "cross circle triangle square L1 R1", "DualSense": "cross circle triangle square L1 R1"}
HEAD = f"# Written by map_gamepad; the package's config/{FILE} says how it is read."

Entries = Mapping[str, Any]  # by model, what differs


def frame_of(name: str) -> str:
    return FRAME + name


def model_of(frame: str, axes: int, buttons: int) -> str:
    """Return the name under which gamepads.yaml has the sender of a message; empty = the message names no gamepad.

    Another mode or driver of the same gamepad has other numbers of axes and buttons, or another name.
    """
    return f"{frame[len(FRAME):]}, {axes} axes, {buttons} buttons" if frame.startswith(FRAME) else ""


def button_label(model: str, button: int) -> str:
    """Return what is printed on a gamepad's button, or its number where that isn't known.

    Args:
        model: see ``model_of``.
        button: its number in the message.
    """
    labels = next((labels.split() for name, labels in LABELS.items() if model.startswith(name)), [])
    return labels[button] if 0 <= button < len(labels) and labels[button] != "-" else f"button {button}"


def load_entries(folder: str | None) -> dict[str, Any]:
    """Load the entries of the package and of the car's folder, if it has any.

    Raises:
        ConfigError: naming the file.
    """
    entries = load_yaml(str(package_file(f"config/{FILE}")))
    own = os.path.join(folder, FILE) if folder else ""
    if own and os.path.exists(own):
        entries.update(load_yaml(own))
    return entries


def config_for(model: str, config: GamepadConfig, entries: Entries) -> GamepadConfig:
    """Return what a gamepad's axes and buttons do.

    Args:
        model: see ``model_of``; empty = by the parameters alone.
        config: by teleop_logi's parameters.

    Raises:
        ConfigError: there is no entry, or it can't be used.
    """
    if not model:
        return config
    require(model in entries, FILE, None, "an entry of that name", f"has no entry for this gamepad, {model!r}")
    entry = entries[model]
    with within(f"{FILE}, {model}"):
        require(isinstance(entry, dict), "the entry", entry, "names of parameters and their values, or {}")
        return read_all(Params(entry), GamepadConfig, default=config)


def with_entry(text: str, path: str, model: str, entry: Mapping[str, float]) -> str:
    """Return the text of a gamepads.yaml with an entry on a line of its own, which replaces the one that it has.

    Args:
        text: of the file; empty = there is none yet.
        path: of the file, for errors.

    Raises:
        ConfigError: it can't be done without changing anything else.
    """
    name = json.dumps(model, ensure_ascii=False)
    before = load_yaml(path, text) if text else {}
    lines = [line for line in (text or HEAD).splitlines() if not line.startswith(f"{name}:")]
    values = ", ".join(f"{key}: {value}" for key, value in entry.items())
    result = "\n".join([*lines, f"{name}: {{{values}}}"]) + "\n"
    with suppress(ConfigError):
        if load_yaml(path, result) == {**before, model: dict(entry)}:
            return result
    raise ConfigError(path, None, f"a file whose entry {name} is on one line", "can't be edited safely")
