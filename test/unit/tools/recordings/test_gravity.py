"""An IMU that is mounted on its side is noticed by the axis along which it feels gravity."""
from __future__ import annotations

import math
from types import SimpleNamespace

import pytest

from car_interface.tools.recordings.gravity import Gravity


def note(*accelerations):
    gravity = Gravity()
    for x, y, z in accelerations:
        gravity.add(SimpleNamespace(x=x, y=y, z=z))
    return gravity.note("imu/data")


@pytest.mark.parametrize("acceleration, axis", [
    ((9.8, 0.3, 0.1), "x"), ((0.2, -9.8, 0.5), "y"), ((7.0, 1.0, 6.5), "x"),
], ids=["nose_up", "on_its_side", "tilted_by_47_degrees"])
def test_imu_on_its_side_is_said_with_the_axis(acceleration, axis):
    assert note(acceleration) == (f"imu/data: gravity lies along its {axis} axis, not along z: it is mounted on its "
                                  "side, and its turn rate about z isn't the car's")


@pytest.mark.parametrize("acceleration", [(0, 0, 9.8), (0, 0, -9.8), (4.0, 0, 9.0), (0, 0, 0), (3.0, 3.0, 0)],
                         ids=["upright", "upside_down", "tilted_by_24_degrees", "nothing", "gravity_taken_off"])
def test_upright_imu_or_one_without_gravity_needs_no_word(acceleration):
    assert note(acceleration) == "" and note() == ""


def test_driving_cancels_out_and_numbers_that_are_none_do_not_count():
    assert note(*[(15.0, 0, 9.8), (-15.0, 0, 9.8)] * 5, (math.nan, 99.0, 0), (math.inf, 99.0, 0)) == ""
