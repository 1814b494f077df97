"""Heading and distance of a recorded drive."""
import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from car_interface.common.package_files import package_file
from car_interface.steering.config import load_steering
from car_interface.tools.calibration.steering.drive import distance_m
from car_interface.tools.calibration.steering.recorded import duty_of_angle, imu_heading
from car_interface.tools.recordings.columns import Imu, Odom


def driving(imu_offset_radps=0.0, odom_ratio=1.0, imu_end_s=60.0):
    """A minute of swinging left and right, by odometry and by an IMU."""
    t_s, imu_s = np.arange(0.0, 60.0, 0.02), np.arange(0.0, imu_end_s, 0.01)
    yaw = odom_ratio * np.sin(0.5 * t_s)
    odom = Odom(t_s, t_s, 0 * t_s, yaw, np.ones(len(t_s)))
    return odom, Imu(imu_s, 0.5 * np.cos(0.5 * imu_s) + imu_offset_radps, 0 * imu_s, 0 * imu_s)


def test_heading_by_the_imu_has_no_offset_and_one_that_covers_too_little_or_is_unrelated_is_not_used():
    odom, imu = driving(imu_offset_radps=0.02, odom_ratio=1.1)
    yaw_rad, ratio = imu_heading(odom, imu)
    assert ratio == pytest.approx(1.1, abs=0.01)
    assert yaw_rad == pytest.approx(np.sin(0.5 * odom.t_s), abs=0.02)
    assert imu_heading(*driving(imu_end_s=50.0)) is None
    odom, imu = driving()
    assert imu_heading(odom, imu._replace(yaw_rate_radps=np.zeros(len(imu.t_s)))) is None


def test_distance_is_as_long_whether_the_recording_has_gaps_or_not():
    t_s = np.arange(0.0, 60.0, 0.02)
    circle = Odom(t_s, np.sin(t_s), 1 - np.cos(t_s), t_s, np.full(len(t_s), 1.02))
    recorded = t_s % 10 < 7  # by speed it's 2 % longer than between positions; across a gap these are no use
    gappy = Odom(*(column[recorded] for column in circle))
    for odom in (circle, gappy):
        travelled_m = distance_m(odom)
        assert np.median(np.diff(travelled_m) / np.diff(odom.t_s)) == pytest.approx(1.0, abs=2e-4)


# The package's own table is so flat that it can't tell radii apart.
TABLE = replace(load_steering(str(package_file("config/turn_arb.yaml"))), radius_axis_m=[0.5, 5.0, 300.0],
                left_duties=[3800, 4800, 5090], right_duties=[6600, 5400, 5110])
duty_of = partial(duty_of_angle, TABLE, 0.324)


def test_angle_is_the_duty_of_its_radius_at_the_board_s_nearest_count_none_the_center_and_more_than_the_table_its_end():
    for radius_m in (0.9, 2.0, 10.0, -0.9, -2.0, -10.0):
        duty = duty_of(math.atan(0.324 / radius_m))
        assert abs(duty - TABLE.planner_duty(radius_m)) <= 8 and duty % 16 == 0
    assert abs(duty_of(0.0) - TABLE.servo_center) <= 8 and duty_of(0.0) == duty_of(1e-9)
    assert duty_of(1.4) == duty_of(1.5) and duty_of(-1.4) == duty_of(-1.5) != duty_of(1.4)
