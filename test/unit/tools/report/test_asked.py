"""What a planner asked for by AckermannDrive, against what the car drove."""
from __future__ import annotations

import math
from types import SimpleNamespace

import pytest

from car_interface.tools.report.page import page
from car_interface.tools.report.plots import plots
from car_interface.tools.report.summary import summarize
from written_recordings import Written, odometry, stamp, write_ros1

STAMPED, PLAIN = "ackermann_msgs/AckermannDriveStamped", "ackermann_msgs/AckermannDrive"
PLAIN_TEXT = "\n".join(f"float32 {name}" for name in (
    "steering_angle", "steering_angle_velocity", "speed", "acceleration", "jerk"))
TYPES = [(PLAIN, PLAIN_TEXT), (STAMPED, f"std_msgs/Header header\n{PLAIN} drive")]
WHEELBASE_M, RADIUS_M, ASKED_MPS, DRIVEN_MPS = 0.3, 2.0, 1.0, 0.9


def asked(time_s, angle_rad, speed_mps, topic="/drive", is_stamped=True):
    drive = {"steering_angle": angle_rad, "speed": speed_mps}
    return Written(time_s, topic, STAMPED, {"header": {"stamp": stamp(time_s)}, "drive": drive}) if is_stamped else \
        Written(time_s, topic, PLAIN, drive)


def circle(duration_s=10.0, topic="/drive", is_stamped=True):
    """A planner asks for a left circle at 1 m/s; the car drives it at 0.9 m/s and 20 % wider."""
    angle_rad, messages = math.atan(WHEELBASE_M / RADIUS_M), []
    for step in range(int(duration_s * 20)):
        time_s = step / 20
        yaw_rad = DRIVEN_MPS * time_s / (1.2 * RADIUS_M)
        messages.append(odometry(time_s, 1.2 * RADIUS_M * math.sin(yaw_rad), 1.2 * RADIUS_M * (1 - math.cos(yaw_rad)),
                                 yaw_rad, DRIVEN_MPS, "/vesc/odom"))
        messages.append(asked(time_s, angle_rad + 0.005 * (-1) ** step, ASKED_MPS, topic, is_stamped))
    return messages


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return str(write_ros1(tmp_path_factory.mktemp("asked") / "a.bag", circle(), extra_types=TYPES))


def test_speed_and_curve_are_compared_with_what_was_asked(bag):
    drive = summarize(bag, wheelbase_m=WHEELBASE_M)
    assert drive.asked.speed_ratio().median == pytest.approx(0.9, abs=0.002)
    (left, samples), (_, none) = drive.motion.by_planner.ratios()
    assert left == pytest.approx(1 / 1.2, abs=0.05) and samples > 100 and none == 0
    assert drive.traces["requested curvature"].maximum == pytest.approx(0.5, abs=0.02)
    text = page(drive, {})
    assert "<tr><th>Speed against what was asked</th><td>10% slower than asked</td></tr>" in text
    assert "<tr><th>Turned against what was asked</th><td>left 2" in text and "% wider than asked</td></tr>" in text
    assert "odom: /vesc/odom (the only nav_msgs/Odometry)" in text


def test_without_the_wheelbase_an_angle_is_only_an_angle_and_the_page_says_so(bag):
    drive = summarize(bag)
    assert drive.traces["requested curvature"].count == 0
    assert drive.traces["requested angle"].maximum == pytest.approx(math.degrees(math.atan(0.15) + 0.005), abs=0.01)
    assert ("<tr><th>Turned against what was asked</th><td>can't tell: which curve an angle asks for needs --wheelbase"
            "</td></tr>") in page(drive, {})
    assert set(plots(drive)) == {"steering", "path", "speed"}


def test_message_without_a_stamp_and_with_another_name_is_guessed(tmp_path):
    path = write_ros1(tmp_path / "a.bag", circle(3.0, "/planner/out", is_stamped=False), extra_types=TYPES)
    drive = summarize(str(path))
    assert drive.traces["requested speed"].count == 60
    assert "ackermann: /planner/out (the only ackermann_msgs/AckermannDrive)" in drive.notes


def test_topic_called_drive_of_another_type_is_not_read(tmp_path):
    messages = [*circle(1.0, "/x"), Written(0.5, "/drive", "std_msgs/String", {"data": "forward"})]
    path = write_ros1(tmp_path / "a.bag", sorted(messages, key=lambda one: one.time_s), extra_types=TYPES)
    assert summarize(str(path)).traces["requested speed"].count == 20
    path = write_ros1(tmp_path / "b.bag", [message for message in messages if message.topic != "/x"])
    assert "drive" not in summarize(str(path)).present


def test_numbers_that_are_none_are_left_out(bag):
    drive = summarize(bag)
    before = drive.traces["requested speed"].count
    for angle, speed in ((math.nan, 1.0), (0.1, math.inf)):
        drive.asked.on_drive(9.0, SimpleNamespace(steering_angle=angle, speed=speed))
    assert drive.traces["requested speed"].count == before
