#!/usr/bin/env python3
"""A person's hands on the gamepad of a virtual car that a planner drives: who has which actuator, and what it does."""
from __future__ import annotations

import re
import threading
import time
import unittest

import rospy
import rostest
from car_interface.msg import SteeringState, TeleopState, ThrottleState
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Log
from sensor_msgs.msg import Joy
from std_msgs.msg import Float32

from waiting import Repeater, Sender, Topic, eventually, retried

MANUAL, AUTONOMOUS, THIRD = 4, 5, 2  # buttons, as config/teleop_logi.yaml and human_first.test have them
SPEED_MPS, RADIUS_M = 1.5, 5.0
READY_S = 60
HOLD_S = 0.5
LATE_S = 0.5  # a busy machine's
NOISE_MPS = 0.02


class Hands:
    """Two sticks and the buttons, at 50 Hz; ``play`` moves the sticks message by message."""

    def __init__(self):
        self._joy = Sender("/joy", Joy)
        self._state = ((), 0.0, 0.0, 8, 11)
        self._script, self._played = [], threading.Event()
        self._is_silent = False
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def hold(self, *buttons, steering=0.0, throttle=0.0, axes=8, button_count=11):
        self._state = (buttons, steering, throttle, axes, button_count)

    def play(self, *throttles):
        """Give the throttle's stick a value for each message; the last one stays."""
        self._played.clear()
        self._script = list(throttles)
        assert self._played.wait(30)

    def be_silent(self, is_silent):
        self._is_silent = is_silent

    def end(self):
        self._ending.set()
        self._thread.join()

    def _run(self):
        while not self._ending.wait(0.02):
            if self._script:
                self._state = (*self._state[:2], self._script.pop(0), *self._state[3:])
                if not self._script:
                    self._played.set()
            if self._is_silent:
                continue
            buttons, steering, throttle, axes, count = self._state
            message = Joy(axes=[0.0] * axes, buttons=[int(index in buttons) for index in range(count)])
            message.axes[0], message.axes[4] = steering, throttle
            self._joy.publish(message)


class HumanFirst(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.truth = Topic("/car_sim/truth", Odometry)
        cls.steering = Topic("/turn_arb/state", SteeringState)
        cls.throttle = Topic("/throttle_arb/state", ThrottleState)
        cls.teleop = Topic("/teleop_logi/state", TeleopState)
        cls.sent = Topic("/teleop_logi/tele_throt_req", Float32)
        cls.log = Topic("/rosout", Log)
        cls.reports = Topic("/diagnostics", DiagnosticArray)
        for topic in (cls.truth, cls.steering, cls.throttle, cls.teleop):
            topic.wait_for(lambda _: True, 0, READY_S)
        cls.planner = Repeater()
        cls.radius, cls.speed = Sender("/av_turnrad_req", Float32), Sender("/av_speed_req", Float32)
        cls.hands = Hands()
        cls.throttle.wait_for(lambda state: state.cause == "human absent" and state.esc != "ARMING", 0, READY_S)

    @classmethod
    def tearDownClass(cls):
        cls.hands.end()
        cls.planner.end()

    def setUp(self):
        self.hands.be_silent(False)
        self.hands.hold()
        self.ask(0.0)
        self.stands()
        self.wait(self.teleop, lambda state: state.cause == "no deadman"
                  and (state.steering_stick, state.throttle_stick) == ("", ""))
        self.addCleanup(self.hands.hold)

    def ask(self, speed_mps):
        """Have the planner drive on a circle to the left."""
        self.planner.hold(self.radius, Float32(RADIUS_M))
        self.planner.hold(self.speed, Float32(speed_mps))

    @staticmethod
    def wait(topic, wanted):
        """The first from now on."""
        return topic.wait_for(wanted, topic.mark())

    def stands(self):
        self.wait(self.truth, lambda message: message.twist.twist.linear.x == 0.0)

    def press(self, *buttons, **sticks):
        """Hold deadmen until all nodes obey; again when the busy machine was silent and they must be let go once."""
        def attempt():
            self.hands.hold(**sticks)
            self.wait(self.throttle, lambda state: state.cause == "human absent")
            self.hands.hold(*buttons, **sticks)
            self.throttle.wait_for(lambda state: state.source >= ThrottleState.NEUTRAL and state.cause != "steering "
                                   "stopped", self.throttle.mark(), 5)
        retried(attempt)

    def drive(self, button=AUTONOMOUS):
        """Let the planner drive, until it does."""
        self.ask(SPEED_MPS)
        self.press(button)
        self.wait(self.truth, lambda message: message.twist.twist.linear.x > 0.9 * SPEED_MPS)
        self.wait(self.throttle, lambda state: state.source == ThrottleState.PLANNER)

    def sources(self, topic, mark):
        return {state.source for state in topic.since(mark)}

    def wait_for_log(self, node, pattern, mark):
        return self.log.wait_for(lambda line: line.name == node and re.search(pattern, line.msg), mark).what

    # --- the throttle ---

    def test_pull_brakes_under_each_planner_s_deadman_and_the_planner_gets_it_back(self):
        for button in (AUTONOMOUS, THIRD):  # the third one: the human steers
            with self.subTest(button):
                self.setUp()
                self.drive(button)
                log, truth = self.log.mark(), self.truth.mark()
                pulled_s = time.monotonic()
                self.hands.hold(button, throttle=-1.0)
                state = self.wait(self.throttle, lambda state: state.esc == "BRAKING")
                self.assertEqual((state.what.source, state.what.cause, state.what.asked),
                                 (ThrottleState.TELEOP, "override", -1.0))
                self.stands()
                print(f"full brake under button {button}: {state.at_s - pulled_s:.2f} s to the ESC, it stands after "
                      f"{time.monotonic() - pulled_s:.2f} s")
                self.wait_for_log("/teleop_logi", r"the throttle stick overrides the planner by -1\.00", log)
                self.wait_for_log("/throttle_arb", r"^TELEOP: tele_throt_req is -1\.000, .*it overrides the planner",
                                  log)
                centered_s = time.monotonic()
                self.hands.hold(button)
                back = self.wait(self.throttle, lambda state: state.source == ThrottleState.PLANNER)
                self.assertGreater(back.at_s - centered_s, HOLD_S - 0.05)
                self.wait(self.truth, lambda message: message.twist.twist.linear.x > 0.5)
                self.assertGreater(min(message.twist.twist.linear.x for message in self.truth.since(truth)),
                                   -NOISE_MPS)

    def test_pull_never_becomes_reverse_however_often_and_by_hand_it_does(self):
        self.press(AUTONOMOUS)
        truth, throttle = self.truth.mark(), self.throttle.mark()
        for repeat in (3, 10, 40):  # messages, of 20 ms
            self.hands.play(*([-1.0] * repeat + [0.0] * repeat) * 3)
        self.hands.hold(AUTONOMOUS, throttle=-1.0)
        self.throttle.wait_for_count(20, self.throttle.mark())
        self.assertEqual({message.twist.twist.linear.x for message in self.truth.since(truth)}, {0.0})
        self.assertNotIn("REVERSE", {state.esc for state in self.throttle.since(throttle)})
        self.assertIn("override", {state.cause for state in self.throttle.since(throttle)})
        # The human takes over while the stick is pulled: nothing before it was centered and pulled twice.
        self.hands.hold(AUTONOMOUS, MANUAL, throttle=-1.0)
        self.wait(self.throttle, lambda state: state.mode == "manual")
        self.throttle.wait_for_count(20, self.throttle.mark())
        self.hands.hold(MANUAL)
        self.wait(self.throttle, lambda state: state.asked == 0.0)
        self.hands.hold(MANUAL, throttle=-1.0)
        self.wait(self.throttle, lambda state: state.asked < -0.9)
        self.assertNotIn("REVERSE", {state.esc for state in self.throttle.since(throttle)})
        self.hands.hold(MANUAL)
        self.wait(self.throttle, lambda state: state.asked == 0.0)
        self.hands.hold(MANUAL, throttle=-1.0)
        self.wait(self.truth, lambda message: message.twist.twist.linear.x < -0.3)
        # And back, while it rolls backward: a pull brakes, and no more.
        self.hands.hold(AUTONOMOUS, throttle=-1.0)
        self.wait(self.throttle, lambda state: state.mode == "autonomous" and state.cause == "override")
        self.stands()

    def test_push_drives_and_a_pull_stops_a_planner_that_reverses(self):
        self.ask(-2.5)
        self.press(AUTONOMOUS)
        self.wait(self.truth, lambda message: message.twist.twist.linear.x < -2.2)
        self.hands.hold(AUTONOMOUS, throttle=-1.0)
        self.wait(self.throttle, lambda state: state.cause == "override" and state.esc == "BRAKING")
        braking = self.truth.mark()
        self.stands()
        speeds = [message.twist.twist.linear.x for message in self.truth.since(braking)]
        self.assertGreater(min(after - before for before, after in zip(speeds, speeds[10:])), -NOISE_MPS)
        self.hands.hold(AUTONOMOUS, throttle=0.8)
        self.wait(self.truth, lambda message: message.twist.twist.linear.x > 0.3)

    def test_push_that_is_centered_and_trembles_at_the_edge_keeps_the_throttle(self):
        self.drive()
        self.hands.hold(AUTONOMOUS, throttle=0.4)
        self.wait(self.throttle, lambda state: state.cause == "override")
        throttle, teleop = self.throttle.mark(), self.teleop.mark()
        self.hands.play(*[0.09, 0.11] * 50, *([0.09] * 10 + [0.11] * 10) * 5)
        self.assertEqual(self.sources(self.throttle, throttle), {ThrottleState.TELEOP})
        self.assertEqual({state.throttle_stick for state in self.teleop.since(teleop)}, {"override"})
        self.hands.hold(AUTONOMOUS)
        self.wait(self.throttle, lambda state: state.source == ThrottleState.PLANNER)

    # --- the steering ---

    def test_stick_steers_while_the_planner_drives_on_and_half_a_second_longer(self):
        self.drive()
        self.wait(self.steering, lambda state: state.source == SteeringState.PLANNER)
        throttle, log = self.throttle.mark(), self.log.mark()
        self.hands.hold(AUTONOMOUS, steering=-0.8)
        state = self.wait(self.steering, lambda state: state.source == SteeringState.TELEOP and state.turn_radius < 0)
        self.wait(self.steering, lambda state: state.reason == "tele_steer_req is -0.800: it overrides the planner")
        self.wait_for_log("/teleop_logi", r"the steering stick overrides the planner by -0\.80", log)
        self.assertGreater(state.what.duty, 5500)
        centered_s = time.monotonic()
        self.hands.hold(AUTONOMOUS)
        back = self.wait(self.steering, lambda state: state.source == SteeringState.PLANNER)
        self.assertGreater(back.at_s - centered_s, HOLD_S - 0.05)
        self.assertLess(back.at_s - centered_s, HOLD_S + LATE_S)
        self.assertEqual(self.sources(self.throttle, throttle), {ThrottleState.PLANNER})

    def test_sticks_that_drift_override_nothing(self):
        self.drive()
        for drift in (0.03, -0.05, 0.07, 0.09, -0.09):
            self.hands.hold(AUTONOMOUS, steering=drift, throttle=drift)
            self.teleop.wait_for_count(3, self.teleop.mark())
            steering, throttle = self.steering.mark(), self.throttle.mark()
            self.throttle.wait_for_count(10, throttle)
            self.assertEqual(self.sources(self.steering, steering), {SteeringState.PLANNER}, drift)
            self.assertEqual(self.sources(self.throttle, throttle), {ThrottleState.PLANNER}, drift)

    # --- two deadmen, and sticks that were held before ---

    def test_with_both_buttons_the_human_has_both_and_letting_one_go_hands_over_at_once(self):
        self.drive()
        self.hands.hold(AUTONOMOUS, MANUAL, steering=0.6, throttle=0.5)
        self.wait(self.throttle, lambda state: state.source == ThrottleState.TELEOP and state.cause == "teleop")
        self.wait(self.steering, lambda state: state.source == SteeringState.TELEOP)
        self.hands.hold(AUTONOMOUS, steering=0.6, throttle=0.5)
        state = self.wait(self.teleop, lambda state: state.cause == "autonomous").what
        self.assertEqual((state.steering_stick, state.throttle_stick), ("off center", "off center"))
        self.wait(self.throttle, lambda state: state.source == ThrottleState.PLANNER)
        self.wait(self.steering, lambda state: state.source == SteeringState.PLANNER)
        self.hands.hold(AUTONOMOUS, throttle=-0.7)  # straight to a pull
        self.wait(self.throttle, lambda state: state.cause == "override" and state.asked < -0.5)
        self.hands.hold(AUTONOMOUS, MANUAL, throttle=-0.7)
        self.wait(self.throttle, lambda state: state.cause == "teleop" and state.asked < -0.5)

    def test_sticks_that_were_held_at_the_press_override_nothing_but_by_a_pull_until_centered(self):
        self.ask(SPEED_MPS)
        log = self.log.mark()
        self.press(AUTONOMOUS, steering=0.7, throttle=0.9)
        self.wait(self.truth, lambda message: message.twist.twist.linear.x > 0.9 * SPEED_MPS)
        self.assertEqual(self.throttle.since()[-1].source, ThrottleState.PLANNER)
        self.assertEqual(self.steering.since()[-1].source, SteeringState.PLANNER)
        self.wait_for_log("/teleop_logi", "the throttle stick, at 0.90, was off its center when the deadman was", log)
        self.hands.hold(AUTONOMOUS)
        self.wait(self.teleop, lambda state: (state.steering_stick, state.throttle_stick) == ("", ""))
        self.hands.hold(AUTONOMOUS, throttle=0.9)
        self.wait(self.throttle, lambda state: state.cause == "override" and state.asked > 0.5)
        self.press(AUTONOMOUS, throttle=-0.9)
        self.wait(self.throttle, lambda state: state.cause == "override" and state.asked < -0.5)
        self.stands()

    # --- what is no stick ---

    def come_back(self, *buttons, **sticks):
        """A gamepad that was away: nothing is known of its axes."""
        self.hands.be_silent(True)
        self.wait(self.teleop, lambda state: state.cause == "joy silent")
        self.hands.hold(*buttons, **sticks)
        self.hands.be_silent(False)
        self.wait(self.teleop, lambda state: state.cause == "no deadman")

    def test_trigger_in_the_place_of_the_throttle_s_stick_never_drives(self):
        self.ask(SPEED_MPS)
        self.come_back(throttle=1.0)
        truth, throttle, log = self.truth.mark(), self.throttle.mark(), self.log.mark()
        self.press(MANUAL, throttle=1.0)
        state = self.wait(self.throttle, lambda state: state.cause == "teleop not finite").what
        self.assertRegex(state.reason, r"^tele_throt_req is nan, no number to act on: manual deadman held; the "
                                       r"gamepad's throttle_axis 4 is 1\.00 and was not seen at its rest: it doesn't "
                                       "count$")
        self.hands.play(0.5, 0.0, -0.5, -1.0, -0.5, 0.0, 0.5, 1.0)  # pressed, and let go
        self.throttle.wait_for_count(10, self.throttle.mark())
        self.assertEqual({message.twist.twist.linear.x for message in self.truth.since(truth)}, {0.0})
        self.assertNotIn(ThrottleState.TELEOP, self.sources(self.throttle, throttle))
        line = self.wait_for_log("/teleop_logi", "throttle_axis 4 is 1.00 and was not seen at its rest", log)
        self.assertEqual(line.level, Log.WARN)
        self.assertIn("Let go of the stick. If the axis stays where it is, it is a trigger", line.msg)
        report = self.wait(self.reports, lambda array: "teleop_logi: gamepad" in [
            status.name for status in array.status]).what
        status = next(status for status in report.status if status.name == "teleop_logi: gamepad")
        self.assertEqual(status.level, DiagnosticStatus.WARN)
        self.assertIn("not seen at its rest", status.message)
        self.press(AUTONOMOUS, throttle=1.0)
        self.wait(self.truth, lambda message: message.twist.twist.linear.x > 0.9 * SPEED_MPS)
        self.assertEqual(self.throttle.since()[-1].source, ThrottleState.PLANNER)

    def test_trigger_that_rests_at_the_brake_s_end_brakes_and_never_reverses(self):
        self.ask(SPEED_MPS)
        self.come_back(throttle=-1.0)
        truth = self.truth.mark()
        self.press(AUTONOMOUS, throttle=-1.0)
        self.wait(self.throttle, lambda state: state.cause == "override")
        for _ in range(3):
            self.hands.play(*[-0.5, 0.0, 0.5, 1.0, 0.5, 0.0, -0.5, -1.0])
        self.throttle.wait_for_count(10, self.throttle.mark())
        self.assertEqual(self.teleop.since()[-1].throttle_stick, "not at rest")
        self.assertGreater(min(message.twist.twist.linear.x for message in self.truth.since(truth)), -NOISE_MPS)

    def test_cross_of_a_gamepad_in_d_mode_drives_nothing_by_hand(self):
        self.come_back(axes=6, button_count=12)
        self.press(MANUAL, axes=6, button_count=12)
        truth = self.truth.mark()
        for cross in (1.0, 0.0, -1.0, 0.0, -1.0):
            self.hands.hold(MANUAL, throttle=cross, axes=6, button_count=12)
            self.throttle.wait_for_count(5, self.throttle.mark())
        self.assertEqual({message.twist.twist.linear.x for message in self.truth.since(truth)}, {0.0})
        state = self.teleop.since()[-1]
        self.assertIn("throttle_axis 4 is where a gamepad with 6 axes and 12 buttons has its cross", state.reason)
        self.hands.hold()
        eventually(lambda: not self.teleop.since()[-1].throttle_stick, "the stick of mode X")


if __name__ == "__main__":
    rospy.init_node("human_first_test")
    rostest.rosrun("car_interface", "human_first_test", "__main__")
