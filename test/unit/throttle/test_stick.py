"""The human's throttle stick: dead band, expo, and the scale that two buttons change."""
from __future__ import annotations

import pytest

from car_interface.common.declared import read
from car_interface.common.errors import ConfigError
from car_interface.common.params import Params
from car_interface.throttle.stick import Scale, StickConfig, shaped


@pytest.mark.parametrize("request_, deadband, expo, expected", [
    (0.05, 0.05, 0.0, 0.0), (-0.05, 0.05, 0.0, 0.0), (0.525, 0.05, 0.0, 0.5), (-1.0, 0.05, 0.0, -1.0),
    (7.0, 0.05, 0.0, 1.0), (0.5, 0.0, 1.0, 0.125), (0.5, 0.0, 0.5, 0.3125), (-0.5, 0.0, 1.0, -0.125),
    (0.01, 0.0, 0.0, 0.01)])
def test_stick_is_shaped(request_, deadband, expo, expected):
    assert shaped(request_, deadband, expo) == pytest.approx(expected)


def press(scale, *buttons):
    return [scale.update(button) for button in buttons]


@pytest.mark.parametrize("buttons, value", [
    ((0, 1), 0.4),
    ((0, 1, 0, -1, 0, -1), 0.2),
    ((0, 1, 1, 1, 1), 0.4),
    ((1, 1), 0.3),  # a node that was restarted gets the last message of the gamepad
    ((0, 2, 0, -2, 100), 0.3),
])
def test_scale_changes_by_a_step_each_time_that_a_button_is_pressed(buttons, value):
    scale = Scale(StickConfig(human_scale=0.3, scale_step=0.1))
    changes = press(scale, *buttons)
    assert scale.value == value
    assert any(changes) == (value != 0.3) and not changes[0]


@pytest.mark.parametrize("start, step, least", [(0.3, 0.2, 0.2), (0.05, 0.1, 0.05), (0.3, 0.0, 0.3)])
def test_scale_ends_at_1_and_at_the_smaller_of_a_step_and_the_start_and_a_step_of_0_changes_nothing(start, step, least):
    scale = Scale(StickConfig(human_scale=start, scale_step=step))
    press(scale, *[0, 1] * 20)
    assert scale.value == (1.0 if step else start)
    assert press(scale, 0, 1) == [False, False]
    press(scale, *[0, -1] * 20)
    assert scale.value == pytest.approx(least)


def test_defaults_are_a_third_forward_and_the_whole_brake():
    assert read(Params({}), StickConfig) == StickConfig(deadband=0.05, expo=0.0, human_scale=0.3, brake_scale=1.0,
                                                 scale_step=0.1)


@pytest.mark.parametrize("name, value, accepted", [
    ("tele_throt_deadband", 0.6, "a number from 0 to 0.5"),
    ("expo", 1.1, "a number from 0 to 1"),
    ("human_scale", 1.5, "a number from 0 to 1"),
    ("brake_scale", -0.1, "a number from 0 to 1"),
    ("scale_step", "x", "a number from 0 to 1"),
])
def test_parameter_out_of_range_is_refused_by_its_name(name, value, accepted):
    with pytest.raises(ConfigError, match=f"{name} is {value!r}; accepted: {accepted}"):
        read(Params({name: value}), StickConfig)
