"""Odometry's turning against an IMU's."""
from __future__ import annotations

import math

import pytest

from car_interface.tools.report.page import page
from car_interface.tools.report.plots import plots
from car_interface.tools.report.summary import summarize
from written_recordings import Written, odometry, stamp, write_ros1


def imu(time_s, rate_radps, gravity):
    return Written(time_s, "/imu/data", "sensor_msgs/Imu", {
        "header": {"stamp": stamp(time_s)}, "angular_velocity": {"z": rate_radps},
        "linear_acceleration": dict(zip("xyz", gravity))})


def spinning(tmp_path, gravity=(0.0, 0.0, 9.8), rate_radps=0.5):
    """Odometry turns at 0.75 rad/s, the IMU at another rate; 50 messages of each in a second, for 5 s."""
    messages = []
    for step in range(250):
        time_s = step / 50
        messages += [odometry(time_s, 0.0, 0.0, math.remainder(0.75 * time_s, 2 * math.pi)),
                     imu(time_s, rate_radps, gravity)]
    return summarize(str(write_ros1(tmp_path / f"{rate_radps}.bag", messages)))


def test_odometry_that_turns_more_than_the_imu_is_said(tmp_path):
    drive = spinning(tmp_path)
    assert drive.imu.odometry_ratio().median == pytest.approx(1.5, abs=0.01)
    assert "<tr><th>Turned by odometry</th><td>50% more than the IMU says</td></tr>" in page(drive, {})
    assert "by the IMU" not in drive.notes and "speed" in plots(drive)


def test_imu_on_its_side_is_not_compared_and_the_page_says_why(tmp_path):
    drive = spinning(tmp_path, (0.0, 9.8, 0.0))
    assert drive.imu.odometry_ratio().samples == 0
    text = page(drive, {})
    assert "Turned by odometry" not in text and "imu/data: gravity lies along its y axis, not along z" in text


def test_imu_that_hardly_turns_or_has_no_number_tells_nothing(tmp_path):
    assert spinning(tmp_path, rate_radps=0.1).imu.odometry_ratio().samples == 0
    drive = spinning(tmp_path, rate_radps=math.nan)
    assert drive.imu.odometry_ratio().samples == 0 and drive.traces["imu turn rate"].count == 0
