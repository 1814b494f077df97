"""When a person has to place the car."""
from __future__ import annotations

import math

import pytest

from car_interface.tools.calibration.drive.lost_turns import LostTurns

LEFT, RIGHT = 0, 1
THREE_RAD = 6 * math.pi


@pytest.mark.parametrize("driven, sign, lost", [(RIGHT, -1, LEFT), (LEFT, 1, RIGHT)], ids=("right", "left"))
def test_a_turn_is_lost_after_three_to_the_other_side_only(driven, sign, lost):
    one = LostTurns()
    one.update_motion(sign * (THREE_RAD - 0.1))
    assert one.drive(driven) is None
    one.update_motion(sign * 0.2)
    assert one.drive(driven) == lost and one.asked is None


def test_what_it_turns_to_that_side_on_its_way_does_not_find_it_again():
    one = LostTurns()
    for _ in range(40):
        one.update_motion(-0.5)
        one.update_motion(0.3)
    assert one.drive(RIGHT) == LEFT


def test_a_tight_turn_to_that_side_does():
    one = LostTurns()
    one.update_motion(-THREE_RAD)
    one.drive(LEFT)
    one.update_motion(-1.0)
    assert one.drive(RIGHT) is None


def test_it_asks_again_only_after_three_more():
    one = LostTurns()
    one.update_motion(-THREE_RAD)
    one.ask(LEFT)
    assert one.asked == LEFT and one.drive(RIGHT) is None
    one.update_motion(-THREE_RAD)
    assert one.drive(RIGHT) == LEFT
