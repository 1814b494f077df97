"""Options that several commands have in common."""
from __future__ import annotations

import argparse

import pytest

from car_interface.cli.options import finite, length_m


@pytest.mark.parametrize("text, number", [("-1.5", -1.5), (" 2 ", 2.0), ("1e3", 1000.0)])
def test_finite_number_is_read(text, number):
    assert finite(text) == number


@pytest.mark.parametrize("text", ["nan", "-inf", "1e999", "", "1,5"])
def test_text_that_is_no_finite_number_is_refused_by_its_text(text):
    with pytest.raises(argparse.ArgumentTypeError) as caught:
        finite(text)
    assert str(caught.value) == f"'{text}' is no finite number"


@pytest.mark.parametrize("text", ["0", "-0.3"])
def test_length_is_above_0(text):
    assert length_m("0.324") == 0.324
    with pytest.raises(argparse.ArgumentTypeError) as caught:
        length_m(text)
    assert str(caught.value) == f"{text!r} is no length above 0 m"
