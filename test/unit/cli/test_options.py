"""Options that several commands have in common."""
from __future__ import annotations

import argparse

import pytest

from car_interface.cli.options import add_namespace_argument, finite, length_m


def parser():
    made = argparse.ArgumentParser()
    add_namespace_argument(made)
    made.add_argument("--number", type=finite)
    return made


def test_namespace_has_a_short_and_a_long_option_and_is_the_root_by_default():
    assert parser().parse_args([]).namespace == "/"
    for option in ("--ns", "--namespace"):
        assert parser().parse_args([option, "/car1"]).namespace == "/car1"


@pytest.mark.parametrize("text, number", [("0", 0.0), ("-1.5", -1.5), (" 2 ", 2.0), ("1e3", 1000.0), ("+.25", 0.25)])
def test_finite_number_is_read(text, number):
    assert finite(text) == number


@pytest.mark.parametrize("text", ["nan", "inf", "-inf", "Infinity", "1e999", "", "a", "1,5", "0x10"])
def test_text_that_is_no_finite_number_is_refused_by_its_text(text):
    with pytest.raises(argparse.ArgumentTypeError) as caught:
        finite(text)
    assert str(caught.value) == f"'{text}' is no finite number"


@pytest.mark.parametrize("text", ["0", "-1", "-0.3"])
def test_length_is_above_0(text):
    assert length_m("0.324") == 0.324
    with pytest.raises(argparse.ArgumentTypeError) as caught:
        length_m(text)
    assert str(caught.value) == f"{text!r} is no length above 0 m"


def test_parser_names_the_option_and_ends_with_2(capsys):
    with pytest.raises(SystemExit) as caught:
        parser().parse_args(["--number", "a"])
    assert caught.value.code == 2 and "argument --number: 'a' is no finite number\n" in capsys.readouterr().err
