#!/usr/bin/env python3
"""teleop_logi by its topics: started by its launch file, for the gamepad that it ships with."""
from __future__ import annotations

import math
import signal
import time
import unittest

import rosnode
import rospy
import rostest
from car_interface.msg import TeleopState
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rosgraph_msgs.msg import Log
from sensor_msgs.msg import Joy
from std_msgs.msg import Bool, Float32, Int8, String

from waiting import Repeater, Sender, Topic, delete_param, eventually, rate_hz, retried, start_node
from witness import measured

STEER, THROTTLE, MANUAL, AUTONOMOUS = 0, 4, 4, 5  # as config/teleop_logi.yaml has them

REARM = "let go of the deadman, then hold it again"
WRONG_MODE = "the gamepad has 4 axes (0 to 3), but throttle_axis is 4"
MODE_REMEDY = ("Is the gamepad in another mode? A Logitech F710 or F310 needs its switch at X for the shipped indices. "
               "For another gamepad set teleop_logi's indices: rostopic echo /joy")
NEVER_REMEDY = "See whether joy_node runs and finds the gamepad: rostopic info /car7/joy; ls /dev/input/js*"
GIVEN = {"steer_axis": 0, "throttle_axis": 4, "manual_button": 4, "autonomous_button": 5}


def joy(steering=0.0, throttle=0.0, manual=0, autonomous=0, axes=8, buttons=11):
    message = Joy(axes=[0.0] * axes, buttons=[0] * buttons)
    message.axes[STEER] = steering
    if axes > THROTTLE:
        message.axes[THROTTLE] = throttle
    message.buttons[MANUAL] = manual
    if buttons > AUTONOMOUS:
        message.buttons[AUTONOMOUS] = autonomous
    return message


def gamepad_report(reports, name, mark=0):
    """The next report of this name."""
    array = reports.wait_for(lambda array: name in [status.name for status in array.status], mark).what
    return next(status for status in array.status if status.name == name)


class TeleopByItsTopics(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.human = Topic("/teleop_logi/human_in_loop", Bool).connected()
        cls.steering = Topic("/teleop_logi/tele_steer_req", Float32).connected()
        cls.throttle = Topic("/teleop_logi/tele_throt_req", Float32).connected()
        cls.states = Topic("/teleop_logi/state", TeleopState).connected()
        cls.reports = Topic("/diagnostics", DiagnosticArray).connected()
        cls.log = Topic("/rosout", Log).connected()
        cls.joy = Sender("/joy", Joy)

    def setUp(self):
        self.inputs = Repeater()
        self.addCleanup(self.inputs.end)

    def hold(self, **what):
        self.inputs.hold(self.joy, joy(**what))

    def press(self, **what):
        """The same, once all was seen let go: what was lost comes back no other way. The next true is of this press."""
        self.inputs.drop()
        self.joy.publish(joy())
        self.wait_for_human(False)
        self.hold(**what)

    def wait_for_human(self, present):
        return self.human.wait_for(lambda message: message.data is present, self.human.mark())

    def wait_for_requests(self, steering, throttle):
        for topic, value in ((self.steering, steering), (self.throttle, throttle)):
            topic.wait_for(lambda message, value=value: message.data == value, topic.mark())

    def test_everything_comes_at_50_hz_also_without_a_gamepad(self):
        def attempt():
            marks = [topic.mark() for topic in (self.human, self.steering, self.throttle)]
            self.assertAlmostEqual(rate_hz(self.human, over_s=1.0), 50, delta=2)
            counts = [topic.mark() - mark for topic, mark in zip((self.human, self.steering, self.throttle), marks)]
            self.assertLessEqual(max(counts) - min(counts), 2, counts)
        retried(attempt)

    def test_manual_deadman_passes_the_sticks_on_both_ways(self):
        for steering, throttle in ((1.0, 0.5), (-1.0, -0.5), (0.25, 0.0)):
            self.press(steering=steering, throttle=throttle, manual=1)
            self.wait_for_human(True)
            self.wait_for_requests(steering, throttle)

    def test_autonomous_deadman_alone_keeps_the_sticks_neutral(self):
        self.press(steering=1.0, throttle=1.0, autonomous=1)
        self.wait_for_human(True)
        self.wait_for_requests(0.0, 0.0)

    def test_mode_and_the_buttons_of_the_scale_are_published(self):
        modes = Topic("/teleop_logi/mode", String).connected()
        buttons = Topic("/teleop_logi/scale_button", Int8).connected()
        for topic in (modes, buttons):
            self.addCleanup(topic.close)
        for held in ("autonomous", "manual"):
            self.press(**{held: 1})
            modes.wait_for(lambda message, held=held: message.data == held, modes.mark())
        for button, value in ((3, 1), (0, -1)):  # Y and A
            message = joy()
            message.buttons[button] = 1
            self.inputs.hold(self.joy, message)
            buttons.wait_for(lambda message, value=value: message.data == value, buttons.mark())
        self.hold()
        buttons.wait_for(lambda message: message.data == 0, buttons.mark())

    def test_both_deadmen_mean_that_the_human_steers(self):
        self.press(steering=-0.5, manual=1, autonomous=1)
        self.wait_for_human(True)
        self.wait_for_requests(-0.5, 0.0)

    def test_letting_go_is_told_with_the_message_that_says_so_however_short_it_is(self):
        def attempt():
            self.press(manual=1)
            self.wait_for_human(True)
            self.inputs.drop()
            mark = self.human.mark()
            for pressed in (1, 0, 1):
                self.joy.publish(joy(manual=pressed))
            released = self.human.wait_for(lambda message: not message.data, mark)
            pressed_again = self.human.wait_for(lambda message: message.data, mark + self.place_of(released, mark))
            self.assertLess(pressed_again.at_s - released.at_s, 0.25)  # the timeout has no part in it
        measured(attempt)

    def place_of(self, heard, mark):
        return self.human.heard_since(mark).index(heard)

    def test_a_gamepad_that_falls_silent_releases_after_a_quarter_of_a_second(self):
        def attempt():
            self.press(steering=1.0, manual=1)
            self.wait_for_human(True)
            self.press()
            mark = self.human.mark()
            self.inputs.drop()
            self.joy.publish(joy(steering=1.0, manual=1))
            held = self.human.wait_for(lambda message: message.data, mark)
            released = self.human.wait_for(lambda message: not message.data, mark + self.place_of(held, mark))
            self.assertAlmostEqual(released.at_s - held.at_s, 0.25, delta=0.06)
        measured(attempt)
        self.wait_for_requests(0.0, 0.0)

    def test_a_gamepad_that_was_silent_has_to_be_let_go_and_held_again(self):
        self.press(manual=1)
        self.wait_for_human(True)
        self.inputs.drop()
        self.wait_for_human(False)
        mark = self.human.mark()
        self.hold(manual=1)
        self.assertEqual({message.data for message in self.human.wait_for_count(20, mark)}, {False})
        self.press(manual=1)
        self.wait_for_human(True)

    def test_a_gamepad_that_lacks_an_axis_or_a_button_has_no_deadman(self):
        for lacking in ({"axes": 4}, {"buttons": 5}):
            with self.subTest(lacking):
                self.press(manual=1)
                self.wait_for_human(True)
                self.hold(manual=1, **lacking)
                self.wait_for_human(False)

    def test_an_axis_that_is_no_number_releases(self):
        for number in (math.nan, math.inf):
            self.press(manual=1)
            self.wait_for_human(True)
            self.hold(steering=number, manual=1)
            self.wait_for_human(False)
            self.wait_for_requests(0.0, 0.0)


    # --- what is wrong is said ---

    def wait_for_cause(self, cause, mark):
        return self.states.wait_for(lambda state: state.cause == cause, mark).what

    def report(self):
        """The next report of the gamepad on /diagnostics."""
        return gamepad_report(self.reports, "teleop_logi: gamepad", self.reports.mark())

    def drive(self):
        """Hold the manual deadman; where the log goes on after the line that says so."""
        mark = self.log.mark()
        self.press(manual=1)
        self.wait_for_human(True)
        driving = self.log.wait_for(lambda line: line.msg == "human in loop: True (manual deadman held)", mark)
        return mark + self.log.heard_since(mark).index(driving) + 1

    def lines(self, mark, count):
        """Level and text of this node's log lines from a place on, as soon as there are so many; no more come."""
        def ours():
            return [(line.level, line.msg) for line in self.log.since(mark) if line.name == "/teleop_logi"]
        eventually(lambda: len(ours()) >= count, f"{count} log lines")
        self.states.wait_for_count(5, self.states.mark())  # half a second, for more to come
        self.assertEqual(len(ours()), count, ours())
        return ours()

    def test_gamepad_in_the_wrong_mode_is_named_in_state_log_and_diagnostics(self):
        log, states = self.drive(), self.states.mark()
        self.hold(manual=1, axes=4)
        state = self.wait_for_cause("joy incomplete", states)
        self.assertEqual((state.human_in_loop, state.reason), (False, WRONG_MODE))
        self.assertLess(state.joy_age, 1.0)
        report = self.report()
        self.assertEqual((report.level, report.message), (DiagnosticStatus.ERROR, f"{WRONG_MODE}. {MODE_REMEDY}"))
        values = {pair.key: pair.value for pair in report.values}
        self.assertEqual((values["cause"], values["axes, buttons"]), ("joy incomplete", "4, 11"))
        self.assertEqual(self.lines(log, 1), [(Log.WARN, f"human in loop: False ({WRONG_MODE}). {MODE_REMEDY}")])

    def test_axis_that_is_no_number_is_named_in_state_log_and_diagnostics(self):
        log, states = self.drive(), self.states.mark()
        self.hold(throttle=math.nan, manual=1)
        reason = "the gamepad's throttle_axis 4 is nan, no number to act on"
        remedy = "See what sends it: rostopic info /joy; rostopic echo /joy"
        self.assertEqual(self.wait_for_cause("joy not finite", states).reason, reason)
        report = self.report()
        self.assertEqual((report.level, report.message), (DiagnosticStatus.ERROR, f"{reason}. {remedy}"))
        self.assertEqual(self.lines(log, 1), [(Log.WARN, f"human in loop: False ({reason}). {remedy}")])

    def test_silence_of_0_27_s_with_the_button_held_on_is_named_once(self):
        def attempt():
            log, states = self.drive(), self.states.mark()
            self.inputs.drop()
            self.joy.publish(joy(manual=1))
            time.sleep(0.27)  # what is tested
            self.hold(manual=1)
            self.assertRegex(self.wait_for_cause("joy silent", states).reason, r"^joy silent for 0\.2[5-8] s$")
            state = self.wait_for_cause("not re-armed", states)
            self.assertEqual(state.reason, f"the gamepad was silent; {REARM}")
            report = self.report()
            self.assertEqual((report.level, report.message),
                             (DiagnosticStatus.WARN, f"the gamepad was silent; {REARM}"))
            (first, silent), second = self.lines(log, 2)
            self.assertEqual(first, Log.WARN)
            self.assertRegex(silent, r"^human in loop: False \(joy silent for 0\.2\d s\)\. See whether the gamepad is "
                                     "on, charged and in range and joy_node runs: rostopic hz /joy$")
            self.assertEqual(second, (Log.WARN, f"human in loop: False (the gamepad was silent; {REARM})"))
        measured(attempt)

    def test_state_comes_10_times_a_second_is_latched_and_ok_at_rest(self):
        def attempt():
            self.assertAlmostEqual(rate_hz(self.states, over_s=1.0), 10, delta=1)
        self.hold()
        retried(attempt)
        late = Topic("/teleop_logi/state", TeleopState)
        self.addCleanup(late.close)
        state = late.wait_for(lambda _: True).what
        self.assertEqual(state._connection_header["latching"], "1")
        self.assertEqual((state.cause, state.reason), ("no deadman", "no deadman is held"))
        self.assertAlmostEqual(state.stamp.to_sec(), time.time(), delta=5)
        report = self.report()
        self.assertEqual((report.level, report.message), (DiagnosticStatus.OK, "no deadman is held"))

    def test_deadmen_are_named_when_they_change(self):
        log = self.drive()
        self.hold(autonomous=1)
        self.log.wait_for(lambda line: line.msg == "human in loop: True (autonomous deadman held)", log)
        self.hold()
        self.log.wait_for(lambda line: line.msg == "human in loop: False (no deadman is held)"
                          and line.level == Log.INFO, log)


class TeleopByItself(unittest.TestCase):
    def test_gamepad_without_a_throttle_axis_leaves_it_to_the_planner_and_steers_before_it(self):
        name = "without_throttle"
        parameters = [f"_{key}:={value}" for key, value in {**GIVEN, "throttle_axis": -1}.items()]
        topics = {key: f"/{name}/{key}" for key in ("human_in_loop", "tele_steer_req", "tele_throt_req", "mode")}
        start_node(self, "teleop_logi", *parameters, f"joy:=/{name}/joy",
                   *(f"/teleop_logi/{key}:={topic}" for key, topic in topics.items()), name=name)
        self.addCleanup(delete_param, f"/{name}")
        steering, throttle = Topic(topics["tele_steer_req"], Float32), Topic(topics["tele_throt_req"], Float32)
        human = Topic(topics["human_in_loop"], Bool)
        inputs = Repeater()
        for clean_up in (steering.close, throttle.close, human.close, inputs.end):
            self.addCleanup(clean_up)
        gamepad = Sender(f"/{name}/joy", Joy)

        def attempt():
            inputs.hold(gamepad, joy(throttle=1.0))
            human.wait_for(lambda message: not message.data, human.mark())
            inputs.hold(gamepad, joy(throttle=1.0, autonomous=1))
            human.wait_for(lambda message: message.data, human.mark(), 5)
            inputs.hold(gamepad, joy(steering=-0.5, throttle=-1.0, autonomous=1))
            mark = throttle.mark()
            steering.wait_for(lambda message: message.data == -0.5, steering.mark(), 5)
            self.assertEqual({message.data for message in throttle.wait_for_count(10, mark)}, {0.0})
            inputs.hold(gamepad, joy(throttle=1.0, manual=1))
            throttle.wait_for(lambda message: math.isnan(message.data), mark, 5)
        retried(attempt)  # a busy machine falls silent by itself

    def test_a_deadman_that_is_held_at_its_start_counts_once_it_was_let_go(self):
        """One that was started anew while the deadman is held must not have the car drive on."""
        human = Topic("/anew/human", Bool)
        inputs = Repeater()
        self.addCleanup(inputs.end)
        parameters = [f"_{key}:={value}" for key, value in GIVEN.items()]
        process = start_node(self, "teleop_logi", *parameters, "joy:=/anew/joy",
                             "/teleop_logi/human_in_loop:=/anew/human", "/teleop_logi/tele_steer_req:=/anew/steer",
                             "/teleop_logi/tele_throt_req:=/anew/throttle", name="anew")
        for key in GIVEN:
            self.addCleanup(delete_param, f"/anew/{key}")
        gamepad = Sender("/anew/joy", Joy)
        inputs.hold(gamepad, joy(manual=1))
        process.wait_for_line(r"WARN.*human in loop: False \(this node has just started; let go of the deadman, then "
                              r"hold it again\)")
        human.wait_for_count(20, human.mark())
        self.assertEqual({message.data for message in human.since()}, {False})
        inputs.hold(gamepad, joy())
        inputs.hold(gamepad, joy(manual=1))
        human.wait_for(lambda message: message.data)
        self.assertEqual(process.end(), 0)

    def test_gamepad_that_was_never_heard_is_a_warning_with_the_remedy_in_its_namespace(self):
        for key, value in GIVEN.items():
            rospy.set_param(f"/car7/teleop_logi/{key}", value)
        self.addCleanup(delete_param, "/car7/teleop_logi")
        states = Topic("/car7/teleop_logi/state", TeleopState)
        reports = Topic("/diagnostics", DiagnosticArray)
        self.addCleanup(states.close)
        self.addCleanup(reports.close)
        process = start_node(self, "teleop_logi", "__ns:=/car7", name="teleop_logi")
        state = states.wait_for(lambda _: True).what
        self.assertEqual((state.human_in_loop, state.cause, state.reason, state.joy_age),
                         (False, "joy never heard", "joy was never heard", math.inf))
        report = gamepad_report(reports, "car7/teleop_logi: gamepad")
        self.assertEqual((report.level, report.message), (
            DiagnosticStatus.WARN, f"joy was never heard. {NEVER_REMEDY}"))
        self.assertEqual(process.end(), 0)

    def test_each_index_is_required_and_named(self):
        started = []
        for missing in GIVEN:
            name = f"teleop_without_{missing}"
            self.addCleanup(delete_param, f"/{name}")
            arguments = [f"_{key}:={value}" for key, value in GIVEN.items() if key != missing]
            started.append((missing, start_node(self, "teleop_logi", *arguments, name=name)))
        for missing, process in started:
            with self.subTest(missing):
                self.assertEqual(process.wait_for_exit(), 1)
                lines = process.stderr.since()
                self.assertEqual(len(lines), 1, lines)
                lowest = -1 if missing == "throttle_axis" else 0  # a gamepad may have none
                self.assertIn(f"{missing} is missing; accepted: an integer from {lowest} to 63", lines[0])

    def test_a_node_that_is_killed_by_rosnode_leaves_nothing_on_the_master(self):
        for attempt in range(5):
            name = f"killed_{attempt}"
            self.addCleanup(delete_param, f"/{name}")
            process = start_node(self, "teleop_logi", "_steer_axis:=0", "_throttle_axis:=1", "_manual_button:=0",
                                 "_autonomous_button:=1", name=name)
            process.wait_for_info("human in loop: False")
            rosnode.kill_nodes([f"/{name}"])
            self.assertEqual(process.wait_for_exit(), 0)
            self.assertNotIn(f"/{name}", rosnode.get_node_names())

    def test_a_deadman_that_is_held_is_let_go_when_the_node_ends(self):
        name = "teleop_that_ends"
        process = start_node(self, "teleop_logi", "_steer_axis:=0", "_throttle_axis:=1", "_manual_button:=0",
                             "_autonomous_button:=1", "joy:=ending/joy", "/teleop_logi/human_in_loop:=ending/human",
                             name=name)
        self.addCleanup(delete_param, f"/{name}")
        human = Topic("/ending/human", Bool)
        inputs = Repeater()
        self.addCleanup(inputs.end)
        gamepad = Sender("/ending/joy", Joy)
        gamepad.publish(Joy(axes=[0.0, 0.0], buttons=[0, 0]))
        inputs.hold(gamepad, Joy(axes=[0.0, 0.0], buttons=[1, 0]))
        human.wait_for(lambda message: message.data)
        self.assertEqual(process.end(signal.SIGTERM), 0)
        self.assertIs(human.since()[-1].data, False)


if __name__ == "__main__":
    rospy.init_node("teleop_logi_test")
    rostest.rosrun("car_interface", "teleop_logi_test", "__main__")
