"""What a recording tells as columns: their times, what is left out of them, and what is said about that."""
from __future__ import annotations

import math

import numpy as np
import pytest

from car_interface.recordings import signals
from car_interface.recordings.recording import NoRecording
from car_interface.recordings.signals import IMU, ODOM, OUTPUT, PULSES, VALUE, load
from car_interface.recordings.timeline import BREAK_S
from written_recordings import START_NS, Written, odometry, stamp, write_ros1, write_ros2

ODOMETRY = [odometry(0.1 * index, x_m=0.2 * index, yaw_rad=0.5 * index, speed_mps=2.0) for index in range(20)]


def vector(time_s, duties, topic="/servo/output"):
    return Written(time_s, topic, "std_msgs/Int32MultiArray", {"data": duties})


def duties(first, second=-1):
    return [first, second] + [-1] * 14


OUTPUTS = [vector(0.0, duties(5104)), vector(0.5, duties(3808)), vector(1.0, duties(3808, 4912))]


@pytest.mark.parametrize("write", (write_ros1, write_ros2), ids=("ROS 1", "ROS 2"))
def test_odometry_counts_by_its_stamps_and_its_heading_is_unwrapped(tmp_path, write):
    later = [message._replace(time_s=message.time_s + 0.03) for message in ODOMETRY]
    odom = load(str(write(tmp_path / "a.bag", later)), [ODOM]).odom
    assert odom.t_s == pytest.approx(0.1 * np.arange(20) - 0.03, abs=1e-6)
    assert odom.x_m == pytest.approx(0.2 * np.arange(20))
    assert odom.yaw_rad == pytest.approx(0.5 * np.arange(20))
    assert set(odom.speed_mps) == {2.0}


def test_output_counts_by_its_recording_and_holds_until_the_next(tmp_path):
    output = load(str(write_ros1(tmp_path / "a.bag", OUTPUTS)), [OUTPUT]).output
    assert output.t_s == pytest.approx([0.0, 0.5, 1.0])
    assert output.at(0, np.array([-0.1, 0.0, 0.49, 0.5, 9.0])).tolist() == [-1, 5104, 5104, 3808, 3808]
    assert output.at(1, np.array([0.7, 1.0])).tolist() == [-1, 4912]


def test_unchanged_output_is_kept_now_and_then_only(tmp_path):
    many = [vector(0.01 * index, duties(5104)) for index in range(200)]
    output = load(str(write_ros1(tmp_path / "a.bag", many)), [OUTPUT]).output
    assert 3 <= len(output.t_s) <= 5


@pytest.mark.parametrize("topic", ("/servo/cmdVector", "/command"))
def test_commands_serve_where_no_output_was_recorded_and_leave_other_channels_alone(tmp_path, topic):
    commands = [vector(0.0, duties(5101), topic), vector(0.1, [-1, 4915] + [-1] * 14, topic),
                vector(0.2, duties(3800), topic)]
    output = load(str(write_ros1(tmp_path / "a.bag", commands)), [OUTPUT]).output
    assert output.duties[:, :2].tolist() == [[5104, -1], [5104, 4912], [3808, 4912]]


def test_output_goes_before_commands(tmp_path):
    path = write_ros1(tmp_path / "a.bag", [vector(0.0, duties(6000), "/servo/cmdVector"), vector(0.1, duties(5104))])
    assert load(str(path), [OUTPUT]).output.duties[:, 0].tolist() == [5104]


@pytest.mark.parametrize("bad, note", (
    (odometry(0.55, x_m=math.nan), "/odom: 1 message with a number that is none: left out"),
    (odometry(0.1)._replace(time_s=0.55), "/odom: 1 message with a stamp that doesn't rise: left out"),
    (odometry(500.0)._replace(time_s=0.55),
     "/odom: 1 message with a stamp seconds away from when it was recorded: recording time taken"),
), ids=("not a number", "stamp back", "stamp far away"))
def test_what_is_left_out_is_counted_with_its_topic(tmp_path, bad, note):
    path = write_ros1(tmp_path / "a.bag", [*ODOMETRY[:6], bad, *ODOMETRY[6:]])
    found = load(str(path), [ODOM], odom="/odom")
    assert found.notes == (note,)
    assert np.all(np.diff(found.odom.t_s) > 0) and np.all(np.isfinite(found.odom.x_m))


def test_vector_of_another_length_is_left_out(tmp_path):
    found = load(str(write_ros1(tmp_path / "a.bag", [vector(0.0, [1, 2]), *OUTPUTS[1:]])), [OUTPUT])
    assert found.output.t_s == pytest.approx([0.5, 1.0])
    assert found.notes == ("/servo/output: 1 message that don't have 16 duties: left out",)


def test_clock_that_is_set_back_begins_another_drive(tmp_path):
    again = [message._replace(time_s=message.time_s - 1000, fields={**message.fields, "header": {
        "stamp": stamp(message.time_s - 1000)}}) for message in ODOMETRY]
    found = load(str(write_ros1(tmp_path / "a.bag", ODOMETRY + again, chunk_bytes=1000)), [ODOM])
    assert len(found.odom.t_s) == 40 and np.all(np.diff(found.odom.t_s) > 0)
    assert found.odom.t_s[20] - found.odom.t_s[19] == pytest.approx(BREAK_S, abs=0.1)
    assert "set back by 1001.9 s" in found.notes[-1]


def test_message_without_a_stamp_counts_by_its_recording(tmp_path):
    values = [Written(0.1 * index, "/generic/output/value", "car_interface/Float64Stamped", {"data": float(index)})
              for index in range(5)]
    found = load(str(write_ros1(tmp_path / "a.bag", values)), [VALUE])
    assert found.value.t_s == pytest.approx(0.1 * np.arange(5))
    assert found.value.value.tolist() == [0, 1, 2, 3, 4]


def imu(time_s, pitch_rad=0.0, unknown=False):
    covariance = [-1.0] + [0.0] * 8 if unknown else [0.01] * 9
    return Written(time_s, "/imu/data", "sensor_msgs/Imu", {
        "header": {"stamp": stamp(time_s)}, "angular_velocity": {"z": 0.3}, "linear_acceleration": {"x": 1.5},
        "orientation": {"y": math.sin(pitch_rad / 2), "w": math.cos(pitch_rad / 2)},
        "orientation_covariance": covariance})


def test_imu_has_pitch_nose_down_unless_it_says_that_it_knows_none(tmp_path):
    messages = [imu(0.0, 0.1), imu(0.1, -0.2), imu(0.2, 0.3, unknown=True)]
    found = load(str(write_ros1(tmp_path / "a.bag", messages)), [IMU])
    assert found.imu.pitch_rad[:2] == pytest.approx([0.1, -0.2]) and math.isnan(found.imu.pitch_rad[2])
    assert set(found.imu.yaw_rate_radps) == {0.3} and set(found.imu.acceleration_mps2) == {1.5}


def wheel(time_s, left, right, tick, left_turned_at=0):
    one = {"speed": 10, "when": tick}
    return Written(time_s, "/teensy_wheel", "car_interface/Wheel", {
        "left": {**one, "dist_abs": left, "dist": left_turned_at, "direction": int(left_turned_at > 0)},
        "right": {**one, "dist_abs": right}})


def clock(time_s, tick):
    monotonic_ns = round(time_s * 1e9) + 7_000_000_000
    return Written(time_s, "/teensy_clock", "car_interface/TeensyClock", {
        "stamp": stamp(time_s), "sent": monotonic_ns - 4_000_000, "received": monotonic_ns, "sent_bytes": 15,
        "baud": 115200, "tick": tick})


def test_pulses_are_when_the_wheels_made_them_backward_ones_taken_off(tmp_path):
    messages = [clock(0.2 * index, 1000 + 200 * index) for index in range(20)]
    messages += [wheel(0.5 + 0.05 * index, index, 2 * index, 1450 + 50 * index) for index in range(60)]
    messages += [wheel(3.5 + 0.05 * index, 60 + index, 118, 4450 + 50 * index, left_turned_at=60) for index in range(5)]
    path = write_ros1(tmp_path / "a.bag", sorted(messages, key=lambda message: message.time_s))
    left, right = load(str(path), [PULSES]).pulses
    assert left.count[-1] == max(left.count) - 5 and right.count[-1] == 2 * 59
    made_s = dict(zip(right.count.tolist(), right.t_s))
    assert made_s[100] == pytest.approx(0.45 + 0.05 * 50, abs=0.02)
    assert np.all(np.diff(left.t_s) > 0)


def test_topics_may_lie_below_a_namespace_or_be_named(tmp_path):
    path = write_ros1(tmp_path / "a.bag", [message._replace(topic="/car1/odom") for message in ODOMETRY]
                      + [message._replace(topic="/localization/kinematic_state") for message in ODOMETRY[:5]])
    assert len(load(str(path), [ODOM], namespace="/car1").odom.t_s) == 20
    assert len(load(str(path), [ODOM], odom="/localization/kinematic_state").odom.t_s) == 5


@pytest.mark.parametrize("wanted, options, message", (
    ([ODOM], {}, "a.bag has no topic odom"),
    ([OUTPUT, VALUE], {}, "a.bag has no topic generic/output/value"),
    ([OUTPUT], {"imu": "imu/data"}, "a.bag has no topic imu/data"),
    ([OUTPUT, PULSES], {}, "a.bag has no topic teensy_wheel"),
))
def test_missing_topic_is_named_with_the_file(tmp_path, wanted, options, message):
    path = write_ros1(tmp_path / "a.bag", OUTPUTS)
    with pytest.raises(NoRecording, match=message):
        load(str(path), wanted, **options)


def test_message_of_another_version_is_told_with_its_type(tmp_path):
    old = ("old_interface/Float64Stamped", "float64 value")
    path = write_ros1(tmp_path / "a.bag", [Written(0.0, "/generic/output/value", old[0], {})], extra_types=[old])
    path.write_bytes(path.read_bytes().replace(b"old_interface/Float64Stamped", b"car_interface/Float64Stamped"))
    with pytest.raises(NoRecording, match=r"a\.bag: .*value was recorded with another version of car_interface/Float"):
        load(str(path), [VALUE])


def test_missing_output_is_named(tmp_path):
    with pytest.raises(NoRecording, match=r"a\.bag has no topic /servo/output"):
        load(str(write_ros1(tmp_path / "a.bag", ODOMETRY)), [OUTPUT])


def test_topic_of_another_type_is_named(tmp_path):
    path = write_ros1(tmp_path / "a.bag", [Written(0.0, "/odom", "std_msgs/Float64", {"data": 1.0})])
    with pytest.raises(NoRecording, match="/odom is of type std_msgs/Float64"):
        load(str(path), [ODOM])


def test_topic_with_nothing_that_can_be_used_is_named(tmp_path):
    path = write_ros1(tmp_path / "a.bag", [odometry(0.0, x_m=math.inf)])
    with pytest.raises(NoRecording, match="nothing that can be used was recorded of odom"):
        load(str(path), [ODOM])


def test_what_is_optional_may_be_missing_and_start_is_the_first_message(tmp_path):
    found = load(str(write_ros1(tmp_path / "a.bag", ODOMETRY)), [ODOM], optional=signals.PARTS)
    assert found.output is found.imu is found.value is found.pulses is None
    assert found.start_s == START_NS / 1e9 and found.duration_s == pytest.approx(1.9)
