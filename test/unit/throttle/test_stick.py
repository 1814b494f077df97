"""The human's throttle stick: dead band, expo, and the scale that two buttons change."""

import pytest

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
