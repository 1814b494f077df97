"""The angles that a planner asked for, in place of duties that nobody recorded."""
from __future__ import annotations

import math
from dataclasses import replace

import pytest

from car_interface.common.package_files import package_file
from car_interface.steering.params import load_steering
from car_interface.tools.calibration.steering.asked import AngleTable

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
