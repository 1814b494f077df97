"""The kernel's joystick events as a gamepad's state, and when that is published.

The bytes are written out by hand from struct js_event of the kernel's documentation.
"""
from __future__ import annotations

import math
import sys

import pytest

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


@pytest.mark.parametrize(("data", "axes", "buttons", "urgent"), [
    (LB_DOWN, [], [0, 0, 0, 0, 1], [True]),
    (LB_DOWN + LB_UP, [], [0, 0, 0, 0, 0], [True, True]),
    (STICK_LEFT, [1.0], [], [False]),
    (STICK_RIGHT, [-1.0], [], [False]),
    (bytes.fromhex("04030201 0180 02 01"), [0.0, 1.0], [], [False]),
    (INIT_LB_DOWN + INIT_STICK_LEFT, [1.0], [0, 0, 0, 0, 1], [False, False]),
    (UNKNOWN_KIND + bytes.fromhex("00000000 0100 01 40"), [], [], []),
    (b"", [], [], []),
])
def test_events_are_the_state_that_they_say_and_only_a_button_that_changed_is_urgent(data, axes, buttons, urgent):
    joystick = Joystick(0.0)
    assert [change.is_urgent for change in joystick.receive(data)] == urgent
    assert (joystick.axes, joystick.buttons) == (axes, buttons)
    assert joystick.ignored == len(data) // 8 - len(urgent)


@pytest.mark.parametrize("size", [1, 3, 7, 8, 11])
def test_event_split_across_reads_is_the_same_and_release_and_press_in_one_read_are_two_changes(size):
    data = INIT_STICK_LEFT + LB_DOWN + STICK_RIGHT + LB_UP + LB_DOWN
    joystick, changes = Joystick(0.0), []
    for at in range(0, len(data), size):
        changes += joystick.receive(data[at:at + size])
    assert changes == Joystick(0.0).receive(data)
    assert [change.buttons[4:] for change in changes] == [(), (1,), (1,), (0,), (1,)]
    assert (joystick.axes, joystick.buttons) == ([-1.0], [0, 0, 0, 0, 1])


@pytest.mark.parametrize(("value", "expected"), [
    (0, 0.0), (1638, 0.0), (-1638, 0.0), (32767, -1.0), (-32768, 1.0), (17203, -0.5), (-17203, 0.5)])
def test_axis_is_zero_in_its_dead_zone_and_rises_to_one_beyond_it(value, expected):
    joystick = Joystick()
    joystick.receive(bytes(4) + value.to_bytes(2, "little", signed=True) + b"\x02\x00")
    assert joystick.axes == [pytest.approx(expected, abs=1e-4)]
    assert math.copysign(1, joystick.axes[0]) == (1 if expected >= 0 else -1)


def test_axes_wait_for_each_other_and_the_state_is_repeated_until_the_device_is_gone():
    pacing = Pacing(0.001, 20.0)
    assert pacing.due_ns == math.inf  # nothing was received: there is nothing to publish
    pacing.changed(5 * S)
    pacing.changed(5 * S + MS // 2)
    assert pacing.due_ns == 5 * S + MS
    pacing.published(5 * S + MS)
    assert pacing.due_ns == 5 * S + 51 * MS
    pacing.stop()
    assert pacing.due_ns == math.inf


def test_without_autorepeat_only_changes_are_published():
    pacing = Pacing(0.001, 0.0)
    pacing.changed(S)
    pacing.published(S + MS)
    assert pacing.due_ns == math.inf
