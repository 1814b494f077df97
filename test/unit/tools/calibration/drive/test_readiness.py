"""What is missing before a drive, and what to do about it, as the person reads it."""
from __future__ import annotations

from dataclasses import replace

import pytest

from car_interface.common import causes
from car_interface.tools.calibration.drive.readiness import Seen, missing, missing_gamepad

READY = Seen(steering=True, throttle=True, planner="speed", odom=True, duty=5100,
             gamepad=(causes.NO_DEADMAN, "no deadman is held"))
LAUNCH = "roslaunch car_interface car.launch throttle:=true planner:=speed"


def test_car_that_has_all_of_it_is_ready():
    assert missing(READY, by_stick=False) == missing(READY, by_stick=True) == missing_gamepad(READY) == []


@pytest.mark.parametrize(("lacks", "sentence"), [
    ({"steering": False}, f"turn_arb isn't heard: is the car launched, and in this namespace? {LAUNCH}"),
    ({"duty": None}, "/servo/output isn't heard: is pca9685 running?"),
    ({"duty": 0}, "the servo board gives no pulse on the steering's channel: rosrun car_interface doctor"),
    ({"duty": -1}, "the servo board gives no pulse on the steering's channel: rosrun car_interface doctor"),
    ({"odom": False}, "there is no odometry on odom: is teensy_sensor_hub running, and the Teensy plugged in?"),
])
def test_what_every_drive_needs(lacks, sentence):
    for by_stick in (False, True):
        assert missing(replace(READY, **lacks), by_stick) == [sentence]


@pytest.mark.parametrize(("lacks", "sentence"), [
    ({"throttle": False}, f"throttle_arb isn't heard, which drives the ESC: launch with throttle:=true ({LAUNCH})"),
    ({"calibrates_esc": True}, ("throttle_arb was launched with calibration_drive:=true, which is for calibrate_esc "
                                "and lets no stop brake: launch without")),
    ({"planner": None}, f"planner_interface isn't heard: launch with planner:=speed ({LAUNCH})"),
    ({"planner": "drive"}, "planner_interface obeys drive, not speeds: launch with planner:=speed in its place"),
    ({"sonars": ("front_left", "rear_left")}, (
        "no range of the sonars front_left, rear_left is heard: a sonar that the car doesn't have is `absent` in "
     "throttle.yaml (obstacle/sonars); --no-sonars drives without any, and then only you keep it from running into "
     "something")),
    ({"others": ["/my_planner publishes /av_turnrad_req, too: end it"]},
     "/my_planner publishes /av_turnrad_req, too: end it"),
])
def test_what_only_a_program_needs_that_drives(lacks, sentence):
    assert missing(replace(READY, **lacks), by_stick=False) == [sentence]
    assert missing(replace(READY, **lacks), by_stick=True) == []


def test_gamepad_that_is_off_is_waited_for():
    gone = replace(READY, gamepad=(causes.JOY_STALE, "joy silent for 3.02 s"))
    assert missing(gone, by_stick=False) == []
    assert missing_gamepad(gone) == [
        ("the gamepad isn't there (joy silent for 3.02 s): switch it on, or on the virtual car start keyboard_drive in "
         "another terminal")]
    assert missing_gamepad(replace(READY, gamepad=None)) == [
        "teleop_logi isn't heard, which reads the gamepad with the deadman: is it running?"]


def test_several_things_are_all_named():
    assert len(missing(Seen(), by_stick=False)) == 5
