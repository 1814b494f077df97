#!/usr/bin/env python3
"""throttle_arb by its topics: started by its launch file, with the ESC that it ships with, and with one that brakes."""
from __future__ import annotations

import math
import os
import re
import shutil
import signal
import tempfile
import threading
import time
import unittest

import rospkg
import rospy
import rostest
import yaml
from car_interface.msg import ConverterState, Float64Stamped, PlannerState, SteeringState, TeleopState, ThrottleState
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from dynamic_reconfigure.client import Client
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Log
from sensor_msgs.msg import Range
from std_msgs.msg import Bool, Float32, Int8, Int32MultiArray, String
from std_srvs.srv import Trigger

from waiting import Repeater, Sender, Topic, config, delete_param, rate_hz, retried, set_params, start_node

NEUTRAL, FULL_FORWARD, FULL_BRAKE = 4915, 6554, 3277
BY_HAND = 5407  # 0.3 of the way to full forward: 4915 + 0.3 · 1639
NAN, INF = math.nan, math.inf


def odometry(velocity):
    message = Odometry()
    message.twist.twist.linear.x = velocity
    return message


def output(duty, steering=0):
    """What the board holds; the steering's duty as in a SteeringState that names none."""
    return Int32MultiArray(data=[steering, duty] + [-1] * 14)


class Rig:
    """All inputs of one throttle_arb, in a namespace, and what it publishes.

    Args:
        namespace: the node's, from / to /.
        board: answer each command on /servo/output, as the servo board does.
    """

    def __init__(self, test, namespace="/", board=False, node="throttle_arb"):
        self.commands = Topic(f"{namespace}servo/cmdVector", Int32MultiArray).connected()
        self.states = Topic(f"{namespace}{node}/state", ThrottleState).connected()
        teleop = f"{namespace}teleop_logi/"
        self.e_stop = Sender(f"{namespace}e_stop", Bool)
        self.human = Sender(f"{teleop}human_in_loop", Bool)
        self.teleop = Sender(f"{teleop}tele_throt_req", Float32)
        self.mode = Sender(f"{teleop}mode", String)
        self.scale_button = Sender(f"{teleop}scale_button", Int8)
        self.teleop_state = Sender(f"{teleop}state", TeleopState)
        self.steering = Sender(f"{namespace}turn_arb/state", SteeringState)
        self.value = Sender(f"{namespace}generic/output/value", Float64Stamped)
        self.converter = Sender(f"{namespace}generic_value_converter/state", ConverterState)
        self.odometry = Sender(f"{namespace}odom", Odometry)
        self.inputs = Repeater(period_s=0.04)
        test.addCleanup(self.inputs.end)
        if board:
            self._holds, self._steering = NEUTRAL, 0
            self._outputs = Sender(f"{namespace}servo/output", Int32MultiArray)
            echo = rospy.Subscriber(f"{namespace}servo/cmdVector", Int32MultiArray, self._answer, tcp_nodelay=True)
            test.addCleanup(echo.unregister)
            self.inputs.hold(self._outputs, output(NEUTRAL))

    def _answer(self, vector):
        if vector.data[1] != self._holds:
            self._holds = vector.data[1]
            self.inputs.hold(self._outputs, output(self._holds, self._steering))

    def hold_steering(self, duty):
        """Have the board hold a duty on the steering's channel."""
        self._steering = duty
        self.inputs.hold(self._outputs, output(self._holds, duty))

    def drop(self, *senders):
        self.inputs.drop(*senders)

    def present(self, teleop=0.0, speed=1.0):
        """A human, everything well, nobody asks for anything; and wait until the ESC is armed."""
        hold = self.inputs.hold
        self.drop(self.value, self.converter)
        hold(self.e_stop, Bool(False))
        hold(self.steering, SteeringState(source=SteeringState.TELEOP))
        hold(self.odometry, odometry(speed))
        hold(self.teleop, Float32(0.0))
        hold(self.human, Bool(False))  # what was lost comes back only by letting go and holding again
        self.wait_for(lambda state: state.cause == "human absent" and state.esc != "ARMING")
        hold(self.human, Bool(False))  # one that comes after the lock was off
        hold(self.human, Bool(True))
        self.wait_for(lambda state: state.source not in (ThrottleState.LOCKED, ThrottleState.NO_HUMAN))
        hold(self.teleop, Float32(teleop))

    def plan(self, value):
        self.inputs.hold(self.converter, ConverterState(value=value, cause="converting"))
        self.inputs.hold(self.value, Float64Stamped(data=value))

    def wait_for(self, wanted, since=None):
        """The first state from ``since`` on (default: now) that is wanted."""
        return self.states.wait_for(wanted, self.states.mark() if since is None else since).what

    def wait_for_reason(self, source, reason):
        return self.wait_for(lambda state: state.source == source and re.fullmatch(reason, state.reason))

    def wait_for_duty(self, duty):
        self.commands.wait_for(lambda vector: vector.data[1] == duty, self.commands.mark())


class ThrottleTest(unittest.TestCase):
    NAMESPACE, BOARD = "/", False

    def setUp(self):
        self.rig = Rig(self, self.NAMESPACE, self.BOARD)

    def hold(self, sender, message):
        self.rig.inputs.hold(sender, message)


class Limits(ThrottleTest):
    def test_a_planner_s_car_that_is_too_fast_for_its_turn_slows_down_which_is_told_and_counted(self):
        diagnostics = Topic("/diagnostics", DiagnosticArray)
        self.addCleanup(diagnostics.close)
        self.rig.present(speed=4.0)
        self.hold(self.rig.steering, SteeringState(source=SteeringState.PLANNER, max_speed=2.0))
        before = self.rig.states.since()[-1].cuts
        self.rig.plan(1.0)
        reason = "the turn that is asked for allows 2.00 m/s, it has 4.00: it brakes"
        cut = self.rig.wait_for(lambda state: state.limit == "slowed for the turn" and state.granted < 0)
        self.assertEqual((cut.limit_reason, cut.granted, cut.max_speed, cut.cuts, cut.esc),
                         (reason, -0.5, 2.0, before + 1, "BRAKING"))
        self.assertGreater(cut.asked, 0)
        diagnostics.wait_for(lambda array: any(
            "throttle_arb: throttle" in status.name and {value.key: value.value for value in status.values}.get(
                "limit") == f"slowed for the turn: {reason}" for status in array.status))
        self.hold(self.rig.steering, SteeringState(source=SteeringState.PLANNER))
        free = self.rig.wait_for(lambda state: state.granted > 0)
        self.assertEqual((free.limit, free.limit_reason, free.max_speed), ("", "", 0.0))


class Obstacles(unittest.TestCase):
    def test_what_a_sonar_ahead_sees_stops_the_car_and_a_silent_one_too(self):
        set_params(self, "/walls/throttle_arb", {**config("throttle.yaml"), "obstacle_stop": True,
                                                 "grant_at_start": True, "output_required": False,
                                                 "sonar_hub": config("sonars.yaml")})
        start_node(self, "throttle_arb", "__ns:=/walls", "/servo/cmdVector:=servo/cmdVector", "/e_stop:=e_stop",
                   "/servo/output:=servo/output", "/teleop_logi/human_in_loop:=teleop_logi/human_in_loop",
                   "/teleop_logi/tele_throt_req:=teleop_logi/tele_throt_req", "/teleop_logi/mode:=teleop_logi/mode",
                   "/teleop_logi/scale_button:=teleop_logi/scale_button", "~input/value:=generic/output/value",
                   "~input/odometry:=odom")
        rig = Rig(self, "/walls/")
        rig.present(speed=0.0)
        rig.inputs.hold(rig.steering, SteeringState(source=SteeringState.PLANNER, turn_radius=math.inf))
        rig.plan(1.0)
        silent = rig.wait_for(lambda state: state.limit == "sonar silent")
        self.assertRegex(silent.limit_reason, r"^(front_\w+) was never heard, and the car doesn't drive blind: "
                                              r"0.00 m/s, it has 0.00: 0.00 instead of 0.33$")
        self.assertEqual(silent.granted, 0)
        sonars = {name: Sender(f"/walls/sonar/{name}", Range) for name in config("sonars.yaml")["sonars"]}
        for sender in sonars.values():
            rig.inputs.hold(sender, Range(range=math.inf))
        free = rig.wait_for(lambda state: state.granted > 0)
        self.assertEqual(free.limit, "")
        rig.inputs.hold(rig.odometry, odometry(1.5))
        rig.inputs.hold(sonars["front_middle"], Range(range=0.5))
        stopped = rig.wait_for(lambda state: state.limit == "obstacle" and "sees 0.50" in state.limit_reason)
        self.assertRegex(stopped.limit_reason, r"front_middle sees 0.50 m, which allows 0\.\d\d m/s, it has 1.50: "
                                               r"it stops")
        self.assertLessEqual(stopped.granted, 0)


class Commands(ThrottleTest):
    def test_rate_is_50_hz_with_the_original_layout_and_minus_one_elsewhere(self):
        self.rig.present(teleop=1.0)
        self.rig.wait_for_duty(BY_HAND)

        def attempt():
            mark = self.rig.commands.mark()
            self.assertAlmostEqual(rate_hz(self.rig.commands, over_s=1.0), 50, delta=2)
            return self.rig.commands.since(mark)
        for vector in retried(attempt):
            self.assertEqual(vector.data, (-1, BY_HAND) + (-1,) * 14)
            self.assertEqual(vector.layout.data_offset, 0)
            self.assertEqual([(dim.label, dim.size, dim.stride) for dim in vector.layout.dim], [("pwm_channel", 16, 1)])

    def test_a_person_drives_the_planner_drives_and_the_person_goes_first(self):
        self.rig.present()
        state = self.rig.wait_for_reason(ThrottleState.NEUTRAL, "neither tele_throt_req nor a planner's value asks .*")
        self.assertEqual((state.cause, state.duty, state.granted), ("no request", NEUTRAL, 0.0))
        self.hold(self.rig.teleop, Float32(1.0))
        state = self.rig.wait_for_reason(ThrottleState.TELEOP, r"tele_throt_req is 1\.000, scaled by 0\.3")
        self.assertEqual((state.duty, state.cause, state.asked, state.esc), (BY_HAND, "teleop", 1.0, "FORWARD"))
        self.assertAlmostEqual(state.granted, 0.3, delta=1e-6)
        self.rig.plan(1.2)
        self.rig.wait_for_duty(BY_HAND)
        self.hold(self.rig.teleop, Float32(0.0))
        state = self.rig.wait_for_reason(ThrottleState.PLANNER, r"the planner's value is 1\.200")
        self.assertEqual((state.duty, state.cause), (5571, "planner"))  # 4915 + 1.2 / 3 · 1639
        self.hold(self.rig.human, Bool(False))
        self.rig.wait_for_reason(ThrottleState.NO_HUMAN, "human_in_loop is false")
        self.rig.wait_for_duty(NEUTRAL)

    def test_by_hand_it_drives_without_odometry_and_without_a_planner(self):
        self.rig.present(teleop=1.0)
        self.rig.drop(self.rig.odometry)
        state = self.rig.wait_for(lambda state: math.isnan(state.speed) and state.source == ThrottleState.TELEOP)
        self.assertEqual(state.duty, BY_HAND)

    def test_buttons_change_the_scale_while_it_drives(self):
        self.rig.present(teleop=1.0)
        self.rig.wait_for_duty(BY_HAND)
        log = Topic("/rosout", Log).connected(2)
        self.addCleanup(log.close)
        for button in (0, 1, 1, 0):
            self.rig.scale_button.publish(Int8(button))
        state = self.rig.wait_for(lambda state: state.human_scale > 0.35)
        self.assertEqual((state.duty, state.reason), (5571, "tele_throt_req is 1.000, scaled by 0.4"))
        log.wait_for(lambda entry: entry.msg == "driving by hand is scaled by 0.4")
        for button in (0, -1):
            self.rig.scale_button.publish(Int8(button))
        self.rig.wait_for_duty(BY_HAND)

    def test_negative_value_brakes_a_car_that_rolls_and_does_nothing_to_one_that_stands(self):
        self.rig.present(speed=4.0)
        self.rig.plan(-5.0)
        state = self.rig.wait_for(lambda state: state.esc == "BRAKING")
        self.assertEqual((state.duty, state.asked), (FULL_BRAKE, -1.0))
        self.hold(self.rig.odometry, odometry(0.0))
        state = self.rig.wait_for(lambda state: state.esc_cause == "at standstill")
        self.assertEqual((state.duty, state.source), (NEUTRAL, ThrottleState.PLANNER))
        self.assertEqual(state.esc_reason, "it stands: a brake doesn't become reverse")

    def test_whatever_is_lost_means_neutral(self):
        rig, hold = self.rig, self.hold
        stopped, locked = (SteeringState(source=source, reason="why")
                           for source in (SteeringState.NO_HUMAN, SteeringState.LOCKED))
        no_value = ConverterState(value=NAN, cause="command not finite", reason="the commanded acceleration is nan")
        of_planner = [
            ("values are silent", lambda: rig.drop(rig.value), r"the planner's value silent for 0\.\d\d s"),
            ("a value is no number", lambda: rig.plan(NAN), "the planner's value is nan, no number to act on"),
            ("the converter has none", lambda: hold(rig.converter, no_value), "the commanded acceleration is nan"),
            ("odometry is silent", lambda: rig.drop(rig.odometry), r"odometry silent for 0\.\d\d s"),
            ("odometry is no number", lambda: hold(rig.odometry, odometry(NAN)), "the velocity in the odometry is nan"),
        ]
        of_both = [
            ("the human lets go", lambda: hold(rig.human, Bool(False)), "human_in_loop is false"),
            ("the human is silent", lambda: rig.drop(rig.human), r"human_in_loop silent for 0\.\d\d s"),
            ("turn_arb sees no human", lambda: hold(rig.steering, stopped), "turn_arb says NO_HUMAN: why"),
            ("turn_arb is locked", lambda: hold(rig.steering, locked), "turn_arb says LOCKED: why"),
            ("turn_arb is silent", lambda: rig.drop(rig.steering), r"turn_arb's state silent for 0\.\d\d s"),
            ("the gamepad is silent", lambda: rig.drop(rig.teleop), r"tele_throt_req silent for 0\.\d\d s"),
            ("the throttle is no number", lambda: hold(rig.teleop, Float32(NAN)), "tele_throt_req is nan, no number.*"),
            ("the lock is on", lambda: hold(rig.e_stop, Bool(True)), "e_stop is true"),
            ("the lock is silent", lambda: rig.drop(rig.e_stop), r"e_stop silent for 1\.\d\d s"),
        ]
        for driver, faults in (("planner", of_planner + of_both), ("human", of_both)):
            for name, break_it, reason in faults:
                with self.subTest(f"{driver}: {name}"):
                    rig.present(teleop=0.0 if driver == "planner" else 1.0)
                    if driver == "planner":
                        rig.plan(3.0)
                    rig.wait_for_duty(FULL_FORWARD if driver == "planner" else BY_HAND)
                    mark = rig.states.mark()
                    break_it()
                    rig.wait_for(lambda state, reason=reason: state.duty == NEUTRAL
                                 and re.fullmatch(reason, state.reason), mark)
                    for vector in rig.commands.wait_for_count(10, rig.commands.mark()):
                        self.assertEqual(vector.data[1], NEUTRAL)

    def test_reason_of_teleop_logi_is_quoted(self):
        self.rig.present()
        self.hold(self.rig.human, Bool(False))
        self.hold(self.rig.teleop_state, TeleopState(human_in_loop=False, reason="no deadman is held"))
        self.rig.wait_for_reason(ThrottleState.NO_HUMAN, "human_in_loop is false: no deadman is held")


class Reports(ThrottleTest):
    def test_state_comes_10_times_a_second_is_latched_and_has_the_ages(self):
        self.rig.present()

        def attempt():
            self.assertAlmostEqual(rate_hz(self.rig.states, over_s=1.0), 10, delta=1)
        retried(attempt)
        late = Topic("/throttle_arb/state", ThrottleState)
        self.addCleanup(late.close)
        state = late.wait_for(lambda _: True).what
        self.assertEqual(state._connection_header["latching"], "1")
        self.assertAlmostEqual(state.stamp.to_sec(), time.time(), delta=5)
        self.assertEqual((state.profile, state.speed), ("unverified", 1.0))
        for age_s in (state.e_stop_age, state.human_age, state.steering_age, state.teleop_age, state.odometry_age):
            self.assertTrue(0 <= age_s < 0.5)
        self.assertEqual(state.output_age, INF)

    def test_diagnostics_say_who_drives_and_why_once_a_second(self):
        reports = Topic("/diagnostics", DiagnosticArray)
        self.addCleanup(reports.close)

        def report(text):
            return reports.wait_for(lambda array: array.status[0].name == "throttle_arb: throttle"
                                    and text in array.status[0].message, reports.mark()).what.status[0]
        self.rig.present(teleop=1.0)
        status = report("TELEOP: tele_throt_req is 1.000, scaled by 0.3; ESC FORWARD: 0.30 is requested")
        self.assertEqual(status.level, DiagnosticStatus.OK)
        values = {pair.key: pair.value for pair in status.values}
        self.assertEqual((values["cause"], values["duty"], values["asked, granted"], values["profile of the ESC"]),
                         ("teleop", str(BY_HAND), "1.000, 0.300", "unverified"))
        self.rig.drop(self.rig.steering)
        self.assertEqual(report("NEUTRAL: turn_arb's state silent for").level, DiagnosticStatus.WARN)

    def test_requests_beyond_what_is_accepted_are_reported_in_the_log(self):
        log = Topic("/rosout", Log).connected(2)
        self.addCleanup(log.close)
        self.rig.present(teleop=1.5)
        log.wait_for(lambda entry: entry.msg == "tele_throt_req is 1.500: clamped to -1..1")
        self.rig.wait_for_duty(BY_HAND)


class Modes(ThrottleTest):
    """A teleop that sends its mode."""

    NAMESPACE = "/modes/"

    def setUp(self):
        super().setUp()
        self.log = Topic("/rosout", Log).connected(2)
        self.addCleanup(self.log.close)

    def test_mode_says_who_drives_while_the_stick_is_at_rest(self):
        self.hold(self.rig.mode, String("autonomous"))
        self.rig.present()
        self.rig.plan(3.0)
        self.rig.wait_for_duty(FULL_FORWARD)
        for mode, source in (("manual", ThrottleState.TELEOP), ("human_steering", ThrottleState.PLANNER),
                             ("human_throttle", ThrottleState.TELEOP), ("autonomous", ThrottleState.PLANNER)):
            with self.subTest(mode):
                self.hold(self.rig.mode, String(mode))
                state = self.rig.wait_for(lambda state, mode=mode: state.mode == mode)
                self.assertEqual(state.source, source)
        self.hold(self.rig.mode, String("sport"))
        state = self.rig.wait_for(lambda state: state.cause == "mode unknown")
        self.assertEqual(state.duty, NEUTRAL)
        self.assertEqual(state.reason,
                         "mode is 'sport', which is none of manual, autonomous, human_throttle, human_steering")
        self.hold(self.rig.mode, String("autonomous"))
        self.rig.wait_for_duty(FULL_FORWARD)
        self.assertEqual(self.log.wait_for(lambda entry: entry.msg.startswith("mode is 'sport'")).what.msg,
                         "mode is 'sport': the throttle is neutral while it lasts; accepted: manual, autonomous, "
                         "human_throttle, human_steering")
        self.rig.drop(self.rig.mode)
        self.rig.wait_for_reason(ThrottleState.NEUTRAL, r"mode silent for 0\.\d\d s")
        self.rig.wait_for_duty(NEUTRAL)


class Braking(ThrottleTest):
    """An ESC that is known to brake before it reverses, and a servo board that says what it holds."""

    NAMESPACE, BOARD = "/braking/", True

    def test_stop_brakes_a_car_that_rolls_until_it_is_slow(self):
        self.rig.present(teleop=1.0, speed=4.0)
        self.rig.wait_for(lambda state: state.esc == "FORWARD" and state.output_age < 1.0)
        self.hold(self.rig.human, Bool(False))
        state = self.rig.wait_for(lambda state: state.esc == "BRAKING")
        self.assertEqual((state.source, state.cause, state.granted), (ThrottleState.NO_HUMAN, "human absent", -0.5))
        self.rig.wait_for_duty(4096)  # 4915 − 0.5 · 1638
        self.hold(self.rig.odometry, odometry(0.2))
        self.rig.wait_for_duty(NEUTRAL)

    def test_second_pull_is_reverse_at_standstill_scaled_as_driving_is(self):
        self.rig.present(speed=0.0)
        self.hold(self.rig.teleop, Float32(-1.0))
        self.rig.wait_for(lambda state: state.source == ThrottleState.TELEOP and state.asked == -1.0)
        self.hold(self.rig.teleop, Float32(0.0))
        self.rig.wait_for(lambda state: state.asked == 0.0)
        mark = self.rig.commands.mark()
        self.hold(self.rig.teleop, Float32(-1.0))
        state = self.rig.wait_for(lambda state: state.esc_cause == "reversing")
        self.assertEqual((state.esc, state.duty), ("REVERSE", 4424))  # 4915 − 0.3 · 1638
        self.assertGreaterEqual(min(vector.data[1] for vector in self.rig.commands.since(mark)), 4424)

    def test_board_that_gives_no_pulse_takes_arming_again(self):
        self.rig.present(teleop=1.0)
        self.rig.wait_for(lambda state: state.esc == "FORWARD")
        self.hold(self.rig._outputs, output(0))
        state = self.rig.wait_for(lambda state: state.esc == "ARMING")
        self.assertEqual(state.duty, NEUTRAL)
        self.assertRegex(state.esc_reason, "the servo board gave no pulse; let go of the deadman, center the stick")


class BothActuatorsOrNone(ThrottleTest):
    """Throttle is given only while the servo board holds what turn_arb commands."""

    NAMESPACE, BOARD = "/braking/", True

    def test_servo_that_does_not_follow_stops_the_car_until_it_follows_again(self):
        log = Topic("/rosout", Log).connected()
        diagnostics = Topic("/diagnostics", DiagnosticArray)
        for topic in (log, diagnostics):
            self.addCleanup(topic.close)
        self.rig.present(teleop=1.0, speed=4.0)
        self.rig.wait_for(lambda state: state.esc == "FORWARD")
        mark = log.mark()
        self.hold(self.rig.steering, SteeringState(source=SteeringState.TELEOP, duty=3818))
        state = self.rig.wait_for(lambda state: state.cause == "steering not held")
        reason = "the servo board holds 0 on channel 0, where turn_arb commands 3818"
        self.assertEqual((state.source, state.reason, state.asked), (ThrottleState.NEUTRAL, reason, 0.0))
        self.rig.wait_for(lambda state: state.granted == -0.5)  # this one is known to brake
        log.wait_for(lambda entry: entry.name == "/braking/throttle_arb" and entry.msg == f"NEUTRAL: {reason}"
                     and entry.level == Log.WARN, mark)
        diagnostics.wait_for(lambda array: any(
            status.name == "braking/throttle_arb: throttle" and status.level == DiagnosticStatus.WARN
            and reason in status.message for status in array.status))
        self.rig.hold_steering(3824)  # the nearest count
        state = self.rig.wait_for(lambda state: state.source == ThrottleState.TELEOP)
        self.assertEqual(state.asked, 1.0)

    def test_board_that_falls_silent_stops_the_car(self):
        self.rig.present(teleop=1.0)
        self.rig.wait_for(lambda state: state.esc == "FORWARD")
        self.rig.drop(self.rig._outputs)
        state = self.rig.wait_for(lambda state: state.cause == "board silent")
        self.assertRegex(state.reason, r"^/servo/output silent for 0\.5\d s$")

    def test_board_that_never_reported_is_not_driven_which_is_told(self):
        set_params(self, "/boardless/throttle_arb", {**config("throttle.yaml"), "grant_at_start": True})
        start_node(self, "throttle_arb", "__ns:=/boardless", "/servo/cmdVector:=servo/cmdVector", "/e_stop:=e_stop",
                   "/servo/output:=servo/output", "throttle_arb/input/odometry:=odom",
                   "throttle_arb/input/value:=generic/output/value",
                   *(f"/teleop_logi/{name}:=teleop_logi/{name}"
                     for name in ("human_in_loop", "tele_throt_req", "mode", "scale_button")))
        rig = Rig(self, "/boardless/")
        diagnostics = Topic("/diagnostics", DiagnosticArray)
        self.addCleanup(diagnostics.close)
        rig.present(teleop=1.0)
        state = rig.wait_for(lambda state: state.cause == "board never heard")
        self.assertEqual(state.granted, 0.0)
        self.assertIn("takes output_required: false", state.reason)
        diagnostics.wait_for(lambda array: any(
            "boardless/throttle_arb: throttle" in status.name and status.level == DiagnosticStatus.WARN
            and "/servo/output was never heard" in status.message for status in array.status))


class CalibrationDrive(ThrottleTest):
    """An ESC whose kind is to be found out: it gets a person's stick, and all say so."""

    NAMESPACE, BOARD = "/calibrating/", True

    def test_pull_at_standstill_reaches_the_esc_until_the_deadman_is_released(self):
        self.rig.present(speed=0.0)
        self.hold(self.rig.teleop, Float32(-1.0))
        state = self.rig.wait_for(lambda state: state.granted)
        self.assertEqual((state.esc_cause, state.duty, state.profile), ("calibration drive", 4424, "unverified"))
        self.assertEqual(state.esc_reason,
                         "calibration drive: the ESC gets the stick as it is, and a brake may become reverse")
        self.rig.wait_for_duty(4424)
        self.hold(self.rig.human, Bool(False))
        self.rig.wait_for_duty(NEUTRAL)

    def test_planner_s_pull_at_standstill_does_not(self):
        self.rig.present(speed=0.0)
        self.rig.plan(-5.0)
        state = self.rig.wait_for(lambda state: state.source == ThrottleState.PLANNER and state.asked == -1.0)
        self.assertEqual(state.duty, NEUTRAL)

    def test_log_and_diagnostics_warn_of_it(self):
        log, reports = Topic("/rosout", Log).connected(2), Topic("/diagnostics", DiagnosticArray)
        self.addCleanup(log.close)
        self.addCleanup(reports.close)
        found = reports.wait_for(lambda array: array.status[0].message.startswith("calibration drive; "))
        status = found.what.status[0]
        self.assertEqual((status.name, status.level), ("calibrating/throttle_arb: throttle", DiagnosticStatus.WARN))
        self.rig.present()
        mark = log.mark()
        self.hold(self.rig._outputs, output(0))
        self.rig.wait_for(lambda state: state.esc == "ARMING")
        self.hold(self.rig._outputs, output(NEUTRAL))
        self.rig.present()
        entry = log.wait_for(lambda entry: entry.name.startswith("/calibrating") and "calibrate_esc" in entry.msg, mark)
        self.assertEqual(entry.what.level, Log.WARN)
        self.assertEqual(entry.what.msg, "calibration drive: the ESC gets the stick as it is, and a brake may become "
                         "reverse; record it for calibrate_esc, and start without calibration_drive afterwards")


class OfPlannerInterface(ThrottleTest):
    """An ESC that brakes before it reverses, and a planner with a gear."""

    NAMESPACE, BOARD = "/braking/", True

    def setUp(self):
        super().setUp()
        self.planner = Sender(f"{self.NAMESPACE}planner_interface/state", PlannerState)
        self.addCleanup(self.planner.close)

    def test_planner_reverses_by_its_gear_and_stops_with_the_reason_of_planner_interface(self):
        self.rig.present(speed=0.0)
        self.hold(self.planner, PlannerState(cause="planner", gear="reverse"))
        self.rig.plan(-2.0)
        state = self.rig.wait_for(lambda state: state.esc_cause == "reversing")
        self.assertEqual((state.source, state.duty), (ThrottleState.PLANNER, 4260))  # 4915 − 2 / 5 · 1638
        mark = self.rig.states.mark()
        self.hold(self.planner, PlannerState(cause="planner silent", gear="reverse", reason="drive silent for 0.50 s"))
        state = self.rig.wait_for(lambda state: state.cause == "planner silent", mark)
        self.assertEqual((state.source, state.duty, state.reason),
                         (ThrottleState.NEUTRAL, NEUTRAL, "drive silent for 0.50 s"))
        self.hold(self.planner, PlannerState(cause="planner", gear="neutral"))
        state = self.rig.wait_for(lambda state: state.source == ThrottleState.PLANNER)
        self.assertEqual((state.duty, state.reason), (NEUTRAL, "the planner's gear is neutral: the car coasts"))

    def test_planner_that_pauses_and_asks_again_is_awaited_and_no_message_was_dropped(self):
        self.rig.present(speed=0.0)
        self.hold(self.planner, PlannerState(cause="planner", gear="drive"))
        self.rig.plan(2.0)
        self.rig.wait_for(lambda state: state.source == ThrottleState.PLANNER)
        mark = self.rig.states.mark()
        self.hold(self.planner, PlannerState(cause="planner silent", gear="drive", reason="drive silent for 0.50 s"))
        self.rig.drop(self.rig.value)
        self.rig.wait_for(lambda state: state.cause == "planner silent", mark)
        self.hold(self.planner, PlannerState(cause="planner", gear="drive"))
        awaited = self.rig.wait_for(lambda state: state.cause == "command awaited", mark)
        self.assertEqual(awaited.reason, "the planner asks again: its first value is awaited")
        late = self.rig.wait_for(lambda state: state.cause == "command silent", mark)
        self.assertEqual(late.reason, "the planner's value was not heard since the planner paused")
        self.rig.plan(2.0)
        self.rig.wait_for(lambda state: state.source == ThrottleState.PLANNER, mark)


class Tuning(ThrottleTest):
    def test_neutral_is_tuned_live_published_and_saved(self):
        folder = tempfile.mkdtemp()
        self.addCleanup(shutil.rmtree, folder, ignore_errors=True)
        path = os.path.join(folder, "throttle.yaml")
        shutil.copy(os.path.join(rospkg.RosPack().get_path("car_interface"), "config", "throttle.yaml"), path)
        set_params(self, "/tuned", {**config("throttle.yaml"), "save_to": path})
        start_node(self, "throttle_arb", "/servo/cmdVector:=tuned/cmdVector", name="tuned")
        commands = Topic("/tuned/cmdVector", Int32MultiArray).connected()
        commands.wait_for(lambda vector: vector.data[1] == NEUTRAL)
        neutrals = Topic("/servo/neutral", Int32MultiArray)
        self.addCleanup(neutrals.close)
        client = Client("/tuned/servo", timeout=10)
        self.addCleanup(client.close)
        self.assertEqual(client.update_configuration({"neutral": 4935})["neutral"], 4935)
        commands.wait_for(lambda vector: vector.data[1] == 4935)
        neutrals.wait_for(lambda vector: vector.data[1] == 4935)
        answer = rospy.ServiceProxy("/tuned/save", Trigger)()
        self.assertTrue(answer.success, answer.message)
        with open(path, encoding="utf-8") as file:
            saved = yaml.safe_load(file)["servo"]
        self.assertEqual((saved["neutral"], saved["duty_table"]), (4935, [3297, 4935, 6574]))


class ByItself(unittest.TestCase):
    """Nodes that the test starts with parameters of its own."""

    def test_bad_parameters_end_the_node_with_one_line(self):
        cases = [
            ({"servo/channel": 16}, "servo/channel is 16; accepted: an integer from 0 to 15"),
            ({"esc/profile": "hobby"}, "esc/profile is 'hobby'; accepted: one of brake_then_reverse, "),
            ({"human_scal": 0.3}, "unknown parameter human_scal is 0.3; accepted: only "),
        ]
        started = []
        for number, (changes, text) in enumerate(cases):
            name = f"refused_{number}"
            set_params(self, f"/{name}", config("throttle.yaml"))
            set_params(self, f"/{name}", changes)
            self.addCleanup(delete_param, f"/{name}")
            started.append((text, start_node(self, "throttle_arb", name=name)))
        for text, process in started:
            with self.subTest(text):
                self.assertEqual(process.wait_for_exit(), 1)
                lines = process.stderr.since()
                self.assertEqual(len(lines), 1, lines)
                self.assertIn(text, lines[0])

    def test_esc_that_is_driven_gets_neutral_when_the_node_ends(self):
        set_params(self, "/ending/throttle_arb", {**config("throttle.yaml"), "output_required": False})
        process = start_node(self, "throttle_arb", "__ns:=/ending", "/servo/cmdVector:=servo/cmdVector",
                             "/servo/output:=servo/output", "/e_stop:=e_stop",
                             "throttle_arb/input/odometry:=odom", "throttle_arb/input/value:=generic/output/value",
                             *(f"/teleop_logi/{name}:=teleop_logi/{name}"
                               for name in ("human_in_loop", "tele_throt_req", "mode", "scale_button")))
        rig = Rig(self, "/ending/")
        rig.present(teleop=1.0)
        rig.wait_for_duty(BY_HAND)
        self.assertEqual(process.end(signal.SIGTERM), 0)
        self.assertEqual(rig.commands.since()[-1].data[1], NEUTRAL)

    def test_deadman_held_at_the_start_counts_after_it_was_released(self):
        set_params(self, "/late/throttle_arb", config("throttle.yaml"))
        human = rospy.Publisher("/late/teleop_logi/human_in_loop", Bool, queue_size=10)
        ending = threading.Event()
        self.addCleanup(ending.set)

        def repeat():
            while not ending.wait(0.05):
                human.publish(True)
        threading.Thread(target=repeat, daemon=True).start()
        start_node(self, "throttle_arb", "__ns:=/late", "/servo/cmdVector:=servo/cmdVector", "/e_stop:=e_stop",
                   "/teleop_logi/human_in_loop:=teleop_logi/human_in_loop")
        states = Topic("/late/throttle_arb/state", ThrottleState).connected()
        state = states.wait_for(lambda state: state.cause == "not re-armed").what
        self.assertEqual(state.reason, "this node has just started; let go once: publish false, then true")
        state = states.wait_for(lambda state: "to go" not in state.esc_reason).what
        self.assertEqual((state.esc, state.esc_reason),
                         ("ARMING", "this node has just started; let go of the deadman"))


if __name__ == "__main__":
    rospy.init_node("throttle_arb_test")
    rostest.rosrun("car_interface", "throttle_arb_test", "__main__")
