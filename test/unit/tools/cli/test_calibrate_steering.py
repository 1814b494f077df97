"""The command calibrate_steering: from a recording of a virtual car to a file by which turn_arb drives it better."""
import contextlib
import io
import math
import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from accuracy import virtual_drive

from car_interface.sim.vehicle import Vehicle
from car_interface.steering.config import load_steering
from car_interface.tools.calibration.steering.recorded import load_steering_drive
from car_interface.tools.cli.main import main
from recorded_drives import recorded
from tools.calibration.steering.synthetic import mixed, true_curvature
from written_recordings import ACKERMANN, STAMPED_ANGLE, Written, odometry, output, stamp, write_ros1

ROOT = Path(__file__).resolve().parents[4]
STOCK = ROOT / "config" / "turn_arb.yaml"
SEED, SECONDS = 2, 100.0
PLACES = mixed(count=36)


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory):
    """What the command made of a virtual car's drive, in place of a file of the car's."""
    bag = recorded(virtual_drive.record, virtual_drive.random_car(SEED), seed=SEED, duration_s=SECONDS)
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
    assert f"# steering by drive.bag: {SECONDS:.0f} s" in text and "segments of steady steering" in text
    assert "backlash of the steering: " in calibrated.out
    (kept,) = calibrated.path.parent.glob("turn_arb.yaml.bak-*")
    assert kept.read_text(encoding="utf-8") == calibrated.base_text
    assert calibrated.path.stat().st_mode & 0o777 == 0o640
    assert f"written: {calibrated.path}; the old one is {kept}\n" in calibrated.out


# --- a steering that is held at one duty after the other, as another package's nodes record it ---

def held(duties, command=output, odom="/odom", hold_s=2.0, start_s=0.0, curve=true_curvature, with_imu=False):
    """Odometry at 1.2 m/s, and what ``command`` makes of (time, duty), 20 times a second."""
    x_m = y_m = yaw = 0.0
    for index in range(round(20 * hold_s) * len(duties)):
        time_s, duty = start_s + index / 20, duties[index // round(20 * hold_s)]
        yield command(time_s, duty)
        yield odometry(time_s, x_m, y_m, yaw, 1.2, odom)
        turn_radps = 1.2 * float(curve(duty))
        if with_imu:
            yield Written(time_s, "/imu/data", "sensor_msgs/Imu", {
                "header": {"stamp": stamp(time_s)}, "angular_velocity": {"z": turn_radps}})
        x_m, y_m, yaw = x_m + 0.06 * math.cos(yaw), y_m + 0.06 * math.sin(yaw), yaw + turn_radps / 20


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """A recording of that kind, and the table that the command makes of it."""
    folder = tmp_path_factory.mktemp("plain")
    bag, table = write_ros1(folder / "plain.bag", held(PLACES)), folder / "plain.yaml"
    assert run(bag, "-o", table) == 0
    return SimpleNamespace(bag=bag, table=table)


# --- a planner's angles in place of duties ---

WHEELBASE_M = 0.3


@pytest.mark.once
def test_angles_of_a_planner_give_the_same_table_and_say_what_they_can_not_tell(plain, tmp_path, capsys):
    # A base with duties for every angle, far from the car's own.
    base, made, values = tmp_path / "base.yaml", tmp_path / "made.yaml", yaml.safe_load(STOCK.read_text("utf-8"))
    center, radii = values["servo_center"], [0.3, 0.5, 1.0, 2.0, 5.0, 20.0, 300.0]
    values.update(m_turnrad_axis_servo=radii, k_pwmcmd_left_table_servo=[center - 900 / radius for radius in radii],
                  k_pwmcmd_right_table_servo=[center + 900 / radius for radius in radii])
    base.write_text(yaml.safe_dump(values), encoding="utf-8")
    table = load_steering(str(base))

    def asked(time_s, duty):
        angle_rad = math.atan(WHEELBASE_M / table.turn_radius_m(duty))
        return Written(time_s, "/drive", STAMPED_ANGLE, {
            "header": {"stamp": stamp(time_s)}, "drive": {"steering_angle": angle_rad, "speed": 1.0}})
    bag = write_ros1(tmp_path / "angles.bag", held(PLACES, asked, "/racer/odom"), extra_types=ACKERMANN)
    assert run(bag, "-o", made) == 1
    said = capsys.readouterr().err
    assert "has no topic /servo/output, nor /servo/cmdVector or command: the servo's duties can't be told. " in said
    assert "The angles that were asked for are on drive: with --wheelbase M, and the --base that made duties" in said
    assert run(bag, "-o", made, "--base", base, "--wheelbase", WHEELBASE_M) == 0
    by_angles, by_duties = load_steering(str(made)), load_steering(str(plain.table))
    for radius_m in (1.5, 2.0, 3.0, 5.0, -1.5, -2.0, -3.0, -5.0):
        assert abs(by_angles.planner_duty(radius_m) - by_duties.planner_duty(radius_m)) <= 16, radius_m
    said = capsys.readouterr().out
    assert f"  {bag}: odom: /racer/odom (the only nav_msgs/Odometry)\n" in said
    assert "the angles on drive count as the duties that --base has for them with a wheelbase of 0.3 m" in said
    assert "What this recording can't tell: whether --base was the table on this drive" in said
    assert "the angles on drive count" in made.read_text(encoding="utf-8")


def test_angles_beside_duties_are_not_used_and_not_spoken_of(tmp_path):
    angles = [Written(0.1, "/planner", STAMPED_ANGLE, {"header": {"stamp": stamp(0.1)}})]
    path = write_ros1(tmp_path / "a.bag", [odometry(0.0), *angles, *OUTPUT], extra_types=ACKERMANN)
    found = load_steering_drive(str(path), 0)
    assert found.notes == () and found.drive.duty[0] == 5104


@pytest.mark.once
def test_calibration_may_be_a_base_and_an_axis_that_ends_early_goes_on_to_almost_straight_on(plain, tmp_path, capsys):
    again = tmp_path / "again.yaml"
    assert run(plain.bag, "-o", again, "--base", plain.table, "--axis", "1.5,2,5") == 0
    assert again.read_text(encoding="utf-8").count("# Written by") == 1
    config, before = load_steering(str(again)), load_steering(str(plain.table))
    assert (config.servo_left, config.servo_center, config.servo_right) == (
        before.servo_left, before.servo_center, before.servo_right)
    assert list(config.radius_axis_m) == [1.5, 2, 5, 6, 7, 8, 10, 12, 15, 20, 30, 50, 100, 300]
    assert "--axis ends at 5 m: 6 to 300 m are added" in capsys.readouterr().out
    for radius in (50.0, 300.0, -300.0):
        assert true_curvature(config.planner_duty(radius)) == pytest.approx(1 / radius, abs=0.01)


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
    bag = write_ros1(tmp_path / "left.bag", held(mixed(3700, 5250, 24), lambda time_s, duty: output(
        time_s, duty, topic="/servo/cmdVector"), with_imu=True))
    assert run(bag, "-o", made) == 1 and not made.exists()
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
            assert true_curvature(config.planner_duty(radius)) == pytest.approx(1 / radius, abs=0.02)


@pytest.mark.once
def test_recording_with_topics_of_other_names_comes_to_the_same_tables_also_in_a_terminal_of_ascii(plain, tmp_path):
    other = write_ros1(tmp_path / "other.bag", held(PLACES, lambda time_s, duty: output(
        time_s, duty, topic="/board/duties"), "/ekf/odometry"))
    done = subprocess.run(
        [sys.executable, "-B", str(ROOT / "scripts" / "calibrate_steering"), str(other), "-o",
         str(tmp_path / "made.yaml"), "--map", "/board/duties=output"], capture_output=True, check=False, env={
             "PYTHONPATH": os.pathsep.join([str(ROOT / "src"), os.environ.get("PYTHONPATH", "")]),
             "PYTHONIOENCODING": "ascii", "OPENBLAS_NUM_THREADS": "1"})
    assert (done.returncode, done.stderr) == (0, b"")
    assert b" +- " in done.stdout and b"other.bag: odom: /ekf/odometry (the only nav_msgs/Odometry)" in done.stdout
    assert load_steering(str(tmp_path / "made.yaml")) == load_steering(str(plain.table))


@pytest.mark.more
def test_copy_of_a_recording_does_not_count_twice(plain, tmp_path, capsys):
    copy = shutil.copy(str(plain.bag), str(tmp_path / "copy.bag"))
    assert run(plain.bag, copy, "-o", tmp_path / "made.yaml", "--jobs", "1") == 1
    assert f"{plain.bag} and {copy} have the same driving in them" in capsys.readouterr().err


@pytest.mark.once
def test_recordings_before_and_after_the_linkage_was_changed_are_forced_together_with_a_word(plain, tmp_path):
    again = write_ros1(tmp_path / "again.bag", held(
        PLACES, start_s=1000.0, curve=lambda duty: true_curvature(duty - 60)))
    assert run(plain.bag, again, "-o", tmp_path / "made.yaml", "--force", "--jobs", "1") == 0
    text = (tmp_path / "made.yaml").read_text(encoding="utf-8").replace("\n# ", " ")
    assert f"{plain.bag} and {again} disagree by 60 duty about" in text and ": 144 s, " in text


STILL = [odometry(0.1 * index) for index in range(300)]
OUTPUT = [output(0.1 * index, 5104) for index in range(300)]


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
