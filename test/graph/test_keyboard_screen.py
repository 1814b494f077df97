"""What the keyboard's terminal says, by the arbiters' states."""
import math
from types import SimpleNamespace

import pytest

from car_interface.common import causes
from car_interface.nodes.keyboard_drive import screen_lines

STEERING = SimpleNamespace(source=3, cause=causes.TELEOP, reason="tele_steer_req is 0.500")
THROTTLE = {"source": 3, "cause": causes.DRIVING, "reason": "tele_throt_req is 0.450, scaled by 0.3", "mode": "manual",
            "human_scale": 0.3, "asked": 0.45, "granted": 0.135, "speed": 1.236, "limit": "", "limit_reason": "",
            "esc": "FORWARD", "esc_cause": causes.DRIVING, "esc_reason": ""}


def lines(steering=STEERING, ranges=None, blocked=False, columns=120, **throttle):
    return screen_lines(steering, SimpleNamespace(**{**THROTTLE, **throttle}), ranges or {}, blocked, columns)


def test_how_it_drives_who_drives_it_and_what_is_near():
    assert lines(ranges={"front_left": 0.62, "rear_middle": math.inf, "front_right": -math.inf, "rear_left": math.nan},
                 esc_reason="it brakes") == [
        "speed 1.24 m/s   throttle 0.14 of 0.45 asked   scale 0.3   mode manual",
        "drives: TELEOP, tele_throt_req is 0.450, scaled by 0.3", "ESC:    FORWARD, it brakes",
        "steers: TELEOP, tele_steer_req is 0.500", "near:   front right 0.00 m, front left 0.62 m",
        "--> let go of M to stop"]
    assert lines(speed=math.nan, limit=causes.OBSTACLE_SLOWED, limit_reason="a thing 0.6 m ahead", mode="")[0] == (
        "speed unknown   throttle 0.14 of 0.45 asked, cut: a thing 0.6 m ahead   scale 0.3   mode none")


@pytest.mark.parametrize("changes, advice", [
    ({"cause": causes.E_STOP_STALE}, "the e-stop is on. To end it: rostopic pub -r 10 /e_stop std_msgs/Bool false"),
    ({"cause": causes.HUMAN_ABSENT}, "hold M to drive, P to let the planner drive"),
    ({"cause": causes.NOT_REARMED}, "let go of all keys, then hold M or P again"),
    ({"blocked": True}, "you hit a wall. To back out: hold S; then M alone for a second; then S again"),
    ({"asked": -0.5, "esc_cause": causes.AT_STANDSTILL},
     "it stands. To reverse: hold M alone for a second, then S again"),
    ({"mode": "autonomous"}, "let go of P to stop"),
    ({"mode": "autonomous", "asked": -0.5, "esc_cause": causes.AT_STANDSTILL}, "let go of P to stop"),
    ({"steering": None}, "the car is silent: does it run?"),
])
def test_what_to_do_next(changes, advice):
    assert lines(**changes)[-1] == f"--> {advice}"


def test_narrow_terminal_gets_shorter_lines():
    assert max(map(len, lines(columns=40))) < 40
