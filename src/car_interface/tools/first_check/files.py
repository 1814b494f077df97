"""Writes what a first check has learned into the car's folder, and its page.

Every file is checked as its node would load it, before the first one is written.
"""
from __future__ import annotations

import os
from typing import Any, Container, Mapping, NamedTuple, Sequence

from car_interface.common import output
from car_interface.common.declared import read_all
from car_interface.common.errors import CarInterfaceError
from car_interface.common.input_file import read_file
from car_interface.common.package_files import is_package_file
from car_interface.common.params import Params
from car_interface.common.yaml_edit import edited, save
from car_interface.common.yaml_file import MAX_BYTES, decode_yaml, load_yaml
from car_interface.steering.config import load_steering
from car_interface.teleop.gamepad import GamepadConfig
from car_interface.teleop.mappings import FILE as MAPPINGS
from car_interface.throttle.config import load_throttle
from car_interface.tools.first_check.car import GAMEPAD, STEERING, THROTTLE
from car_interface.tools.first_check.questions import CLASSES, Result

MAX_SHOWN = 3  # numbers of a list: a table moves along with what was learned
LOADS = {STEERING: load_steering, THROTTLE: load_throttle,
         GAMEPAD: lambda path, text: read_all(Params(load_yaml(path, text)), GamepadConfig)}


class Edit(NamedTuple):
    """The change of one file."""

    path: str  # of the file
    values: Mapping[str, Any]  # new ones, by the parameters' names; empty where it can't be written
    lines: Sequence[str]  # what is to be said: one for each parameter, or why it can't be written


def find_folder(folder: str | None) -> str:
    """Return the folder that the car was launched with.

    Raises:
        CarInterfaceError: there is none, or it is the package's own.
    """
    if folder is None:
        raise CarInterfaceError("turn_arb isn't launched, or not in this namespace (ROS_NAMESPACE): roslaunch "
                                "car_interface car.launch throttle:=true calibration_drive:=true config:=$HOME/my_car")
    if is_package_file(os.path.join(folder, f"{STEERING}.yaml")):
        raise CarInterfaceError("the car runs on the package's own files, which are not to be changed: copy them (cp "
                                "-r $(rospack find car_interface)/config ~/my_car), and launch with "
                                "config:=$HOME/my_car")
    return folder


def plan(folder: str, changes: Mapping[str, Mapping[str, Any]], mapped: Container[str] = ()) -> list[Edit]:
    """Return the changes of the files in a folder, each checked as its node would load it.

    Args:
        changes: new values by file and parameter.
        mapped: the parameters that gamepads.yaml has for the gamepad; teleop_logi.yaml's don't count for it.
    """
    return [_plan(os.path.join(folder, f"{file}.yaml"), file, values, mapped if file == GAMEPAD else ())
            for file, values in changes.items()]


def _plan(path, file, values, mapped):
    name, useless = os.path.basename(path), [name for name in values if name in mapped]
    try:
        if useless:
            raise CarInterfaceError(f"for this gamepad {MAPPINGS} has {', '.join(useless)}: run map_gamepad again")
        text = decode_yaml(read_file(path, MAX_BYTES), path)
        content = load_yaml(path, text)
        if "esc/profile" in values and _look_up(content, "esc/profile_measured"):
            values = {**values, "esc/profile_measured": False}  # it was measured of another kind
        LOADS.get(file, load_yaml)(path, edited(text, values, path))
        output.check(path)
    except (CarInterfaceError, OSError) as error:
        return Edit(path, {}, [f"{name} can't be changed: {error}"])
    before = {parameter: _look_up(content, parameter) for parameter in values}
    changed = {parameter: value for parameter, value in values.items() if value != before[parameter]}
    return Edit(path, changed, [f"{name}: {parameter} {_text(before[parameter])} → {_text(value)}"
                                for parameter, value in changed.items()])


def write(edits: Sequence[Edit]) -> list[str]:
    """Write the changes; return a line for each file, with where its old content is.

    Raises:
        CarInterfaceError: one can't be written.
    """
    backups = {edit.path: save(edit.path, edit.values) for edit in edits if edit.values}
    return [f"written: {path}; the old one is {backup}" if backup else f"{path} is as it was"
            for path, backup in backups.items()]


def write_page(path: str, date: str, results: Sequence[tuple[str, Result]], written: Sequence[str]) -> str:
    """Write the page; return a line that says so, or why there is none.

    Args:
        results: by the question's title.
        written: lines on what was written.
    """
    repairs = [(title, result.repair) for title, result in results if result.repair]
    verdicts = [result.verdict for _, result in results]
    try:
        from car_interface.tools.report.html import render
        output.write(path, render("first_check.html", title="First check", date=date, results=results, written=written,
                                  repairs=repairs, classes=CLASSES, count=verdicts.count))
    except ImportError:
        return "no page: sudo apt install python3-jinja2"
    except (CarInterfaceError, OSError) as error:
        return f"no page: {error}"
    return f"page: {path}"


def _look_up(content, name):
    for part in name.split("/"):
        content = content.get(part) if isinstance(content, dict) else None
    return content


def _text(value):
    if value is None:
        return "(none)"
    if not isinstance(value, (list, tuple)):
        return str(value)
    if len(value) > MAX_SHOWN:
        return f"[{value[0]:g}, … {value[-1]:g}]"
    return f"[{', '.join(f'{each:g}' for each in value)}]"
