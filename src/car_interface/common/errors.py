"""The errors of this package. Each message is one line that names the problem and the remedy."""
from __future__ import annotations

from contextlib import contextmanager
from typing import Iterator


class CarInterfaceError(Exception):
    """The base of all errors that this package raises."""


class EndedEarly(CarInterfaceError):
    """A program's work wasn't done: somebody ended it, or it found too little. Neither a fault nor a success."""


class ConfigError(CarInterfaceError, ValueError):
    """An invalid parameter, table or file.

    Args:
        name: the parameter as the user wrote it, e.g. ``servo_channel`` or ``value_map.csv, line 3``.
        value: the value found; ``None`` = it is missing.
        accepted: the accepted values, e.g. ``an integer from 0 to 15``.
        found: a text instead of "is" and the value, e.g. ``has 2 columns``.
    """

    def __init__(self, name, value, accepted, found=None):
        self.name = name
        self.value = value
        self.accepted = accepted
        if found is None:
            found = "is missing" if value is None else f"is {_shorten(value)}"
        super().__init__(f"{name} {found}; accepted: {accepted}")
        self.found = found


@contextmanager
def within(place: str) -> Iterator[None]:
    """Have each ConfigError that is raised inside name the place, e.g. a file, before its name."""
    try:
        yield
    except ConfigError as error:
        raise ConfigError(f"{place}, {error.name}", error.value, error.accepted, error.found) from error


def require(fine: bool, name: str, value: object, accepted: str, found: str | None = None) -> None:
    """Raise a ConfigError of these unless ``fine``."""
    if not fine:
        raise ConfigError(name, value, accepted, found)


class ProtocolError(CarInterfaceError, ValueError):
    """A request that the protocol or the firmware behind it can't carry; raised before a byte is sent."""


class DeviceError(CarInterfaceError):
    """A device that is absent, not permitted or failing. The node reports it and tries again.

    Args:
        what: the device, e.g. ``PCA9685 at 0x40 on /dev/i2c-1``.
        remedy: what the user can do or type next.
    """

    def __init__(self, what, cause, remedy):
        self.what = what
        self.cause = cause
        self.remedy = remedy
        super().__init__(f"{what}: {cause}. {remedy}")


def _shorten(value, limit=80):
    text = repr(value)
    return text if len(text) <= limit else text[: limit - 1] + "…"
