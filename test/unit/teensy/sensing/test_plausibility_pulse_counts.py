"""Signed pulses from two reports of a wheel."""

import pytest

from car_interface.teensy.link.protocol import BACKWARD, FORWARD, UINT32, Wheel
from car_interface.teensy.sensing.plausibility import learning_pulses, signed_pulses
from wheel_reports import NEW, forward


@pytest.mark.parametrize("before, now, pulses", [
    (forward(5, 0), forward(9, 0), 4), (Wheel(0, BACKWARD, 0, 3, 5), Wheel(0, BACKWARD, 0, 3, 9), -4),
    (forward(5, 0), forward(5, 0), 0), (forward(UINT32 - 2, 0, 7), forward(3, 0, 7), 5),
    (forward(5, 0), Wheel(0, BACKWARD, 0, 8, 9), 0),  # two forward, then two back
    (Wheel(0, BACKWARD, 0, 3, 5), forward(9, 0, 6), 4),  # turns round with the next pulse
    (forward(5, 0), forward(9, 0, 8), 1),  # turned round twice: one back, the unknown counts as none
    (forward(5, 0), forward(8, 0, 7), 1),  # one back, two forward: nothing is unknown
    (NEW, forward(3, 0), 3), (NEW, forward(3, 0, 3), -1),  # from rest
])
def test_signed_pulses_between_two_reports(before, now, pulses):
    assert signed_pulses(before, now) == pulses


@pytest.mark.parametrize("before, now, expected", [
    (NEW, Wheel(0, BACKWARD, 300, 1, 1), (0, 1)),
    (NEW, Wheel(0, BACKWARD, 300, 1, 2), (0, 2)),
    (NEW, Wheel(0, FORWARD, 300, 3, 4), (2, 2)),
    (Wheel(0, BACKWARD, 300, 1, 2), Wheel(0, FORWARD, 400, 3, 4), (2, 0)),
    (NEW, Wheel(0, FORWARD, 300, 2, 2), (1, 1)),
    (NEW, Wheel(0, FORWARD, 300, 5, 7), (1, 2)),  # of the five after them two back, then three forward
    (Wheel(0, FORWARD, 300, 3, 4), Wheel(0, FORWARD, 400, 3, 6), (2, 0)),
], ids=["first", "first_two", "two_and_two_more", "after_the_first_two", "direction_with_the_second", "reversed_later",
        "later"])
def test_first_two_pulses_after_power_up_are_unproven(before, now, expected):
    assert learning_pulses(before, now) == expected
