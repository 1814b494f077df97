"""The angles that a planner asked for, in place of duties that nobody recorded."""
from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from car_interface.calibration.steering.asked import AngleTable
from car_interface.common.package_files import package_file
from car_interface.recordings.series import Ackermann
from car_interface.steering.params import load_steering

# The package's own table is so flat that it can't tell radii apart.
TABLE = replace(load_steering(str(package_file("config/turn_arb.yaml"))), radius_axis_m=[0.5, 5.0, 300.0],
                left_duties=[3800, 4800, 5090], right_duties=[6600, 5400, 5110])
ANGLES = AngleTable(TABLE, 0.324)


@pytest.mark.parametrize("radius_m", [0.9, 2.0, 10.0, -0.9, -2.0, -10.0])
def test_angle_is_the_duty_of_its_radius_at_the_boards_nearest_count(radius_m):
    duty = ANGLES.duty(math.atan(0.324 / radius_m))
    assert abs(duty - TABLE.planner_duty(radius_m)) <= 8 and duty % 16 == 0


def test_no_angle_is_the_center_and_more_than_the_table_has_its_end():
    assert abs(ANGLES.duty(0.0) - TABLE.servo_center) <= 8 and ANGLES.duty(0.0) == ANGLES.duty(1e-9)
    assert ANGLES.duty(1.4) == ANGLES.duty(1.5) and ANGLES.duty(-1.4) == ANGLES.duty(-1.5) != ANGLES.duty(1.4)


def test_every_row_has_a_duty():
    asked = Ackermann(np.array([0.0, 0.1]), np.array([0.2, -0.2]), np.array([1.0, 1.0]))
    assert ANGLES.duties(asked).tolist() == [ANGLES.duty(0.2), ANGLES.duty(-0.2)]


def test_note_says_what_such_a_recording_can_not_tell():
    assert ANGLES.note("/drive") == (
        "no duties of the servo were recorded: the angles on /drive count as the duties that --base has for them with "
        "a wheelbase of 0.324 m. What this recording can't tell: whether --base was the table on this drive, and "
        "whether anything else steered (a gamepad, a trim, a limit)")
