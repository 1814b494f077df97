"""Recordings of odd content: nothing of numpy's, scipy's and matplotlib's comes to the terminal, and no traceback.

Each warning is an error here, so that its cause shows.
"""
import itertools
import math
import os
import subprocess
import sys
import warnings
from pathlib import Path

import pytest

from car_interface.tools.cli.main import main
from written_recordings import drive, odometry, write_ros1

ROOT = Path(__file__).resolve().parents[4]
CALIBRATIONS = ("calibrate_esc", "calibrate_steering", "calibrate_value_map")
LARGEST_FLOAT32 = 3e38
TEXTS = ("电池 🚗 ليل", "$x^$ \\frac{", "_x", "", "a\nb\tc\x07", "x" * 5000)


def changed(messages, kind, *values):
    """The messages with these values, one after the other, in place of all of a kind but the times."""
    values = itertools.cycle(values)

    def walk(value, key=None):
        if isinstance(value, dict):
            return {name: walk(inner, name) for name, inner in value.items()}
        if isinstance(value, list):
            return [walk(inner, key) for inner in value]
        is_one = isinstance(value, kind) and not isinstance(value, bool) and key not in ("sec", "nanosec")
        return next(values) if is_one else value
    return [message._replace(fields=walk(message.fields)) for message in messages]


def odd_drives():
    whole = drive(7.0)
    yield "numbers_are_infinite_or_huge_of_either_sign", [
        odometry(one.time_s, 1e300, 0.0, 0.0, 1e300) if one.topic == "/odom" else one
        for one in changed(whole, float, math.inf, LARGEST_FLOAT32, -LARGEST_FLOAT32)]
    yield "no_number_is_one_and_counts_and_texts_are_odd", changed(
        changed(changed(whole, float, math.nan), int, 3, 5, 0), str, *TEXTS)
    yield "one_message", [odometry(0.0)]
    yield "all_at_one_time", [one._replace(time_s=1.0) for one in whole]


@pytest.fixture(scope="module")
def bags(tmp_path_factory):
    folder = tmp_path_factory.mktemp("odd")
    return [write_ros1(folder / f"{name} 电$x^$.bag", messages) for name, messages in odd_drives()]


@pytest.fixture
def run(capfd):
    """Run a command; return its code, and what it wrote to the terminal."""
    def run(name, *arguments):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            code = main(name, [str(argument) for argument in arguments])
        return (code, *capfd.readouterr())
    return run


@pytest.mark.once
def test_reports_and_the_table_of_odd_drives_are_made_without_a_word(bags, run, tmp_path):
    code, _, err = run("bag_report", *bags, "-o", tmp_path, "--jobs", "1")
    assert (code, err) == (0, "") and len(list(tmp_path.glob("*.html"))) == len(bags)
    for read in ("read now, 0 read before", "0 read now"):  # then out of the cache
        code, out, err = run("drives", bags[0].parent, "-o", tmp_path / "drives.html", "--jobs", "1")
        assert (code, err) == (0, "") and read in out


@pytest.mark.parametrize("name", CALIBRATIONS)
def test_calibration_of_an_odd_drive_is_refused_in_one_line(name, bags, run, tmp_path):
    for bag in bags:
        code, _, err = run(name, bag, "-o", tmp_path / "made", "--jobs", "1")
        assert code == 1 and err.count("\n") == 1 and err.startswith(f"{name}: "), bag


@pytest.mark.parametrize("name", CALIBRATIONS)
def test_calibration_that_would_overwrite_its_recording_is_refused(name, run, tmp_path):
    bag = write_ros1(tmp_path / "a.bag", [odometry(0.0)])
    before = bag.read_bytes()
    code, _, err = run(name, bag, "-o", bag)
    assert code == 1 and f"{bag} is an input" in err and bag.read_bytes() == before


@pytest.mark.more
def test_map_of_an_odd_name_is_drawn_without_a_word(run, tmp_path):
    odd = tmp_path / ("_电池 $x^$ \\frac{ tab\there\nand more" + "x" * 200 + ".csv")
    odd.write_bytes((ROOT / "config" / "value_map.csv").read_bytes())
    assert run("check_map", odd, "-o", tmp_path / "made.png")[::2] == (0, "")


@pytest.mark.once
def test_surroundings_of_matplotlib_bring_no_line_to_the_terminal(tmp_path):
    """Its folder can't be written, its settings have a typo, its backend isn't installed."""
    (tmp_path / "matplotlibrc").write_text("no.such.key: 1\nlines.linewidth: thick\n", encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-B", str(ROOT / "scripts" / "check_map"), str(ROOT / "config" / "value_map.csv"), "-o",
         str(tmp_path / "made.png")], capture_output=True, check=False, timeout=300, encoding="utf-8", env={
            **os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT / "src"), *filter(None, sys.path)]),
            "MATPLOTLIBRC": str(tmp_path / "matplotlibrc"), "MPLCONFIGDIR": "/proc/nowhere", "MPLBACKEND": "nonsense"})
    assert (done.returncode, done.stderr) == (0, "")
