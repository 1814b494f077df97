"""Recordings of odd content: nothing of numpy's, scipy's and matplotlib's comes to the terminal, and no traceback.

The commands run in processes of their own in which each warning is an error, so that its cause shows.
"""
from __future__ import annotations

import math
import os
import subprocess
import sys
from pathlib import Path

import pytest

from written_recordings import drive, odometry, write_ros1

ROOT = Path(__file__).resolve().parents[3]
CALIBRATIONS = ("calibrate_esc", "calibrate_steering", "calibrate_value_map")
LARGEST_FLOAT32 = 3e38


def changed(messages, kind, change):
    """The messages with ``change(key, value)`` for each value of a kind."""
    def walk(value, key=None):
        if isinstance(value, dict):
            return {name: walk(inner, name) for name, inner in value.items()}
        if isinstance(value, list):
            return [walk(inner, key) for inner in value]
        return change(key, value) if isinstance(value, kind) and not isinstance(value, bool) else value
    return [message._replace(fields=walk(message.fields)) for message in messages]


def with_odometry(messages, x_m, speed_mps):
    return [odometry(one.time_s, x_m, 0.0, 0.0, speed_mps) if one.topic == "/odom" else one for one in messages]


def odd_drives():
    """Messages of odd drives, by what is odd about them."""
    whole = drive(25.0)
    for number in (math.nan, math.inf, 0.0, 1.0, 1e-300, LARGEST_FLOAT32, -LARGEST_FLOAT32):
        yield f"all_numbers_are_{number}", changed(whole, float, lambda key, value, number=number: number)
    for count in (0, 3, 5):
        yield f"all_counts_are_{count}", changed(
            whole, int, lambda key, value, count=count: value if key in ("sec", "nanosec") else count)
    for name, text in (("chinese", "电池 🚗 ليل"), ("a_formula", "$x^$ \\frac{"), ("hidden", "_x"), ("empty", ""),
                       ("control_characters", "a\nb\tc\x07"), ("long", "x" * 5000)):
        yield f"texts_are_{name}", changed(whole, str, lambda key, value, text=text: text)
    yield "three_messages", whole[:3]
    yield "one_message", [odometry(0.0)]
    yield "standing", [odometry(step / 20) for step in range(400)]
    yield "all_at_one_time", [one._replace(time_s=1.0) for one in whole]
    yield "odometry_is_nan", with_odometry(whole, math.nan, math.nan)
    yield "odometry_is_huge", with_odometry(whole, 1e300, 1e300)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("odd")
    for name, messages in odd_drives():
        write_ros1(folder / f"{name} 电$x^$.bag", messages)
    return folder


def run(name, *arguments, flags=("-W", "error"), **environment):
    return subprocess.run(
        [sys.executable, "-B", *flags, str(ROOT / "scripts" / name), *map(str, arguments)], capture_output=True,
        check=False, timeout=300, encoding="utf-8", env={
            **os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT / "src"), *filter(None, sys.path)]), **environment})


def test_reports_and_the_table_of_odd_drives_are_made_without_a_word(folder, tmp_path):
    bags = sorted(folder.glob("*.bag"))
    done = run("bag_report", *bags, "-o", tmp_path, "--jobs", "2")
    assert (done.returncode, done.stderr) == (0, "") and len(list(tmp_path.glob("*.html"))) == len(bags)
    for read in ("read now, 0 read before", "0 read now"):  # then out of the cache
        done = run("drives", folder, "-o", tmp_path / "drives.html", "--jobs", "2")
        assert (done.returncode, done.stderr) == (0, "") and read in done.stdout


@pytest.mark.parametrize("name", CALIBRATIONS)
def test_calibration_of_an_odd_drive_is_refused_in_one_line(name, folder, tmp_path):
    for bag in sorted(folder.glob("*.bag"))[::1 if name == "calibrate_value_map" else 4]:
        done = run(name, bag, "-o", tmp_path / "made")
        assert done.returncode == 1 and done.stderr.count("\n") == 1 and done.stderr.startswith(f"{name}: "), bag


@pytest.mark.parametrize("name", [
    "电池.csv", "$x^$ \\frac{.csv", "_hidden.csv", "tab\there\nand more.csv", "x" * 200 + ".csv",
], ids=["chinese", "formula", "underscore", "white_space", "long"])
def test_map_of_an_odd_name_is_drawn_without_a_word(name, tmp_path):
    path = tmp_path / name
    path.write_bytes((ROOT / "config" / "value_map.csv").read_bytes())
    done = run("check_map", path, "-o", tmp_path / "made.png")
    assert (done.returncode, done.stderr) == (0, "")


def test_surroundings_of_matplotlib_bring_no_line_to_the_terminal(tmp_path):
    """Its folder can't be written, its settings have a typo, its backend isn't installed."""
    (tmp_path / "matplotlibrc").write_text("no.such.key: 1\nlines.linewidth: thick\n", encoding="utf-8")
    done = run("check_map", ROOT / "config" / "value_map.csv", "-o", tmp_path / "made.png", flags=(),
               MATPLOTLIBRC=str(tmp_path / "matplotlibrc"), MPLCONFIGDIR="/proc/nowhere", MPLBACKEND="nonsense")
    assert (done.returncode, done.stderr) == (0, "")
