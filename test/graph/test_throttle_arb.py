"""throttle_arb: from its inputs to the ESC's command, with the ESC that it ships with, and with one that brakes."""
import math
import re

import pytest
from car_interface.msg import ConverterState, Float64Stamped, PlannerState, SteeringState, TeleopState, ThrottleState
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import BatteryState, Range
from std_msgs.msg import Bool, Float32, Int8, Int32MultiArray, String

from car import Car, config
from inputs import Arbiter, odometry

NEUTRAL, FULL_FORWARD = 4915, 6554
BY_HAND = 5407  # 0.3 of the way to full forward: 4915 + 0.3 · 1639
BY_PLANNER = 5571  # 4915 + 1.2 / 3 · 1639
NAN, INF = math.nan, math.inf
BRAKES = {"esc": {"profile": "brake_then_reverse"}}
STEERS = SteeringState(source=SteeringState.TELEOP)
PLANS = SteeringState(source=SteeringState.PLANNER)
OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


def value(data):
    return Float64Stamped(data=data)


def battery(voltage):
    return BatteryState(voltage=voltage)


def same(message):
    return message


TOPICS = {"e_stop": ("/e_stop", Bool), "human": ("/teleop_logi/human_in_loop", Bool),
          "teleop": ("/teleop_logi/tele_throt_req", Float32), "mode": ("/teleop_logi/mode", String),
          "scale_button": ("/teleop_logi/scale_button", Int8), "teleop_state": ("/teleop_logi/state", same),
          "steering": ("/turn_arb/state", same), "value": ("/generic/output/value", value),
          "converter": ("/generic_value_converter/state", same), "planner": ("/planner_interface/state", same),
          "speed": ("/odom", odometry), "battery": ("/battery_state", battery)}


class Arb(Arbiter):
    """throttle_arb in a graph of its own, and a servo board.

    Attributes:
        steering: the duty that the board holds on the steering's channel.
        pulse: what it holds on the ESC's; None = what was commanded.
    """

    def __init__(self, board=False, **parameters):
        self.car = Car()
        super().__init__(self.car.graph, TOPICS, 0.022, "throttle_arb", 1)
        self.steering, self.pulse = 0, None
        self.node = self.car.throttle_arb(**{"output_required": board, **parameters})
        if board:
            self.graph.hold("/servo/output", self._output, 50)

    def _output(self):
        return Int32MultiArray(data=[self.steering, self.duty if self.pulse is None else self.pulse] + [-1] * 14)

    def present(self, teleop=0.0, speed=1.0, **inputs):
        """A human, everything well, nobody asks for anything; once the ESC is armed."""
        self.silence("value", "converter")
        self.hold(e_stop=False, steering=STEERS, speed=speed, teleop=0.0, human=False)
        self.hold(**inputs)
        self.graph.run_until(lambda: self.state.cause == "human absent" and self.state.esc != "ARMING", 5.0)
        self.hold(human=False)
        self.hold(human=True, teleop=teleop)
        return self

    def plan(self, value):
        self.hold(converter=ConverterState(value=value, cause="converting"), value=value)

    def report(self):
        self.run(1.0)
        return self.graph.report("throttle_arb: throttle")


# --- what it sends, and when ---

@pytest.mark.parametrize("value_hz", [0, 50])
def test_commands_come_at_50_hz_with_the_original_layout_and_minus_one_elsewhere(value_hz):
    """A planner's values, too, have one command each, not one more by the timer."""
    arb = Arb().present(teleop=0.0 if value_hz else 1.0)
    if value_hz:
        arb.plan(1.2)
        arb.graph.hold("/generic/output/value", lambda: Float64Stamped(data=1.2 + arb.graph.now_ns % 97 / 1000), 50,
                       phase_s=0.0051)
    arb.run(0.1)
    since_ns = arb.graph.now_ns
    arb.run(1.0)
    records = [record for record in arb.graph.recorded["/servo/cmdVector"] if record.at_ns > since_ns]
    assert len(records) == 50
    assert {after.at_ns - before.at_ns for before, after in zip(records, records[1:])} == {20_000_000}
    for vector in (record.message for record in records):
        assert vector.data[:1] + vector.data[2:] == (-1,) * 15 and (value_hz or vector.data[1] == BY_HAND)
        assert vector.layout.data_offset == 0
        assert [(dim.label, dim.size, dim.stride) for dim in vector.layout.dim] == [("pwm_channel", 16, 1)]


def test_state_comes_10_times_a_second_and_is_latched_and_the_neutral_once():
    arb = Arb().present()
    since_ns = arb.graph.now_ns
    arb.run(2.0)
    assert len(arb.states(since_ns + 1)) == 20
    assert (arb.graph.recorded["/throttle_arb/state"][-1].at_ns - arb.start_ns) % 100_000_000 == 80_000_000  # 5th tick
    assert {vector.data for vector in arb.graph.messages("/servo/neutral", since_ns)} == {(-1, NEUTRAL) + (-1,) * 14}
    assert len(arb.graph.messages("/servo/neutral", since_ns)) == 2
    for topic in ("/throttle_arb/state", "/servo/neutral"):
        assert [each.latch for each in arb.graph.publishers[topic]] == [True]
    state = arb.state
    assert abs(state.stamp.to_nsec() - arb.graph.now_ns - arb.graph.ros_ahead_ns) <= 100_000_000
    assert (state.profile, state.speed, state.output_age, state.mode_age, state.planner_age) == (
        "unverified", 1.0, INF, INF, INF)
    for age_s in (state.e_stop_age, state.human_age, state.steering_age, state.teleop_age, state.odometry_age):
        assert 0 <= age_s < 0.07


def test_change_is_commanded_in_the_instant_in_which_it_arrives_in_each_phase_of_the_timer():
    arb = Arb().present()
    for request, duty in [(1.0, BY_HAND), (0.0, NEUTRAL)] * 10:
        arb.run(0.1017)
        arb.hold(teleop=request)
        assert arb.duty == duty
        arb.graph.link("/teleop_logi/tele_throt_req", delay_s=0.0)
        sent_ns = arb.graph.now_ns
        arb.once("human", False)
        arb.run(0.0)
        assert set(arb.duties(sent_ns)) == {NEUTRAL} and arb.states(sent_ns)[0].cause == "human absent"
        arb.hold(human=False)
        arb.hold(human=True)


# --- who drives ---

def test_a_person_drives_the_planner_drives_and_the_person_goes_first():
    arb = Arb().present()
    assert arb.now[::2] == (ThrottleState.NEUTRAL, NEUTRAL)
    assert re.fullmatch("neither tele_throt_req nor a planner's value asks .*", arb.state.reason)
    assert (arb.state.cause, arb.state.granted) == ("no request", 0.0)
    arb.hold(teleop=1.0)
    assert arb.now == (ThrottleState.TELEOP, "tele_throt_req is 1.000, scaled by 0.3", BY_HAND)
    assert (arb.state.cause, arb.state.asked, arb.state.esc) == ("teleop", 1.0, "FORWARD")
    assert arb.state.granted == pytest.approx(0.3, abs=1e-6)
    arb.plan(1.2)
    assert arb.duty == BY_HAND
    arb.hold(teleop=0.0)
    assert arb.now == (ThrottleState.PLANNER, "the planner's value is 1.200", BY_PLANNER)
    assert arb.state.cause == "planner"
    arb.hold(human=False)
    assert arb.now == (ThrottleState.NO_HUMAN, "human_in_loop is false", NEUTRAL)
    arb.hold(teleop_state=TeleopState(human_in_loop=False, reason="no deadman is held"))
    arb.run(0.1)
    assert arb.now[1] == "human_in_loop is false: no deadman is held"


def test_buttons_change_the_scale_once_for_each_press_while_it_drives():
    arb = Arb().present(teleop=1.0)
    for button in (0, 1, 1, 0):
        arb.once("scale_button", button)
        arb.run(0.03)
    assert arb.now == (ThrottleState.TELEOP, "tele_throt_req is 1.000, scaled by 0.4", BY_PLANNER)
    assert arb.state.human_scale == pytest.approx(0.4)
    assert arb.graph.lines("/throttle_arb").count("driving by hand is scaled by 0.4") == 1
    for button in (0, -1):
        arb.once("scale_button", button)
    arb.run(0.03)
    assert arb.duty == BY_HAND


# --- the battery ---

STOPS_BELOW = {"battery": {"warn_below": 7.0, "stop_below": 6.6, "recovery": 0.5}}
EMPTY = "the battery has 6.40 V after it fell below stop_below, 6.6 V: no planner drives before it has 7.1 V"


def battery_report(arb):
    arb.run(1.0)
    return arb.graph.report("throttle_arb: battery")[:2]


def test_empty_battery_stops_the_planner_with_its_reason_until_it_is_changed_and_a_person_drives_on():
    arb = Arb(**STOPS_BELOW).present(battery=8.0)
    arb.plan(1.2)
    assert arb.duty == BY_PLANNER and battery_report(arb) == (OK, "8.00 V")
    arb.hold(battery=6.4)
    arb.run(1.9)
    assert arb.duty == BY_PLANNER
    arb.run(0.2)
    assert (arb.state.cause, *arb.now) == ("battery empty", ThrottleState.NEUTRAL, EMPTY, NEUTRAL)
    assert battery_report(arb) == (ERROR, EMPTY)
    assert [line for line in arb.warnings() if "battery" in line] == [f"NEUTRAL: {EMPTY}", f"battery: {EMPTY}"]
    arb.hold(battery=7.0)  # the car stands
    arb.run(10.0)
    assert arb.state.cause == "battery empty"
    arb.hold(teleop=1.0)
    assert arb.now[::2] == (ThrottleState.TELEOP, BY_HAND)
    arb.hold(teleop=0.0, battery=8.0)
    arb.run(2.1)
    assert arb.duty == BY_PLANNER and battery_report(arb) == (OK, "8.00 V")


def test_battery_that_is_low_is_a_warning_and_no_stop():
    arb = Arb(**STOPS_BELOW).present(battery=8.0)
    arb.plan(1.2)
    arb.hold(battery=6.8)
    arb.run(6.0)
    text = "the battery has 6.80 V after it fell below warn_below, 7 V: low until it has 7.5 V"
    assert arb.duty == BY_PLANNER and battery_report(arb) == (WARN, text)
    assert arb.warnings() == [f"battery: {text}"]


def test_car_on_which_nobody_publishes_a_battery_s_state_is_told_of_nothing():
    arb = Arb().present()
    assert battery_report(arb) == (OK, "battery_state was never heard") and not arb.warnings()


# --- modes ---

def test_mode_says_who_drives_while_the_stick_is_at_rest():
    arb = Arb().present()
    arb.plan(3.0)
    for mode, source in (("manual", ThrottleState.TELEOP), ("autonomous", ThrottleState.PLANNER)):
        arb.hold(mode=mode)
        assert (arb.state.mode, arb.state.source) == (mode, source)
    arb.hold(mode="sport")
    assert (arb.state.cause, arb.duty, arb.state.reason) == (
        "mode unknown", NEUTRAL, "mode is 'sport', which is none of manual, autonomous, human_throttle, human_steering")
    assert arb.warnings()[0] == ("mode is 'sport': the throttle is neutral while it lasts; accepted: manual, "
                                 "autonomous, human_throttle, human_steering")
    arb.hold(mode="manual")
    arb.silence("mode")
    arb.run(0.57)
    assert arb.now[::2] == (ThrottleState.NEUTRAL, NEUTRAL)
    assert re.fullmatch(r"mode silent for 0\.5\d s", arb.state.reason)


# --- what it reports ---

def test_diagnostics_say_who_drives_and_why_once_a_second():
    arb = Arb().present(teleop=1.0)
    arb.graph.recorded["/diagnostics"].clear()
    level, message, values = arb.report()
    assert len(arb.graph.messages("/diagnostics")) == 1
    assert (level, message) == (
        OK, "TELEOP: tele_throt_req is 1.000, scaled by 0.3; ESC FORWARD: 0.30 is requested")
    expected = {"cause": "teleop", "duty": str(BY_HAND), "asked, granted": "1.000, 0.300",
                "profile of the ESC": "unverified", "mode": "never heard", "limit": "none is reached",
                "age of /servo/output": "never heard", "scale of driving by hand": "0.3",
                "cause of the ESC's state": "driving"}
    assert {key: values[key] for key in expected} == expected
    arb.silence("steering")
    level, message, _ = arb.report()
    assert level == WARN and message.startswith("NEUTRAL: turn_arb's state silent for")


@pytest.mark.parametrize("name, value, text", [
    ("teleop", 1.5, "tele_throt_req is 1.500: clamped to -1..1"),
    ("teleop", NAN, "tele_throt_req is nan: the throttle is neutral while it lasts"),
    ("value", INF, "the planner's value is inf: it doesn't drive"),
    ("speed", NAN, "the velocity in the odometry is nan: the planner doesn't drive"),
    ("speed", 1e308, "the velocity in the odometry is 1e+308: the planner doesn't drive"),  # no float32 of the state
    ("steering", SteeringState(source=SteeringState.TELEOP, channel=16),
     "turn_arb/state names channel 16 of the servo board; accepted: 0 to 15"),
])
def test_odd_input_is_warned_of_in_the_log(name, value, text):
    arb = Arb().present()
    arb.hold(**{name: value})
    assert [line for line in arb.warnings() if line.startswith(text)] == [text]
    arb.hold(teleop=1.0)
    assert arb.warnings().count("tele_throt_req is 1.000: clamped to -1..1") == 0


def test_output_of_another_length_is_ignored_and_warned_of():
    arb = Arb(board=True)
    arb.graph.hold("/servo/output", Int32MultiArray(data=[0] * 15), 50)
    arb.present(teleop=1.0)
    assert (arb.state.cause, arb.warnings()[0]) == ("board never heard", "/servo/output has 15 values, not 16: ignored")


# --- an ESC that brakes before it reverses, on a board that says what it holds ---

def test_board_that_gives_no_pulse_takes_arming_again():
    arb = Arb(board=True, **BRAKES).present(teleop=1.0)
    arb.run(1.0)
    assert arb.duty == BY_HAND
    arb.pulse = 0
    arb.run(0.1)
    assert (arb.state.esc, arb.duty) == ("ARMING", NEUTRAL)
    assert arb.state.esc_reason.startswith(
        "the servo board gave no pulse; let go of the deadman, center the stick")
    assert arb.graph.lines("/throttle_arb")[-1].startswith("ESC ARMING: the servo board gave no pulse")
    arb.pulse = None
    arb.present()
    arb.run(0.1)
    assert "ESC armed, profile brake_then_reverse" in arb.graph.lines("/throttle_arb")


def test_board_that_never_reported_is_not_driven_which_is_told():
    arb = Arb(output_required=True).present(teleop=1.0)
    assert (arb.state.cause, arb.state.granted, set(arb.duties())) == ("board never heard", 0.0, {NEUTRAL})
    assert "takes output_required: false" in arb.state.reason
    level, message, _ = arb.report()
    assert level == WARN and "/servo/output was never heard" in message


# --- an ESC whose kind is to be found out: it gets a person's stick, and all say so ---

def test_calibration_drive_passes_a_person_s_pull_at_standstill_on_until_the_deadman_is_released():
    arb = Arb(board=True, esc={"profile": "unverified", "calibration_drive": True}).present(speed=0.0)
    arb.run(1.0)
    warning = ("calibration drive: the ESC gets the stick as it is, and a brake may become reverse; record it for "
               "calibrate_esc, and start without calibration_drive afterwards")
    assert arb.warnings().count(warning) == 2  # at the start, and when the ESC is armed
    arb.hold(teleop=-1.0)
    assert (arb.duty, arb.state.esc_cause, arb.state.profile) == (4424, "calibration drive", "unverified")
    assert arb.state.esc_reason == "calibration drive: the ESC gets the stick as it is, and a brake may become reverse"
    level, message, _ = arb.report()
    assert level == WARN and message.startswith("calibration drive; ")
    arb.hold(human=False)
    assert arb.duty == NEUTRAL


def test_pull_that_may_not_brake_since_nobody_knows_the_esc_s_kind_is_warned_of():
    arb = Arb(board=True).present(teleop=1.0, speed=0.4)
    arb.run(0.5)
    arb.hold(teleop=-1.0)
    arb.run(0.5)
    assert (arb.duty, arb.state.esc_cause) == (NEUTRAL, "brake uncertain")
    assert f"no brake: {arb.state.esc_reason}" in arb.warnings()


# --- of planner_interface ---

def test_planner_reverses_by_its_gear_and_stops_with_the_reason_of_planner_interface():
    arb = Arb(board=True, **BRAKES).present(speed=0.0, planner=PlannerState(cause="planner", gear="reverse"))
    arb.run(1.0)
    arb.plan(-2.0)
    arb.run(2.0)
    assert (arb.state.esc_cause, arb.now[::2]) == ("reversing", (ThrottleState.PLANNER, 4260))  # 4915 − 2 / 5 · 1638
    assert any(line.startswith("ESC REVERSE: ") for line in arb.graph.lines("/throttle_arb"))
    # The ESC has gone through several states, and each line about who drives is there once.
    assert [line for line in arb.graph.lines("/throttle_arb") if line.startswith("PLANNER: ")] == [
        "PLANNER: the planner's value is -2.000"]
    arb.hold(planner=PlannerState(cause="planner silent", gear="reverse", reason="drive silent for 0.50 s"))
    assert (arb.state.cause, arb.now) == (
        "planner silent", (ThrottleState.NEUTRAL, "drive silent for 0.50 s", NEUTRAL))
    arb.hold(planner=PlannerState(cause="planner", gear="neutral"))
    assert arb.now == (ThrottleState.PLANNER, "the planner's gear is neutral: the car coasts", NEUTRAL)


# --- limits ---

def test_a_planner_s_car_that_is_too_fast_for_its_turn_slows_down_which_is_told_and_counted():
    arb = Arb().present(speed=4.0)
    arb.graph.hold("/odom", lambda: odometry(4.0 + arb.graph.now_ns % 97 / 1e9), 20)  # no two are the same
    arb.hold(steering=SteeringState(source=SteeringState.PLANNER, max_speed=2.0))
    arb.plan(1.0)
    reason = "the turn that is asked for allows 2.00 m/s, it has 4.00: it brakes"
    state = arb.state
    assert (state.limit, state.limit_reason, state.granted, state.max_speed, state.cuts, state.esc) == (
        "slowed for the turn", reason, -0.5, 2.0, 1, "BRAKING")
    assert state.asked > 0
    report = arb.report().values
    assert (report["limit"], report["requests cut by a limit"]) == (f"slowed for the turn: {reason}", "1")
    assert arb.graph.lines("/throttle_arb").count(reason) == 1
    arb.hold(steering=PLANS)
    assert arb.state.granted > 0
    assert (arb.state.limit, arb.state.limit_reason, arb.state.max_speed) == ("", "", 0.0)
    arb.run(0.2)
    assert "" not in arb.graph.lines("/throttle_arb")


def test_limit_without_odometry_is_off_which_is_logged_once():
    arb = Arb(human={"max_speed": 2.0})
    arb.hold(e_stop=False, steering=STEERS, teleop=0.0, human=False)
    arb.run(2.0)
    arb.hold(human=True, teleop=1.0)
    arb.run(1.0)
    reason = "odom was never heard: nothing limits the throttle"
    assert (arb.duty, arb.state.limit, arb.state.limit_reason) == (BY_HAND, "limits off", reason)
    assert arb.graph.lines("/throttle_arb").count(reason) == 1


def test_what_a_sonar_ahead_sees_stops_the_car_and_a_silent_one_too():
    arb = Arb(obstacle_stop=True, sonar_hub=config("sonars.yaml")).present(
        speed=0.0, steering=SteeringState(source=SteeringState.PLANNER, turn_radius=INF))
    arb.plan(1.0)
    assert (arb.state.limit, arb.state.granted) == ("sonar silent", 0.0)
    assert re.fullmatch(r"(front_\w+) was never heard, and the car doesn't drive blind: "
                        r"0.00 m/s, it has 0.00: 0.00 instead of 0.33", arb.state.limit_reason)
    for name in config("sonars.yaml")["sonars"]:
        arb.graph.hold(f"/sonar/{name}", Range(range=INF), 20)
    arb.run(0.1)
    assert (arb.state.limit in ("", "obstacle"), arb.state.granted > 0) == (True, True)  # it begins slowly
    arb.hold(speed=1.5)
    arb.graph.hold("/sonar/front_middle", Range(range=0.5), 20)
    arb.run(0.1)
    assert (arb.state.limit, arb.state.granted <= 0) == ("obstacle", True)
    assert re.fullmatch(r"front_middle (sees 0.50 m|saw something, 0.\d\d m from here on this arc), which allows "
                        r"0\.\d\d m/s, it has 1.50: it stops", arb.state.limit_reason)


# --- the end ---

def test_esc_that_is_driven_gets_neutral_when_the_node_ends():
    arb = Arb().present(teleop=1.0)
    assert arb.duty == BY_HAND
    arb.node.end()
    assert (arb.duty, arb.node.fault, arb.node.is_alive) == (NEUTRAL, "", False)
