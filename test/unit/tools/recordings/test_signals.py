"""What a recording tells as columns: their times, what is left out of them, and what is said about that."""
import math

import numpy as np
import pytest

from car_interface.tools.recordings import signals
from car_interface.tools.recordings.columns import BREAK_S
from car_interface.tools.recordings.recording import NoRecording
from car_interface.tools.recordings.signals import PULSES, load
from written_recordings import START_NS, Written, odometry, output, stamp, write_ros1

ODOMETRY = [odometry(0.1 * index, x_m=0.2 * index, yaw_rad=0.5 * index, speed_mps=2.0) for index in range(20)]


OUTPUTS = [output(0.0, 5104), output(0.5, 3808), output(1.0, 3808, 4912)]


@pytest.mark.parametrize("topic", ("/servo/cmdVector", "/command"))
def test_commands_serve_where_no_output_was_recorded(tmp_path, topic):
    path = write_ros1(tmp_path / "a.bag", [output(0.0, 5101, topic=topic), output(0.2, 3800, topic=topic)])
    assert load(str(path), ["output"]).output.duties[:, 0].tolist() == [5104, 3808]


def test_clock_that_is_set_back_begins_another_drive(tmp_path):
    again = [message._replace(time_s=message.time_s - 1000, fields={**message.fields, "header": {
        "stamp": stamp(message.time_s - 1000)}}) for message in ODOMETRY]
    found = load(str(write_ros1(tmp_path / "a.bag", ODOMETRY + again, chunk_bytes=1000)), ["odom"])
    assert len(found.odom.t_s) == 40 and np.all(np.diff(found.odom.t_s) > 0)
    assert found.odom.t_s[20] - found.odom.t_s[19] == pytest.approx(BREAK_S, abs=0.1)
    (note,) = found.notes  # and none that says that stamps lie seconds away
    assert "set back by 1001.9 s, 1.9 s after the start: " in note


def test_what_is_optional_is_not_read_where_its_usual_name_is_another_type(tmp_path):
    path = write_ros1(tmp_path / "a.bag", [*OUTPUTS, Written(2.0, "/drive", "std_msgs/String", {"data": "x"})])
    assert load(str(path), ["output"], optional=["ackermann"]).ackermann is None
    with pytest.raises(NoRecording, match="/drive is of type std_msgs/String; accepted: ackermann_msgs/Ackermann"):
        load(str(path), ["output"], optional=["ackermann"], ackermann="/drive")


@pytest.mark.parametrize("role", ["output", "command"])
def test_duties_may_have_another_name_which_goes_before_the_usual_ones(tmp_path, role):
    path = write_ros1(tmp_path / "a.bag", [output(0.0, 6000), output(0.1, 5101, topic="/pwm")])
    found = load(str(path), ["output"], **{role: "/pwm"})
    assert found.output.duties[0, 0] == (5101 if role == "output" else 5104) and found.topics == {"output": "/pwm"}
    with pytest.raises(NoRecording, match=r"a\.bag has no topic /missing"):
        load(str(path), [], optional=["output"], **{role: "/missing"})


@pytest.mark.parametrize("wanted, options, message", (
    (["odom"], {}, "a.bag has no topic odom"),
    (["output", PULSES], {}, "a.bag has no topic teensy_wheel"),
    (["output"], {"output": "/board"}, "a.bag has no topic /board; it has /servo/output$"),
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
        load(str(path), ["value"])


def test_topic_that_the_user_names_is_of_another_type_though_that_is_another_role_s(tmp_path):
    path = write_ros1(tmp_path / "a.bag", [*ODOMETRY, Written(0.0, "/imu/data", "sensor_msgs/Imu", {})])
    with pytest.raises(NoRecording, match=r"/imu/data is of type sensor_msgs/Imu; accepted: nav_msgs/Odometry$"):
        load(str(path), ["odom"], optional=["imu"], odom="/imu/data")
    with pytest.raises(NoRecording, match=r"/odom is of type nav_msgs/Odometry; accepted: sensor_msgs/Imu$"):
        load(str(path), ["odom"], optional=["imu"], imu="/odom")


def test_topic_with_nothing_that_can_be_used_is_named(tmp_path):
    path = write_ros1(tmp_path / "a.bag", [odometry(0.0, x_m=math.inf)])
    with pytest.raises(NoRecording, match="nothing that can be used was recorded of odom"):
        load(str(path), ["odom"])


def test_what_is_optional_may_be_missing_and_start_is_the_first_message(tmp_path):
    found = load(str(write_ros1(tmp_path / "a.bag", ODOMETRY)), ["odom"], optional=signals.PARTS)
    assert found.output is found.imu is found.value is found.pulses is None
    assert found.start_s == START_NS / 1e9 and found.duration_s == pytest.approx(1.9)
