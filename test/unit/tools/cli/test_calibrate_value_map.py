"""The command calibrate_value_map, on drives whose true map is known."""
import argparse
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from accuracy import virtual_drive

from car_interface.sim.drive_train import true_acceleration_mps2
from car_interface.throttle.value_map import load_value_map
from car_interface.tools.cli.calibrate_value_map import add_arguments, config_of
from car_interface.tools.cli.main import main
from recorded_drives import recorded
from tools.calibration.value_map.synthetic import DELAY_S, acceleration, messages_of, value_at
from written_recordings import Written, odometry, output, write_ros1

ROOT = Path(__file__).resolve().parents[4]
OUTPUT = output(0.0, 5100, 4915)
KNOWN_DELAY = ("--delay", DELAY_S)  # estimating it takes most of a fit's time


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return write_ros1(tmp_path_factory.mktemp("drive") / "drive.bag", messages_of(120.0))


@pytest.fixture(scope="module")
def short_bag(tmp_path_factory):
    """Too little for a map."""
    return write_ros1(tmp_path_factory.mktemp("short") / "short.bag", messages_of(4.0, seed=1))


def run(*arguments):
    return main("calibrate_value_map", [str(argument) for argument in arguments])


def error_mps2(table, truth=acceleration):
    """RMS of a map."""
    return float(np.sqrt(np.mean([(table.acceleration_at(value, velocity) - float(truth(value, velocity))) ** 2
                                  for value in table.values for velocity in table.velocities])))


def test_map_of_a_virtual_car_is_near_the_truth_and_the_report_lies_beside_it(tmp_path, capsys):
    seconds, car = 80.0, virtual_drive.random_car(3)
    bag = recorded(virtual_drive.record, car, seed=3, duration_s=seconds)
    assert run(bag, "-o", tmp_path / "map.csv") == 0
    thrust = car.drive.thrust(seconds / 2)  # in the middle of the drive
    assert error_mps2(load_value_map(str(tmp_path / "map.csv")), lambda value, velocity: true_acceleration_mps2(
        virtual_drive.duty_of_value(value), max(velocity, 1e-3), car.drive, thrust)) < 0.05
    report = (tmp_path / "map.report.txt").read_text(encoding="utf-8")
    assert "accelerations by pulse times of the wheels" in report
    assert "held out (every 5th manoeuvre" in report and "standard error" in report and "ground rises by" in report
    assert "steering: a tight turn, or tyres at work" in report and "missing: value" in report
    assert report.strip() in capsys.readouterr().out
    assert sorted(path.name for path in tmp_path.iterdir()) == ["map.csv", "map.report.txt"]


@pytest.mark.once
def test_recording_with_topics_of_other_names_comes_to_the_map_too(tmp_path, capsys):
    other = write_ros1(tmp_path / "other.bag", messages_of(120.0, names={
        "odom": "/ekf/odometry", "output": "/board/duties", "value": "/esc/value"}))
    assert run(other, "-o", tmp_path / "map.csv") == 1
    assert "; name another by --map TOPIC=value; it has /esc/value\n" in capsys.readouterr().err
    assert run(other, "-o", tmp_path / "map.csv", "--map", "/esc/value=value", "--map", "/board/duties=output",
               *KNOWN_DELAY) == 0
    assert "other.bag: odom: /ekf/odometry (the only nav_msgs/Odometry)" in capsys.readouterr().out
    assert error_mps2(load_value_map(str(tmp_path / "map.csv"))) < 0.12


def throttle_state(time_s, source, asked=0.5):
    return Written(time_s, "/throttle_arb/state", "car_interface/ThrottleState", {"source": source, "asked": asked})


@pytest.mark.parametrize("messages, expected", [
    ([value_at(0.0)], "generic/output/value"),
    ([value_at(0.0), OUTPUT], "generic/output/value"),
    ([OUTPUT], "duty:2"),
    ([value_at(0.0), OUTPUT, throttle_state(0.1, 3), throttle_state(0.2, 3), throttle_state(0.3, 4)], "duty:2"),
    ([value_at(0.0), OUTPUT, throttle_state(0.1, 3), throttle_state(0.2, 4)], "generic/output/value"),
    ([value_at(0.0), OUTPUT, throttle_state(0.1, 3, 0.0), throttle_state(0.2, 3, 0.0)], "generic/output/value"),
    ([value_at(0.0), throttle_state(0.1, 3)], "generic/output/value"),
], ids=["value_alone", "value_and_output", "output_alone", "mostly_by_hand", "as_often_by_the_planner",
        "deadman_held_and_nothing_asked", "no_output"])
def test_without_a_word_the_recording_says_whether_it_was_driven_by_hand(tmp_path, messages, expected):
    path = write_ros1(tmp_path / "a.bag", [odometry(0.0), *messages])
    throttle = throttle_file(tmp_path, "servo: {channel: 2, value_axis: [-5, 0, 3], duty_table: [3277, 4915, 6554], "
                                       "neutral: 4915}")
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    config = config_of(parser.parse_args([str(path), "-o", "map.csv", "--throttle", str(throttle)]))
    assert config.value_name == expected


def throttle_file(tmp_path, text):
    path = tmp_path / "throttle.yaml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("text, said", [
    ("servo: {value_axis: [-5, 0, 3], duty_table: [3277, 4915, 4915], neutral: 4915}", "that only rise, or only"),
    ("servo: {value_axis: [-5, 0, 3], duty_table: [3277, 4915, 4000], neutral: 4000}", "that only rise, or only"),
    ("servo: {value_axis: [-5, 3], duty_table: [3277, 6554], neutral: 7000}", "servo/neutral is 7000"),
    ("- 1", "YAML lines"),
], ids=["level", "back", "neutral", "list"])
def test_throttle_that_can_not_be_turned_round_is_refused_by_name(short_bag, tmp_path, capsys, text, said):
    path = throttle_file(tmp_path, text)
    assert run(short_bag, "-o", tmp_path / "map.csv", "--value", "duty:1", "--throttle", path) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert str(path) in line and said in line and not (tmp_path / "map.csv").exists()


@pytest.mark.once
def test_duties_count_as_the_values_that_make_them_and_those_that_none_makes_are_told(bag, tmp_path, capsys):
    path = throttle_file(tmp_path, "servo: {value_axis: [-3, 0, 2], duty_table: [3932, 4915, 6008], neutral: 4915}")
    assert run(bag, "-o", tmp_path / "map.csv", "--value", "duty:1", "--throttle", path, *KNOWN_DELAY) == 0
    out = capsys.readouterr().out
    assert "value: duty:1; accelerations by" in out and "makes it: 3932 is -3, 6008 is 2" in out
    assert re.search(r"[1-9]\d* of \d+ duties lie beyond 3932 to 6008, where .* has no value", out)
    table = load_value_map(str(tmp_path / "map.csv"))
    assert error_mps2(table) < 0.1 and -3.0 <= table.values[0] < table.values[-1] <= 2.0


@pytest.mark.once
def test_what_was_not_driven_is_missing_and_not_made_up(bag, tmp_path, capsys):
    # Nobody drove faster than 9 m/s, or braked harder than -4.
    axes = ("--values", -10, -5, -2, 0, 1, 2, "--velocities", 1, 3, 5, 7, 9, 13)
    assert run(bag, "-o", tmp_path / "map.csv", *axes, *KNOWN_DELAY) == 0
    table = load_value_map(str(tmp_path / "map.csv"))
    assert table.values[0] >= -5.0 and table.velocities[-1] <= 9.0
    out = capsys.readouterr().out
    assert "missing: value -10.0: at any speed" in out and "13.0 m/s" in out


@pytest.mark.once
def test_imu_finds_the_map_too(tmp_path):
    bag = write_ros1(tmp_path / "imu.bag", messages_of(120.0, with_imu=True))
    assert run(bag, "-o", tmp_path / "map.csv", "--imu", "imu/data", "--acceleration", "imu", *KNOWN_DELAY) == 0
    assert error_mps2(load_value_map(str(tmp_path / "map.csv"))) < 0.12


@pytest.mark.once
def test_prior_gives_the_axes_stays_where_nothing_was_driven_and_is_kept_beside_the_map_that_replaces_it(
        bag, short_bag, tmp_path, capsys):
    path, before = tmp_path / "map.csv", load_value_map(str(ROOT / "config" / "value_map.csv"))
    shutil.copy(str(ROOT / "config" / "value_map.csv"), str(path))
    (tmp_path / "map.report.txt").write_text("old", encoding="utf-8")
    assert run(bag, short_bag, "-o", path, "--prior", path, "--jobs", 2, *KNOWN_DELAY) == 0
    after, out = load_value_map(str(path)), capsys.readouterr().out
    assert (after.values, after.velocities) == (before.values, before.velocities)
    assert after.acceleration_at(3.0, 10.0) == before.acceleration_at(3.0, 10.0)
    assert abs(after.acceleration_at(1.2, 2.0) - before.acceleration_at(1.2, 2.0)) > 0.02
    assert "the prior's" in out and "narrower" not in out
    kept = sorted(path.name for path in tmp_path.glob("*.bak-*"))
    assert [name.split(".bak-")[0] for name in kept] == ["map.csv", "map.report.txt"]
    assert all(f"; the old one is {tmp_path / name}\n" in out for name in kept)


@pytest.mark.more
def test_map_that_is_narrower_than_the_old_one_is_said_so_last_in_one_line(bag, tmp_path, capsys):
    path = tmp_path / "map.csv"
    shutil.copy(str(ROOT / "config" / "value_map.csv"), str(path))
    assert run(bag, "-o", path, *KNOWN_DELAY) == 0
    new, last = load_value_map(str(path)), capsys.readouterr().out.splitlines()[-1]
    (kept,) = tmp_path.glob("map.csv.bak-*")
    assert last.startswith("narrower than the old map: ")
    assert f"velocities {new.velocities[0]} to {new.velocities[-1]} in place of 0.0 to 10.0" in last
    assert last.endswith(f": drive what is missing, or fill it from the old one by --prior {kept}")


def test_too_little_driving_is_refused_with_what_is_missing_and_no_file_is_left(short_bag, tmp_path, capsys):
    assert run(short_bag, "-o", tmp_path / "map.csv") == 1
    assert "support no two values at the same two velocities; drive longer" in capsys.readouterr().err
    assert not list(tmp_path.glob("map*"))


@pytest.mark.once
def test_map_that_is_not_good_enough_is_refused_and_if_forced_marked(bag, tmp_path, capsys):
    # Two values only: no map that anybody should drive with.
    given = (bag, "-o", tmp_path / "map.csv", "--values", "0.2", "2.5", "--velocities", 1, 2, 3, *KNOWN_DELAY)
    assert run(*given) == 1 and not list(tmp_path.glob("map*"))
    error = capsys.readouterr().err
    assert "no map is written" in error and "--force" in error
    assert run(*given, "--force") == 0
    assert "not good enough: " in (tmp_path / "map.report.txt").read_text(encoding="utf-8")


# --- what can't be calibrated with ---

@pytest.mark.parametrize("messages, said", [
    ([odometry(0.02 * i, speed_mps=1.0) for i in range(9)] + [value_at(0.02 * i) for i in range(9)],
     "tells an acceleration"),
    ([odometry(0.02 * i) for i in range(500)] + [value_at(0.02 * i) for i in range(500)], "a stop"),
], ids=["too_short", "standing"])
def test_recording_that_tells_nothing_is_refused_in_one_line(tmp_path, capsys, messages, said):
    path = write_ros1(tmp_path / "a.bag", sorted(messages, key=lambda message: message.time_s))
    assert run(path, "-o", tmp_path / "map.csv") == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert said in line and "a.bag" in line


@pytest.mark.parametrize("options, said", [
    (("--value", "duty:16"), "--value is 'duty:16'; accepted: a topic, or duty:CHANNEL"),
    (("--acceleration", "imu"), "--imu is missing"),
    (("--values", "1", "0"), "--values"),
    (("--prior", "nowhere.csv"), "nowhere.csv"),
    (("--imu", "imu/none"), "imu/none"),
    (("--value", "none"), "none"),
    (("--ns", "/other"), "/other"),
    (("--esc-channel", "-2"), "--esc-channel is -2; accepted: a channel of the servo board, 0 to 15"),
], ids=lambda part: " ".join(part) if isinstance(part, tuple) else "")
def test_option_that_is_no_good_is_named(short_bag, tmp_path, capsys, options, said):
    assert run(short_bag, "-o", tmp_path / "map.csv", *options) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert said in line


@pytest.mark.parametrize("option", ["--neutral", "--delay", "--min-speed", "--values", "--esc-neutral"])
def test_number_that_is_none_is_a_matter_of_usage(capsys, option):
    with pytest.raises(SystemExit, match="2"):
        run("a.bag", "-o", "map.csv", option, "nan")
    assert "'nan' is no finite number" in capsys.readouterr().err
