"""The kernel's joystick events as a gamepad's state, and when that is published.

The bytes are written out by hand from struct js_event of the kernel's documentation.
"""
from __future__ import annotations

import math
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from car_interface.common.errors import ConfigError
from car_interface.teleop.joystick import Joystick, Pacing

MS, S = 1_000_000, 1_000_000_000
pytestmark = pytest.mark.skipif(sys.byteorder != "little", reason="the bytes below are those of such a computer")
# time in ms (4), value (2), type, number
LB_DOWN = bytes.fromhex("04030201 0100 01 04")
LB_UP = bytes.fromhex("05030201 0000 01 04")
STICK_LEFT = bytes.fromhex("04030201 0180 02 00")  # −32767
STICK_RIGHT = bytes.fromhex("04030201 ff7f 02 00")  # 32767
INIT_LB_DOWN = bytes.fromhex("04030201 0100 81 04")
INIT_STICK_LEFT = bytes.fromhex("04030201 0180 82 00")
UNKNOWN_KIND = bytes.fromhex("04030201 0100 04 00")


def state(data, deadzone=0.0):
    joystick = Joystick(deadzone)
    joystick.receive(data)
    return joystick.axes, joystick.buttons


def axis(value):
    return bytes(4) + value.to_bytes(2, "little", signed=True) + b"\x02\x00"


# Events


@pytest.mark.parametrize(("data", "axes", "buttons"), [
    pytest.param(LB_DOWN, [], [0, 0, 0, 0, 1], id="button_pressed"),
    pytest.param(LB_DOWN + LB_UP, [], [0, 0, 0, 0, 0], id="button_released"),
    pytest.param(STICK_LEFT, [1.0], [], id="stick_left_is_plus_one"),
    pytest.param(STICK_RIGHT, [-1.0], [], id="stick_right_is_minus_one"),
    pytest.param(INIT_LB_DOWN + INIT_STICK_LEFT, [1.0], [0, 0, 0, 0, 1], id="state_at_opening_counts"),
    pytest.param(UNKNOWN_KIND, [], [], id="unknown_kind_changes_nothing"),
    pytest.param(bytes.fromhex("00000000 0100 01 ff"), [], [], id="button_255_changes_nothing"),
    pytest.param(b"", [], [], id="nothing"),
])
def test_events_are_the_state_that_they_say(data, axes, buttons):
    assert state(data) == (axes, buttons)


@pytest.mark.parametrize("size", [1, 3, 5, 7, 8, 11])
def test_event_split_across_reads_is_the_same(size):
    data = INIT_STICK_LEFT + LB_DOWN + STICK_RIGHT + LB_UP + LB_DOWN
    joystick, changes = Joystick(0.0), []
    for at in range(0, len(data), size):
        changes += joystick.receive(data[at:at + size])
    assert changes == Joystick(0.0).receive(data)
    assert (joystick.axes, joystick.buttons) == ([-1.0], [0, 0, 0, 0, 1])


def test_release_and_press_in_one_read_are_two_changes():
    joystick = Joystick(0.0)
    joystick.receive(LB_DOWN)
    assert [change.buttons[4] for change in joystick.receive(LB_UP + LB_DOWN)] == [0, 1]


@pytest.mark.parametrize(("data", "urgent"), [(LB_DOWN, True), (LB_UP, True), (INIT_LB_DOWN, False),
                                              (STICK_LEFT, False), (INIT_STICK_LEFT, False)])
def test_only_a_button_that_changed_is_urgent(data, urgent):
    assert [change.is_urgent for change in Joystick().receive(data)] == [urgent]


@pytest.mark.parametrize(("value", "expected"), [
    (0, 0.0), (1638, 0.0), (-1638, 0.0), (32767, -1.0), (-32767, 1.0), (-32768, 1.0), (17203, -0.5), (-17203, 0.5)])
def test_axis_is_zero_in_its_dead_zone_and_rises_to_one_beyond_it(value, expected):
    (found,), _ = state(axis(value), 0.05)
    assert found == pytest.approx(expected, abs=1e-4) and math.copysign(1, found) == (1 if expected >= 0 else -1)


@given(st.binary(max_size=200), st.floats(0, 0.9))
def test_any_bytes_give_axes_within_one_and_buttons_of_zero_and_one(data, deadzone):
    axes, buttons = state(data, deadzone)
    assert all(-1 <= value <= 1 for value in axes) and set(buttons) <= {0, 1}
    assert len(axes) <= 64 and len(buttons) <= 64


def test_events_that_are_ignored_are_counted():
    joystick = Joystick()
    joystick.receive(UNKNOWN_KIND + LB_DOWN + bytes.fromhex("00000000 0100 01 40"))
    assert joystick.ignored == 2


@pytest.mark.parametrize("deadzone", [-0.1, 1.0, math.nan])
def test_dead_zone_without_an_axis_beyond_it_is_refused(deadzone):
    with pytest.raises(ConfigError, match=r"deadzone is .*; accepted: a number from 0 to less than 1"):
        Joystick(deadzone)


# Pacing


def test_axes_wait_for_each_other_and_the_state_is_repeated():
    pacing = Pacing(0.001, 20.0)
    assert pacing.due_ns == math.inf  # nothing was received: there is nothing to publish
    pacing.changed(5 * S)
    pacing.changed(5 * S + MS // 2)
    assert pacing.due_ns == 5 * S + MS
    pacing.published(5 * S + MS)
    assert pacing.due_ns == 5 * S + 51 * MS


def test_state_of_a_device_that_is_gone_is_not_repeated():
    pacing = Pacing(0.001, 20.0)
    pacing.published(S)
    pacing.stop()
    assert pacing.due_ns == math.inf


def test_without_autorepeat_only_changes_are_published():
    pacing = Pacing(0.001, 0.0)
    pacing.changed(S)
    pacing.published(S + MS)
    assert pacing.due_ns == math.inf
