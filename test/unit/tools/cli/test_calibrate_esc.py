"""The command calibrate_esc, on recordings of persons who follow docs/calibrate.md with virtual ESCs."""
import contextlib
import io
import os
import re
from pathlib import Path

import numpy as np
import pytest
import virtual_escs
import yaml
from accuracy import esc_calibration as drives

from car_interface.throttle.config import load_throttle
from car_interface.tools.cli.main import main
from recorded_drives import recorded
from tools.calibration.esc.synthetic import Person
from written_recordings import odometry, output, write_ros1

ROOT = Path(__file__).resolve().parents[4]
SHIPPED = ROOT / "config" / "throttle.yaml"
SEED = 1  # brake_then_reverse
RANDOM_ESCS = range(20) if os.environ.get("CAR_INTERFACE_ALL") else (SEED,)


@pytest.fixture(scope="module")
def bag():
    return record()


def record(seed=SEED):
    return recorded(drives.record_drive, seed)


def drive_without(path, *leaves_out, start_s=0.0):
    """A recording of a synthetic drive that lacks some parts."""
    drive = Person(virtual_escs.xl5(dwell_s=0.25), seed=3).drive(leaves_out)
    places_m = np.cumsum(drive.speed_mps) * 0.02
    messages = [odometry(start_s + time_s, place_m, speed_mps=speed_mps)
                for time_s, place_m, speed_mps in zip(drive.t_s, places_m, drive.speed_mps)]
    is_said = (np.diff(drive.duty, prepend=0) != 0) | (np.arange(drive.t_s.size) % 25 == 0)
    messages += [output(start_s + time_s, 5100, duty) for time_s, duty in zip(drive.t_s[is_said], drive.duty[is_said])]
    return write_ros1(path, sorted(messages, key=lambda message: message.time_s))


def run(*arguments):
    return main("calibrate_esc", [str(argument) for argument in arguments])


@pytest.mark.once
def test_random_escs_are_right_or_refused_and_never_wrong(tmp_path):
    outcomes = [drives.judge(seed, tmp_path, record(seed)) for seed in RANDOM_ESCS]
    for seed, outcome in zip(RANDOM_ESCS, outcomes):
        assert outcome.profile in (outcome.kind, None) and not outcome.errors, (seed, outcome)
        assert outcome.code == (0 if outcome.profile else 1), (seed, outcome)
    assert sum(outcome.profile is not None for outcome in outcomes) >= 0.75 * len(RANDOM_ESCS)


@pytest.fixture(scope="module")
def calibrated(bag, tmp_path_factory):
    """The file that the command made of the drive, and what it wrote to the terminal."""
    path = tmp_path_factory.mktemp("calibrated") / "throttle.yaml"
    with contextlib.redirect_stdout(io.StringIO()) as out:
        assert run(bag, "-o", path) == 0
    return path, out.getvalue()


def test_report_says_what_shows_each_number(bag, calibrated):
    path, out = calibrated
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
    lines = out.splitlines()
    assert len(lines) == len(expected)
    for line, pattern in zip(lines, expected):
        assert re.fullmatch(pattern, line), (line, pattern)


def test_file_loads_keeps_the_rest_of_its_base_and_says_what_was_seen(bag, calibrated, tmp_path, capsys):
    # Calibrated again from the same drive, with the new file: the neutral of the drive is what it was.
    path, base_text = tmp_path / "throttle.yaml", calibrated[0].read_text(encoding="utf-8")
    path.write_text(base_text.replace("human_scale: 0.3 ", "human_scale: 0.45 "), encoding="utf-8")
    assert run(bag, "-o", path, "--base", path) == 0
    config, text = load_throttle(str(path)), path.read_text(encoding="utf-8")
    assert (config.esc.profile, config.esc.profile_measured) == ("brake_then_reverse", True)
    assert config.arbiter.stick.human_scale == 0.45 and config.calibration.channel == 1
    assert list(config.calibration.duty_table) == [config.calibration.neutral + shift for shift in (-1638, 0, 1639)]
    assert yaml.safe_load(text) == {**yaml.safe_load(base_text), "human_scale": 0.45}
    assert text.startswith("# Written by calibrate_esc; throttle_arb loads it.")
    out = capsys.readouterr().out
    for line in out.splitlines()[:-1]:
        assert f"# {line}\n" in text
    assert "  # forward and reverse, at the start" in text.replace("     #", " #")  # comments stay
    (kept,) = tmp_path.glob("throttle.yaml.bak-*")
    assert f"written: {path}; the old one is {kept}\n" in out and "human_scale: 0.45" in kept.read_text("utf-8")


@pytest.mark.once
def test_what_was_not_driven_is_refused_with_what_to_drive_and_if_forced_keeps_the_old_numbers(tmp_path, capsys):
    path = drive_without(tmp_path / "a.bag", "creep backward")
    assert run(path, "-o", tmp_path / "new.yaml") == 1 and not (tmp_path / "new.yaml").exists()
    found = capsys.readouterr()
    said = "esc/dead_band_reverse: from standstill, pull the stick so slowly that the car just sets off"
    (line,) = found.err.splitlines()
    assert line.startswith("calibrate_esc: nothing is written: the drive doesn't show ") and said in line
    assert ", or keep the old numbers there by --force: " in line
    assert f"  missing: {said}" in found.out and "not shown by the drive, stays" in found.out
    assert run(path, "-o", tmp_path / "new.yaml", "--force") == 0
    config = load_throttle(str(tmp_path / "new.yaml"))
    assert config.esc.profile == "brake_then_reverse" and config.esc.dwell_s < 0.5
    assert (config.calibration.neutral, config.esc.dead_band_reverse) == (4915, 0.08)
    text = (tmp_path / "new.yaml").read_text(encoding="utf-8")
    assert "#   esc/dead_band_reverse: not shown by the drive, stays 0.08\n" in text


@pytest.mark.once
def test_what_one_recording_lacks_another_one_may_have_and_without_a_profile_nothing_is_forced(tmp_path, capsys):
    one = drive_without(tmp_path / "one.bag", "creep backward")
    other = drive_without(tmp_path / "other.bag", "creep forward", "coast", "brake", "pull twice", "wait and pull",
                          start_s=1000.0)
    assert run(other, "-o", tmp_path / "new.yaml", "--force") == 1
    assert "the drive doesn't show which kind of ESC it is. Drive this, and" in capsys.readouterr().err
    assert not (tmp_path / "new.yaml").exists()
    assert run(one, other, "-o", tmp_path / "new.yaml", "--jobs", 1) == 0
    assert f"ESC by {one}, {other}: " in capsys.readouterr().out


def test_base_that_the_node_would_refuse_is_refused_by_name(bag, tmp_path, capsys):
    base = tmp_path / "base.yaml"
    text = SHIPPED.read_text(encoding="utf-8").replace("profile: unverified", "profile: fast")
    base.write_text(text, encoding="utf-8")
    assert run(bag, "-o", tmp_path / "new.yaml", "--base", base) == 1
    assert f"{base}, esc/profile is 'fast'; accepted: one of brake_then_reverse" in capsys.readouterr().err


@pytest.mark.parametrize("options, said", [
    (("--channel", "16"), "--channel is 16; accepted: a channel of the servo board, 0 to 15"),
    (("--channel", "3"), "channel 3 of the servo board never had a pulse: is the ESC on another one (--channel)?"),
    (("--map", "/none=output"), "part.bag has no topic /none"),
    (("--ns", "/other"), "part.bag has no topic odom below /other"),
    (("--base", "nowhere.yaml"), "nowhere.yaml"),
], ids=lambda part: " ".join(part) if isinstance(part, tuple) else "")
def test_option_that_is_no_good_is_named(bag, tmp_path, capsys, options, said):
    assert run(bag, "-o", tmp_path / "new.yaml", *options) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert said.replace("part.bag", bag) in line
