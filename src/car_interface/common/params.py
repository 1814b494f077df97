"""Reads and checks the parameters of a node.

Plain values in, plain values out; ``ros.runtime`` fetches them from the parameter server, a tool from a YAML file. A
ConfigError names the parameter, its value and the accepted values. ``finish`` refuses unknown names, so that a typing
error in a YAML file doesn't leave a default in use.

The values come from YAML or XML: ``10`` is accepted for a float, ``10.0`` for an integer, and ``1e-3`` and ``0x40``
arrive as strings. True is not a number.
"""
from __future__ import annotations

import math
import os
from types import MappingProxyType
from typing import Any, Callable, Mapping, Sequence

from car_interface.common.errors import ConfigError, require
from car_interface.common.input_file import finite_number, integer

REQUIRED = object()
DURATION_S = (0.0, 3600.0)  # range of every timeout: up to an hour
BY_LAUNCH_FILE = "by the launch file that started this process"
CONFIG_FOLDER = "config_folder"  # each launch file sets it to the folder that it has read
# What a launch file's arguments choose, by the parameter's name. roslaunch ignores an argument that is misspelt.
LAUNCH_ARGUMENTS = {CONFIG_FOLDER: "config", "device": "i2c", "address": "address", "port": "port"}


class Params:
    """The parameters in a node's private namespace.

    Args:
        private: the content of the namespace, as rospy returns it: nested dicts for names with a slash.
        search_parents: looks up a name that the private namespace lacks in the namespaces around it; None when there is
            none.
        fixed: what a launch file gave to the process itself, see ``fixed_parameters``: a scalar that is missing or
            differs from that is refused; ``None`` = it must not be set.
    """

    def __init__(self, private: dict[str, Any] | None, search_parents: Callable[[str], Any] = lambda name: None,
                 fixed: Mapping[str, str | None] = MappingProxyType({})):
        self._values = dict(_flatten(private or {}))
        self._search_parents = search_parents
        self._fixed = fixed
        self._known: set = set()

    def number(self, name: str, default=REQUIRED, low=-math.inf, high=math.inf, above=None) -> float:
        """Return a finite number from ``low`` to ``high``, or greater than ``above``."""
        accepted = "a number" + _range_text(low, high, above)
        return self._scalar(name, default, False, lambda value: _number(value, low, high, above), accepted)

    def integer(self, name: str, default=REQUIRED, low=-2 ** 31, high=2 ** 31 - 1, search_parents=False) -> int:
        """Return an integer from ``low`` to ``high``, or the default, which may be ``None``."""
        accepted = "an integer" + _range_text(low, high)
        return self._scalar(name, default, search_parents, lambda value: _integer(value, low, high), accepted)

    def numbers(self, name: str, default=REQUIRED, low=-math.inf, high=math.inf, search_parents=False) -> list[float]:
        """Return a list of finite numbers from ``low`` to ``high``, or the default, which may be ``None``."""
        element = "a number" + _range_text(low, high)
        accepted = f"a list, each {element}"
        value = self._get(name, default, search_parents, accepted)
        if value is None:
            return None
        require(isinstance(value, (list, tuple)), name, value, accepted)
        return [self._checked(f"{name}[{index}]", x, lambda x: _number(x, low, high), element)
                for index, x in enumerate(value)]

    def integers(self, name: str, default, length: int, low: int, high: int) -> tuple[int, ...]:
        """Return ``length`` integers; a scalar stands for all of them."""
        accepted = "an integer" + _range_text(low, high)
        value = self._get(name, default, False)
        if not isinstance(value, (list, tuple)):
            value = self._checked(name, value, lambda v: _integer(v, low, high), f"{accepted}, or {length} of them")
            return (value,) * length
        require(len(value) == length, name, value, f"{length} integers, or one for all of them")
        return tuple(self._checked(f"{name}[{index}]", element, lambda v: _integer(v, low, high), accepted)
                     for index, element in enumerate(value))

    def flag(self, name: str, default=REQUIRED) -> bool:
        """Return true or false."""
        return self._scalar(name, default, False, lambda v: v if isinstance(v, bool) else None, "true or false",
                            read_fixed=lambda text: {"true": True, "false": False}.get(text.lower()))

    def text(self, name: str, default=REQUIRED, may_be_empty=False) -> str:
        """Return a string; not an empty one unless ``may_be_empty``."""
        return self._scalar(name, default, False,
                            lambda v: v if isinstance(v, str) and (may_be_empty or v.strip()) else None, "a text")

    def path(self, name: str, default=REQUIRED) -> str:
        """Return the absolute path of a file or folder.

        Relative paths and ~ are refused: they would depend on the folder and the user that ROS starts the node in.
        """
        return self._scalar(name, default, False, lambda v: v if isinstance(v, str) and os.path.isabs(v) else None,
                            "a whole path, from / on, such as $PWD/my_car makes: nodes run in another folder, and ~ is "
                            "no name to them")

    def text_or_integer(self, name: str, default):
        """Return a non-empty string, or an integer of at least 0."""
        def read(value):
            number = _integer(value, 0, 2 ** 31 - 1)
            return number if number is not None else value if isinstance(value, str) and value.strip() else None
        return self._scalar(name, default, False, read, "a text, or an integer of at least 0")

    def choice(self, name: str, default, choices: Sequence[str]) -> str:
        """Return one of ``choices``."""
        return self._scalar(name, default, False, lambda v: v if v in choices else None, "one of " + ", ".join(choices))

    def timeout(self, name: str, default: float) -> float:
        """Return the seconds after which an input without messages is stale; 0 = never."""
        return self.number(name, default, *DURATION_S)

    def launched_with(self) -> str:
        """Return what the launch file's arguments chose, for the node's first line in the log; empty by rosrun."""
        if CONFIG_FOLDER not in self._values:
            return ""
        return ", ".join(f"{argument} {self._values[name]}" for name, argument in LAUNCH_ARGUMENTS.items()
                         if name in self._values)

    def finish(self, ignored_namespaces: Sequence[str] = ()) -> None:
        """Refuse names that no reader has asked for.

        Args:
            ignored_namespaces: names below these are not refused: another node checks them.

        Raises:
            ConfigError: naming the first unknown parameter and the known ones.
        """
        ignored = tuple(f"{namespace}/" for namespace in ignored_namespaces)
        unknown = sorted(name for name in self._values
                         if name not in (*self._known, CONFIG_FOLDER) and not name.startswith(ignored))
        if unknown:
            raise ConfigError(f"unknown parameter {unknown[0]}", self._values[unknown[0]],
                              "only " + ", ".join(sorted(self._known)))

    def _scalar(self, name, default, search_parents, read, accepted, read_fixed=None):
        if name in self._fixed:
            return self._fixed_scalar(name, default, read, accepted, read_fixed or read)
        value = self._get(name, default, search_parents, accepted)
        return None if value is None else self._checked(name, value, read, accepted)

    def _fixed_scalar(self, name, default, read, accepted, read_fixed):
        """Return a parameter that must be as the launch file has it."""
        self._known.add(name)
        value, fixed = self._values.get(name), self._fixed[name]
        if fixed is None:
            require(value is None, name, value, f"none, {BY_LAUNCH_FILE}; its argument {name} sets it")
            return default
        result = None if value is None else self._checked(name, value, read, accepted)
        require(result is not None and result == read_fixed(fixed), name, value, f"{fixed}, {BY_LAUNCH_FILE}")
        return result

    def _get(self, name, default, search_parents, accepted=""):
        self._known.add(name)
        value = self._values.get(name)
        if value is None and search_parents:
            value = self._search_parents(name)
        if value is None:
            value = default
        require(value is not REQUIRED, name, None, accepted)
        return value

    @staticmethod
    def _checked(name, value, read, accepted):
        result = read(value)
        require(result is not None, name, value, accepted)
        return result


def _flatten(tree, prefix=""):
    """Yield each name, with its namespaces, and its value."""
    for key, value in tree.items():
        if isinstance(value, dict):
            yield from _flatten(value, f"{prefix}{key}/")
        else:
            yield f"{prefix}{key}", value


def _number(value, low, high, above=None):
    """Return a number in a range, also if it is written as 1e-3 or 0x40; else ``None``."""
    if isinstance(value, str):
        number = finite_number(value)
        value = integer(value) if number is None else number
    try:
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            return None
    except OverflowError:  # an integer beyond all floats
        return None
    return float(value) if low <= value <= high and (above is None or value > above) else None


def _integer(value, low, high):
    if isinstance(value, str):
        value = integer(value)
    if isinstance(value, float) and value % 1 == 0:
        value = int(value)
    if isinstance(value, bool) or not isinstance(value, int):
        return None
    return value if low <= value <= high else None


def _range_text(low, high, above=None):
    if above is not None:
        return f" above {above}" + (f", at most {high}" if high < math.inf else "")
    if low == -math.inf and high == math.inf:
        return ""
    if high == math.inf:
        return f" of at least {low}"
    return f" from {low} to {high}"
