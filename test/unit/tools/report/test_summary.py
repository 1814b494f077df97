"""What is found in a recording, and which recordings are refused."""
import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.typesys import Stores

import written_recordings
from car_interface.tools.recordings.recording import NoRecording
from car_interface.tools.report.summary import summarize
from tools.report.summaries import summarized
from written_recordings import (
    HOSTILE,
    NEUTRAL,
    NO_HUMAN,
    PLANNER,
    SPEED_MPS,
    TELEOP,
    Written,
    drive,
    odometry,
    write_ros2,
)


def test_who_drove_when_and_why_is_listed_once_for_each_cause_and_the_servo_is_found_by_its_output(seen):
    assert [(episode.source, round(episode.start_s, 2)) for episode in seen.steering.episodes] == [
        (NO_HUMAN, 0.0), (TELEOP, 5.0), (PLANNER, 20.0), (NEUTRAL, 40.0)]
    assert seen.steering.episodes[-1].reason == "av_turnrad_req silent for 0.50 s"
    assert seen.steering.source_s[PLANNER] == pytest.approx(20.0)
    assert seen.steering.steering_channel == 3 and sorted(seen.steering.duties) == [2, 3]
    assert seen.teensy.counters == {"txPackets": (0, 5900), "rxErrorChecksum": (7, 7)}, "first and last"


def test_sonar_hits_are_where_the_car_was(seen):
    places = seen.sonars.echoes.places()
    assert seen.sonars.echoes.count == 3 and np.abs(places.imag).max() < 0.02
    # At 10.2 s it has driven for 5.2 s.
    assert places.real.min() == pytest.approx(5.2 * SPEED_MPS + 0.42 + 0.8, abs=0.1)
    assert (seen.sonars.nearest_m, seen.sonars.nearest_sonar) == (pytest.approx(0.8), "front_middle")


def test_recording_of_ros_2_gives_the_same(seen, tmp_path):
    messages = [message for message in drive() if message.topic != "/rosout"]
    again = summarize(str(write_ros2(tmp_path / "drive", messages, with_definitions=False)))
    assert again.steering.episodes == seen.steering.episodes and again.motion.distance_m == seen.motion.distance_m
    assert str(again.faults.entries) == str([fault for fault in seen.faults.entries if fault.what != HOSTILE])


@pytest.mark.more
def test_car_below_a_namespace_is_found_there(seen, tmp_path):
    messages = drive(20.0, "/car1")
    assert summarized(tmp_path, messages, "/car1").motion.distance_m == pytest.approx(15 * SPEED_MPS, rel=0.01)
    with pytest.raises(NoRecording, match=r"a\.bag has no message of odom.*: try --ns /car1"):
        summarized(tmp_path, messages)


@pytest.mark.parametrize("messages", [
    pytest.param(drive(5.0), id="only_another_cars"),
    pytest.param([*drive(5.0), Written(0.0, "/car1/sonar/front_middle", "sensor_msgs/Range", {})], id="only_a_sonar"),
])
def test_namespace_without_a_drive_is_refused_though_absolute_names_are_found(messages, tmp_path):
    with pytest.raises(NoRecording, match=r"a\.bag has no message of odom, .* below /car1: try it without --ns$"):
        summarized(tmp_path, messages, "/car1")


def test_topic_that_was_only_announced_is_not_there(tmp_path):
    path = announced(tmp_path, [odometry(0.1 * step, 0.1 * step, speed_mps=1.0) for step in range(20)])
    assert summarize(path).present == {"odom"}
    with pytest.raises(NoRecording, match="has no message of odom"):
        summarize(announced(tmp_path, []))


def announced(tmp_path, messages):
    """A recording in which turn_arb/state never said anything."""
    path, store = tmp_path / f"{len(messages)}.bag", written_recordings.typestore(Stores.ROS1_NOETIC)
    with Ros1Writer(path) as writer:
        writer.add_connection("/turn_arb/state", "car_interface/msg/SteeringState", typestore=store)
        written_recordings._write(writer, store, store.serialize_ros1, messages)
    return str(path)


RADIUS, STICK = "av_turnrad_req", "/teleop_logi/tele_steer_req"


@pytest.mark.parametrize("recorded, role, named, usual, present", [
    ("/" + RADIUS, "stick", RADIUS, RADIUS, STICK), (STICK, "radius", STICK[1:], STICK, RADIUS),
], ids=["radius_as_stick", "stick_as_radius_by_its_relative_name"])
def test_topic_that_the_user_gave_to_one_role_plays_no_other_by_its_usual_name(
        recorded, role, named, usual, present, tmp_path):
    messages = [odometry(0.0), Written(0.1, recorded, "std_msgs/Float32", {})]
    assert summarized(tmp_path, messages).present == {"odom", usual}
    assert summarized(tmp_path, messages, **{role: named}).present == {"odom", present}


@pytest.mark.parametrize("messages, words", [
    pytest.param([Written(0.0, "/chatter", "std_msgs/String", {"data": "x"})], "it has /chatter", id="other_topics"),
    pytest.param([], "no topic at all", id="empty"),
    pytest.param([Written(0.0, "/odom", "std_msgs/String", {"data": "x"})],
                 "/odom is of type std_msgs/String; accepted: nav_msgs/Odometry", id="wrong_type"),
])
def test_recording_without_a_drive_is_refused_by_name(messages, words, tmp_path):
    with pytest.raises(NoRecording, match=f"^.*/a\\.bag.*{words}"):
        summarized(tmp_path, messages)
