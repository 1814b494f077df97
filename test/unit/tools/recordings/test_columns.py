"""The columns of a topic: their times, and the messages that are left out."""
import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from car_interface.common.units import NS_PER_S
from car_interface.tools.recordings.columns import (
    CommandColumn,
    Gravity,
    ImuColumn,
    OdomColumn,
    OutputColumn,
    Timeline,
    ValueColumn,
)
from car_interface.tools.recordings.recording import Recorded
from car_interface.tools.recordings.signals import load
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
    odom = load(str(write(tmp_path / "a.bag", later)), ["odom"]).odom
    assert odom.t_s == pytest.approx(0.1 * np.arange(20) - 0.03, abs=1e-6)
    assert odom.x_m == pytest.approx(0.2 * np.arange(20))
    assert odom.yaw_rad == pytest.approx(0.5 * np.arange(20))
    assert set(odom.speed_mps) == {2.0}


# --- columns with stamps ---

def test_stamp_up_to_two_seconds_from_the_recording_time_counts_and_each_reason_has_a_note_of_its_own():
    column = values(ValueColumn("v"), (0.0, -1.99, 1), (0.1, -2.2, 2), (3.0, 4.99, 3), (5.1, 7.2, 4))
    series, notes = column.build()
    assert series.t_s == pytest.approx([-1.99, 0.1, 4.99, 5.1])
    assert notes == [
        "v: 2 messages with a stamp seconds away from when it was recorded: recording time taken"]
    column = values(ValueColumn("v"), (0.0, 0.0, 1), (0.1, 0.1, math.nan), (0.2, 0.2, math.inf), (0.3, 0.0, 2))
    assert column.build()[1] == ["v: 2 messages with a number that is none: left out",
                                 "v: 1 message with a stamp that doesn't rise: left out"]


def test_message_that_can_not_be_used_leaves_a_column_empty():
    assert values(ValueColumn("v")).build() == (None, [])
    assert values(ValueColumn("v"), (0.0, 0.0, math.nan)).build()[0] is None
    assert values(ValueColumn("v"), (0.0, 0.0, 1.0)).build()[0] is not None
    output = vectors(OutputColumn("o"), (0.0, [1] * 15), (0.1, [1] * 17), (0.2, []))
    assert output.build() == (None, ["o: 3 messages that don't have 16 duties: left out"])


# --- odometry without a twist ---

def captured(*poses, linear=(0.0, 0.0)):
    """A column of (time in s, x in m, y in m, yaw) each, with the same twist all the time."""
    column = OdomColumn("odom")
    for time_s, x_m, y_m, yaw in poses:
        column.add(Recorded(0, "odom", SimpleNamespace(
            pose=SimpleNamespace(pose=SimpleNamespace(
                position=SimpleNamespace(x=x_m, y=y_m),
                orientation=SimpleNamespace(x=0.0, y=0.0, z=math.sin(yaw / 2), w=math.cos(yaw / 2)))),
            twist=SimpleNamespace(twist=SimpleNamespace(linear=SimpleNamespace(x=linear[0], y=linear[1]))))),
            time_s, Timeline())
    return column


def circle(sign=1.0):
    """A left-hand circle of 1 m at 2 m/s, 100 poses a second, forward or backward."""
    return [(step / 100, math.sin(sign * step / 50), 1 - math.cos(sign * step / 50), sign * step / 50)
            for step in range(300)]


@pytest.mark.parametrize("sign", [1.0, -1.0], ids=["forward", "backward"])
def test_odometry_without_a_twist_has_the_speed_of_its_pose_and_a_note(sign):
    odom, notes = captured(*circle(sign)).build()
    assert odom.speed_mps == pytest.approx(2.0 * sign, rel=0.003)
    assert notes == [
        "odom: its twist is 0 throughout while its pose moves: speed and turn rate are taken from the pose"]


@pytest.mark.parametrize("poses, linear, speed_mps", [
    (circle(), (1.9, 0.0), 1.9), (circle(), (0.0, 0.1), 0.0),
    ([(step / 100, 0.001 * (-1) ** step, 0.0, 0.0) for step in range(100)], (0.0, 0.0), 0.0),
    ([(0.0, 1.0, 1.0, 0.0)], (0.0, 0.0), 0.0),
], ids=["has_a_twist", "slides_sideways", "stands", "one_pose"])
def test_twist_that_is_not_0_and_a_pose_that_does_not_move_are_believed(poses, linear, speed_mps):
    odom, notes = captured(*poses, linear=linear).build()
    assert odom.speed_mps == pytest.approx(speed_mps) and notes == []


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
    built, _ = column.build()
    assert (built.yaw_rate_radps[0], built.acceleration_mps2[0]) == (0.3, 1.5)
    return built.pitch_rad[0]


# --- columns of duties ---


def test_output_has_a_row_at_each_change_and_each_half_second_and_none_that_was_recorded_before_the_last():
    rows = [(0.1 * index, [5104] * 16) for index in range(11)]
    assert vectors(OutputColumn("o"), *rows).build()[0].t_s == pytest.approx([0.0, 0.5, 1.0])
    output = vectors(OutputColumn("o"), (0.0, [1] * 16), (0.001, [2] * 16), (0.002, [1] * 16)).build()[0]
    assert output.t_s.tolist() == [0.0, 0.001, 0.002]
    assert output.duties.shape == (3, 16) and output.duties[:, 15].tolist() == [1, 2, 1]
    column = vectors(OutputColumn("o"), (1.0, [1] * 16), (0.9, [2] * 16), (1.0, [3] * 16))
    output, notes = column.build()
    assert output.duties[:, 0].tolist() == [1, 3]
    assert notes == ["o: 1 message with a stamp that doesn't rise: left out"]


@pytest.mark.parametrize("command, output", [
    # A count of the PCA9685 is 16 duties: the nearest one, and full on for 4096 counts.
    (7, 0), (8, 16), (5101, 5104), (65527, 65520), (65528, 65535),
])
def test_command_is_the_duty_of_the_nearest_count(command, output):
    assert vectors(CommandColumn("c"), (0.0, [command] * 16)).build()[0].duties.tolist() == [[output] * 16]


@pytest.mark.parametrize("outside", [-1, 65536])
def test_command_outside_the_range_leaves_its_channel_unchanged(outside):
    output = vectors(CommandColumn("c"), (0.0, [outside, 1600] + [-1] * 14),
                     (0.1, [3200, outside] + [-1] * 14), (0.2, [outside, 4800] + [-1] * 14)).build()[0]
    assert output.duties[:, :3].tolist() == [[-1, 1600, -1], [3200, 1600, -1], [3200, 4800, -1]]


@pytest.mark.parametrize("accelerations, axis", [
    pytest.param([(9.8, 0.3, 0.1)], "x", id="nose_up"), pytest.param([(0.2, -9.8, 0.5)], "y", id="on_its_side"),
    pytest.param([(7.0, 1.0, 6.5)], "x", id="tilted_by_47_degrees"),
    pytest.param([(4.0, 0, 9.0)], None, id="tilted_by_24_degrees"), pytest.param([(0, 0, 9.8)], None, id="upright"),
    pytest.param([(0, 0, -9.8)], None, id="upside_down"), pytest.param([], None, id="without_a_message"),
    pytest.param([(0, 0, 0)], None, id="nothing"), pytest.param([(3.0, 3.0, 0)], None, id="gravity_taken_off"),
    pytest.param([(15.0, 0, 9.8), (-15.0, 0, 9.8)] * 5 + [(math.nan, 99.0, 0), (math.inf, 99.0, 0)], None,
                 id="driving_cancels_out_and_what_is_no_number_does_not_count"),
])
def test_imu_on_its_side_is_said_with_the_axis(accelerations, axis):
    gravity = Gravity()
    for axes in accelerations:
        gravity.add(*axes)
    assert gravity.note("imu/data") == ("" if axis is None else (
        f"imu/data: gravity lies along its {axis} axis, not along z: it is mounted on its side, and its turn rate "
        "about z isn't the car's"))


def test_times_count_from_the_first_message_and_a_small_step_back_is_no_set_clock():
    timeline = Timeline()
    times_s = [0.0, 0.5, 2.0, 1.5]
    assert [timeline.recorded_s(START_NS + round(t * NS_PER_S)) for t in times_s] == times_s
    assert (timeline.start_ns, timeline.last_s, timeline.notes) == (START_NS, 2.0, [])
    assert timeline.stamped_s(START_NS + NS_PER_S) == 1.0


@given(st.lists(st.integers(0, 10**6), min_size=1, max_size=30))
def test_newest_time_never_falls(times_ms):
    timeline, last_s = Timeline(), 0.0
    for time_ms in times_ms:
        timeline.recorded_s(START_NS + time_ms * 1_000_000)
        assert timeline.last_s >= last_s
        last_s = timeline.last_s
