"""The columns of a topic: their times, and the messages that are left out."""
from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from car_interface.tools.recordings.columns import CommandColumn, ImuColumn, OutputColumn, ValueColumn
from car_interface.tools.recordings.recording import Recorded
from car_interface.tools.recordings.series import Output
from car_interface.tools.recordings.signals import ODOM, load
from car_interface.tools.recordings.timeline import Timeline
from written_recordings import START_NS, odometry, write_ros1, write_ros2

ODOMETRY = [odometry(0.1 * index, x_m=0.2 * index, yaw_rad=0.5 * index, speed_mps=2.0) for index in range(20)]


def vectors(column, *rows):
    """Adds (recording time in s, duties) to a column."""
    for time_s, duties in rows:
        column.add(Recorded(0, column.topic, SimpleNamespace(data=duties)), time_s, Timeline())
    return column


def values(column, *rows):
    """Adds (recording time in s, stamp in s, number) to a column, on a time scale that begins at START_NS."""
    timeline = Timeline()
    timeline.recorded_s(START_NS)
    for time_s, stamp_s, number in rows:
        time_ns = START_NS + round(stamp_s * 1e9)
        message = SimpleNamespace(stamp=SimpleNamespace(sec=time_ns // 10**9, nanosec=time_ns % 10**9), data=number)
        column.add(Recorded(0, column.topic, message), time_s, timeline)
    return column


@pytest.mark.parametrize("write", (write_ros1, write_ros2), ids=("ROS 1", "ROS 2"))
def test_odometry_counts_by_its_stamps_and_its_heading_is_unwrapped(tmp_path, write):
    later = [message._replace(time_s=message.time_s + 0.03) for message in ODOMETRY]
    odom = load(str(write(tmp_path / "a.bag", later)), [ODOM]).odom
    assert odom.t_s == pytest.approx(0.1 * np.arange(20) - 0.03, abs=1e-6)
    assert odom.x_m == pytest.approx(0.2 * np.arange(20))
    assert odom.yaw_rad == pytest.approx(0.5 * np.arange(20))
    assert set(odom.speed_mps) == {2.0}


# --- columns with stamps ---


def test_stamp_up_to_two_seconds_from_the_recording_time_counts_and_others_do_not():
    column = values(ValueColumn("v"), (0.0, -1.99, 1), (0.1, -2.2, 2), (3.0, 4.99, 3), (5.1, 7.2, 4))
    assert column.build().t_s == pytest.approx([-1.99, 0.1, 4.99, 5.1])
    assert column.notes() == [
        "v: 2 messages with a stamp seconds away from when it was recorded: recording time taken"]


def test_each_reason_has_a_note_of_its_own():
    column = values(ValueColumn("v"), (0.0, 0.0, 1), (0.1, 0.1, math.nan), (0.2, 0.2, math.inf), (0.3, 0.0, 2))
    assert column.notes() == ["v: 2 messages with a number that is none: left out",
                              "v: 1 message with a stamp that doesn't rise: left out"]


def test_message_that_can_not_be_used_leaves_a_column_empty():
    assert values(ValueColumn("v"), (0.0, 0.0, math.nan)).is_empty
    assert not values(ValueColumn("v"), (0.0, 0.0, 1.0)).is_empty
    output = vectors(OutputColumn("o"), (0.0, [1] * 15), (0.1, [1] * 17), (0.2, []))
    assert output.is_empty and output.notes() == ["o: 3 messages that don't have 16 duties: left out"]


@pytest.mark.parametrize("orientation, pitch", [
    pytest.param((0, 0.5 ** 0.5, 0, 0.5 ** 0.5), math.pi / 2, id="nose_straight_down"),
    pytest.param((0, -0.5, 0, 0.75 ** 0.5), -math.pi / 3, id="nose_up_60_degrees"),
    pytest.param((0.5, 0, 0, 0.75 ** 0.5), 0.0, id="roll_only"),
    pytest.param((0, 0, 0, 0), math.nan, id="none"),
    pytest.param((0, 0.3, 0, 0.8), math.nan, id="not_of_unit_length"),
])
def test_pitch_is_that_of_the_orientation(orientation, pitch):
    assert pitch_rad(orientation) == pytest.approx(pitch, abs=1e-6, nan_ok=True)
    assert math.isnan(pitch_rad(orientation, unknown=True)), "as its covariance says"


def pitch_rad(orientation, unknown=False):
    x, y, z, w = orientation
    column = ImuColumn("imu/data")
    message = SimpleNamespace(
        angular_velocity=SimpleNamespace(z=0.3), linear_acceleration=SimpleNamespace(x=1.5, y=0.0, z=9.8),
        orientation=SimpleNamespace(x=x, y=y, z=z, w=w), orientation_covariance=[-1.0 if unknown else 0.0] * 9)
    column.add(Recorded(0, "imu/data", message), 0.0, Timeline())
    built = column.build()
    assert (built.yaw_rate_radps[0], built.acceleration_mps2[0]) == (0.3, 1.5)
    return built.pitch_rad[0]


# --- columns of duties ---


def test_output_that_does_not_change_has_a_row_each_half_second():
    rows = [(0.1 * index, [5104] * 16) for index in range(11)]
    assert vectors(OutputColumn("o"), *rows).build().t_s == pytest.approx([0.0, 0.5, 1.0])


def test_output_that_changes_has_a_row_at_once():
    output = vectors(OutputColumn("o"), (0.0, [1] * 16), (0.001, [2] * 16), (0.002, [1] * 16)).build()
    assert output.t_s.tolist() == [0.0, 0.001, 0.002]
    assert output.duties.shape == (3, 16) and output.duties[:, 15].tolist() == [1, 2, 1]


def test_output_that_was_recorded_earlier_than_the_one_before_is_left_out():
    column = vectors(OutputColumn("o"), (1.0, [1] * 16), (0.9, [2] * 16), (1.0, [3] * 16))
    assert column.build().duties[:, 0].tolist() == [1, 3]
    assert column.notes() == ["o: 1 message with a stamp that doesn't rise: left out"]


@pytest.mark.parametrize("command, output", [
    # A count of the PCA9685 is 16 duties: the nearest one, and full on for 4096 counts.
    (7, 0), (8, 16), (5101, 5104), (65527, 65520), (65528, 65535),
])
def test_command_is_the_duty_of_the_nearest_count(command, output):
    assert vectors(CommandColumn("c"), (0.0, [command] * 16)).build().duties.tolist() == [[output] * 16]


@pytest.mark.parametrize("outside", [-1, 65536])
def test_command_outside_the_range_leaves_its_channel_unchanged(outside):
    output = vectors(CommandColumn("c"), (0.0, [outside, 1600] + [-1] * 14),
                     (0.1, [3200, outside] + [-1] * 14), (0.2, [outside, 4800] + [-1] * 14)).build()
    assert output.duties[:, :3].tolist() == [[-1, 1600, -1], [3200, 1600, -1], [3200, 4800, -1]]


def test_duty_of_a_channel_is_that_of_the_newest_row():
    output = Output(np.array([1.0, 2.0, 2.5]), np.array([[first, second, *[-1] * 14] for first, second in (
        (5104, -1), (3808, -1), (3808, 4912))]))
    for channel, t_s, duties in (
            (0, [0.999, 1.0, 1.999, 2.0, 1e9], [-1, 5104, 5104, 3808, 3808]),
            (1, [2.49, 2.5], [-1, 4912]), (15, [9.0], [-1]), (0, [2.0, 0.0, 1.0], [3808, -1, 5104]), (0, [], [])):
        found = output.at(channel, np.array(t_s))
        assert found.tolist() == duties and found.dtype.kind == "i"


def test_of_rows_with_the_same_time_the_last_one_counts():
    output = Output(np.array([1.0, 1.0]), np.array([[100] * 16, [200] * 16]))
    assert output.at(3, np.array([1.0])).tolist() == [200]
