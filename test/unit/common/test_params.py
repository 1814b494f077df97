"""A node's parameters: what each reader accepts and what it says of the rest. No ROS is needed to read them."""
import math

import pytest

from car_interface.common.errors import ConfigError
from car_interface.common.params import Params


def read(reader, value, *args, **kwargs):
    """What a reader makes of the one parameter ``x``; value None = it isn't there. It doesn't look outwards unasked."""
    params = Params({} if value is None else {"x": value}, lambda name: pytest.fail(f"{name} was looked up outwards"))
    return getattr(params, reader)("x", *args, **kwargs)


UNIT, CHANNEL = {"low": 0.0, "high": 1.0}, {"low": 0, "high": 15}
AB, EITHER, HALF_S = {"default": "a", "choices": ("a", "b")}, {"default": "a"}, {"default": 0.5}


@pytest.mark.parametrize("reader, value, args, result", [
    ("number", 10, {}, 10.0),
    ("number", "25e6", {}, 25e6),  # as YAML reads it
    ("number", " -2 ", {}, -2.0),
    ("number", 0, UNIT, 0.0),
    ("number", 1, UNIT, 1.0),
    ("number", 1e-9, {"above": 0}, 1e-9),
    ("number", None, {"default": 3}, 3.0),
    ("number", None, {"default": None}, None),
    ("integer", "0x40", {}, 64),
    ("integer", 64.0, {}, 64),
    ("integer", 0, CHANNEL, 0),
    ("integer", 15, CHANNEL, 15),
    ("integer", -2 ** 31, {}, -2 ** 31),
    ("integer", 2 ** 31 - 1, {}, 2 ** 31 - 1),
    ("integer", None, {"default": 7}, 7),
    ("integer", None, {"default": None}, None),
    ("numbers", (1, 2.5, "1e-3"), {}, [1.0, 2.5, 0.001]),
    ("numbers", [], {}, []),
    ("numbers", None, {"default": ()}, []),
    ("numbers", None, {"default": None}, None),
    ("flag", True, {}, True),
    ("flag", False, {}, False),
    ("flag", None, {"default": True}, True),
    ("text", "/dev/ttyAMA0", {}, "/dev/ttyAMA0"),
    ("text", None, {"default": None}, None),
    ("text", "", {"may_be_empty": True}, ""),
    ("path", "/home/me/my_car/map.csv", {}, "/home/me/my_car/map.csv"),
    ("path", None, {"default": None}, None),
    ("text_or_integer", "/dev/i2c-1", EITHER, "/dev/i2c-1"),
    ("text_or_integer", 0, EITHER, 0),
    ("text_or_integer", "1", EITHER, 1),
    ("text_or_integer", 2 ** 31 - 1, EITHER, 2 ** 31 - 1),
    ("text_or_integer", None, EITHER, "a"),
    ("choice", "b", AB, "b"),
    ("choice", None, AB, "a"),
    ("timeout", 0, HALF_S, 0.0),
    ("timeout", 3600, HALF_S, 3600.0),
    ("timeout", None, HALF_S, 0.5),
])
def test_parameter_is_read_as(reader, value, args, result):
    found = read(reader, value, **args)
    assert found == result
    assert type(found) is type(result)


WHOLE, LISTED = "accepted: an integer from -2147483648 to 2147483647$", "accepted: a list, each a number$"


@pytest.mark.parametrize("reader, value, args, message", [
    ("number", None, UNIT, "^x is missing; accepted: a number from 0.0 to 1.0$"),
    ("number", True, {}, "^x is True; accepted: a number$"),
    ("number", "fast", {}, "^x is 'fast'; accepted: a number$"),
    ("number", math.nan, {}, "^x is nan; accepted: a number$"),
    ("number", "inf", {}, "^x is 'inf'; accepted: a number$"),
    ("number", "0x" + "f" * 300, {}, "^x is '0xfff"),
    ("number", "1_0", {}, "^x is '1_0'; accepted: a number"),
    ("number", -0.1, UNIT, "^x is -0.1; accepted: a number from 0.0 to 1.0$"),
    ("number", 1.1, UNIT, "^x is 1.1; accepted: a number from 0.0 to 1.0$"),
    ("number", -1, {"low": 0}, "^x is -1; accepted: a number of at least 0$"),
    ("number", "0x0", {"above": 0.0}, "^x is '0x0'; accepted: a number above 0.0$"),
    ("number", 9, {"above": 0.0, "high": 5}, "^x is 9; accepted: a number above 0.0, at most 5$"),
    ("integer", None, CHANNEL, "^x is missing; accepted: an integer from 0 to 15$"),
    ("integer", None, {"default": 20, **CHANNEL}, "^x is 20; accepted: an integer from 0 to 15$"),
    ("integer", 16, CHANNEL, "^x is 16; accepted: an integer from 0 to 15$"),
    ("integer", -1, CHANNEL, "^x is -1; accepted: an integer from 0 to 15$"),
    ("integer", -2.0 ** 31 - 1, {}, WHOLE),
    ("integer", 2.0 ** 31, {}, WHOLE),
    ("integer", 0.5, CHANNEL, "^x is 0.5; accepted: an integer"),
    ("integer", math.nan, CHANNEL, "^x is nan; accepted: an integer"),
    ("integer", math.inf, CHANNEL, "^x is inf; accepted: an integer"),
    ("integer", True, CHANNEL, "^x is True; accepted: an integer"),
    ("integer", "1e-3", CHANNEL, "^x is '1e-3'; accepted: an integer"),
    ("numbers", None, {}, f"^x is missing; {LISTED}"),
    ("numbers", 1.0, {}, f"^x is 1.0; {LISTED}"),
    ("numbers", "1, 2", {}, f"^x is '1, 2'; {LISTED}"),
    ("numbers", [True], {}, r"^x\[0\] is True; accepted: a number$"),
    ("numbers", [0, 2], UNIT, r"^x\[1\] is 2; accepted: a number from 0.0 to 1.0$"),
    ("numbers", [None], {}, r"^x\[0\] is missing; accepted: a number$"),
    ("flag", None, {}, "^x is missing; accepted: true or false$"),
    ("flag", 1, {}, "^x is 1; accepted: true or false$"),
    ("text", None, {}, "^x is missing; accepted: a text$"),
    ("text", "  ", {}, "^x is '  '; accepted: a text$"),
    ("text", 1, {}, "^x is 1; accepted: a text$"),
    ("path", "my_car/map.csv", {}, "^x is 'my_car/map.csv'; accepted: a whole path, from / on"),
    ("text_or_integer", "", EITHER, "^x is ''; accepted: a text, or an integer of at least 0$"),
    ("text_or_integer", -1, EITHER, "^x is -1; accepted: a text, or an integer of at least 0$"),
    ("text_or_integer", 2 ** 31, EITHER, "^x is 2147483648; accepted: a text"),
    ("text_or_integer", True, EITHER, "^x is True; accepted: a text"),
    ("choice", ["a"], AB, r"^x is \['a'\]; accepted: one of a, b$"),
    ("timeout", -0.1, HALF_S, "^x is -0.1; accepted: a number from 0.0 to 3600.0$"),
    ("timeout", 3601, HALF_S, "^x is 3601; accepted: a number from 0.0 to 3600.0$"),
])
def test_parameter_is_refused_naming_it_its_value_and_what_is_accepted(reader, value, args, message):
    with pytest.raises(ConfigError, match=message):
        read(reader, value, **args)


@pytest.mark.parametrize("value, result", [("0x40", (64, 64, 64)), ([1, 2.0, "3"], (1, 2, 3)), (None, (7, 7, 7))])
def test_integers_of_a_given_length_may_be_one_for_all(value, result):
    assert read("integers", value, length=3, default=7, low=0, high=255) == result


@pytest.mark.parametrize("value, message", [
    ([1, 2], r"^x is \[1, 2\]; accepted: 3 integers, or one for all of them$"),
    ([1, 2, 3, 4], r"^x is \[1, 2, 3, 4\]; accepted: 3 integers, or one for all"),
    ([1, 2, 256], r"^x\[2\] is 256; accepted: an integer from 0 to 255$"),
    (256, "^x is 256; accepted: an integer from 0 to 255, or 3 of them$"),
    ("all", "^x is 'all'; accepted: an integer from 0 to 255, or 3 of them$"),
])
def test_integers_that_do_not_fit_are_refused(value, message):
    with pytest.raises(ConfigError, match=message):
        read("integers", value, length=3, default=7, low=0, high=255)


def test_names_with_a_slash_are_found_in_nested_namespaces():
    Params(None).finish()
    params = Params({"servo": {"channel": 1, "value_axis": [0, 1], "deep": {"er": True}}})
    assert params.integer("servo/channel") == 1
    assert params.numbers("servo/value_axis") == [0.0, 1.0]
    assert params.flag("servo/deep/er") is True
    params.finish()


@pytest.mark.parametrize("private, unknown", [
    ({"x": 1, "servo_centre": 5100}, "servo_centre is 5100"),
    ({"b": 1, "a": 2}, "a is 2"),
    ({"servo": {"chanel": 1}}, "servo/chanel is 1"),
    ({"x": {"y": 1}}, "x/y is 1"),
])
def test_name_that_nobody_asked_for_is_refused_at_the_end(private, unknown):
    params = Params(private)
    params.number("x", 0.0)
    params.number("y", 0.0)
    with pytest.raises(ConfigError, match=f"^unknown parameter {unknown}; accepted: only x, y$"):
        params.finish()


def test_names_below_an_ignored_namespace_are_not_refused_and_not_listed():
    params = Params({"a": {"x": 1, "b": {"y": 2}}, "other": 3})
    assert params.integer("a/x") == 1
    with pytest.raises(ConfigError, match=r"^unknown parameter other is 3; accepted: only a/x$"):
        params.finish(ignored_namespaces=["a"])
    Params({"a": {"x": 1, "b": {"y": 2}}}).finish(ignored_namespaces=["a"])


@pytest.mark.parametrize("private", [{"a": 1}, {"ab": {"x": 1}}, {"b": {"a": {"x": 1}}}])
def test_ignored_namespace_is_neither_a_value_nor_a_part_of_a_name(private):
    with pytest.raises(ConfigError, match=r"^unknown parameter "):
        Params(private).finish(ignored_namespaces=["a"])


def test_name_that_the_namespace_lacks_is_looked_up_outwards_where_that_was_asked_for_and_checked_like_any_other():
    around = {"servo_left": 3800, "m_turnrad_axis_servo": [1, 2], "input_timeout": 9.0, "servo_channel": 20}
    params = Params({}, around.get)
    assert params.integer("servo_left", search_parents=True) == 3800
    assert params.numbers("m_turnrad_axis_servo", search_parents=True) == [1.0, 2.0]
    assert params.timeout("input_timeout", 0.5) == 0.5
    with pytest.raises(ConfigError, match=r"^servo_channel is 20; accepted: an integer from 0 to 15$"):
        params.integer("servo_channel", search_parents=True, **CHANNEL)
    assert Params({"servo_channel": 0}, around.get).integer("servo_channel", search_parents=True) == 0


def test_name_found_nowhere_is_missing_or_its_default():
    params = Params({}, lambda name: None)
    with pytest.raises(ConfigError, match=r"^servo_left is missing; accepted: an integer from 0 to 65535$"):
        params.integer("servo_left", low=0, high=65535, search_parents=True)
    assert params.integer("servo_left", 3800, search_parents=True) == 3800


def test_node_that_was_launched_names_what_the_arguments_chose_and_takes_the_folder_for_no_parameter():
    params = Params({"config_folder": "/home/me/my_car", "device": "/dev/i2c-7", "address": "0x41", "frequency": 50})
    assert params.launched_with() == "config /home/me/my_car, i2c /dev/i2c-7, address 0x41"
    for name, read in (("device", params.text), ("address", params.text), ("frequency", params.number)):
        read(name)
    params.finish()
    assert Params({"device": "/dev/i2c-7"}).launched_with() == ""
