"""Distance, curvature and acceleration by odometry."""
from __future__ import annotations

import math

import pytest

from car_interface.report.summary import summarize
from written_recordings import SPEED_MPS, Written, odometry, write_ros1


def test_distance_and_speed_are_those_of_odometry(seen):
    assert seen.motion.distance_m == pytest.approx(35 * SPEED_MPS, rel=0.01)
    assert seen.motion.moving_s == pytest.approx(35.0, abs=0.1)
    assert seen.traces["speed"].maximum == SPEED_MPS


def test_wider_turns_than_the_tables_say_are_measured_by_side(seen):
    (left, samples), (_, none) = seen.motion.by_tables.ratios()
    assert left == pytest.approx(1 / 1.1, abs=0.01) and samples > 500 and none == 0


def test_curvature_is_that_of_the_steering_backwards_too(tmp_path):
    # Backwards with the wheels to the left, radius 2 m: x and y as on the way there, the heading turns to the right.
    messages = [odometry(0.02 * step, 2 * math.sin(angle), 2 - 2 * math.cos(angle), angle, -1.0)
                for step, angle in ((step, -0.01 * step) for step in range(200))]
    seen = summarize(str(write_ros1(tmp_path / "a.bag", messages)))
    turned = seen.traces["driven curvature"]
    assert (turned.minimum, turned.maximum) == (pytest.approx(0.5, abs=0.01), pytest.approx(0.5, abs=0.01))


def test_odometry_that_was_reset_is_no_distance_and_its_gap_is_a_fault(tmp_path):
    jump = [odometry(0.1 * step, 0.1 * step, speed_mps=1.0) for step in range(20)]
    jump += [odometry(5 + 0.1 * step, 50 + 0.1 * step, speed_mps=1.0) for step in range(20)]
    seen = summarize(str(write_ros1(tmp_path / "a.bag", jump)))
    assert seen.motion.distance_m == pytest.approx(3.8)
    assert [fault.what for fault in seen.faults.entries] == [
        "silent for 3.10 s", "began anew: 48.1 m from where it was"]


def test_clock_set_back_is_a_fault_and_leaves_accelerations_sane(tmp_path):
    messages = [odometry(10 + 0.02 * step, speed_mps=1.0) for step in range(200)]
    messages += [odometry(5 + 0.02 * step, speed_mps=1.0) for step in range(200)]
    seen = summarize(str(write_ros1(tmp_path / "a.bag", messages)))
    assert seen.traces["acceleration"].maximum == seen.traces["acceleration"].minimum == 0.0
    assert any("went back once" in fault.what for fault in seen.faults.entries)


def test_small_step_back_of_the_recording_time_is_no_fault(tmp_path):
    times = [0.02 * step - (0.4 if step >= 100 else 0.0) for step in range(200)]
    seen = summarize(str(write_ros1(tmp_path / "a.bag", [odometry(time_s, speed_mps=1.0) for time_s in times])))
    assert not [fault for fault in seen.faults.entries if "went back" in fault.what]


def test_numbers_that_are_none_are_left_out(tmp_path):
    messages = [odometry(0.02 * step, speed_mps=math.nan if step == 5 else 1.0) for step in range(50)]
    messages.append(Written(0.5, "/av_turnrad_req", "std_msgs/Float32", {"data": math.nan}))
    seen = summarize(str(write_ros1(tmp_path / "a.bag", messages)))
    assert seen.traces["speed"].count == 49 and seen.traces["requested curvature"].count == 0
