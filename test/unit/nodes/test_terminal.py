"""Lines that are drawn over on a terminal, and only those that stay elsewhere."""
import io
import sys

import pytest

pytest.importorskip("rospy")

from car_interface.nodes.terminal import LiveText
from car_interface.ros.logs import LogStream


class Screen(io.StringIO):
    def __init__(self, is_terminal):
        super().__init__()
        self._is_terminal = is_terminal

    def isatty(self):
        return self._is_terminal


@pytest.fixture
def screen(monkeypatch):
    def make(is_terminal):
        made = Screen(is_terminal)
        monkeypatch.setattr(sys, "stdout", made)
        return made
    return make


def test_block_is_drawn_over_when_it_has_changed(screen):
    shown, text = screen(True), LiveText()
    text.show(["a", "b"])
    text.show(["a", "b"])
    text.show(["c"])
    assert shown.getvalue() == "\r\x1b[Ja\nb\n\r\x1b[2A\x1b[Jc\n"


def test_line_that_stays_takes_the_block_s_place_unless_that_is_kept(screen):
    shown, text = screen(True), LiveText()
    text.show(["a"])
    text.say("stays")
    text.show(["a"])
    assert shown.getvalue() == "\r\x1b[Ja\n\r\x1b[1A\x1b[Jstays\n\r\x1b[Ja\n"
    text.keep()
    text.say("below")
    assert shown.getvalue().endswith("\x1b[Ja\n\r\x1b[Jbelow\n")


@pytest.mark.parametrize("name, is_elsewhere, expected", [
    ("stdout", False, "\r\x1b[Ja\nb\na warning\n\r\x1b[Jc\n\r\x1b[1A\x1b[Jd\n"),
    ("stderr", False, "\r\x1b[Ja\nb\na warning\n\r\x1b[Jc\n\r\x1b[1A\x1b[Jd\n"),
    ("stderr", True, "\r\x1b[Ja\nb\n\r\x1b[2A\x1b[Jc\n\r\x1b[1A\x1b[Jd\n"),
])
def test_block_below_which_something_was_printed_is_left_as_it_is(screen, monkeypatch, name, is_elsewhere, expected):
    shown = screen(True)
    monkeypatch.setattr(sys, "stdout", LogStream(shown))
    monkeypatch.setattr(sys, "stderr", LogStream(Screen(False) if is_elsewhere else shown))
    text = LiveText()
    text.show(["a", "b"])
    getattr(sys, name).write("a warning\n")
    text.show(["c"])
    text.show(["d"])
    assert shown.getvalue() == expected


def test_elsewhere_only_lines_that_stay_are_printed(screen):
    shown, text = screen(False), LiveText()
    text.show(["a"])
    text.say("stays")
    assert (text.is_live, shown.getvalue()) == (False, "stays\n")
