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
from typing import NamedTuple

import numpy as np
import pytest
import yaml

from car_interface.calibration.steering.recorded import load_drive
from car_interface.cli.calibrate_steering import Config
from car_interface.cli.main import main
from car_interface.common.errors import ConfigError
from car_interface.common.units import stamp_ns, yaw_rad
from car_interface.recordings.recording import read
from car_interface.sim.vehicle import Vehicle
from car_interface.steering.params import load_steering
from recorded_drives import recorded
from written_recordings import START_NS, Written, odometry, rename_topics, stamp, write_ros1

ROOT = Path(__file__).resolve().parents[3]
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
def bag_without_right_turns():
    return record(missing=virtual_drive.NO_RIGHT, duration_s=90.0)


class Calibrated(NamedTuple):
    """What the command made of the drive by its own defaults."""

    path: Path
    out: str


@pytest.fixture(scope="module")
def calibrated(bag, tmp_path_factory):
    made = tmp_path_factory.mktemp("calibrated") / "made.yaml"
    with contextlib.redirect_stdout(io.StringIO()) as out:
        assert run(bag, "-o", made) == 0
    return Calibrated(made, out.getvalue())


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
    assert "backlash of the steering: " in calibrated.out


def test_file_keeps_what_else_the_base_has_and_tells_how_well_it_is_known(bag, tmp_path):
    base, made = tmp_path / "base.yaml", tmp_path / "made.yaml"
    text = STOCK.read_text(encoding="utf-8").replace("servo_channel: 0 ", "servo_channel: 0 ")
    base.write_text(text + "slew_limit: 9000  # gently\n", encoding="utf-8")
    assert run(bag, "-o", made, "--base", base) == 0
    before, after = (yaml.safe_load(path.read_text(encoding="utf-8")) for path in (base, made))
    calibrated = {"servo_left", "servo_center", "servo_right", "m_turnrad_axis_servo", "k_pwmcmd_left_table_servo",
                  "k_pwmcmd_right_table_servo"}
    assert {name for name in before if before[name] != after[name]} == calibrated
    assert list(before) == list(after)
    text = made.read_text(encoding="utf-8")
    assert "slew_limit: 9000  # gently\n" in text and "# of the PCA9685, 0..15" in text
    assert "Traxxas" not in text and text.startswith("# Written by calibrate_steering")
    assert "# steering by drive.bag: 130 s" in text and "segments of steady steering" in text
    for name in ("servo_left", "servo_center", "servo_right"):
        assert isinstance(after[name], int)
    for name in ("k_pwmcmd_left_table_servo", "k_pwmcmd_right_table_servo"):
        assert all(isinstance(duty, int) for duty in after[name])
        assert np.all(np.diff(after[name]) >= 0) or np.all(np.diff(after[name]) <= 0)


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
                                     pose.position.y, yaw_rad(pose.orientation), twist.linear.x, "/vesc/odom")
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
    assert run(bag_of_angles, "-o", made, "--base", base_of_angles, "--wheelbase", WHEELBASE_M) == 0
    by_angles, by_duties = load_steering(str(made)), load_steering(str(calibrated.path))
    for radius_m in (1.5, 2.0, 3.0, 5.0, -1.5, -2.0, -3.0, -5.0):
        assert abs(by_angles.planner_duty(radius_m) - by_duties.planner_duty(radius_m)) <= 16, radius_m
    said = capsys.readouterr().out
    assert f"  {bag_of_angles}: odom: /vesc/odom (the only nav_msgs/Odometry)\n" in said
    assert "the angles on drive count as the duties that --base has for them with a wheelbase of 0.3 m" in said
    assert "What this recording can't tell: whether --base was the table on this drive" in said
    assert "# " in made.read_text(encoding="utf-8") and "the angles on drive count" in made.read_text(encoding="utf-8")


@pytest.mark.once
def test_angles_alone_are_refused_with_what_to_type(bag_of_angles, tmp_path, capsys):
    assert run(bag_of_angles, "-o", tmp_path / "made.yaml") == 1
    said = capsys.readouterr().err
    assert "has no topic /servo/output, nor /servo/cmdVector or command: the servo's duties can't be told. " in said
    assert "The angles that were asked for are on drive: with --wheelbase M, and the --base that made duties" in said


def test_two_topics_with_angles_are_refused_with_both_names(tmp_path, capsys):
    angles = [Written(0.1 * step, topic, ANGLES[1][0], {"header": {"stamp": stamp(0.1 * step)}})
              for step in range(5) for topic in ("/a", "/b")]
    path = write_ros1(tmp_path / "a.bag", [odometry(0.0), *angles], extra_types=ANGLES)
    assert run(path, "-o", tmp_path / "made.yaml", "--wheelbase", "0.3") == 1
    assert ("the servo's duties can't be told. ackermann: there are /a and /b, and no drive; say which by --map, as in "
            "--map /a=ackermann\n") in capsys.readouterr().err


def test_angles_beside_duties_are_not_used_and_not_spoken_of(tmp_path, capsys):
    angles = [Written(0.1, "/planner", ANGLES[1][0], {"header": {"stamp": stamp(0.1)}})]
    path = write_ros1(tmp_path / "a.bag", [odometry(0.0), *angles, *OUTPUT], extra_types=ANGLES)
    assert load_drive(str(path), 0, angle_table=None).notes == ()
    assert load_drive(str(path), 0).drive.duty[0] == 5104


def test_wheelbase_is_a_length(capsys):
    with pytest.raises(SystemExit) as caught:
        run("a.bag", "-o", "made.yaml", "--wheelbase", "0")
    assert caught.value.code == 2 and "'0' is no length above 0 m" in capsys.readouterr().err


@pytest.mark.once
def test_calibration_may_be_its_own_base(bag, calibrated, tmp_path):
    made, again = calibrated.path, tmp_path / "again.yaml"
    assert run(bag, "-o", again, "--base", made) == 0
    assert again.read_text(encoding="utf-8").count("# Written by") == 1
    assert yaml.safe_load(again.read_text(encoding="utf-8")) == yaml.safe_load(made.read_text(encoding="utf-8"))


@pytest.mark.once
def test_base_in_another_layout_keeps_its_values(bag, tmp_path):
    base, made = tmp_path / "base.yaml", tmp_path / "made.yaml"
    values = {**yaml.safe_load(STOCK.read_text(encoding="utf-8")), "slew_limit": 9000}
    base.write_text(yaml.safe_dump(values, default_flow_style=True), encoding="utf-8")
    assert run(bag, "-o", made, "--base", base) == 0
    assert yaml.safe_load(made.read_text(encoding="utf-8"))["slew_limit"] == 9000


@pytest.mark.once
def test_axis_is_the_one_that_is_asked_for(bag, tmp_path):
    made = tmp_path / "made.yaml"
    assert run(bag, "-o", made, "--axis", "1.5,2,3,5,10,100") == 0
    config = load_steering(str(made))
    assert list(config.radius_axis_m) == [1.5, 2, 3, 5, 10, 100]


@pytest.mark.once
def test_axis_that_ends_early_goes_on_to_almost_straight_on(bag, tmp_path, capsys):
    made = tmp_path / "made.yaml"
    assert run(bag, "-o", made, "--axis", "1.5,2,5") == 0
    config = load_steering(str(made))
    assert list(config.radius_axis_m) == [1.5, 2, 5, 6, 7, 8, 10, 12, 15, 20, 30, 50, 100, 300]
    assert "--axis ends at 5 m: 6 to 300 m are added" in capsys.readouterr().out
    for radius in (50.0, 300.0, -300.0):
        assert 1 / driven_radius_m(config, radius) == pytest.approx(1 / radius, abs=0.01)


def test_axis_outside_of_what_was_driven_is_refused(bag, tmp_path, capsys):
    assert run(bag, "-o", tmp_path / "made.yaml", "--axis", "0.1,0.2") == 1
    assert "--axis 0.1 to 0.2 m lies outside of what was driven: the tightest circle" in capsys.readouterr().err


@pytest.mark.once
def test_calibration_that_is_replaced_stays_beside_it(bag, tmp_path, capsys):
    made = tmp_path / "turn_arb.yaml"
    shutil.copy(str(STOCK), str(made))
    made.chmod(0o640)
    assert run(bag, "-o", made, "--base", made) == 0
    (kept,) = tmp_path.glob("turn_arb.yaml.bak-*")
    assert kept.read_bytes() == STOCK.read_bytes() and made.stat().st_mode & 0o777 == 0o640
    assert f"written: {made}; the old one is {kept}\n" in capsys.readouterr().out


def test_output_that_can_not_be_written_is_refused_before_the_work(tmp_path, capsys):
    assert run(tmp_path / "missing.bag", "-o", tmp_path / "none" / "a.yaml") == 1
    assert f"{tmp_path / 'none' / 'a.yaml'} can't be written: there is no folder" in capsys.readouterr().err


@pytest.mark.once
def test_terminal_that_knows_ascii_only_loses_no_work(bag, tmp_path):
    made = tmp_path / "made.yaml"
    done = subprocess.run([sys.executable, "-B", str(ROOT / "scripts" / "calibrate_steering"), bag, "-o", str(made)],
                          capture_output=True, check=False,
                          env={"PYTHONPATH": os.pathsep.join([str(ROOT / "src"), os.environ.get("PYTHONPATH", "")]),
                               "PYTHONIOENCODING": "ascii"})
    assert (done.returncode, done.stderr) == (0, b"")
    assert b" +- " in done.stdout and made.exists()


def test_center_drives_straight(calibrated):
    center = load_steering(str(calibrated.path)).servo_center
    curvature = virtual_drive.true_curvature_per_m(virtual_drive.random_car(SEED), center)
    assert abs(curvature) < 0.005


@pytest.mark.once
def test_side_that_was_not_driven_is_refused_with_what_to_drive(bag_without_right_turns, tmp_path, capsys):
    made = tmp_path / "made.yaml"
    assert run(bag_without_right_turns, "-o", made) == 1
    assert not made.exists() and not list(tmp_path.glob("*.part"))
    error = capsys.readouterr().err
    assert len(error.splitlines()) == 1
    assert "no data for right turns tighter than" in error and "drive three slow right circles" in error
    assert "left turns" not in error


@pytest.mark.once
def test_forced_table_keeps_old_duties_where_nothing_was_driven_marked(bag_without_right_turns, tmp_path):
    made = tmp_path / "made.yaml"
    assert run(bag_without_right_turns, "-o", made, "--force") == 0
    text, stock, config = made.read_text(encoding="utf-8"), load_steering(str(STOCK)), load_steering(str(made))
    assert "missing: no data for right turns" in text and text.count("* ") > 10
    assert config.servo_right == stock.servo_right
    for radius in config.radius_axis_m:
        if 1.1 < radius < 5:
            assert config.planner_duty(-radius) == pytest.approx(stock.planner_duty(-radius), abs=1)
            assert config.planner_duty(radius) != stock.planner_duty(radius)


@pytest.mark.once
def test_recording_with_gaps_is_calibrated_all_the_same(tmp_path):
    path = record(missing=virtual_drive.TWO_THIRDS, duration_s=120.0)
    assert run(path, "-o", tmp_path / "made.yaml") in (0, 1)  # but never a wrong table
    if (tmp_path / "made.yaml").exists():
        config = load_steering(str(tmp_path / "made.yaml"))
        assert driven_radius_m(config, 2.0) == pytest.approx(2.0, rel=0.08)


def tables(path):
    """What turn_arb loads of a file."""
    return yaml.safe_load(Path(path).read_text(encoding="utf-8"))


@pytest.mark.once
def test_recording_with_topics_of_other_names_comes_to_the_same_tables(bag, calibrated, tmp_path, capsys):
    other = rename_topics(bag, tmp_path / "other.bag", {"/odom": "/ekf/odometry", "/servo/output": "/board/duties"})
    assert run(other, "-o", tmp_path / "made.yaml", "--map", "/board/duties=output") == 0
    assert "other.bag: odom: /ekf/odometry (the only nav_msgs/Odometry)" in capsys.readouterr().out
    assert tables(tmp_path / "made.yaml") == tables(calibrated.path)


@pytest.mark.once
def test_imu_and_commands_instead_of_output_do_as_well(tmp_path, capsys):
    path = record(imu=True, servo_topic="/servo/cmdVector", duration_s=120.0)
    assert run(path, "-o", tmp_path / "made.yaml") == 0
    assert "heading by the IMU" in capsys.readouterr().out
    config = load_steering(str(tmp_path / "made.yaml"))
    for radius in (1.5, 3.0, -1.5, -3.0):
        assert driven_radius_m(config, radius) == pytest.approx(radius, rel=0.06)


@pytest.mark.once
def test_several_recordings_count_together(bag, tmp_path, capsys):
    again = record(SEED + 1, duration_s=30.0)
    assert run(bag, again, "-o", tmp_path / "made.yaml", "--jobs", "2") == 0
    assert "160 s" in capsys.readouterr().out


@pytest.mark.once
def test_copy_of_a_recording_does_not_count_twice(bag, tmp_path, capsys):
    shutil.copy(bag, str(tmp_path / "copy.bag"))
    for again, words in ((bag, "are the same recording"), (tmp_path / "copy.bag", "have the same driving in them")):
        assert run(bag, again, "-o", tmp_path / "made.yaml") == 1
        assert f"{bag} and {again} {words}" in capsys.readouterr().err


@pytest.mark.once
def test_recordings_before_and_after_the_linkage_was_changed_are_refused_by_their_names(bag, tmp_path, capsys):
    car = virtual_drive.random_car(SEED)
    moved = replace(car.steering, center_duty=car.steering.center_duty + 60,
                    curve=tuple((duty + 60, curvature) for duty, curvature in car.steering.curve))
    again = record(SEED + 1, replace(car, steering=moved), duration_s=80.0)
    assert run(bag, again, "-o", tmp_path / "made.yaml") == 1
    error = capsys.readouterr().err
    assert re.search(f"{bag} and {again} disagree by [56][0-9] duty about .*: was the linkage changed between", error)
    assert len(error.splitlines()) == 1 and "drive" not in error.split("disagree")[1]
    assert run(bag, again, "-o", tmp_path / "made.yaml", "--force") == 0
    assert "disagree by" in (tmp_path / "made.yaml").read_text(encoding="utf-8")


STILL = [odometry(0.1 * index) for index in range(300)]
OUTPUT = [Written(0.1 * index, "/servo/output", "std_msgs/Int32MultiArray", {"data": [5104] + [-1] * 15})
          for index in range(300)]


@pytest.mark.parametrize("messages, error", (
    (STILL, "has no topic /servo/output"),
    (OUTPUT, "has no topic odom"),
    (STILL + OUTPUT, "no steering can be told from this"),
    (STILL + [one._replace(fields={"data": [-1] * 16}) for one in OUTPUT], "channel 0 of the servo board never had"),
), ids=("no output", "no odometry", "standing", "no pulses"))
def test_recording_that_tells_nothing_is_refused_in_one_line_that_names_it(messages, error, tmp_path, capsys):
    path = write_ros1(tmp_path / "bad.bag", sorted(messages, key=lambda message: message.time_s))
    assert run(path, "-o", tmp_path / "made.yaml") == 1
    said = capsys.readouterr().err
    assert len(said.splitlines()) == 1 and "bad.bag" in said and error in said


@pytest.mark.parametrize("axis", ("", "2,1", "0,1", "1", "a", ",".join(map(str, range(1, 300)))))
def test_axis_that_is_none_is_a_matter_of_usage(axis, bag, tmp_path):
    with pytest.raises(SystemExit, match="2"):
        run(bag, "-o", tmp_path / "made.yaml", "--axis", axis)


def test_axis_with_spaces_is_told_about_commas(bag, tmp_path, capsys):
    with pytest.raises(SystemExit, match="2"):
        run(bag, "-o", tmp_path / "made.yaml", "--axis", "0.7", "1", "2")
    assert "with commas between them, like 0.7,1,2,5,20,100,300" in capsys.readouterr().err


@pytest.mark.parametrize("given, message", [
    ({"channel": 16}, "--channel is 16; accepted: a channel of the servo board, 0 to 15"),
    ({"axis_m": (2.0, 1.0)}, r"--axis\[1\] is 1.0"),
    ({"axis_m": (0.0, 1.0)}, "--axis is .*; accepted: at most 200 radii above 0 m"),
], ids=["channel", "falling_axis", "no_radius"])
def test_configuration_is_checked_when_it_is_made(given, message):
    with pytest.raises(ConfigError, match=message):
        Config(("a.bag",), "out.yaml", "base.yaml", **given)
