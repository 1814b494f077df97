"""A gamepad that fails while somebody drives: what turn_arb, the doctor and the report say of it, word for word."""
from __future__ import annotations

import math
import re
from html import unescape

import pytest
from car_interface.msg import SteeringState
from sensor_msgs.msg import Joy
from std_msgs.msg import Bool

from bags import write_bag
from car import Car, config
from car_interface.common import causes
from car_interface.common.params import Params
from car_interface.doctor.checks.findings import BAD, WARN
from car_interface.doctor.checks.gamepad import Gamepad, JoySample, check_gamepad
from car_interface.nodes.teleop_logi import TeleopLogi
from car_interface.nodes.turn_arb import TurnArb
from car_interface.report import faults as report
from car_interface.report.page import page
from car_interface.report.plots import plots
from car_interface.report.summary import summarize
from car_interface.teleop.gamepad import read_gamepad

REARM = "the gamepad was silent; let go of the deadman, then hold it again"
WRONG_MODE = "the gamepad has 4 axes (0 to 3), but throttle_axis is 4"
NAN = "the gamepad's throttle_axis 4 is nan, no number to act on"
X_MODE = ("Is the gamepad in another mode? A Logitech F710 or F310 needs its switch at X for the shipped indices. For "
          "another gamepad set teleop_logi's indices: rostopic echo /joy")
LET_GO = "Let go of both deadman buttons once, then hold one"
NO_NUMBER = "See what sends it: rostopic info /joy; rostopic echo /joy"
MANUAL = 4  # button


def joy(held=True, axes=8, throttle=0.0):
    message = Joy(axes=[0.0] * axes, buttons=[0] * 11)
    message.buttons[MANUAL] = int(held)
    if axes > 4:
        message.axes[4] = throttle
    return message


class Driven:
    """Somebody drives by a gamepad whose messages come 20 times a second."""

    def __init__(self):
        self.car, self.message = Car(), joy(held=False)
        self.graph = self.car.graph
        self.car.turn_arb()
        self.car.teleop()
        self.graph.repeat("/e_stop", Bool(False), 20)
        self.end = self.graph.repeat("/joy", lambda: self.message, 20, sender="/joy_node")
        self.graph.run(1.0)
        self.message = joy()
        self.graph.run(1.0)
        assert self.state.source == SteeringState.TELEOP

    @property
    def state(self):
        return self.graph.newest("/turn_arb/state")

    def fall_silent(self, duration_s):
        self.end()
        self.graph.run(duration_s)
        self.graph.repeat("/joy", lambda: self.message, 20, sender="/joy_node")

    def doctor(self):
        """Return level, text and remedy of what the doctor finds by teleop_logi's newest state and the messages."""
        said, axes = self.graph.newest("/teleop_logi/state"), self.message.axes
        values = {index: value for index, value in enumerate(axes) if not math.isfinite(value)}
        found, = check_gamepad(Gamepad(
            "/teleop_logi", "/joy", ("/joy_node",), read_gamepad(Params(config("teleop_logi.yaml"))),
            JoySample(21, 0.05, len(axes), len(self.message.buttons), values), said.cause, said.reason))
        return found.level, found.what, found.remedy


@pytest.mark.parametrize("fail, cause, reason, doctor, faults", [
    pytest.param(lambda driven: setattr(driven, "message", joy(axes=4)), causes.JOY_INCOMPLETE, WRONG_MODE,
                 (BAD, WRONG_MODE, X_MODE), [(report.ERROR, WRONG_MODE)], id="wrong_mode"),
    pytest.param(lambda driven: setattr(driven, "message", joy(throttle=math.nan)), causes.JOY_NOT_FINITE, NAN,
                 (BAD, NAN, NO_NUMBER), [(report.ERROR, NAN)], id="axis_that_is_no_number"),
    pytest.param(lambda driven: driven.fall_silent(0.27), causes.JOY_STALE, REARM, (WARN, REARM, LET_GO),
                 [(report.WARN, "joy silent for 0.26 s"), (report.WARN, REARM)],
                 id="silence_of_0_27_s_with_the_button_held_on"),
])
def test_gamepad_that_fails_is_told_word_for_word(tmp_path, fail, cause, reason, doctor, faults):
    driven = Driven()
    at_ns = driven.graph.now_ns
    fail(driven)
    driven.graph.run(2.0)
    assert (driven.state.source, driven.state.reason) == (
        SteeringState.NO_HUMAN, f"human_in_loop is false: {reason}")
    assert driven.doctor() == doctor
    assert cause in {state.cause for state in driven.graph.messages("/teleop_logi/state", at_ns)}
    drive = summarize(write_bag(driven.graph, tmp_path / "drive.bag"), "/", None)
    assert [(fault.where, fault.level, fault.what) for fault in drive.faults.entries if fault.where != "ROS"] == [
        ("teleop_logi", *fault) for fault in faults]
    text = " ".join(unescape(re.sub("<[^>]*>", " ", page(drive, plots(drive)))).split())
    assert f"The car was stopped once because something was lost or locked: {cause}." in text


def test_turn_arb_quotes_the_gamepad_of_its_namespace(graph):
    remap = {"/teleop_logi/human_in_loop": "/one/teleop_logi/human_in_loop"}
    graph.record("/one/turn_arb/state")
    for node_class, name in ((TurnArb, "turn_arb"), (TeleopLogi, "teleop_logi")):
        graph.add(node_class, f"/one/{name}", config(f"{name}.yaml"), remap)
    for topic, message in (("/joy", joy()), ("/one/joy", joy(axes=4))):
        graph.repeat(topic, message, 20)
    graph.run(2.0)
    assert graph.newest("/one/turn_arb/state").reason == f"human_in_loop is false: {WRONG_MODE}"
