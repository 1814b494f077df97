"""Input events as a gamepad's state with the joystick interface's numbers, and when that is published."""
import math
from typing import NamedTuple

import pytest
from evdev import AbsInfo
from hypothesis import given
from hypothesis import strategies as st
from pads import (
    ABS,
    BYTE_STICK,
    DROPPED,
    EAST,
    F310_D,
    F710_X,
    HAT_X,
    HAT_Y,
    KEY,
    NORTH,
    REPORT,
    RX,
    RY,
    RZ,
    SOUTH,
    SYN,
    TL,
    TR,
    WEST,
    XBOX_BLUETOOTH,
    XPAD_STICK,
    X,
    Y,
    Z,
    listed,
)

from car_interface.common.errors import ConfigError
from car_interface.teleop.input_devices import parse_pads
from car_interface.teleop.joystick import Joystick, JoystickConfig


class Event(NamedTuple):
    """What an evdev.InputEvent has."""

    type: int
    code: int
    value: int


END, DROP = Event(SYN, REPORT, 0), Event(SYN, DROPPED, 0)
LB_DOWN, LB_UP, LB_REPEATS = Event(KEY, TL, 1), Event(KEY, TL, 0), Event(KEY, TL, 2)
LEFT, RIGHT = Event(ABS, X, -32768), Event(ABS, X, 32767)
LB = 4


def axis(low, high, flat):
    return AbsInfo(0, low, high, 0, flat, 0)


def joystick(model=F710_X, deadzone=0.0):
    (pad,) = parse_pads(listed(model, 5), 64)
    return Joystick(pad.keys, {code: axis(*values) for code, values in model.ranges.items()}, deadzone)


# As jstest numbers them on these gamepads.
@pytest.mark.parametrize("model, axes, buttons", [
    (F710_X, [X, Y, Z, RX, RY, RZ, HAT_X, HAT_Y], [SOUTH, EAST, NORTH, WEST, TL, TR]),
    (XBOX_BLUETOOTH, [X, Y, Z, RZ], [SOUTH, EAST, 0x132, NORTH, WEST, 0x135, TL, TR]),
    (F310_D, [X, Y, Z, RZ, HAT_X, HAT_Y], range(0x120, 0x12c)),
], ids=lambda value: getattr(value, "name", ""))
def test_axes_and_buttons_have_the_numbers_of_the_joystick_interface(model, axes, buttons):
    for number, code in enumerate(axes):
        state = joystick(model)
        change, = state.receive([Event(ABS, code, model.ranges[code][0]), END])
        assert [index for index, value in enumerate(change.axes) if value] == [number] and not change.is_urgent
    for number, code in enumerate(buttons):
        change, = joystick(model).receive([Event(KEY, code, 1), END])
        assert [index for index, value in enumerate(change.buttons) if value] == [number] and change.is_urgent


def test_keys_below_the_joysticks_come_last_and_those_of_a_keyboard_have_no_number():
    state = Joystick([0x2c0, 0x110, SOUTH, 167], {})  # a paddle, a mouse button, A, a share button
    for number, code in enumerate([SOUTH, 0x2c0, 0x110]):
        change, = state.receive([Event(KEY, code, 1), END])
        assert change.buttons[number] == 1
    assert state.receive([Event(KEY, 167, 1), END]) == [] and len(state.buttons) == 3


@pytest.mark.parametrize("events, urgent", [
    ([LB_DOWN, LEFT, END], [True]), ([LEFT, END], [False]), ([LB_DOWN, END, LB_UP, END], [True, True]),
    ([LB_DOWN, END, LB_REPEATS, END], [True]), ([Event(4, 4, 0x90001), END], []), ([END], []), ([], []),
], ids=["button_and_stick", "stick", "press_and_release_at_once", "repeat", "scan_code", "empty_report", "nothing"])
def test_a_report_is_a_change_and_a_button_makes_it_urgent(events, urgent):
    assert [change.is_urgent for change in joystick().receive(events)] == urgent


def test_report_that_is_cut_between_two_reads_is_one_change():
    state = joystick()
    assert state.receive([LB_DOWN]) == []
    change, = state.receive([LEFT, END])
    assert (change.axes[0], change.buttons[LB]) == (1.0, 1)


# value > t + flat ? (2^29 / range * (value − t − flat)) >> 14, and likewise below; range = half − 2 flat, t the middle.
@given(st.integers(-40000, 40000), st.sampled_from([XPAD_STICK, BYTE_STICK, (0, 1023, 63), (-1, 1, 0)]))
def test_axis_is_scaled_as_the_joystick_interface_does(position, limits):
    low, high, flat = limits
    middle, slope = int((low + high) / 2), (1 << 29) // ((high - low) // 2 - 2 * flat)
    beyond = position - middle - flat if position > middle + flat else min(0, position - middle + flat)
    expected = -max(-32767, min(32767, slope * beyond >> 14)) / 32767
    state = Joystick([], {X: axis(*limits)}, 0.0)
    state.receive([Event(ABS, X, position), END])
    assert state.axes == [pytest.approx(expected, abs=1e-3)]


@pytest.mark.parametrize("position, expected", [
    (0, 0.0), (1753, 0.0), (-1753, 0.0), (32767, -1.0), (-32768, 1.0), (17196, -0.5), (-17196, 0.5)])
def test_axis_is_zero_in_its_dead_zone_and_rises_to_one_beyond_it(position, expected):
    state = joystick(deadzone=0.05)
    state.receive([Event(ABS, X, position), END])
    assert state.axes[0] == pytest.approx(expected, abs=1e-3)
    assert math.copysign(1, state.axes[0]) == (1 if expected >= 0 else -1)


@pytest.mark.parametrize("limits", [(0, 0, 0), (0, 10, 5)])
def test_axis_without_a_range_stays_at_zero(limits):
    state = Joystick([], {X: axis(*limits)}, 0.0)
    state.receive([Event(ABS, X, 10), END])
    assert state.axes == [0.0]


def test_positions_are_read_at_the_start_and_a_button_that_is_held_then_counts_from_its_next_press_on():
    state = joystick()
    change = state.read_axes({**dict.fromkeys(F710_X.ranges, 0), X: -32768})
    assert (change.axes[:2], change.axes[2], change.buttons, change.is_urgent) == ((1.0, 0.0), 1.0, (0,) * 11, False)
    change, = state.receive([LB_UP, END])
    assert not any(change.buttons)
    change, = state.receive([LB_DOWN, END])
    assert change.buttons[LB] == 1


def test_lost_events_release_every_button_at_once_and_nothing_counts_until_the_axes_were_read():
    state = joystick()
    state.receive([LB_DOWN, RIGHT, END])
    released, = state.receive([DROP, LB_DOWN, LEFT])
    assert released.axes[0] == -1.0  # invented at rest, teleop_logi would trust the axis for that
    assert (released.buttons, released.is_urgent, state.is_lost, state.losses) == ((0,) * 11, True, False, 1)
    assert state.receive([LB_DOWN]) == []  # still the report that the kernel began to drop
    assert state.receive([END, LB_DOWN, END]) == [] and state.is_lost
    change = state.read_axes({X: 32767})
    assert (change.axes[0], change.buttons, state.is_lost) == (-1.0, (0,) * 11, False)
    assert state.receive([LB_UP, END])[0].buttons[LB] == 0
    assert state.receive([LB_DOWN, END])[0].buttons[LB] == 1


@pytest.mark.parametrize("dev", ["js0", "none", ""])
def test_device_is_a_path_or_any(dev):
    with pytest.raises(ConfigError, match=r"dev.*auto, or a path such as /dev/input/event5"):
        JoystickConfig(dev=dev)
    assert [JoystickConfig(dev=right).dev for right in ("auto", "/dev/input/event5")] == ["auto", "/dev/input/event5"]
