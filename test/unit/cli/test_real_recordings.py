"""Recordings of robots that are not ours: what the commands find in them, and what they say that they can't tell.

They are not part of this package: the folder that has them is named by CAR_INTERFACE_REAL_BAGS. They are
robot_localization's test bags of a Clearpath Husky (husky.bag) and a Jackal (jackal.bag), both steered by their wheels'
speeds.
"""
from __future__ import annotations

import os
import re
import shutil
from html import unescape
from pathlib import Path

import pytest

from browser import Browser, find_browser
from car_interface.cli.main import main

FOLDER = os.environ.get("CAR_INTERFACE_REAL_BAGS", "")
pytestmark = pytest.mark.skipif(not FOLDER, reason="CAR_INTERFACE_REAL_BAGS names no folder with recordings")
CANT_TELL = ("What this recording can't tell: no /turn_arb/state (who drove, and why the car stopped); no "
             "/teensy_sensor_hub/link (errors of the Teensy's link); no /diagnostics of pca9685 (errors of the servo "
             "board)")
NO_DUTIES = ("has no topic /servo/output, nor /servo/cmdVector or command: the servo's duties can't be told, and no "
             "ackermann_msgs/AckermannDriveStamped that could stand for them")


@pytest.fixture(params=["husky", "jackal"])
def robot(request):
    return request.param


def bag(robot):
    return str(Path(FOLDER) / f"{robot}.bag")


def page(robot, tmp_path):
    """The page's text as its reader sees it."""
    out = tmp_path / "page.html"
    assert main("bag_report", [bag(robot), "-o", str(out)]) == 0
    text = re.sub("<svg.*?</svg>", "", out.read_text(encoding="utf-8"), flags=re.DOTALL)
    return unescape(re.sub("<[^>]*>", " ", text))


def test_report_needs_no_option_and_says_what_it_took_for_odometry(robot, tmp_path, capsys):
    text, odom = page(robot, tmp_path), f"odom: /{robot}_velocity_controller/odom (the only nav_msgs/Odometry)"
    assert odom in text and CANT_TELL in text and "Nothing went wrong" not in text
    assert f"bag_report: {bag(robot)}: {odom}\n" in capsys.readouterr().err


def test_husky_drove_a_round_and_its_imu_lies_on_its_side(tmp_path):
    text = page("husky", tmp_path)
    assert "358.8 m" in text and "1.02 m/s" in text and "2015-05-21 19:11:38 UTC" in text
    assert "imu/data: gravity lies along its y axis, not along z: it is mounted on its side" in text
    assert "Turned by odometry" not in text


def test_jackal_has_no_date_and_its_wheels_slide_in_turns(tmp_path):
    text = page("jackal", tmp_path)
    assert "84.2 m" in text and "no date: its clock began at 0, 47.6 s before" in text
    assert re.search(r"Turned by odometry\s+1[45]\d% more than the IMU says", text)


@pytest.mark.parametrize("command, options, words", [
    ("calibrate_steering", [], NO_DUTIES),
    ("calibrate_value_map", [], "has no topic generic/output/value, the value: what drives the car"),
    ("calibrate_value_map", ["--value", "duty:1"], "has no topic /servo/output"),
], ids=["steering", "value_map", "value_map_by_duty"])
def test_calibration_says_in_one_line_what_the_recording_lacks(robot, command, options, words, tmp_path, capsys):
    out = tmp_path / "made"
    assert main(command, [bag(robot), *options, "-o", str(out)]) == 1
    shown = capsys.readouterr().err
    assert words in shown and shown.count("\n") == 1 and not out.exists()


def test_drives_has_a_row_for_both(tmp_path, capsys):
    for robot in ("husky", "jackal"):
        shutil.copy(bag(robot), str(tmp_path))
    assert main("drives", [str(tmp_path), "--jobs", "1"]) == 0
    assert "2 recordings, 2 read now" in capsys.readouterr().out
    lines = (tmp_path / "drives.csv").read_text(encoding="utf-8").split("\n")
    assert lines[1].startswith("jackal.bag,,61.201,0.084182,,,,")
    assert lines[2].startswith("husky.bag,2015-05-21T19:11:38Z,395.307,0.358797,,,,")


@pytest.mark.browser
@pytest.mark.skipif(find_browser() is None, reason="no Chromium on this computer")
def test_page_in_chromium_has_a_plot_for_what_was_recorded(robot, tmp_path):
    page(robot, tmp_path)
    with Browser(find_browser()) as browser:
        browser.open(tmp_path / "page.html")
        shown = browser.evaluate("[...document.querySelectorAll('svg[data-plot]')].map(svg => svg.dataset.plot)")
    assert shown == ["steering", "path", "speed"] and browser.complaints == []
