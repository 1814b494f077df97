"""The command calibrate_esc, on recordings of persons who follow docs/calibrate.md with virtual ESCs."""
from __future__ import annotations

import importlib
import os
import re
import shutil
import sys
from pathlib import Path

import pytest
import yaml

from car_interface.cli.calibrate_esc import Config
from car_interface.cli.main import main
from car_interface.common.errors import ConfigError
from car_interface.throttle.params import load_throttle
from recorded_drives import recorded
from written_recordings import Written, rename_topics, write_ros1

ROOT = Path(__file__).resolve().parents[3]
sys.path.append(str(ROOT / "test"))
drives = importlib.import_module("accuracy.esc_calibration")
SHIPPED = ROOT / "config" / "throttle.yaml"
SEED, CRAWLER, RACE = 1, 7, 4  # brake_then_reverse, brake_becomes_reverse, forward_only
RANDOM_ESCS = range(20) if os.environ.get("CAR_INTERFACE_ALL") else (SEED, CRAWLER, RACE)


@pytest.fixture(scope="module")
def bag():
    return record()


def record(seed=SEED, **changes):
    return recorded(drives.record_drive, seed, **changes)


def run(*arguments):
    return main("calibrate_esc", [str(argument) for argument in arguments])


@pytest.mark.once
def test_random_escs_are_right_or_refused_and_never_wrong(tmp_path):
    outcomes = [drives.judge(seed, tmp_path, record(seed)) for seed in RANDOM_ESCS]
    for seed, outcome in zip(RANDOM_ESCS, outcomes):
        assert outcome.profile in (outcome.kind, None) and not outcome.errors, (seed, outcome)
        assert outcome.code == (0 if outcome.profile else 1), (seed, outcome)
    assert sum(outcome.profile is not None for outcome in outcomes) >= 0.75 * len(RANDOM_ESCS)


def test_report_says_what_shows_each_number(bag, tmp_path, capsys):
    path = tmp_path / "throttle.yaml"
    assert run(bag, "-o", path) == 0
    lines = capsys.readouterr().out.splitlines()
    expected = [
        rf"ESC by {re.escape(bag)}: \d+ s",
        (r"  esc/profile: brake_then_reverse \(was unverified\): 1\d brakes held the car, \d second pulls drove it "
         r"backward"),
        r"  servo/neutral: 49\d\d \(was 4915\): the car set off at 5\d{3} \(3 times\) and 4\d{3} \(3 times\)",
        r"  esc/dead_band_forward: 0\.1\d+ \(was 0\.08\): from there to where the car sets off",
        r"  esc/dead_band_reverse: 0\.1\d+ \(was 0\.08\): from there to where the car sets off",
        r"  esc/dwell: 0\.\d+ s \(was 0\.5 s\): 0\.\d+ s of neutral were enough, 0\.\d+ s were not",
        (r"  esc/reverse_after_neutral: \d\.\d+ s \(was 0\.0 s\): after \d\.\d s in neutral the first pull was "
         r"reverse, .*"),
        r"  esc/drag_deceleration: \d\.\d+ m/s² \(was 0\.3 m/s²\): .* m/s² in neutral: the ESC has a drag brake",
        rf"written: {re.escape(str(path))}",
    ]
    assert len(lines) == len(expected)
    for line, pattern in zip(lines, expected):
        assert re.fullmatch(pattern, line), (line, pattern)


def test_file_loads_keeps_the_rest_of_its_base_and_says_what_was_seen(bag, tmp_path, capsys):
    path = tmp_path / "throttle.yaml"
    path.write_text(SHIPPED.read_text(encoding="utf-8").replace("human_scale: 0.3 ", "human_scale: 0.45 "),
                    encoding="utf-8")
    assert run(bag, "-o", path, "--base", path) == 0
    config, text = load_throttle(str(path)), path.read_text(encoding="utf-8")
    assert (config.esc.profile, config.esc.profile_measured) == ("brake_then_reverse", True)
    assert config.arbiter.stick.human_scale == 0.45 and config.calibration.channel == 1
    assert list(config.calibration.duty_table) == [config.calibration.neutral + shift for shift in (-1638, 0, 1639)]
    out = capsys.readouterr().out
    for line in out.splitlines()[:-1]:
        assert f"# {line}\n" in text
    assert "  # forward and reverse, at the start" in text.replace("     #", " #")  # comments stay
    (kept,) = tmp_path.glob("throttle.yaml.bak-*")
    assert f"written: {path}; the old one is {kept}\n" in out and "profile: unverified" in kept.read_text("utf-8")
    # Calibrated again from the same drive, with the new file: the neutral of the drive is what it was.
    before = yaml.safe_load(text)
    assert run(bag, "-o", path, "--base", path) == 0
    assert yaml.safe_load(path.read_text(encoding="utf-8")) == before


@pytest.mark.once
@pytest.mark.parametrize("heading, said", [
    ("creep backward", "esc/dead_band_reverse: from standstill, pull the stick so slowly that the car just sets off"),
    ("pull twice", "the profile: after a brake, center the stick for a second and pull back all the way"),
    ("wait and pull", "esc/reverse_after_neutral: full stick for a good second, center it, and after 8 s pull back"),
])
def test_what_was_not_driven_is_refused_with_what_to_drive(tmp_path, capsys, heading, said):
    path = record(leaves_out=(heading,))
    code = run(path, "-o", tmp_path / "new.yaml")
    found = capsys.readouterr()
    (line,) = found.err.splitlines()
    assert code == 1 and not (tmp_path / "new.yaml").exists()
    assert line.startswith("calibrate_esc: nothing is written: the drive doesn't show ") and said in line
    assert f"  missing: {said}" in found.out and "not shown by the drive, stays" in found.out


@pytest.mark.once
def test_force_writes_what_is_shown_and_keeps_the_rest(tmp_path, capsys):
    path = record(leaves_out=("creep backward",))
    assert run(path, "-o", tmp_path / "new.yaml") == 1
    assert ", or keep the old numbers there by --force: " in capsys.readouterr().err
    assert run(path, "-o", tmp_path / "new.yaml", "--force") == 0
    config = load_throttle(str(tmp_path / "new.yaml"))
    assert config.esc.profile == "brake_then_reverse" and config.esc.dwell_s < 0.5
    assert (config.calibration.neutral, config.esc.dead_band_reverse) == (4915, 0.08)
    text = (tmp_path / "new.yaml").read_text(encoding="utf-8")
    assert "#   esc/dead_band_reverse: not shown by the drive, stays 0.08\n" in text


def test_force_names_no_profile_that_was_not_shown(tmp_path, capsys):
    path = record(leaves_out=("pull twice",))
    assert run(path, "-o", tmp_path / "new.yaml", "--force") == 1
    assert "the drive doesn't show which kind of ESC it is. Drive this, and" in capsys.readouterr().err
    assert not (tmp_path / "new.yaml").exists()


@pytest.mark.once
def test_what_one_recording_lacks_another_one_may_have(tmp_path, capsys):
    one, other = (record(leaves_out=parts) for parts in (
        ("wait and pull",), ("creep forward", "brake", "pull twice", "creep backward")))
    assert run(one, "-o", tmp_path / "new.yaml") == 1
    assert run(one, other, "-o", tmp_path / "new.yaml", "--jobs", 1) == 0
    assert f"ESC by {one}, {other}: " in capsys.readouterr().out


def test_drive_without_calibration_drive_is_refused_with_what_to_start(tmp_path, capsys):
    path = record(is_calibration_drive=False)
    assert run(path, "-o", tmp_path / "new.yaml") == 1
    assert capsys.readouterr().err == (
        f"calibrate_esc: {path} was driven without calibration_drive, so that throttle_arb withheld the pulls that "
        "would show what the ESC makes of them: roslaunch car_interface car.launch throttle:=true "
        "calibration_drive:=true, and drive again\n")


@pytest.mark.once
def test_esc_without_reverse_keeps_its_neutral_and_is_not_asked_for_what_it_has_not(tmp_path, capsys):
    assert run(record(RACE), "-o", tmp_path / "new.yaml") == 0
    config = load_throttle(str(tmp_path / "new.yaml"))
    assert (config.esc.profile, config.calibration.neutral) == ("forward_only", 4915)
    out = capsys.readouterr().out
    assert "missing" not in out and "  servo/neutral: not shown by the drive, stays 4915\n" in out
    assert re.search(r"  esc/dead_band_forward: 0\.\d+ \(was 0\.08\): the car set off at 5\d{3} \(3 times\)\n", out)


@pytest.mark.once
def test_crawler_s_pause_is_what_names_it(tmp_path, capsys):
    assert run(record(CRAWLER), "-o", tmp_path / "new.yaml") == 0
    assert re.search(r"esc/profile: brake_becomes_reverse \(was unverified\): \d brakes that were held drove the car "
                     r"backward, after it had stood for 0\.2\d s\n", capsys.readouterr().out)


@pytest.mark.once
def test_copy_of_a_recording_does_not_count_twice(bag, tmp_path, capsys):
    shutil.copy(bag, str(tmp_path / "copy.bag"))
    assert run(bag, tmp_path / "copy.bag", "-o", tmp_path / "new.yaml") == 1
    assert "have the same driving in them" in capsys.readouterr().err


def test_base_that_the_node_would_refuse_is_refused_by_name(bag, tmp_path, capsys):
    base = tmp_path / "base.yaml"
    text = SHIPPED.read_text(encoding="utf-8").replace("profile: unverified", "profile: fast")
    base.write_text(text, encoding="utf-8")
    assert run(bag, "-o", tmp_path / "new.yaml", "--base", base) == 1
    assert f"{base}, esc/profile is 'fast'; accepted: one of brake_then_reverse" in capsys.readouterr().err


def test_output_that_is_the_recording_is_refused(bag, capsys):
    assert run(bag, "-o", bag) == 1
    assert f"{bag} is one of the recordings" in capsys.readouterr().err


@pytest.mark.parametrize("options, said", [
    (("--channel", "16"), "--channel is 16; accepted: a channel of the servo board, 0 to 15"),
    (("--channel", "3"), "channel 3 of the servo board never had a pulse: is the ESC on another one (--channel)?"),
    (("--odom", "none"), "none"),
    (("--ns", "/other"), "part.bag has no topic odom below /other"),
    (("--base", "nowhere.yaml"), "nowhere.yaml"),
], ids=lambda part: " ".join(part) if isinstance(part, tuple) else "")
def test_option_that_is_no_good_is_named(bag, tmp_path, capsys, options, said):
    assert run(bag, "-o", tmp_path / "new.yaml", *options) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert said.replace("part.bag", bag) in line


def test_recording_without_the_board_s_output_is_refused(tmp_path, capsys):
    path = write_ros1(tmp_path / "a.bag", [
        Written(0.0, "/odom", "nav_msgs/Odometry", {}),
        Written(0.0, "/servo/cmdVector", "std_msgs/Int32MultiArray", {"data": [4915] * 16})])
    assert run(path, "-o", tmp_path / "new.yaml") == 1
    assert "has no topic /servo/output, which says what the ESC got" in capsys.readouterr().err


@pytest.mark.once
def test_recording_with_topics_of_other_names_comes_to_the_same_calibration(bag, tmp_path, capsys):
    names = {"/odom": "/ekf/odometry", "/servo/output": "/board/duties"}
    other = rename_topics(bag, tmp_path / "other.bag", names)
    assert run(other, "-o", tmp_path / "other.yaml") == 1
    assert ("has no topic /servo/output, which says what the ESC got; name another by --map TOPIC=output; it has "
            in capsys.readouterr().err)
    assert run(bag, "-o", tmp_path / "own.yaml") == 0
    capsys.readouterr()
    assert run(other, "-o", tmp_path / "other.yaml", "--map", "/board/duties=output") == 0
    assert "odom: /ekf/odometry (the only nav_msgs/Odometry)" in capsys.readouterr().out
    own, found = (yaml.safe_load((tmp_path / name).read_text(encoding="utf-8")) for name in ("own.yaml", "other.yaml"))
    assert own == found


def test_configuration_refuses_a_channel_that_is_none():
    with pytest.raises(ConfigError, match="--channel is -1; accepted: a channel of the servo board, 0 to 15"):
        Config(("a.bag",), "a.yaml", "b.yaml", channel=-1)
