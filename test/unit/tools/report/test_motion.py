"""Distance, curvature and acceleration by odometry."""
from __future__ import annotations

import math
from types import SimpleNamespace

import pytest

from car_interface.tools.report.page import page
from car_interface.tools.report.plots import plots
from car_interface.tools.report.summary import summarize
from written_recordings import Written, odometry, stamp, write_ros1


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
    assert ("<tr><th>Turned against what was asked</th><td>can&#39;t tell: which curve an angle asks for needs "
            "--wheelbase</td></tr>") in page(drive, {})
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


def test_requests_that_are_none_are_left_out(bag):
    drive = summarize(bag)
    before = drive.traces["requested speed"].count
    for angle, speed in ((math.nan, 1.0), (0.1, math.inf)):
        drive.asked.on_drive(9.0, SimpleNamespace(steering_angle=angle, speed=speed))
    assert drive.traces["requested speed"].count == before


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
