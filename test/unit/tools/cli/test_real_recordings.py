"""Recordings of robots that are not ours: what the commands find in them, and what they say that they can't tell.

They are not part of this package: the folder that has them is named by CAR_INTERFACE_REAL_BAGS. They are
robot_localization's test bags of a Clearpath Husky (husky.bag) and a Jackal (jackal.bag), both steered by their wheels'
speeds.
"""
import os
import re
import shutil
from html import unescape
from pathlib import Path

import pytest

from car_interface.tools.cli.main import main

FOLDER = os.environ.get("CAR_INTERFACE_REAL_BAGS", "")
pytestmark = pytest.mark.skipif(not FOLDER, reason="CAR_INTERFACE_REAL_BAGS names no folder with recordings")
CANT_TELL = ("What this recording can't tell: no /turn_arb/state (who drove, and why the car stopped); no "
             "/teensy_sensor_hub/link (errors of the Teensy's link); no /diagnostics of pca9685 (errors of the servo "
             "board)")
NO_DUTIES = ("has no topic /servo/output, nor /servo/cmdVector or command: the servo's duties can't be told, and no "
             "ackermann_msgs/AckermannDriveStamped that could stand for them")


NOTHING_ON = "So this page has nothing on who drove, faults, throttle, limits, the Teensy."
SEEN = {"husky": ("358.8 m", "1.02 m/s", "2015-05-21 19:11:38 UTC",
                  "imu/data: gravity lies along its y axis, not along z: it is mounted on its side"),
        "jackal": ("84.2 m", "no date: its clock began at 0, 47.6 s before", "Turned by odometry")}


@pytest.fixture(params=SEEN)
def robot(request):
    return request.param


def bag(robot):
    return str(Path(FOLDER) / f"{robot}.bag")


def test_report_needs_no_option_says_what_it_took_for_odometry_and_what_can_be_known(robot, tmp_path, capsys):
    out, odom = tmp_path / "page.html", f"odom: /{robot}_velocity_controller/odom (the only nav_msgs/Odometry)"
    assert main("bag_report", [bag(robot), "-o", str(out)]) == 0
    assert f"bag_report: {bag(robot)}: {odom}\n" in capsys.readouterr().err
    page = out.read_text(encoding="utf-8")
    assert re.findall('data-plot="(.*?)"', page) == ["steering", "path", "speed"]
    assert re.findall('<section id="(.*?)"', page) == ["steering", "path", "speed", "contents"]
    text = unescape(re.sub("<[^>]*>", " ", re.sub("<svg.*?</svg>", "", page, flags=re.DOTALL)))
    for words in (odom, CANT_TELL, NOTHING_ON, *SEEN[robot]):
        assert words in text
    assert "Nothing went wrong" not in text
    assert bool(re.search(r"Turned by odometry\s+1[45]\d% more than the IMU says", text)) == (robot == "jackal")


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
    assert lines[1].startswith('"jackal.bag",,61.201,0.084182,,,,')
    assert lines[2].startswith('"husky.bag","2015-05-21T19:11:38Z",395.307,0.358797,,,,')
