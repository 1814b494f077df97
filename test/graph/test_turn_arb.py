"""turn_arb: from its inputs to the command, with the calibration that it ships with."""
import logging
import math
import re

import pytest
from car_interface.msg import TeleopState
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import Joy
from std_msgs.msg import Bool, Float32

from car import Car, config
from car_interface.nodes.teleop_logi import TeleopLogi
from car_interface.nodes.turn_arb import TurnArb
from inputs import Arbiter, odometry

LEFT, CENTER, RIGHT = 3800, 5100, 6700
NAN, INF = math.nan, math.inf
LOCKED, NO_HUMAN, NEUTRAL, TELEOP, PLANNER = range(5)


TOPICS = {"e_stop": ("/e_stop", Bool), "human": ("/teleop_logi/human_in_loop", Bool),
          "teleop": ("/teleop_logi/tele_steer_req", Float32), "planner": ("/av_turnrad_req", Float32),
          "steering": ("/av_steer_req", Float32), "speed": ("/odom", odometry)}

# Steering request → duty: linear to each side between center and the end, clamped beyond. Radius in m → duty, by hand
# from the shipped table.
CASES = {"teleop": [(1.0, 3800), (-0.5, 5900), (0.25, 4775), (0.002, 5097), (-1.5, 6700), (1e30, 3800)],
         "planner": [(1.0, 3800), (1.5, 3815), (70.0, 4450), (1e6, 5100), (0.01, 3800), (-2.5, 6625), (-90.0, 5450),
                     (-INF, 5100)]}


class Arb(Arbiter):
    def __init__(self, **parameters):
        self.car = Car()
        super().__init__(self.car.graph, TOPICS, 0.012, "turn_arb", 0)  # a repeated value is handled at the next tick
        self.car.turn_arb(**{"grant_at_start": True, **parameters})

    def drive(self, **inputs):
        self.once("human", False)
        self.hold(**inputs, human=True)
        return self


# --- what it sends, and when ---

def test_commands_come_at_100_hz_with_the_original_layout_and_minus_one_elsewhere():
    """One in each tick, also in that in which silence centers the steering."""
    arb = Arb().drive(teleop=1.0)
    arb.silence("human")
    since_ns = arb.graph.now_ns
    arb.run(1.0)
    records = [record for record in arb.graph.recorded["/servo/cmdVector"] if record.at_ns > since_ns]
    first = (since_ns - arb.start_ns) // 10_000_000 + 1
    assert [record.at_ns - arb.start_ns for record in records] == [
        tick * 10_000_000 for tick in range(first, first + 100)]
    assert {record.message.data for record in records} == {(duty,) + (-1,) * 15 for duty in (LEFT, CENTER)}
    for layout in (record.message.layout for record in records):
        assert layout.data_offset == 0
        assert [(dim.label, dim.size, dim.stride) for dim in layout.dim] == [("pwm_channel", 16, 1)]


def test_state_comes_20_times_a_second_and_is_latched_and_the_center_once():
    arb = Arb()
    arb.run(1.0)
    assert len(arb.graph.messages("/turn_arb/state", arb.start_ns)) == 21  # and one for the first decision
    assert [vector.data for vector in arb.graph.messages("/servo/neutral", arb.start_ns + 1)] == [
        (CENTER,) + (-1,) * 15]
    assert (arb.state.channel, arb.state.stamp.to_nsec()) == (0, arb.graph.now_ns + arb.graph.ros_ahead_ns - 10_000_000)
    for topic in ("/turn_arb/state", "/servo/neutral"):
        assert [each.latch for each in arb.graph.publishers[topic]] == [True]


@pytest.mark.parametrize("name", CASES)
def test_each_request_has_its_exact_duty_in_the_instant_in_which_it_arrives(name):
    arb = Arb().drive(teleop=0.0, planner=-3.0)
    arb.graph.link(TOPICS[name][0], delay_s=0.0013)
    for request, duty in CASES[name]:
        before, sent_ns = arb.duty, arb.graph.now_ns
        arb.once(name, request)
        arb.run(0.0013)
        assert arb.duty == duty
        assert set(arb.duties(sent_ns)) <= {before, duty}
        if duty != before:  # and its state
            assert arb.graph.recorded["/turn_arb/state"][-1].at_ns - sent_ns == 1_300_000
        arb.drive()


def test_a_false_is_seen_even_when_a_true_follows_immediately_in_each_phase_of_the_timer():
    arb = Arb().drive(teleop=1.0)
    for _ in range(10):
        arb.run(0.0511)
        sent_ns = arb.graph.now_ns
        arb.once("human", False, True)
        arb.run(0.0)
        assert arb.duties(sent_ns)[-2:] == [CENTER, LEFT]
        arb.hold(human=True)
        states = [(each.source, each.reason, each.duty) for each in arb.graph.messages("/turn_arb/state", sent_ns)]
        assert (NO_HUMAN, "human_in_loop is false", CENTER) in states


# --- who steers ---

def test_teleop_goes_before_planner_and_nobody_before_both():
    arb = Arb()
    arb.run(0.002)
    assert arb.now == (NO_HUMAN, "human_in_loop was never heard", CENTER)
    arb.drive(planner=2.0)  # where no gamepad was ever heard
    assert arb.state.source == PLANNER
    assert (arb.state.teleop_age, arb.state.e_stop_age, arb.state.odometry_age) == (INF, INF, INF)
    assert 0 <= arb.state.planner_age <= arb.state.human_age < 0.01
    arb.drive(teleop=0.0, planner=0.0)
    assert arb.now == (NEUTRAL, "av_turnrad_req is 0, which asks for nothing", CENTER)
    arb.hold(planner=2.0)
    assert arb.now == (PLANNER, "av_turnrad_req is 2.000 m", 3830)
    arb.hold(teleop=-1.0)
    assert arb.now == (TELEOP, "tele_steer_req is -1.000", RIGHT)
    arb.hold(human=False)
    assert (arb.now, arb.state.cause) == ((NO_HUMAN, "human_in_loop is false", CENTER), "human absent")
    arb.hold(human=True)
    assert arb.now == (TELEOP, "tele_steer_req is -1.000", RIGHT)
    arb.hold(teleop=0.0)
    assert arb.now == (PLANNER, "av_turnrad_req is 2.000 m", 3830)


# --- what it reports ---

def test_diagnostics_say_who_drives_and_why_once_a_second():
    arb = Arb().drive(teleop=1.0)
    arb.run(2.1)
    assert len(arb.graph.messages("/diagnostics")) == 2
    report = arb.graph.report("turn_arb: steering")
    assert report[:2] == (DiagnosticStatus.OK, "TELEOP: tele_steer_req is 1.000")
    assert (report.values["age of e_stop"], report.values["limit"]) == ("never heard", "none is reached")
    arb.silence("human")
    arb.run(1.6)
    report = arb.graph.report("turn_arb: steering")
    assert report.level == DiagnosticStatus.WARN and report.message.startswith("NO_HUMAN: human_in_loop silent for ")
    assert [report.values[key] for key in ("cause", "locked", "duty", "tuned live", "ROS master")] == [
        "human silent", "False", "5100", "nothing", "there"]
    assert re.fullmatch(r"\d\.\d\d s", report.values["age of human_in_loop"])
    arb.hold(e_stop=True)
    arb.run(1.0)
    report = arb.graph.report("turn_arb: steering")
    assert (report.level, report.values["locked"]) == (DiagnosticStatus.WARN, "True")


def test_master_that_is_gone_is_warned_of_and_reported_while_it_drives_on():
    arb = Arb().drive(teleop=1.0)
    arb.graph.master_fault = "the ROS master is gone"
    arb.run(2.5)
    assert arb.warnings() == ["the ROS master is gone"]
    assert arb.graph.report("turn_arb: steering").values["ROS master"] == "the ROS master is gone"
    assert arb.duty == LEFT
    arb.graph.master_fault = ""
    arb.run(2.0)
    assert arb.graph.report("turn_arb: steering").values["ROS master"] == "there"


def test_gamepad_s_reason_is_quoted_while_the_deadman_is_false():
    """Also one that arrives after the deadman. In state, log and diagnostics; without it these are as they were."""
    reason = "the gamepad has 4 axes (0 to 3), but throttle_axis is 4"
    arb = Arb().drive(teleop=1.0)
    arb.run(0.1)
    arb.hold(human=False)
    arb.run(0.015)
    arb.graph.hold("/teleop_logi/state", TeleopState(cause="joy incomplete", reason=reason), 10)
    arb.run(1.0)
    assert arb.now == (NO_HUMAN, f"human_in_loop is false: {reason}", CENTER)
    assert arb.state.cause == "human absent"
    assert arb.graph.lines("/turn_arb")[-1] == f"NO_HUMAN: human_in_loop is false: {reason}"
    assert arb.graph.report("turn_arb: steering").message == f"NO_HUMAN: human_in_loop is false: {reason}"
    arb.graph.silence("/teleop_logi/state")
    arb.run(1.0)
    assert arb.now == (NO_HUMAN, "human_in_loop is false", CENTER)


def test_gamepad_that_is_quoted_is_that_of_its_namespace(graph):
    remap = {"/teleop_logi/human_in_loop": "/one/teleop_logi/human_in_loop"}
    graph.record("/one/turn_arb/state")
    for node_class, name in ((TurnArb, "turn_arb"), (TeleopLogi, "teleop_logi")):
        graph.add(node_class, f"/one/{name}", config(f"{name}.yaml"), remap)
    for topic, axes in (("/joy", 8), ("/one/joy", 4)):
        graph.repeat(topic, Joy(axes=[0.0] * axes, buttons=[0] * 11), 20)
    graph.run(2.0)
    assert graph.newest("/one/turn_arb/state").reason == (
        "human_in_loop is false: the gamepad has 4 axes (0 to 3), but throttle_axis is 4")


def test_gamepad_s_state_grants_nothing_and_tells_an_override():
    arb = Arb().drive(teleop=1.0)
    arb.hold(human=False)
    state = TeleopState(human_in_loop=True, cause="manual", reason="manual deadman held", steering_stick="override")
    since_ns = arb.graph.now_ns
    arb.graph.hold("/teleop_logi/state", state, 10)
    arb.run(1.0)
    assert (set(arb.duties(since_ns)), arb.state.reason) == ({CENTER}, "human_in_loop is false")
    arb.drive(teleop=-0.8)
    assert arb.now == (TELEOP, "tele_steer_req is -0.800: it overrides the planner", 6380)


@pytest.mark.parametrize("name, value, text", [
    ("teleop", 1.5, "tele_steer_req is 1.500: clamped to -1..1"),
    ("teleop", NAN, "tele_steer_req is nan: the steering is neutral while it lasts"),
    ("planner", NAN, "av_turnrad_req is nan: taken for no request"),
    ("steering", -1.5, "av_steer_req is -1.500: clamped to -1..1"),
    ("steering", INF, "av_steer_req is inf: taken for no request"),
    ("speed", NAN, "the velocity in the odometry is nan: the limits go by the last speed"),
])
def test_odd_request_is_warned_of_at_once_and_then_every_10_s(name, value, text):
    arb = Arb().drive(**{name: value})
    assert arb.warnings() == [text]
    arb.run(20.1)
    assert [line for line in arb.warnings() if line.startswith(text)] == [
        text, f"{text} (201 so far)", f"{text} (401 so far)"]


@pytest.mark.parametrize("name, value", [("teleop", 1.0), ("teleop", -1.0), ("steering", 1.0), ("planner", INF)])
def test_request_at_its_limit_is_not_warned_of(name, value):
    assert Arb().drive(**{name: value}).warnings() == []


def test_line_follows_its_change_by_two_or_three_ticks_which_the_gamepad_s_state_may_be_late():
    arb = Arb().drive(teleop=1.0)
    arb.run(0.1)
    at_ns = arb.graph.now_ns
    arb.once("human", False)
    arb.run(0.1)
    (line,) = [line for line in arb.graph.log if line.at_ns >= at_ns]
    assert line.text == "NO_HUMAN: human_in_loop is false" and 20_000_000 <= line.at_ns - at_ns <= 31_000_000


def test_log_has_a_line_for_each_change_of_source_or_cause_and_warns_of_losses():
    arb = Arb()
    arb.run(0.1)
    arb.drive(teleop=1.0)
    arb.run(0.1)
    for request in (0.9, 0.8):
        arb.hold(teleop=request)
    arb.silence("teleop")
    arb.run(0.7)
    arb.hold(teleop=0.0, steering=0.5, planner=2.0)
    arb.run(0.1)
    assert [(line.level, line.text) for line in arb.graph.log if ": " in line.text] == [
        (logging.INFO, "NO_HUMAN: human_in_loop was never heard"), (logging.INFO, "NO_HUMAN: human_in_loop is false"),
        (logging.INFO, "TELEOP: tele_steer_req is 1.000"),
        (logging.WARNING, "NEUTRAL: tele_steer_req silent for 0.51 s"),
        (logging.INFO, "NEUTRAL: neither tele_steer_req nor av_turnrad_req asks for anything"),
        (logging.INFO, "PLANNER: av_steer_req is 0.500"),
        (logging.INFO, "odom was never heard: nothing limits the steering"),
        (logging.WARNING, "NEUTRAL: av_turnrad_req and av_steer_req are both published: neither is obeyed")]


@pytest.mark.parametrize("radius_m, level, message", [
    (-1.5, DiagnosticStatus.WARN, "steering calibration?"),
    (2.5, DiagnosticStatus.OK, "the car turns as it is told to, or stands")])
def test_car_that_turns_against_its_steering_is_reported(radius_m, level, message):
    arb = Arb().drive(planner=radius_m)
    arb.graph.hold("/odom", odometry(1.0, 1.0 / 2.4), 20)
    arb.run(4.0)
    report = arb.graph.report("turn_arb: steering by the wheels")
    assert report.level == level and message in report.message
    assert report.values["commanded turn radius"] == f"{radius_m:.2f} m"
    assert report.values["estimated_turn_radius"] == "2.40 m"


def test_odometry_without_a_yaw_rate_is_not_taken_for_a_car_that_goes_straight_on():
    arb = Arb().drive(planner=2.0)
    for yaw_rate_radps, level in ((0.0, DiagnosticStatus.OK), (1e-6, DiagnosticStatus.WARN)):
        arb.graph.hold("/odom", odometry(1.0, yaw_rate_radps), 20)
        arb.run(4.0)
        assert arb.graph.report("turn_arb: steering by the wheels").level == level


# --- limits by what the car turns, and by the measured speed: 4 m/s² sideways at 4 m/s are a radius of 4 m ---

def test_turns_tighter_than_the_car_s_are_cut_and_told_everywhere_and_warned_of_once():
    arb = Arb().drive(speed=1.0)
    for radius, side, duty in ((0.17, "left", LEFT), (-0.17, "right", RIGHT), (0.17, "left", LEFT)):
        arb.hold(planner=radius)
        arb.run(1.0)
        state, text = arb.state, f"asks for 0.17 m, this car turns on 1.00 m to the {side}: rad? rad/s? wheelbase?"
        assert (state.source, state.cause, state.duty, state.limit, state.limit_reason) == (
            PLANNER, "planner", duty, "too tight", text)
        assert (state.asked_radius, abs(state.turn_radius), state.max_speed) == (pytest.approx(radius), 1.0, 2.0)
    report = arb.graph.report("turn_arb: steering")
    assert report.level == DiagnosticStatus.WARN and text in report.message and "degrees" in report.values["remedy"]
    assert report.values["warnings of too tight"] == "1"
    assert arb.warnings() == [f"the planner {text}"]


def test_a_turn_is_widened_to_what_the_speed_allows_told_counted_and_kept_when_odometry_is_lost():
    arb = Arb().drive(planner=1.0)
    assert (arb.duty, arb.state.limit, arb.state.limit_reason) == (
        LEFT, "limits off", "odom was never heard: nothing limits the steering")
    assert math.isnan(arb.state.speed)
    arb.hold(speed=4.0)
    arb.run(0.3)
    reason = "4 m/s² sideways: at 4.0 m/s no tighter than 4.00 m, 1.00 m was asked for"
    state = arb.state
    assert (arb.duty, state.limit, state.limit_reason) == (3850, "lateral acceleration", reason)
    assert (state.source, state.cause, state.asked_radius, state.max_speed, state.speed, state.cuts) == (
        PLANNER, "planner", 1.0, 2.0, 4.0, 1)
    for radius_m in (INF, 1.0, INF, 1.0):
        arb.hold(planner=radius_m)
        arb.run(0.3)
    assert [line for line in arb.graph.lines("/turn_arb") if "sideways" in line] == [reason]  # at most every 10 s
    arb.run(1.0)
    report = arb.graph.report("turn_arb: steering").values
    assert (report["limit"], report["requests cut by a limit"]) == (f"lateral acceleration: {reason}", "3")
    arb.graph.silence("/odom")
    arb.run(1.0)
    assert "by the last speed, odom silent" in arb.state.limit_reason
    assert (arb.state.source, arb.state.cuts, 0.9 < arb.state.odometry_age < 1.1) == (PLANNER, 3, True)
    assert 3850 <= arb.duty < 3900  # the bound of the speed that it may have gained unseen
    arb.hold(speed=1.0)
    arb.run(1.0)
    assert (arb.duty, arb.state.limit, arb.state.limit_reason, arb.state.max_speed) == (LEFT, "", "", 2.0)
