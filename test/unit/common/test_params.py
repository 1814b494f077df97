"""A node's parameters: what each reader accepts and what it says of the rest. No ROS is needed to read them."""
from __future__ import annotations

import math

import pytest

from car_interface.common.errors import ConfigError
from car_interface.common.params import Params


def read(reader, value, *args, **kwargs):
    """What a reader makes of the one parameter ``x``; value None = it isn't there."""
    return getattr(Params({} if value is None else {"x": value}), reader)("x", *args, **kwargs)


@pytest.mark.parametrize("reader, value, args, result", [
    pytest.param("number", 0.5, {}, 0.5, id="number_that_is_a_float"),
    pytest.param("number", 10, {}, 10.0, id="number_that_is_an_integer"),
    pytest.param("number", "1e-3", {}, 0.001, id="number_as_a_text_with_an_exponent"),
    pytest.param("number", "25e6", {}, 25e6, id="number_as_yaml_reads_25e6"),
    pytest.param("number", "0x40", {}, 64.0, id="number_in_hex"),
    pytest.param("number", " -2 ", {}, -2.0, id="number_as_a_text_with_spaces"),
    pytest.param("number", 0, {"low": 0, "high": 1}, 0.0, id="number_at_its_lower_limit"),
    pytest.param("number", 1, {"low": 0, "high": 1}, 1.0, id="number_at_its_upper_limit"),
    pytest.param("number", 1e-9, {"above": 0}, 1e-9, id="number_just_above"),
    pytest.param("number", None, {"default": 0.25}, 0.25, id="number_by_default"),
    pytest.param("number", None, {"default": 3}, 3.0, id="number_by_an_integer_default"),
    pytest.param("number", None, {"default": None}, None, id="number_that_may_be_missing"),
    pytest.param("integer", 64, {}, 64, id="integer"),
    pytest.param("integer", "0x40", {}, 64, id="integer_in_hex"),
    pytest.param("integer", "64", {}, 64, id="integer_as_a_text"),
    pytest.param("integer", "-5", {}, -5, id="negative_integer_as_a_text"),
    pytest.param("integer", 64.0, {}, 64, id="integer_as_a_float_without_a_fraction"),
    pytest.param("integer", 0, {"low": 0, "high": 15}, 0, id="integer_at_its_lower_limit"),
    pytest.param("integer", 15, {"low": 0, "high": 15}, 15, id="integer_at_its_upper_limit"),
    pytest.param("integer", -2 ** 31, {}, -2 ** 31, id="least_integer_that_the_parameter_server_takes"),
    pytest.param("integer", 2 ** 31 - 1, {}, 2 ** 31 - 1, id="greatest_integer_that_it_takes"),
    pytest.param("text_or_integer", 0, {"default": "a"}, 0, id="text_or_integer_that_is_0"),
    pytest.param("integer", None, {"default": 7}, 7, id="integer_by_default"),
    pytest.param("integer", None, {"default": None}, None, id="integer_that_may_be_missing"),
    pytest.param("numbers", [1, 2.5, "1e-3"], {}, [1.0, 2.5, 0.001], id="numbers_of_any_spelling"),
    pytest.param("numbers", (1, 2), {}, [1.0, 2.0], id="numbers_in_a_tuple"),
    pytest.param("numbers", [], {}, [], id="no_numbers"),
    pytest.param("numbers", None, {"default": ()}, [], id="numbers_by_default"),
    pytest.param("flag", True, {}, True, id="flag_that_is_true"),
    pytest.param("flag", False, {}, False, id="flag_that_is_false"),
    pytest.param("flag", None, {"default": True}, True, id="flag_by_default"),
    pytest.param("text", "/dev/ttyAMA0", {}, "/dev/ttyAMA0", id="text"),
    pytest.param("text", None, {"default": "/dev/ttyAMA0"}, "/dev/ttyAMA0", id="text_by_default"),
    pytest.param("text", None, {"default": None}, None, id="text_that_may_be_missing"),
    pytest.param("text", "", {"may_be_empty": True}, "", id="text_that_may_be_empty"),
    pytest.param("path", "/home/me/my_car/map.csv", {}, "/home/me/my_car/map.csv", id="whole_path"),
    pytest.param("path", None, {"default": None}, None, id="path_that_may_be_missing"),
    pytest.param("text_or_integer", "/dev/i2c-1", {"default": "a"}, "/dev/i2c-1", id="text_or_integer_that_is_a_text"),
    pytest.param("text_or_integer", 1, {"default": "a"}, 1, id="text_or_integer_that_is_an_integer"),
    pytest.param("text_or_integer", "1", {"default": "a"}, 1, id="text_or_integer_that_spells_one"),
    pytest.param("text_or_integer", None, {"default": "a"}, "a", id="text_or_integer_by_default"),
    pytest.param("choice", "b", {"default": "a", "choices": ("a", "b")}, "b", id="choice"),
    pytest.param("choice", None, {"default": "a", "choices": ("a", "b")}, "a", id="choice_by_default"),
    pytest.param("timeout", 0, {"default": 0.5}, 0.0, id="timeout_of_0"),
    pytest.param("timeout", 3600, {"default": 0.5}, 3600.0, id="timeout_of_an_hour"),
    pytest.param("timeout", None, {"default": 0.5}, 0.5, id="timeout_by_default"),
])
def test_parameter_is_read_as(reader, value, args, result):
    found = read(reader, value, **args)
    assert found == result
    assert type(found) is type(result)


NUMBER_0_TO_1 = {"low": 0.0, "high": 1.0}
CHANNEL = {"low": 0, "high": 15}


@pytest.mark.parametrize("reader, value, args, message", [
    pytest.param("number", None, {}, "^x is missing; accepted: a number$", id="number_missing"),
    pytest.param("number", None, NUMBER_0_TO_1, "^x is missing; accepted: a number from 0.0 to 1.0$",
                 id="number_with_a_range_missing"),
    pytest.param("number", True, {}, "^x is True; accepted: a number$", id="true_is_no_number"),
    pytest.param("number", False, NUMBER_0_TO_1, "^x is False; accepted: a number", id="false_is_no_number"),
    pytest.param("number", "fast", {}, "^x is 'fast'; accepted: a number$", id="word_is_no_number"),
    pytest.param("number", "", {}, "^x is ''; accepted: a number$", id="empty_text_is_no_number"),
    pytest.param("number", [1], {}, r"^x is \[1\]; accepted: a number$", id="list_is_no_number"),
    pytest.param("number", math.nan, {}, "^x is nan; accepted: a number$", id="nan"),
    pytest.param("number", "nan", {}, "^x is 'nan'; accepted: a number$", id="nan_as_a_text"),
    pytest.param("number", "inf", {}, "^x is 'inf'; accepted: a number$", id="infinity_as_a_text"),
    pytest.param("number", "1e999", {}, "^x is '1e999'; accepted: a number$", id="number_too_great"),
    pytest.param("number", "0x" + "f" * 300, {}, "^x is '0xfff", id="hex_number_too_great"),
    pytest.param("number", -0.1, NUMBER_0_TO_1, "^x is -0.1; accepted: a number from 0.0 to 1.0$",
                 id="number_below_its_range"),
    pytest.param("number", 1.1, NUMBER_0_TO_1, "^x is 1.1; accepted: a number from 0.0 to 1.0$",
                 id="number_above_its_range"),
    pytest.param("number", -1, {"low": 0}, "^x is -1; accepted: a number of at least 0$", id="number_below_its_least"),
    pytest.param("number", 0, {"above": 0.0}, "^x is 0; accepted: a number above 0.0$", id="number_not_above"),
    pytest.param("number", "1_0", {}, "^x is '1_0'; accepted: a number", id="number_with_an_underscore"),
    pytest.param("number", "١٢", {}, "^x is '١٢'; accepted: a number", id="number_in_arabic_digits"),
    pytest.param("integer", "1_0", CHANNEL, "^x is '1_0'; accepted: an integer", id="integer_with_an_underscore"),
    pytest.param("integer", "٣", CHANNEL, "^x is '٣'; accepted: an integer", id="integer_in_arabic_digits"),
    pytest.param("number", "0x0", {"above": 0.0}, "^x is '0x0'; accepted: a number above 0.0$",
                 id="hex_number_not_above"),
    pytest.param("number", 9, {"above": 0.0, "high": 5}, "^x is 9; accepted: a number above 0.0, at most 5$",
                 id="number_above_but_too_great"),
    pytest.param("integer", None, CHANNEL, "^x is missing; accepted: an integer from 0 to 15$", id="integer_missing"),
    pytest.param("integer", 20, CHANNEL, "^x is 20; accepted: an integer from 0 to 15$", id="integer_above_its_range"),
    pytest.param("integer", -1, CHANNEL, "^x is -1; accepted: an integer from 0 to 15$", id="integer_below_its_range"),
    pytest.param("integer", -2.0 ** 31 - 1, {}, "accepted: an integer from -2147483648 to 2147483647$",
                 id="integer_too_small_for_the_parameter_server"),
    pytest.param("integer", 2.0 ** 31, {}, "accepted: an integer from -2147483648 to 2147483647$",
                 id="integer_too_great_for_the_parameter_server"),
    pytest.param("integer", 0.5, CHANNEL, "^x is 0.5; accepted: an integer", id="fraction_is_no_integer"),
    pytest.param("integer", math.nan, CHANNEL, "^x is nan; accepted: an integer", id="nan_is_no_integer"),
    pytest.param("integer", math.inf, CHANNEL, "^x is inf; accepted: an integer", id="infinity_is_no_integer"),
    pytest.param("integer", True, CHANNEL, "^x is True; accepted: an integer", id="true_is_no_integer"),
    pytest.param("integer", "1e-3", CHANNEL, "^x is '1e-3'; accepted: an integer",
                 id="text_with_a_fraction_is_no_integer"),
    pytest.param("integer", "zero", CHANNEL, "^x is 'zero'; accepted: an integer", id="word_is_no_integer"),
    pytest.param("numbers", None, {}, "^x is missing; accepted: a list, each a number$", id="numbers_missing"),
    pytest.param("numbers", 1.0, {}, "^x is 1.0; accepted: a list, each a number$", id="one_number_is_no_list"),
    pytest.param("numbers", "1, 2", {}, "^x is '1, 2'; accepted: a list, each a number$", id="text_is_no_list"),
    pytest.param("numbers", [1, "two"], {}, r"^x\[1\] is 'two'; accepted: a number$", id="word_in_a_list"),
    pytest.param("numbers", [True], {}, r"^x\[0\] is True; accepted: a number$", id="true_in_a_list"),
    pytest.param("numbers", [0, 2], NUMBER_0_TO_1, r"^x\[1\] is 2; accepted: a number from 0.0 to 1.0$",
                 id="number_beyond_its_range_in_a_list"),
    pytest.param("numbers", [None], {}, r"^x\[0\] is missing; accepted: a number$", id="nothing_in_a_list"),
    pytest.param("flag", None, {}, "^x is missing; accepted: true or false$", id="flag_missing"),
    pytest.param("flag", 1, {}, "^x is 1; accepted: true or false$", id="one_is_no_flag"),
    pytest.param("flag", "true", {}, "^x is 'true'; accepted: true or false$", id="text_is_no_flag"),
    pytest.param("text", None, {}, "^x is missing; accepted: a text$", id="text_missing"),
    pytest.param("text", "", {}, "^x is ''; accepted: a text$", id="empty_text"),
    pytest.param("text", "  ", {}, "^x is '  '; accepted: a text$", id="blank_text"),
    pytest.param("text", 1, {}, "^x is 1; accepted: a text$", id="number_is_no_text"),
    pytest.param("text_or_integer", "", {"default": "a"}, "^x is ''; accepted: a text, or an integer of at least 0$",
                 id="empty_text_or_integer"),
    pytest.param("text_or_integer", -1, {"default": "a"}, "^x is -1; accepted: a text, or an integer of at least 0$",
                 id="negative_text_or_integer"),
    pytest.param("text_or_integer", True, {"default": "a"},
                 "^x is True; accepted: a text, or an integer of at least 0$",
                 id="true_is_neither_text_nor_integer"),
    pytest.param("choice", "c", {"default": "a", "choices": ("a", "b")}, "^x is 'c'; accepted: one of a, b$",
                 id="choice_that_is_none"),
    pytest.param("choice", ["a"], {"default": "a", "choices": ("a", "b")}, r"^x is \['a'\]; accepted: one of a, b$",
                 id="list_is_no_choice"),
    pytest.param("timeout", -0.1, {"default": 0.5}, "^x is -0.1; accepted: a number from 0.0 to 3600.0$",
                 id="negative_timeout"),
    pytest.param("timeout", 3601, {"default": 0.5}, "^x is 3601; accepted: a number from 0.0 to 3600.0$",
                 id="timeout_of_more_than_an_hour"),
])
def test_parameter_is_refused_naming_it_its_value_and_what_is_accepted(reader, value, args, message):
    with pytest.raises(ConfigError, match=message):
        read(reader, value, **args)


def test_default_out_of_range_is_refused_like_any_value():
    with pytest.raises(ConfigError, match=r"^x is 20; accepted: an integer from 0 to 15$"):
        read("integer", None, default=20, **CHANNEL)


@pytest.mark.parametrize("value, result", [
    pytest.param(250, [250, 250, 250], id="a_scalar_stands_for_all"),
    pytest.param("0x40", [64, 64, 64], id="a_scalar_in_hex_too"),
    pytest.param([1, 2.0, "3"], [1, 2, 3], id="a_list_is_taken_as_it_is"),
    pytest.param(None, [7, 7, 7], id="the_default_stands_for_all"),
])
def test_integers_of_a_given_length(value, result):
    assert read("integers", value, length=3, default=7, low=0, high=255) == result


@pytest.mark.parametrize("value, message", [
    pytest.param([1, 2], r"^x is \[1, 2\]; accepted: 3 integers, or one for all of them$", id="list_too_short"),
    pytest.param([1, 2, 3, 4], r"^x is \[1, 2, 3, 4\]; accepted: 3 integers, or one for all", id="list_too_long"),
    pytest.param([], r"^x is \[\]; accepted: 3 integers, or one for all", id="empty_list"),
    pytest.param([1, 2, 256], r"^x\[2\] is 256; accepted: an integer from 0 to 255$", id="element_out_of_range"),
    pytest.param([1, True, 3], r"^x\[1\] is True; accepted: an integer from 0 to 255$", id="true_in_the_list"),
    pytest.param(256, "^x is 256; accepted: an integer from 0 to 255, or 3 of them$", id="scalar_out_of_range"),
    pytest.param("all", "^x is 'all'; accepted: an integer from 0 to 255, or 3 of them$", id="word"),
])
def test_integers_that_do_not_fit_are_refused(value, message):
    with pytest.raises(ConfigError, match=message):
        read("integers", value, length=3, default=7, low=0, high=255)


def test_names_with_a_slash_are_found_in_nested_namespaces():
    params = Params({"servo": {"channel": 1, "value_axis": [0, 1], "deep": {"er": True}}})
    assert params.integer("servo/channel") == 1
    assert params.numbers("servo/value_axis") == [0.0, 1.0]
    assert params.flag("servo/deep/er") is True
    params.finish()


@pytest.mark.parametrize("private", [None, {}], ids=["no_namespace", "an_empty_one"])
def test_namespace_without_parameters_leaves_the_defaults(private):
    params = Params(private)
    assert params.number("x", 0.5) == 0.5
    params.finish()


@pytest.mark.parametrize("private, message", [
    pytest.param({"x": 1, "servo_centre": 5100}, "^unknown parameter servo_centre is 5100; accepted: only x, y$",
                 id="a_typing_error"),
    pytest.param({"b": 1, "a": 2}, "^unknown parameter a is 2; accepted: only x, y$", id="the_first_of_several"),
    pytest.param({"servo": {"chanel": 1}}, "^unknown parameter servo/chanel is 1; accepted: only x, y$",
                 id="one_in_a_nested_namespace"),
    pytest.param({"x": {"y": 1}}, "^unknown parameter x/y is 1; accepted: only x, y$",
                 id="a_namespace_where_a_value_should_be"),
])
def test_name_that_nobody_asked_for_is_refused_at_the_end(private, message):
    params = Params(private)
    params.number("x", 0.0)
    params.number("y", 0.0)
    with pytest.raises(ConfigError, match=message):
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


def test_name_that_the_namespace_lacks_is_looked_up_outwards_where_that_was_asked_for():
    around = {"servo_left": 3800, "m_turnrad_axis_servo": [1, 2], "input_timeout": 9.0, "k": 1.5}
    params = Params({}, around.get)
    assert params.integer("servo_left", search_parents=True) == 3800
    assert params.numbers("m_turnrad_axis_servo", search_parents=True) == [1.0, 2.0]
    assert params.number("k", search_parents=True) == 1.5
    assert params.timeout("input_timeout", 0.5) == 0.5
    params.finish()


@pytest.mark.parametrize("reader, args", [
    pytest.param("number", {"default": 1.5}, id="number"),
    pytest.param("integer", {"default": 2}, id="integer"),
    pytest.param("numbers", {"default": [3.0]}, id="numbers"),
    pytest.param("integers", {"default": 4, "length": 2, "low": 0, "high": 9}, id="integers"),
    pytest.param("flag", {"default": False}, id="flag"),
    pytest.param("text", {"default": "five"}, id="text"),
    pytest.param("text_or_integer", {"default": "six"}, id="text_or_integer"),
    pytest.param("choice", {"default": "a", "choices": ("a", "b")}, id="choice"),
    pytest.param("timeout", {"default": 7.0}, id="timeout"),
])
def test_reader_does_not_look_outwards_unasked(reader, args):
    assert getattr(Params({}, lambda name: pytest.fail(f"{name} was looked up outwards")), reader)("x", **args) in (
        args["default"], [args["default"]] * 2)


def test_name_in_the_namespace_wins_over_one_outwards_even_as_0():
    params = Params({"servo_channel": 0}, {"servo_channel": 5}.get)
    assert params.integer("servo_channel", search_parents=True) == 0


def test_name_found_nowhere_is_missing_or_its_default():
    params = Params({}, lambda name: None)
    with pytest.raises(ConfigError, match=r"^servo_left is missing; accepted: an integer from 0 to 65535$"):
        params.integer("servo_left", low=0, high=65535, search_parents=True)
    assert params.integer("servo_left", 3800, search_parents=True) == 3800


def test_name_found_outwards_is_checked_like_any_other():
    params = Params({}, {"servo_channel": 20}.get)
    with pytest.raises(ConfigError, match=r"^servo_channel is 20; accepted: an integer from 0 to 15$"):
        params.integer("servo_channel", search_parents=True, **CHANNEL)
