"""The newest motion by odometry."""
from __future__ import annotations

import math

import pytest

from car_interface.calibration.drive.area import Pose, moved
from car_interface.calibration.drive.motion import MIN_COASTING_MPS2, Coasting, Motion

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


@pytest.mark.parametrize("curvature", [0.0, 0.8, -1.1])
def test_curvature_is_that_of_the_path(curvature):
    motion, total_m, total_rad = driven(curvature)
    assert motion.curvature_per_m() == pytest.approx(curvature, abs=1e-3)
    assert total_m == pytest.approx(0.98, rel=1e-3) and total_rad == pytest.approx(0.98 * curvature, abs=1e-6)


def test_backward_counts_negative_and_has_the_same_curvature():
    _, total_m, _ = driven(0.5, speed_mps=-1.0)
    assert total_m == pytest.approx(-0.98, rel=1e-3)


def test_a_car_that_hardly_moves_has_no_curvature():
    assert driven(0.5, speed_mps=0.05)[0].curvature_per_m() is None
    assert Motion().curvature_per_m() is None


def test_what_happened_in_a_gap_does_not_count():
    motion, _, _ = driven(0.0)
    assert motion.update(Pose(9.0, 9.0, 1.0), 1.0, 9_000 * MS) == (0.0, 0.0)
    assert motion.curvature_per_m() is None and motion.pose.x_m == 9.0


# --- coasting ---


def coasted(begin_mps, mps2, seconds=3.0, hands_mps=None):
    """After a second of driving nothing drives it; once it stands hands may move it."""
    coasting = Coasting()
    for tick in range(50):
        coasting.update(begin_mps + 0.5 * tick / 50, True, tick * 20 * MS)
    speed_mps = begin_mps
    for tick in range(50, 50 + round(50 * seconds)):
        coasting.update(speed_mps if speed_mps > 0 or hands_mps is None else hands_mps, False, tick * 20 * MS)
        speed_mps = max(0.0, speed_mps - 0.02 * mps2)
    return coasting.least_mps2


@pytest.mark.parametrize("mps2", [0.15, 0.3, 0.5])
def test_coasting_is_measured_after_the_button_was_let_go(mps2):
    assert coasted(1.5, mps2) == pytest.approx(mps2, rel=0.05)


def test_a_car_that_is_driven_or_stops_at_once_does_not_coast():
    assert Coasting().least_mps2 == math.inf
    assert coasted(0.5, 3.0) == math.inf


def test_downhill_it_is_never_less_than_the_least():
    assert coasted(0.8, 0.02) == MIN_COASTING_MPS2


def test_a_car_that_gets_faster_is_pushed():
    assert coasted(0.8, -0.3) == math.inf


def test_hands_that_move_a_standing_car_are_no_coasting():
    assert coasted(1.0, 0.4, 8.0, hands_mps=0.7) == pytest.approx(0.4, rel=0.05)


def test_the_least_of_all_times_counts():
    coasting, now_ns = Coasting(), 0
    for mps2 in (0.4, 0.2, 0.6):
        for tick in range(100):
            now_ns += 20 * MS
            coasting.update(1.0 - max(0, tick - 20) * 0.02 * mps2, tick <= 20, now_ns)
    assert coasting.least_mps2 == pytest.approx(0.2, rel=0.05)
