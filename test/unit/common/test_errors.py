"""The errors: each message is one line."""
from __future__ import annotations

from car_interface.common.errors import CarInterfaceError, ConfigError, DeviceError, ProtocolError


def test_config_error_of_a_long_value_is_one_short_line():
    message = str(ConfigError("table", list(range(1000)), "a table"))
    assert message.startswith("table is [0, 1, 2") and message.endswith("…; accepted: a table")
    assert len(message) < 120 and "\n" not in message


def test_config_error_of_a_value_of_80_characters_shows_it_whole_and_of_81_shortens_it():
    assert str(ConfigError("x", "a" * 78, "less")) == "x is '" + "a" * 78 + "'; accepted: less"
    assert str(ConfigError("x", "a" * 79, "less")) == "x is '" + "a" * 78 + "…; accepted: less"


def test_config_error_keeps_what_it_was_made_of():
    error = ConfigError("x", 20, "less")
    assert (error.name, error.value, error.accepted) == ("x", 20, "less")


def test_device_error_says_what_why_and_what_to_do():
    error = DeviceError("PCA9685 at 0x40", "nothing answers", "Check its power")
    assert str(error) == "PCA9685 at 0x40: nothing answers. Check its power"
    assert (error.what, error.cause, error.remedy) == ("PCA9685 at 0x40", "nothing answers", "Check its power")


def test_errors_are_all_of_the_package_s_own_kind():
    assert all(issubclass(kind, CarInterfaceError) for kind in (ConfigError, ProtocolError, DeviceError))


def test_config_error_within_a_file_names_both():
    error = ConfigError("x", 20, "less", "has too many").within("a.yaml")
    assert str(error) == "a.yaml, x has too many; accepted: less"


def test_config_error_without_a_value_is_about_a_missing_one():
    assert str(ConfigError("x", None, "a number")) == "x is missing; accepted: a number"
