"""The errors of this package, each of which ends as one line that a car's owner can act on."""
from __future__ import annotations


class CarInterfaceError(Exception):
    """Whatever this package raises on purpose."""


class ConfigError(CarInterfaceError, ValueError):
    """A parameter, table or file that the package can't work with.

    Args:
        name: the parameter as its owner wrote it, e.g. ``servo_channel`` or ``value_map.csv, line 3``.
        value: what was found there; ``None`` where nothing was.
        accepted: what would have been accepted, e.g. ``an integer from 0 to 15``.
        found: what to say in place of "is" and the value, e.g. ``has 2 columns``.
    """

    def __init__(self, name, value, accepted, found=None):
        self.name = name
        self.value = value
        self.accepted = accepted
        if found is None:
            found = "is missing" if value is None else f"is {_shorten(value)}"
        super().__init__(f"{name} {found}; accepted: {accepted}")
        self._found = found

    def within(self, place: str) -> ConfigError:
        """The same error, its name behind the place where it was found, e.g. a file."""
        return ConfigError(f"{place}, {self.name}", self.value, self.accepted, self._found)


class ProtocolError(CarInterfaceError, ValueError):
    """A request that the protocol or the firmware behind it can't carry; raised before a byte is sent."""


class DeviceError(CarInterfaceError):
    """A device that is absent, refused or failing. It never ends a node; it's reported and tried again.

    Args:
        what: the device, e.g. ``PCA9685 at 0x40 on /dev/i2c-1``.
        cause: what went wrong, in words.
        remedy: what its owner can do or type next.
    """

    def __init__(self, what, cause, remedy):
        self.what = what
        self.cause = cause
        self.remedy = remedy
        super().__init__(f"{what}: {cause}. {remedy}")


def _shorten(value, limit=80):
    text = repr(value)
    return text if len(text) <= limit else text[: limit - 1] + "…"
