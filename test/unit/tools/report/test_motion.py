"""Distance, curvature and acceleration by odometry."""
from __future__ import annotations

import math

import pytest

from car_interface.tools.report.summary import summarize
from written_recordings import Written, odometry, write_ros1


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


@pytest.mark.parametrize("back_s, is_fault", [(5.0, True), (0.4, False)], ids=["clock_set", "recorded_late"])
def test_clock_set_back_is_a_fault_and_leaves_accelerations_sane(tmp_path, back_s, is_fault):
    times_s = [10 + 0.02 * step - (back_s if step >= 200 else 0.0) for step in range(400)]
    seen = summarize(str(write_ros1(tmp_path / "a.bag", [odometry(time_s, speed_mps=1.0) for time_s in times_s])))
    assert seen.traces["acceleration"].maximum == seen.traces["acceleration"].minimum == 0.0
    assert any("went back once" in fault.what for fault in seen.faults.entries) is is_fault


def test_numbers_that_are_none_are_left_out(tmp_path):
    messages = [odometry(0.02 * step, speed_mps=math.nan if step == 5 else 1.0) for step in range(50)]
    messages.append(Written(0.5, "/av_turnrad_req", "std_msgs/Float32", {"data": math.nan}))
    seen = summarize(str(write_ros1(tmp_path / "a.bag", messages)))
    assert seen.traces["speed"].count == 49 and seen.traces["requested curvature"].count == 0
