"""teleop_logi: from the gamepad's messages to deadman and requests, for the gamepad that it ships with."""
import logging
import math
import re

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import Joy

from car import config
from car_interface.nodes.teleop_logi import TeleopLogi
from graph import Graph

STEER, THROTTLE, MANUAL, AUTONOMOUS, FASTER, SLOWER = 0, 4, 4, 5, 3, 0  # as config/teleop_logi.yaml has them
HUMAN, STEERING, THROTTLES, MODE, BUTTON, STATE = (f"/teleop_logi/{name}" for name in (
    "human_in_loop", "tele_steer_req", "tele_throt_req", "mode", "scale_button", "state"))
GIVEN = {"steer_axis": 0, "throttle_axis": 4, "manual_button": 4, "autonomous_button": 5}
REARM = "let go of the deadman, then hold it again"
WRONG_MODE = "the gamepad has 4 axes (0 to 3), but throttle_axis is 4"
MODE_REMEDY = ("Is the gamepad in another mode? A Logitech F710 or F310 needs its switch at X for the shipped indices. "
               "For another gamepad set teleop_logi's indices: rostopic echo /joy")
OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


def joy(steering=0.0, throttle=0.0, manual=0, autonomous=0, faster=0, slower=0, axes=8, buttons=11):
    message = Joy(axes=[0.0] * axes, buttons=[0] * buttons)
    message.axes[STEER] = steering
    if axes > THROTTLE:
        message.axes[THROTTLE] = throttle
    for index, pressed in ((MANUAL, manual), (AUTONOMOUS, autonomous), (FASTER, faster), (SLOWER, slower)):
        if buttons > index:
            message.buttons[index] = pressed
    return message


class Teleop:
    """teleop_logi in a graph of its own, and a gamepad that sends 20 times a second."""

    def __init__(self, **parameters):
        self.graph = Graph()
        self.run = self.graph.run
        self.graph.record(HUMAN, STEERING, THROTTLES, MODE, BUTTON, STATE, "/diagnostics")
        self.start_ns = self.graph.now_ns
        self.node = self.graph.add(TeleopLogi, "teleop_logi", {**config("teleop_logi.yaml"), **parameters})

    def hold(self, **what):
        self.graph.hold("/joy", joy(**what), 20)
        self.run(0.0)

    def press(self, **what):
        """The same, after all was seen let go: what was lost comes back no other way."""
        self.hold()
        self.hold(**what)

    def silence(self):
        self.graph.silence("/joy")

    def published(self, *topics):
        return tuple(self.graph.newest(topic).data for topic in topics or (HUMAN, STEERING, THROTTLES))

    def since(self, topic, since_ns):
        return [message.data for message in self.graph.messages(topic, since_ns)]

    @property
    def state(self):
        return self.graph.newest(STATE)

    def causes(self, since_ns):
        return [state.cause for state in self.graph.messages(STATE, since_ns)]

    def log(self, since_ns):
        return [(line.level, line.text) for line in self.graph.log if line.at_ns >= since_ns]

    def report(self):
        self.run(1.0)
        return self.graph.report("teleop_logi: gamepad")


# --- what it sends, and when ---

def test_requests_come_at_50_hz_and_mode_button_and_state_at_10_also_without_a_gamepad():
    teleop = Teleop()
    teleop.run(2.0)
    for topic, period_ms in ((HUMAN, 20), (STEERING, 20), (THROTTLES, 20), (MODE, 100), (BUTTON, 100), (STATE, 100)):
        times = [record.at_ns for record in teleop.graph.recorded[topic] if record.at_ns > teleop.start_ns]
        assert {after - before for before, after in zip(times, times[1:])} == {period_ms * 1_000_000}, topic
        assert len(times) == 2000 / period_ms
        assert times[0] - teleop.start_ns == (period_ms - 20 or 20) * 1_000_000  # the first tick is at once
    assert teleop.graph.publishers[STATE][0].latch
    assert teleop.state.stamp.to_nsec() == teleop.graph.recorded[STATE][-1].at_ns + teleop.graph.ros_ahead_ns


@pytest.mark.parametrize("held, published, mode", [
    ({"steering": 1.0, "throttle": 0.5, "manual": 1}, (True, 1.0, 0.5), "manual"),
    ({"steering": 0.0, "throttle": 0.0, "autonomous": 1}, (True, 0.0, 0.0), "autonomous"),
    ({"steering": -0.5, "throttle": 0.0, "manual": 1, "autonomous": 1}, (True, -0.5, 0.0), "manual"),
    ({"steering": 1.0, "throttle": 1.0}, (False, 0.0, 0.0), "manual"),
])
def test_deadmen_say_which_sticks_are_passed_on_in_the_instant_in_which_they_are_held(held, published, mode):
    teleop = Teleop()
    for phase_ms in (0, 3, 11, 19):
        teleop.run(0.1 + phase_ms / 1000)
        teleop.press(**held)
        assert teleop.published() == published
        teleop.run(0.1)
        assert teleop.published() == published
        assert teleop.published(MODE) == (mode,)


def test_buttons_of_the_scale_are_published_at_once():
    teleop = Teleop()
    for held, value in (({"faster": 1}, 1), ({"slower": 1}, -1), ({}, 0)):
        teleop.run(0.013)
        teleop.hold(**held)
        assert teleop.published(BUTTON) == (value,)


def test_release_is_sent_before_the_sticks_and_a_true_after_them():
    teleop = Teleop()
    teleop.hold()
    order = []
    for topic in (HUMAN, STEERING, THROTTLES, MODE):
        teleop.graph.recorded[topic] = Spy(topic, order)
    for held in ({"manual": 1}, {}, {"autonomous": 1}, {"manual": 1}):
        teleop.hold(**held)
    assert order == [STEERING, THROTTLES, HUMAN,
                     HUMAN, STEERING, THROTTLES,
                     STEERING, THROTTLES, MODE, HUMAN,  # who hands over sends the mode after the sticks
                     MODE, STEERING, THROTTLES, HUMAN]  # and who takes over before them


class Spy(list):
    def __init__(self, topic, order):
        super().__init__()
        self._topic, self._order = topic, order

    def append(self, record):
        super().append(record)
        self._order.append(self._topic)


def test_letting_go_is_told_with_the_message_that_says_so_however_short_it_is():
    teleop = Teleop()
    teleop.press(manual=1)
    for phase_ms in (0, 7, 15):
        teleop.run(0.1 + phase_ms / 1000)
        since_ns = teleop.graph.now_ns
        for pressed in (1, 0, 1):
            teleop.graph.publish("/joy", joy(manual=pressed))
        teleop.run(0.0)
        assert teleop.since(HUMAN, since_ns)[-2:] == [False, True]


# --- silence ---

@pytest.mark.parametrize("phase_ms", [0, 5, 10, 15])
def test_silence_of_0_27_s_with_the_button_held_on_is_named_once_whatever_the_timer_saw(phase_ms):
    teleop = Teleop()
    teleop.press(manual=1)
    teleop.run(0.1 + phase_ms / 1000)
    teleop.silence()
    teleop.graph.publish("/joy", joy(manual=1))
    teleop.run(0.03)
    since_ns = teleop.graph.now_ns
    teleop.run(0.24)
    teleop.hold(manual=1)
    report = teleop.report()
    states = teleop.graph.messages(STATE, since_ns)
    silent = next(state for state in states if state.cause == "joy silent")
    assert re.fullmatch(r"joy silent for 0\.2[5-7] s", silent.reason)
    assert list(dict.fromkeys(teleop.causes(since_ns))) == ["manual", "joy silent", "not re-armed"]
    assert teleop.state.reason == f"the gamepad was silent; {REARM}"
    assert report[:2] == (WARN, f"the gamepad was silent; {REARM}")
    assert (report.values["times joy silent"], report.values["times not re-armed"]) == ("1", "1")
    (first, text), second = teleop.log(since_ns)
    assert first == logging.WARNING
    assert re.fullmatch(r"human in loop: False \(joy silent for 0\.2\d s\)\. See whether the gamepad is on, charged "
                        r"and in range and joy_node runs: rostopic hz /joy", text)
    assert second == (logging.WARNING, f"human in loop: False (the gamepad was silent; {REARM})")


def test_gamepad_that_was_never_heard_is_a_warning_with_the_remedy_in_its_namespace(graph):
    graph.record("/car7/teleop_logi/state", "/diagnostics")
    graph.add(TeleopLogi, "/car7/teleop_logi", GIVEN)
    graph.run(1.1)
    state = graph.newest("/car7/teleop_logi/state")
    assert (state.human_in_loop, state.cause, state.reason, state.joy_age) == (
        False, "joy never heard", "joy was never heard", math.inf)
    report = graph.report("car7/teleop_logi: gamepad")
    remedy = ("See whether joy_node runs and finds the gamepad: rostopic info /car7/joy; rostopic echo -n 1 "
              "/diagnostics")
    assert report[:2] == (WARN, f"joy was never heard. {remedy}")
    assert (report.values["age of joy"], report.values["steering stick"]) == ("never heard", "as the mode says")


# --- what is no gamepad of these indices ---

@pytest.mark.parametrize("wrong, cause, reason, remedy", [
    ({"axes": 4}, "joy incomplete", WRONG_MODE, MODE_REMEDY),
    ({"buttons": 5}, "joy incomplete",
     "the gamepad has 5 buttons (0 to 4), but autonomous_button is 5", MODE_REMEDY),
    ({"throttle": math.nan}, "joy not finite", "the gamepad's throttle_axis 4 is nan, no number to act on",
     "See what sends it: rostopic info /joy; rostopic echo /joy"),
    ({"steering": math.inf}, "joy not finite", "the gamepad's steer_axis 0 is inf, no number to act on",
     "See what sends it: rostopic info /joy; rostopic echo /joy"),
])
def test_gamepad_that_can_t_be_read_releases_and_is_named_in_state_log_and_diagnostics(wrong, cause, reason, remedy):
    teleop = Teleop()
    teleop.press(manual=1)
    since_ns = teleop.graph.now_ns + 1
    teleop.run(0.1)
    teleop.hold(manual=1, **wrong)
    assert teleop.published() == (False, 0.0, 0.0)
    assert (teleop.state.human_in_loop, teleop.state.cause, teleop.state.reason) == (False, cause, reason)
    report = teleop.report()
    assert report[:2] == (ERROR, f"{reason}. {remedy}")
    assert report.values["cause"] == cause and teleop.state.joy_age < 0.1
    assert report.values["axes, buttons"] == f"{wrong.get('axes', 8)}, {wrong.get('buttons', 11)}"
    assert teleop.log(since_ns) == [(logging.WARNING, f"human in loop: False ({reason}). {remedy}")]


def test_deadmen_are_named_in_the_log_when_they_change():
    teleop = Teleop()
    teleop.run(0.1)
    for held in ({}, {"manual": 1}, {"autonomous": 1}, {}):
        teleop.hold(**held)
        teleop.run(1.0)
    assert teleop.log(teleop.start_ns + 1) == [(logging.INFO, f"human in loop: {text}") for text in (
        "False (no deadman is held)", "True (manual deadman held)", "True (autonomous deadman held)",
        "False (no deadman is held)")]


# --- parameters, end ---

def test_deadman_that_is_held_is_let_go_when_the_node_ends():
    teleop = Teleop()
    teleop.press(manual=1)
    assert teleop.published()[0] is True
    teleop.node.end()
    assert (teleop.published()[0], teleop.node.fault) == (False, "")
