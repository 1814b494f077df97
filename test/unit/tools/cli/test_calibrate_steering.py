"""The command calibrate_steering: from a recording of a virtual car to a file by which turn_arb drives it better."""
from __future__ import annotations

import contextlib
import importlib
import io
import math
import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml

from car_interface.common.units import stamp_ns, yaw_rad
from car_interface.sim.vehicle import Vehicle
from car_interface.steering.config import load_steering
from car_interface.tools.calibration.steering.recorded import load_steering_drive
from car_interface.tools.cli.main import main
from car_interface.tools.recordings.recording import read
from recorded_drives import recorded
from written_recordings import START_NS, Written, odometry, rename_topics, stamp, write_ros1

ROOT = Path(__file__).resolve().parents[4]
sys.path.append(str(ROOT / "test"))
virtual_drive = importlib.import_module("accuracy.virtual_drive")
STOCK = ROOT / "config" / "turn_arb.yaml"
SEED, SECONDS = 2, 130.0


def record(seed=SEED, car=None, duration_s=SECONDS, **options):
    return recorded(virtual_drive.record, car or virtual_drive.random_car(SEED), seed=seed, duration_s=duration_s,
                    **options)


@pytest.fixture(scope="module")
def bag():
    return record()


@pytest.fixture(scope="module")
def calibrated(bag, tmp_path_factory):
    """What the command made of the drive, in place of a file of the car's."""
    path = tmp_path_factory.mktemp("calibrated") / "turn_arb.yaml"
    base_text = STOCK.read_text(encoding="utf-8") + "slew_limit: 9000  # gently\n"
    path.write_text(base_text, encoding="utf-8")
    path.chmod(0o640)
    with contextlib.redirect_stdout(io.StringIO()) as out:
        assert run(bag, "-o", path, "--base", path) == 0
    return SimpleNamespace(path=path, out=out.getvalue(), base_text=base_text)


def run(*arguments):
    return main("calibrate_steering", [str(argument) for argument in arguments])


def driven_radius_m(config, radius_m):
    """What the virtual car makes of a planner's request, once its servo has arrived from straight on."""
    vehicle = Vehicle(virtual_drive.random_car(SEED))
    for duty in (config.servo_center, config.planner_duty(radius_m)):
        for _ in range(200):
            vehicle.step(10_000_000, virtual_drive.count_duty(duty), -1)
    return 1 / vehicle.curvature_per_m


def test_car_that_is_driven_by_its_own_table_turns_as_it_is_asked(calibrated):
    made = calibrated.path
    radii = [sign * radius for sign in (1, -1) for radius in (1.3, 1.6, 2.0, 2.5, 3.0, 4.0, 5.0)]
    errors = {path: [abs(driven_radius_m(load_steering(str(path)), radius) / radius - 1) for radius in radii]
              for path in (STOCK, made)}
    assert np.median(errors[made]) < 0.04 and max(errors[made]) < 0.10
    assert np.median(errors[made]) < np.median(errors[STOCK]) / 5
    center = load_steering(str(made)).servo_center
    assert abs(virtual_drive.true_curvature_per_m(virtual_drive.random_car(SEED), center)) < 0.005


def test_file_keeps_what_else_it_had_tells_how_well_it_is_known_and_the_old_one_stays_beside_it(calibrated):
    text = calibrated.path.read_text(encoding="utf-8")
    before, after = yaml.safe_load(calibrated.base_text), yaml.safe_load(text)
    assert {name for name in before if before[name] != after[name]} == {
        "servo_left", "servo_center", "servo_right", "m_turnrad_axis_servo", "k_pwmcmd_left_table_servo",
        "k_pwmcmd_right_table_servo"}
    assert list(before) == list(after)
    assert "slew_limit: 9000  # gently\n" in text and "# of the PCA9685, 0..15" in text
    assert "Traxxas" not in text and text.startswith("# Written by calibrate_steering")
    assert "# steering by drive.bag: 130 s" in text and "segments of steady steering" in text
    assert "backlash of the steering: " in calibrated.out
    (kept,) = calibrated.path.parent.glob("turn_arb.yaml.bak-*")
    assert kept.read_text(encoding="utf-8") == calibrated.base_text
    assert calibrated.path.stat().st_mode & 0o777 == 0o640
    assert f"written: {calibrated.path}; the old one is {kept}\n" in calibrated.out


# --- a planner's angles in place of duties ---


WHEELBASE_M = 0.3
ANGLES = [("ackermann_msgs/AckermannDrive", "\n".join(f"float32 {name}" for name in (
    "steering_angle", "steering_angle_velocity", "speed", "acceleration", "jerk"))),
    ("ackermann_msgs/AckermannDriveStamped", "std_msgs/Header header\nackermann_msgs/AckermannDrive drive")]


@pytest.fixture(scope="module")
def base_of_angles(tmp_path_factory):
    """A base with duties for every angle, far from the car's own."""
    path = tmp_path_factory.mktemp("base") / "base.yaml"
    values = yaml.safe_load(STOCK.read_text(encoding="utf-8"))
    center, radii = values["servo_center"], [0.3, 0.5, 1.0, 2.0, 5.0, 20.0, 300.0]
    values.update(m_turnrad_axis_servo=radii, k_pwmcmd_left_table_servo=[center - 900 / radius for radius in radii],
                  k_pwmcmd_right_table_servo=[center + 900 / radius for radius in radii])
    path.write_text(yaml.safe_dump(values), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def bag_of_angles(bag, base_of_angles, tmp_path_factory):
    """The same drive, with the angles in place of the duties that they became."""
    table, messages = load_steering(str(base_of_angles)), []
    for time_ns, topic, message in read(bag, ["odom", "/servo/output"]):
        time_s = (time_ns - START_NS) / 1e9
        if topic == "odom":
            pose, twist = message.pose.pose, message.twist.twist
            messages.append(odometry(stamp_ns(message.header.stamp) / 1e9 - START_NS / 1e9, pose.position.x,
                                     pose.position.y, yaw_rad(pose.orientation), twist.linear.x, "/racer/odom")
                            ._replace(time_s=time_s))
        else:
            angle_rad = math.atan(WHEELBASE_M / table.turn_radius_m(message.data[0]))
            messages.append(Written(time_s, "/drive", ANGLES[1][0], {
                "header": {"stamp": stamp(time_s)}, "drive": {"steering_angle": angle_rad, "speed": 1.0}}))
    return str(write_ros1(tmp_path_factory.mktemp("angles") / "angles.bag", messages, extra_types=ANGLES))


@pytest.mark.once
def test_angles_of_a_planner_give_the_same_table_and_say_what_they_can_not_tell(
        bag_of_angles, base_of_angles, calibrated, tmp_path, capsys):
    made = tmp_path / "made.yaml"
    assert run(bag_of_angles, "-o", made) == 1
    said = capsys.readouterr().err
    assert "has no topic /servo/output, nor /servo/cmdVector or command: the servo's duties can't be told. " in said
    assert "The angles that were asked for are on drive: with --wheelbase M, and the --base that made duties" in said
    assert run(bag_of_angles, "-o", made, "--base", base_of_angles, "--wheelbase", WHEELBASE_M) == 0
    by_angles, by_duties = load_steering(str(made)), load_steering(str(calibrated.path))
    for radius_m in (1.5, 2.0, 3.0, 5.0, -1.5, -2.0, -3.0, -5.0):
        assert abs(by_angles.planner_duty(radius_m) - by_duties.planner_duty(radius_m)) <= 16, radius_m
    said = capsys.readouterr().out
    assert f"  {bag_of_angles}: odom: /racer/odom (the only nav_msgs/Odometry)\n" in said
    assert "the angles on drive count as the duties that --base has for them with a wheelbase of 0.3 m" in said
    assert "What this recording can't tell: whether --base was the table on this drive" in said
    assert "the angles on drive count" in made.read_text(encoding="utf-8")


def test_angles_beside_duties_are_not_used_and_not_spoken_of(tmp_path, capsys):
    angles = [Written(0.1, "/planner", ANGLES[1][0], {"header": {"stamp": stamp(0.1)}})]
    path = write_ros1(tmp_path / "a.bag", [odometry(0.0), *angles, *OUTPUT], extra_types=ANGLES)
    assert load_steering_drive(str(path), 0, angle_table=None).notes == ()
    assert load_steering_drive(str(path), 0).drive.duty[0] == 5104


@pytest.mark.once
def test_calibration_may_be_a_base_and_an_axis_that_ends_early_goes_on_to_almost_straight_on(
        bag, calibrated, tmp_path, capsys):
    again = tmp_path / "again.yaml"
    assert run(bag, "-o", again, "--base", calibrated.path, "--axis", "1.5,2,5") == 0
    assert again.read_text(encoding="utf-8").count("# Written by") == 1
    config, before = load_steering(str(again)), load_steering(str(calibrated.path))
    assert (config.servo_left, config.servo_center, config.servo_right) == (
        before.servo_left, before.servo_center, before.servo_right)
    assert list(config.radius_axis_m) == [1.5, 2, 5, 6, 7, 8, 10, 12, 15, 20, 30, 50, 100, 300]
    assert "--axis ends at 5 m: 6 to 300 m are added" in capsys.readouterr().out
    for radius in (50.0, 300.0, -300.0):
        assert 1 / driven_radius_m(config, radius) == pytest.approx(1 / radius, abs=0.01)


def test_output_that_can_not_be_written_and_a_channel_that_is_none_are_refused_before_the_work(tmp_path, capsys):
    assert run(tmp_path / "missing.bag", "-o", tmp_path / "none" / "a.yaml") == 1
    assert f"{tmp_path / 'none' / 'a.yaml'} can't be written: there is no folder" in capsys.readouterr().err
    assert run(tmp_path / "missing.bag", "-o", tmp_path / "a.yaml", "--channel", "16") == 1
    assert "--channel is 16; accepted: a channel of the servo board, 0 to 15" in capsys.readouterr().err


@pytest.mark.once
def test_side_that_was_not_driven_is_refused_with_what_to_drive_and_if_forced_keeps_its_old_duties_marked(
        tmp_path, capsys):
    """By an IMU and commands, which do as well as odometry and output."""
    made = tmp_path / "made.yaml"
    bag = record(missing=virtual_drive.NO_RIGHT, duration_s=90.0, imu=True, servo_topic="/servo/cmdVector")
    assert run(bag, "-o", made) == 1
    assert not list(tmp_path.iterdir())
    (error,) = capsys.readouterr().err.splitlines()
    assert "no data for right turns tighter than" in error and "drive three slow right circles" in error
    assert "left turns" not in error
    assert run(bag, "-o", made, "--force") == 0
    assert "heading by the IMU" in capsys.readouterr().out
    text, stock, config = made.read_text(encoding="utf-8"), load_steering(str(STOCK)), load_steering(str(made))
    assert "missing: no data for right turns" in text and text.count("* ") > 10
    assert config.servo_right == stock.servo_right
    for radius in config.radius_axis_m:
        if 1.1 < radius < 5:
            assert config.planner_duty(-radius) == pytest.approx(stock.planner_duty(-radius), abs=1)
            assert config.planner_duty(radius) != stock.planner_duty(radius)
    for radius in (1.5, 3.0):
        assert driven_radius_m(config, radius) == pytest.approx(radius, rel=0.06)


@pytest.mark.once
def test_recording_with_topics_of_other_names_comes_to_the_same_tables_also_in_a_terminal_of_ascii(
        bag, calibrated, tmp_path):
    other = rename_topics(bag, tmp_path / "other.bag", {"/odom": "/ekf/odometry", "/servo/output": "/board/duties"})
    done = subprocess.run(
        [sys.executable, "-B", str(ROOT / "scripts" / "calibrate_steering"), str(other), "-o",
         str(tmp_path / "made.yaml"), "--map", "/board/duties=output"], capture_output=True, check=False, env={
             "PYTHONPATH": os.pathsep.join([str(ROOT / "src"), os.environ.get("PYTHONPATH", "")]),
             "PYTHONIOENCODING": "ascii", "OPENBLAS_NUM_THREADS": "1"})
    assert (done.returncode, done.stderr) == (0, b"")
    assert b" +- " in done.stdout and b"other.bag: odom: /ekf/odometry (the only nav_msgs/Odometry)" in done.stdout
    tables = yaml.safe_load((tmp_path / "made.yaml").read_text(encoding="utf-8"))
    expected = yaml.safe_load(calibrated.path.read_text(encoding="utf-8"))
    assert {**tables, "slew_limit": 9000} == expected


@pytest.mark.once
def test_copy_of_a_recording_does_not_count_twice(bag, tmp_path, capsys):
    shutil.copy(bag, str(tmp_path / "copy.bag"))
    assert run(bag, tmp_path / "copy.bag", "-o", tmp_path / "made.yaml") == 1
    assert f"{bag} and {tmp_path / 'copy.bag'} have the same driving in them" in capsys.readouterr().err


@pytest.mark.once
def test_recordings_before_and_after_the_linkage_was_changed_are_forced_together_with_a_word(bag, tmp_path):
    car = virtual_drive.random_car(SEED)
    moved = replace(car.steering, center_duty=car.steering.center_duty + 60,
                    curve=tuple((duty + 60, curvature) for duty, curvature in car.steering.curve))
    again = record(SEED + 1, replace(car, steering=moved), duration_s=60.0)
    assert run(bag, again, "-o", tmp_path / "made.yaml", "--force", "--jobs", "2") == 0
    text = (tmp_path / "made.yaml").read_text(encoding="utf-8").replace("\n# ", " ")
    assert re.search(f"{bag} and {again} disagree by [56][0-9] duty about", text) and ": 190 s, " in text


def circle(duty, start_s, curvature_per_m, speed_mps=1.2, duration_s=15.0):
    """18 m of a steady circle, as another package's nodes record it."""
    for index in range(round(duration_s * 20)):
        time_s = start_s + index / 20
        yaw = curvature_per_m * speed_mps * index / 20
        yield odometry(time_s, math.sin(yaw) / curvature_per_m, (1 - math.cos(yaw)) / curvature_per_m, yaw, speed_mps)
        yield Written(time_s, "/servo/output", "std_msgs/Int32MultiArray", {"data": [duty] + [-1] * 15})


@pytest.mark.once
def test_steady_circles_a_recording_each_are_used_and_what_they_cannot_show_is_named(tmp_path, capsys):
    (tmp_path / "a_long_path_of_a_folder").mkdir()
    duties = [16 * round(duty / 16) for duty in (4000, 4400, 4800, 5400, 5800, 6200)]
    bags = [write_ros1(tmp_path / "a_long_path_of_a_folder" / f"{duty}.bag",
                       list(circle(duty, 100.0 * index, (5100 - duty) / 1200))) for index, duty in enumerate(duties)]
    assert run(*bags, "-o", tmp_path / "made.yaml", "--imu", "none") == 1
    printed = capsys.readouterr()
    assert "aren't known: the duty never changed within a recording" in printed.out
    reason = printed.err.splitlines()[-1]
    assert "no calibration is written: " in reason and "drive" in reason and "a_long_path" not in reason
    assert run(*bags, "-o", tmp_path / "made.yaml", "--imu", "none", "--force") == 0
    made = load_steering(str(tmp_path / "made.yaml"))
    for duty in duties[1:-1]:  # beyond the outermost ones old duties stay
        assert 1 / made.turn_radius_m(duty) == pytest.approx((5100 - duty) / 1200, abs=0.02)

    assert run(bags[0], "-o", tmp_path / "made.yaml", "--imu", "none") == 1
    assert "4000.bag: no steering can be told from this: the steering was held in fewer than four places" in (
        capsys.readouterr().err)


STILL = [odometry(0.1 * index) for index in range(300)]
OUTPUT = [Written(0.1 * index, "/servo/output", "std_msgs/Int32MultiArray", {"data": [5104] + [-1] * 15})
          for index in range(300)]


@pytest.mark.parametrize("messages, error", (
    (STILL + OUTPUT, "no steering can be told from this"),
    (STILL + [one._replace(fields={"data": [-1] * 16}) for one in OUTPUT], "channel 0 of the servo board never had"),
), ids=("standing", "no pulses"))
def test_recording_that_tells_nothing_is_refused_in_one_line_that_names_it(messages, error, tmp_path, capsys):
    path = write_ros1(tmp_path / "bad.bag", sorted(messages, key=lambda message: message.time_s))
    assert run(path, "-o", tmp_path / "made.yaml") == 1
    said = capsys.readouterr().err
    assert len(said.splitlines()) == 1 and "bad.bag" in said and error in said


@pytest.mark.parametrize("options, said", [
    *((("--axis", axis), "with commas between them, like 0.7,1,2") for axis in ("2,1", "1", "a")),
    (("--axis", "0,1"), "at most 200 radii above 0 m"),
    (("--axis", ",".join(map(str, range(1, 300)))), "at most 200 radii above 0 m"),
    (("--axis", "0.7", "1", "2"), "with commas between them, like 0.7,1,2,5,20,100,300"),
    (("--wheelbase", "0"), "'0' is no length above 0 m"),
], ids=lambda part: " ".join(part)[:20] if isinstance(part, tuple) else "")
def test_number_that_is_none_is_a_matter_of_usage(options, said, capsys):
    with pytest.raises(SystemExit, match="2"):
        run("a.bag", "-o", "made.yaml", *options)
    assert said in capsys.readouterr().err
