"""The newest motion by odometry."""
from __future__ import annotations

import math

import pytest

from car_interface.tools.calibration.drive.area import Pose, moved
from car_interface.tools.calibration.drive.motion import Motion

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


def test_a_car_that_hardly_moves_has_no_curvature():
    assert driven(0.5, speed_mps=0.05)[0].curvature_per_m() is None
    assert Motion().curvature_per_m() is None


def test_what_happened_in_a_gap_does_not_count():
    motion, _, _ = driven(0.0)
    assert motion.update(Pose(9.0, 9.0, 1.0), 1.0, 9_000 * MS) == (0.0, 0.0)
    assert motion.curvature_per_m() is None and motion.pose.x_m == 9.0
