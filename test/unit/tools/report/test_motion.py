"""Distance, curvature and acceleration by odometry."""
import math
from types import SimpleNamespace

import pytest

from car_interface.common import causes
from car_interface.common.sources import LOCKED, NEUTRAL, NO_HUMAN, PLANNER, TELEOP
from car_interface.tools.report.page import page
from car_interface.tools.report.plots import plots
from car_interface.tools.report.summary import summarize
from tools.report.summaries import summarized
from written_recordings import ACKERMANN, ANGLE, STAMPED_ANGLE, Written, odometry, stamp, write_ros1


def test_curvature_is_that_of_the_steering_backwards_too(tmp_path):
    # Backwards with the wheels to the left, radius 2 m: x and y as on the way there, the heading turns to the right.
    messages = [odometry(0.02 * step, 2 * math.sin(angle), 2 - 2 * math.cos(angle), angle, -1.0)
                for step, angle in ((step, -0.01 * step) for step in range(200))]
    seen = summarized(tmp_path, messages)
    turned = seen.traces["driven curvature"]
    assert (turned.minimum, turned.maximum) == (pytest.approx(0.5, abs=0.01), pytest.approx(0.5, abs=0.01))


def test_odometry_that_was_reset_is_no_distance_and_its_gap_is_a_fault(tmp_path):
    jump = [odometry(0.1 * step, 0.1 * step, speed_mps=1.0) for step in range(20)]
    jump += [odometry(5 + 0.1 * step, 50 + 0.1 * step, speed_mps=1.0) for step in range(20)]
    seen = summarized(tmp_path, jump)
    assert seen.motion.distance_m == pytest.approx(3.8)
    assert [fault.what for fault in seen.faults.entries] == [
        "silent for 3.10 s", "began anew: 48.1 m from where it was"]


@pytest.mark.parametrize("back_s, is_fault", [(5.0, True), (0.4, False)], ids=["clock_set", "recorded_late"])
def test_clock_set_back_is_a_fault_and_leaves_accelerations_sane(tmp_path, back_s, is_fault):
    times_s = [10 + 0.02 * step - (back_s if step >= 200 else 0.0) for step in range(400)]
    seen = summarize(str(write_ros1(tmp_path / "a.bag", [message for time_s in times_s for message in (
        odometry(time_s, speed_mps=1.0), Written(time_s, "/generic/output/value", "std_msgs/Float64", {}))])))
    assert seen.traces["acceleration"].maximum == seen.traces["acceleration"].minimum == 0.0
    assert any("went back once" in fault.what for fault in seen.faults.entries) is is_fault


@pytest.mark.parametrize("garbage", [1e308, math.inf, math.nan])
def test_place_that_no_car_can_have_is_left_out(tmp_path, garbage):
    messages = [odometry(0.02 * step, *([garbage] * 2 if step == 5 else [0.02 * step, 0.0]), speed_mps=1.0)
                for step in range(50)]
    seen = summarized(tmp_path, messages)
    assert seen.traces["speed"].count == 49 and seen.motion.distance_m == pytest.approx(0.98)


def test_numbers_that_are_none_are_left_out(tmp_path, bag):
    messages = [odometry(0.02 * step, speed_mps=math.nan if step == 5 else 1.0) for step in range(50)]
    messages.append(Written(0.5, "/av_turnrad_req", "std_msgs/Float32", {"data": math.nan}))
    seen = summarized(tmp_path, messages)
    assert seen.traces["speed"].count == 49 and seen.traces["requested curvature"].count == 0
    drive = summarize(bag)
    before = drive.traces["requested speed"].count
    for angle, speed in ((math.nan, 1.0), (0.1, math.inf)):
        drive.asked.on_drive(9.0, SimpleNamespace(steering_angle=angle, speed=speed))
    assert drive.traces["requested speed"].count == before


WHEELBASE_M, RADIUS_M, ASKED_MPS, DRIVEN_MPS = 0.3, 2.0, 1.0, 0.9


def asked(time_s, angle_rad, speed_mps, topic="/drive", is_stamped=True):
    drive = {"steering_angle": angle_rad, "speed": speed_mps}
    if is_stamped:
        return Written(time_s, topic, STAMPED_ANGLE, {"header": {"stamp": stamp(time_s)}, "drive": drive})
    return Written(time_s, topic, ANGLE, drive)


def circle(duration_s=10.0, topic="/drive", is_stamped=True):
    """A planner asks for a left circle at 1 m/s; the car drives it at 0.9 m/s and 20 % wider."""
    angle_rad, messages = math.atan(WHEELBASE_M / RADIUS_M), []
    for step in range(int(duration_s * 20)):
        time_s = step / 20
        yaw_rad = DRIVEN_MPS * time_s / (1.2 * RADIUS_M)
        messages.append(odometry(time_s, 1.2 * RADIUS_M * math.sin(yaw_rad), 1.2 * RADIUS_M * (1 - math.cos(yaw_rad)),
                                 yaw_rad, DRIVEN_MPS, "/racer/odom"))
        messages.append(asked(time_s, angle_rad + 0.005 * (-1) ** step, ASKED_MPS, topic, is_stamped))
    return messages


def state(time_s, topic, source, **fields):
    kind = {"turn_arb": "SteeringState", "throttle_arb": "ThrottleState", "planner_interface": "PlannerState"}[topic]
    return Written(time_s, f"/{topic}/state", f"car_interface/{kind}", {"source": source, **fields})


def every(period_s, begin_s, end_s, message):
    """The messages that a function makes of each of these times."""
    return [message(begin_s + step * period_s) for step in range(round((end_s - begin_s) / period_s))]


def compared(tmp_path, *more, driven_mps=lambda time_s: 1.0, asked_until_s=12.0):
    """For 12 s a planner asks for a circle at 1 m/s, and the car is on it at another speed; there are more messages."""
    messages, way_m = [message for messages in more for message in messages], 0.0
    for time_s in (step / 20 for step in range(240)):
        way_m += driven_mps(time_s) / 20
        yaw_rad = way_m / RADIUS_M
        messages.append(odometry(time_s, RADIUS_M * math.sin(yaw_rad), RADIUS_M * (1 - math.cos(yaw_rad)), yaw_rad,
                                 driven_mps(time_s)))
        if time_s < asked_until_s:
            messages.append(asked(time_s, math.atan(WHEELBASE_M / RADIUS_M), ASKED_MPS))
    return summarized(tmp_path, messages, extra_types=ACKERMANN, wheelbase_m=WHEELBASE_M)


def test_car_that_drove_as_asked_did_so_and_what_it_does_after_the_last_request_is_not_compared(tmp_path):
    drive = compared(tmp_path, asked_until_s=4.0, driven_mps=lambda time_s: 1.0 if time_s < 4.3 else 0.0)
    ratios = drive.asked.speed_ratios
    assert ratios.median() == pytest.approx(1.0, abs=0.002) and 60 < ratios.samples < 80
    assert "<td>as asked</td>" in page(drive, {})
    assert 60 < compared(tmp_path, asked_until_s=4.0).motion.by_planner.left.samples < 80


def test_request_counts_anew_after_a_pause_once_the_car_has_had_time_to_follow(tmp_path):
    drive = compared(tmp_path, every(0.05, 8.0, 12.0, lambda time_s: asked(time_s, 0.0, ASKED_MPS)), asked_until_s=4.0,
                     driven_mps=lambda time_s: 1.0 if time_s < 4.3 or time_s > 8.6 else 0.0)
    assert drive.asked.speed_ratios.median() == pytest.approx(1.0, abs=0.002)
    assert 120 < drive.asked.speed_ratios.samples < 150


def test_pause_of_the_requests_between_two_messages_of_a_slow_odometry_counts_as_well(tmp_path):
    requests = [asked(time_s, 0.0, ASKED_MPS) for time_s in (2.5, 2.9, 3.3, 3.9, 4.3, 4.7)]
    messages = [*requests, *(odometry(time_s, speed_mps=0.5) for time_s in (2.6, 3.0, 4.0, 5.0))]
    drive = summarized(tmp_path, messages, extra_types=ACKERMANN)
    assert drive.asked.speed_ratios.samples == 1, "at 5.0 s"


@pytest.mark.parametrize("states, speeds, turns", [
    ([("turn_arb", PLANNER), ("throttle_arb", PLANNER)], True, True),
    ([("turn_arb", PLANNER), ("throttle_arb", TELEOP)], False, True),
    ([("turn_arb", TELEOP), ("throttle_arb", PLANNER)], True, False),
    ([("turn_arb", PLANNER)], True, True), ([("turn_arb", TELEOP)], False, False),
    ([("throttle_arb", PLANNER)], True, True), ([("throttle_arb", NO_HUMAN)], False, False), ([], True, True),
    ([("planner_interface", "drive", causes.PLANNER)], True, True),
    ([("planner_interface", "cmd_vel", causes.PLANNER)], False, False),
    ([("planner_interface", "drive", causes.REQUEST_REFUSED)], False, False),
], ids=["planner", "human_drives", "human_steers", "planner_by_turn_arb", "human_by_turn_arb",
        "planner_by_throttle_arb", "nobody_by_throttle_arb", "not_recorded", "obeyed", "another_source_is", "refused"])
def test_who_has_the_car_and_what_is_obeyed_say_what_is_compared_with_the_planners_request(
        states, speeds, turns, tmp_path):
    drive = compared(tmp_path, *(every(0.1, 0, 12, lambda time_s, topic=topic, source=source, cause=cause: state(
        time_s, topic, source, cause=cause)) for topic, source, cause in (
            (*each, "")[:3] for each in states)))
    assert (drive.asked.speed_ratios.samples > 100) is speeds
    assert (drive.motion.by_planner.left.samples > 100) is turns


def test_planner_that_takes_the_car_over_is_compared_a_while_later_and_not_after_the_last_state(tmp_path):
    drive = compared(tmp_path, every(0.1, 0, 4, lambda time_s: state(time_s, "turn_arb", TELEOP)),
                     every(0.1, 4, 8, lambda time_s: state(time_s, "turn_arb", PLANNER)),
                     driven_mps=lambda time_s: 1.0 if 4.6 < time_s < 8.4 else 0.4)
    assert drive.asked.speed_ratios.median() == pytest.approx(1.0, abs=0.002)
    assert 65 < drive.asked.speed_ratios.samples < 80


@pytest.mark.parametrize("source, until_s, low, high", [
    (TELEOP, 12, 200, 240), (NEUTRAL, 12, 200, 240), (TELEOP, 6, 90, 120), (NO_HUMAN, 12, 0, 0), (LOCKED, 12, 0, 0),
], ids=["gamepad", "nobody_steers", "turn_arb_ends", "no_human", "locked"])
def test_turns_are_compared_with_the_tables_while_somebody_has_the_car(source, until_s, low, high, tmp_path):
    drive = compared(tmp_path, every(0.05, 0, until_s, lambda time_s: state(
        time_s, "turn_arb", source, duty=4000, turn_radius=RADIUS_M)))
    assert low <= drive.motion.by_tables.left.samples <= high


def test_acceleration_is_compared_where_the_planner_had_the_throttle_all_along(tmp_path):
    requests = every(0.05, 0, 12, lambda time_s: Written(
        time_s, "/control/command/control_cmd", "car_interface/Control", {"longitudinal": {"acceleration": 1.0}}))
    drive = compared(tmp_path, requests, every(0.1, 0, 4, lambda time_s: state(time_s, "throttle_arb", TELEOP)),
                     every(0.1, 4, 8, lambda time_s: state(time_s, "throttle_arb", PLANNER)),
                     driven_mps=lambda time_s: 0.5 + (0.5 * (time_s - 4) if 4 < time_s < 9 else 0.0))
    driving = drive.motion.accelerating.driving
    assert driving.median() == pytest.approx(-0.5, abs=0.02) and 70 < driving.samples < 85


# --- odometry without a twist ---

def captured(speed_mps, yaw_rad=0.0, noise_m=0.0, twist=None, duration_s=6.0, rate_hz=100, has_stamp=True):
    """Motion capture of a car that drives straight on for 4 s, then stands: poses, and a twist of (m/s, rad/s)."""
    for step in range(int(duration_s * rate_hz)):
        time_s = step / rate_hz
        x_m = speed_mps * min(time_s, 4.0) + noise_m * (-1) ** step
        message = odometry(time_s, x_m, 0.0, yaw_rad, topic="/mocap/odom")
        if not has_stamp:
            message.fields["header"]["stamp"] = {}
        if twist is not None:
            message.fields["twist"]["twist"] = {"linear": {"x": twist[0]}, "angular": {"z": twist[1]}}
        yield message


@pytest.mark.parametrize("case, speed_mps", [
    ({}, 1.5), ({"twist": (0.0, 0.3)}, 1.5), ({"yaw_rad": 3.0}, -1.5), ({"yaw_rad": 0.5}, 1.5), ({"rate_hz": 5}, 1.5),
    ({"has_stamp": False}, 1.5),
], ids=["no_twist", "only_turn_rates", "backward", "body_turned_against_the_car", "five_a_second", "no_stamps"])
def test_odometry_without_a_twist_has_the_speed_of_its_pose_and_the_page_says_so(case, speed_mps, tmp_path):
    drive = summarized(tmp_path, captured(1.5, **case))
    speed, acceleration = drive.traces["speed"], drive.traces["acceleration"]
    fastest = max(speed.minimum, speed.maximum, key=abs)
    assert fastest == pytest.approx(speed_mps, rel=1e-3)
    assert max(acceleration.maximum * speed_mps, 0) == pytest.approx(0, abs=1e-3), "it drove from the first pose on"
    assert drive.motion.distance_m == pytest.approx(6.0, rel=0.02)
    note = "/mocap/odom: its twist is 0 throughout while its pose moves: speed and turn rate are taken from the pose"
    text = page(drive, {}).replace("<wbr>", "")
    assert note in drive.notes and note in text and "<b>1.50 m/s</b><span>top speed" in text


def test_odometry_without_a_twist_turns_as_its_pose_does(tmp_path):
    messages = circle()
    for message in messages:
        message.fields.pop("twist", None)
    drive = summarized(tmp_path, messages, extra_types=ACKERMANN, wheelbase_m=WHEELBASE_M)
    assert drive.asked.speed_ratios.median() == pytest.approx(0.9, abs=0.003)
    assert drive.motion.by_planner.left.median() == pytest.approx(1 / 1.2, abs=0.05)
    turned = drive.traces["turn rate"]
    assert (turned.minimum, turned.maximum) == (pytest.approx(0.375, abs=0.001), pytest.approx(0.375, abs=0.001))


def test_noise_of_a_pose_that_stands_is_no_distance(tmp_path):
    drive = summarized(tmp_path, captured(1.0, noise_m=0.001))
    assert drive.motion.distance_m == pytest.approx(4.0, abs=0.1)
    assert drive.motion.moving_s == pytest.approx(4.0, abs=0.2)
    stood = summarized(tmp_path, captured(0.0, noise_m=0.001))
    assert stood.motion.distance_m == 0.0 and not any("twist" in note for note in stood.notes)


def test_twist_that_is_there_is_believed(tmp_path):
    drive = summarized(tmp_path, captured(1.5, twist=(1.2, 0.0)))
    assert drive.traces["speed"].maximum == 1.2 and not any("twist" in note for note in drive.notes)


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return str(write_ros1(tmp_path_factory.mktemp("asked") / "a.bag", circle(), extra_types=ACKERMANN))


def test_speed_and_curve_are_compared_with_what_was_asked(bag):
    drive = summarize(bag, wheelbase_m=WHEELBASE_M)
    assert drive.asked.speed_ratios.median() == pytest.approx(0.9, abs=0.002)
    left, right = drive.motion.by_planner.left, drive.motion.by_planner.right
    assert left.median() == pytest.approx(1 / 1.2, abs=0.05) and left.samples > 100 and right.samples == 0
    assert drive.traces["requested curvature"].maximum == pytest.approx(0.5, abs=0.02)
    text = page(drive, {}).replace("<wbr>", "")
    assert "<tr><th>Speed against what was asked</th><td>10% slower than asked</td></tr>" in text
    assert "<tr><th>Turned against what was asked</th><td>left 2" in text and "% wider than asked</td></tr>" in text
    assert "odom: /racer/odom (the only nav_msgs/Odometry)" in text


def test_without_the_wheelbase_an_angle_is_only_an_angle_and_the_page_says_so(bag):
    drive = summarize(bag)
    assert drive.traces["requested curvature"].count == 0
    assert drive.traces["requested angle"].maximum == pytest.approx(math.degrees(math.atan(0.15) + 0.005), abs=0.01)
    assert ("<tr><th>Turned against what was asked</th><td>can&#39;t tell: which curve an angle asks for needs "
            "--wheelbase</td></tr>") in page(drive, {})
    assert set(plots(drive)) == {"steering", "path", "speed"}


def test_message_without_a_stamp_and_with_another_name_is_guessed(tmp_path):
    drive = summarized(tmp_path, circle(3.0, "/planner/out", is_stamped=False), extra_types=ACKERMANN)
    assert drive.traces["requested speed"].count == 60
    assert "ackermann: /planner/out (the only ackermann_msgs/AckermannDrive)" in drive.notes


def test_topic_called_drive_of_another_type_is_not_read(tmp_path):
    messages = [*circle(1.0, "/x"), Written(0.5, "/drive", "std_msgs/String", {"data": "forward"})]
    assert summarized(tmp_path, messages, extra_types=ACKERMANN).traces["requested speed"].count == 20
    assert "drive" not in summarized(tmp_path, [one for one in messages if one.topic != "/x"]).present


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
    return summarized(tmp_path, messages)


def test_odometry_that_turns_more_than_the_imu_is_said(tmp_path):
    drive = spinning(tmp_path)
    assert drive.imu.ratios.median() == pytest.approx(1.5, abs=0.01)
    assert "<tr><th>Turned by odometry</th><td>50% more than the IMU says</td></tr>" in page(drive, {})
    assert "by the IMU" not in drive.notes and "speed" in plots(drive)


def test_imu_on_its_side_or_that_hardly_turns_or_has_no_number_is_not_compared_and_the_page_says_why(tmp_path):
    drive = spinning(tmp_path, (0.0, 9.8, 0.0))
    text = page(drive, {}).replace("<wbr>", "")
    assert "Turned by odometry" not in text and "imu/data: gravity lies along its y axis, not along z" in text
    assert spinning(tmp_path, rate_radps=0.1).imu.ratios.samples == 0
    drive = spinning(tmp_path, rate_radps=math.nan)
    assert drive.imu.ratios.samples == 0 and drive.traces["imu turn rate"].count == 0


def test_turn_rate_of_an_odometry_that_has_ended_is_not_compared_with_the_imu(tmp_path):
    messages = [*(odometry(step / 50, 0.0, 0.0, 0.5 * step / 50) for step in range(100)),
                *(imu(step / 50, 0.5 if step < 100 else 2.0, (0.0, 0.0, 9.8)) for step in range(400))]
    drive = summarized(tmp_path, messages)
    assert drive.imu.ratios.median() == pytest.approx(1.0, abs=0.01)
