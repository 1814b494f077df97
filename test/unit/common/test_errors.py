"""The errors: each message is one line."""
import pytest

from car_interface.common.errors import ConfigError, within


@pytest.mark.parametrize("value, message", [
    (20, "x is 20; accepted: less"),
    (None, "x is missing; accepted: less"),
    ("a" * 78, "x is '" + "a" * 78 + "'; accepted: less"),
    ("a" * 79, "x is '" + "a" * 78 + "…; accepted: less"),
    ([0] * 1000, "x is [" + "0, " * 26 + "…; accepted: less"),
])
def test_config_error_is_one_short_line_and_keeps_what_it_was_made_of(value, message):
    error = ConfigError("x", value, "less")
    assert str(error) == message
    assert (error.name, error.value, error.accepted) == ("x", value, "less")


def test_config_error_within_a_file_names_both():
    with pytest.raises(ConfigError) as caught, within("a.yaml"):
        raise ConfigError("x", 20, "less", "has too many")
    error = caught.value
    assert str(error) == "a.yaml, x has too many; accepted: less"
