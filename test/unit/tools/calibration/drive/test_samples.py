"""Samples of a drive: arrays for the fit at any moment."""
import math

import numpy as np
import pytest

from car_interface.tools.calibration.drive.area import Pose, moved
from car_interface.tools.calibration.drive.survey import Motion, Samples

S = 1_000_000_000
START_NS = 5_000 * S


def circling(seconds, speed_mps=1.0, yaw_rate_radps=1.0):
    samples = Samples()
    samples.update_duty(5000, START_NS - S)
    for tick in range(round(50 * seconds)):
        t_s = tick / 50
        yaw = yaw_rate_radps * t_s
        samples.update_odometry(Pose(math.sin(yaw), 1 - math.cos(yaw), yaw), speed_mps, START_NS + round(t_s * S))
    return samples


def test_distance_is_that_of_the_path_and_times_are_on_one_scale():
    drive = circling(20.0).drive()
    assert drive.yaw_rad[-1] == pytest.approx(19.98, abs=1e-6)
    assert drive.distance_m[-1] - drive.distance_m[0] == pytest.approx(19.98, rel=1e-3)
    assert drive.t_s[-1] - drive.t_s[0] == pytest.approx(19.98)
    assert drive.t_s[0] - drive.duty_t_s[0] == pytest.approx(1.0), "on one scale"


@pytest.mark.parametrize("duty", [0, -1, 65535, 9000])
def test_what_is_no_pulse_is_an_unknown_duty(duty):
    samples = Samples()
    samples.update_duty(duty, START_NS)
    assert np.isnan(samples.drive().duty[0])


def test_odometry_out_of_order_is_left_out():
    samples = circling(1.0)
    samples.update_odometry(Pose(0.0, 0.0, 0.0), 1.0, START_NS)
    assert len(samples.drive().t_s) == 50


def test_a_drive_that_was_taken_does_not_change_any_more():
    samples = circling(1.0)
    drive = samples.drive()
    samples.update_odometry(Pose(9.0, 9.0, 0.0), 1.0, START_NS + 9 * S)
    assert len(drive.t_s) == 50 and len(samples.drive().t_s) == 51


MS = 1_000_000


def driven(curvature, speed_mps=1.0, ticks=50, period_ms=20):
    motion, pose = Motion(), Pose(1.0, 1.0, 3.0)
    total_m = total_rad = 0.0
    for tick in range(ticks):
        wrapped = pose._replace(yaw_rad=math.remainder(pose.yaw_rad, 2 * math.pi))
        distance_m, turned_rad = motion.update(wrapped, speed_mps, tick * period_ms * MS)
        total_m, total_rad = total_m + distance_m, total_rad + turned_rad
        pose = moved(pose, speed_mps * period_ms / 1000, curvature)
    return motion, total_m, total_rad


@pytest.mark.parametrize("curvature, speed_mps", [(0.0, 1.0), (0.8, 1.0), (-1.1, 1.0), (0.5, -1.0)])
def test_curvature_is_that_of_the_path_and_backward_counts_negative(curvature, speed_mps):
    motion, total_m, total_rad = driven(curvature, speed_mps)
    assert motion.curvature_per_m() == (pytest.approx(curvature, abs=1e-3) if speed_mps > 0 else None)
    assert total_m == pytest.approx(0.98 * speed_mps, rel=1e-3)
    assert total_rad == pytest.approx(0.98 * speed_mps * curvature, abs=1e-6)
    assert motion.pose.yaw_rad == pytest.approx(3.0 + total_rad), "unwrapped"


def test_car_that_hardly_moves_has_no_curvature_and_what_happened_in_a_gap_does_not_count():
    assert driven(0.5, speed_mps=0.05)[0].curvature_per_m() is None
    assert Motion().curvature_per_m() is None
    motion, _, _ = driven(0.0)
    assert motion.update(Pose(9.0, 9.0, 1.0), 1.0, 9_000 * MS) == (0.0, 0.0)
    assert motion.curvature_per_m() is None and motion.pose.x_m == 9.0
