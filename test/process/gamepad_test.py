#!/usr/bin/env python3
"""A gamepad that fails while somebody drives: what turn_arb, the doctor and the report say about it, word for word."""
from __future__ import annotations

import math
import os
import re
import shutil
import subprocess
import tempfile
import time
import unittest
from html import unescape
from typing import NamedTuple
from xmlrpc.client import ServerProxy

import rosgraph
import rosnode
import rospy
import rostest
from car_interface.msg import SteeringState, TeleopState
from roslib.packages import find_node
from sensor_msgs.msg import Joy
from std_msgs.msg import Bool

from waiting import Repeater, Sender, Topic, eventually, executable, retried, start

REARM = "the gamepad was silent; let go of the deadman, then hold it again"
MODE_REMEDY = ("Is the gamepad in another mode? A Logitech F710 or F310 needs its switch at X for the shipped indices. "
               "For another gamepad set teleop_logi's indices: rostopic echo {joy}")


class Told(NamedTuple):
    """What the owner reads about one fault."""

    reason: str  # turn_arb's, and the report's for that time; a pattern
    doctor: str  # one line
    report: str  # in the summary
    faults: list  # the patterns of the report's table, in order


WRONG_MODE = Told(
    r"human_in_loop is false: the gamepad has 4 axes \(0 to 3\), but throttle_axis is 4",
    "bad   gamepad     the gamepad has 4 axes (0 to 3), but throttle_axis is 4 | remedy: "
    + MODE_REMEDY.format(joy="/joy"),
    "The car was stopped once because something was lost or locked: joy incomplete.",
    [r"error teleop_logi the gamepad has 4 axes \(0 to 3\), but throttle_axis is 4"])
NOT_A_NUMBER = Told(
    "human_in_loop is false: the gamepad's throttle_axis 4 is nan, no number to act on",
    "bad   gamepad     the gamepad's throttle_axis 4 is nan, no number to act on | remedy: See what sends it: "
    "rostopic info /joy; rostopic echo /joy",
    "The car was stopped once because something was lost or locked: joy not finite.",
    ["error teleop_logi the gamepad's throttle_axis 4 is nan, no number to act on"])
SILENT = Told(
    f"human_in_loop is false: {REARM}",
    f"warn  gamepad     {REARM} | remedy: Let go of both deadman buttons once, then hold one",
    "The car was stopped once because something was lost or locked: joy silent.",
    [r"warning teleop_logi joy silent for 0\.\d\d s", f"warning teleop_logi {REARM}"])


def joy(manual=0, axes=8, throttle=0.0):
    message = Joy(axes=[0.0] * axes, buttons=[0] * 11)
    message.buttons[4] = manual
    if axes > 4:
        message.axes[4] = throttle
    return message


def output_of(*command):
    """What a program prints, whatever its exit code."""
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert not done.stderr, done.stderr
    return done.stdout


class GamepadFails(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.states = Topic("/turn_arb/state", SteeringState).connected()
        cls.gamepad = Sender("/joy", Joy)
        cls.e_stop = Sender("/e_stop", Bool)

    def setUp(self):
        self.inputs = Repeater()
        self.addCleanup(self.inputs.end)
        self.folder = tempfile.mkdtemp()
        self.addCleanup(shutil.rmtree, self.folder)
        self.inputs.hold(self.e_stop, False)

    def wait_for(self, source, reason=".*"):
        return self.states.wait_for(lambda state: state.source == source and re.fullmatch(reason, state.reason),
                                    self.states.mark())

    def drive(self):
        """Release, then hold the manual deadman."""
        self.inputs.hold(self.gamepad, joy())
        self.wait_for(SteeringState.NO_HUMAN, "human_in_loop is false: no deadman is held")
        self.inputs.hold(self.gamepad, joy(manual=1))
        self.wait_for(SteeringState.TELEOP)

    def record(self):
        """Record the arbiters' states until the returned function is called; it returns the path."""
        path, name = os.path.join(self.folder, "drive.bag"), f"recorder_{time.monotonic_ns()}"
        recorder = start(self, find_node("rosbag", "record")[0], "-q", "-O", path, "/turn_arb/state",
                         "/teleop_logi/state", "/diagnostics", "/rosout", f"__name:={name}")

        def connections():
            """The topics that the recorder receives, as it says itself; none before it is there."""
            try:
                uri = rosnode.get_api_uri(rosgraph.Master(rospy.get_name()), f"/{name}", skip_cache=True)
                if not uri:
                    return set()
                _, _, infos = ServerProxy(uri).getBusInfo(rospy.get_name())
            except (OSError, rosnode.ROSNodeException):
                return set()
            return {info[4] for info in infos if info[5]}
        eventually(lambda: {"/turn_arb/state", "/teleop_logi/state"} <= connections(), "the recorder's connections")
        self.states.wait_for_count(5, self.states.mark())

        def stop():
            recorder.end()
            eventually(lambda: os.path.exists(path), "the bag")
            return path
        return stop

    def report_on(self, bag):
        """The report's verdict, and the rows of its table of faults that these two nodes have."""
        page = output_of("rosrun", "car_interface", "bag_report", bag).strip()
        with open(page, encoding="utf-8") as file:
            html = file.read()

        def text(part):
            return " ".join(unescape(re.sub("<[^>]*>", " ", part)).split())
        verdict = re.search('<p class="verdict">.*?</p>', html, re.S).group(0)
        faults = re.search('<section id="faults".*?</section>', html, re.S).group(0)
        rows = [text(row) for row in re.findall("<tr>(.*?)</tr>", faults, re.S)]
        return text(verdict), [row for row in rows if re.search(r" (warning|error) (turn_arb|teleop_logi) ", row)]

    def check(self, fail, told):
        """Drive, let the gamepad fail, and read; again when the busy machine fell silent by itself."""
        retried(lambda: self.check_once(fail, told), 4)

    def check_once(self, fail, told):
        """Drive, let the gamepad fail, and read."""
        self.drive()
        stop_recording = self.record()
        fail()
        self.wait_for(SteeringState.NO_HUMAN, told.reason)

        def examine():
            lines = output_of(executable("doctor")).splitlines()
            self.assertIn(told.doctor, lines)
            self.assertEqual([line for line in lines if "reports" in line and "gamepad" in line], [])
        retried(examine)  # on a busy machine it gives up listening
        verdict, faults = self.report_on(stop_recording())
        self.assertIn(told.report, verdict)
        self.assertEqual(len(faults), len(told.faults), faults)
        for row, pattern in zip(faults, told.faults):
            self.assertRegex(row, pattern)

    def doctors_line(self, *options):
        """What the doctor says of the gamepad."""
        def examine():
            lines = [line for line in output_of(executable("doctor"), *options).splitlines() if "  gamepad  " in line]
            self.assertEqual(len(lines), 1, lines)
            return lines[0]
        return retried(examine)

    def test_wrong_mode(self):
        self.check(lambda: self.inputs.hold(self.gamepad, joy(manual=1, axes=4)), WRONG_MODE)

    def test_axis_that_is_no_number(self):
        self.check(lambda: self.inputs.hold(self.gamepad, joy(manual=1, throttle=math.nan)), NOT_A_NUMBER)

    def test_silence_of_0_27_s_with_the_button_held_on(self):
        def fall_silent():
            self.inputs.drop(self.gamepad)
            self.gamepad.publish(joy(manual=1))
            time.sleep(0.27)  # what is tested
            self.inputs.hold(self.gamepad, joy(manual=1))
        self.check(fall_silent, SILENT)

    def test_gamepad_that_works_is_ok_for_the_doctor(self):
        def attempt():
            self.drive()
            self.assertRegex(self.doctors_line(), r"^ok    gamepad     /joy: 8 axes, 11 buttons, \d\d\.\d times a "
                                                  "second; manual deadman held$")
        retried(attempt)  # a busy machine falls silent by itself

    def test_slow_gamepad_is_bad_for_the_doctor(self):
        slow = Repeater(period_s=0.4)
        self.addCleanup(slow.end)
        slow.hold(self.gamepad, joy())
        self.states.wait_for_count(10, self.states.mark())
        line = self.doctors_line()
        self.assertRegex(line, r"^bad   gamepad     /joy comes 2\.\d times a second, too seldom for a joy_timeout of "
                               r"0\.25 s: the deadman is released again and again \| remedy: Set joy_node's "
                               "autorepeat_rate to 20")

    def test_gamepad_that_nobody_reads_is_named_by_the_doctor(self):
        line = self.doctors_line("--ns", "one")
        self.assertTrue(line.startswith(
            "warn  gamepad     no node publishes /one/joy, so that no deadman can be held (joy was never heard) | "
            "remedy: Start joy_node: roslaunch car_interface car.launch gamepad:=true"), line)


class OneProcess(unittest.TestCase):
    def test_turn_arb_in_car_nodes_quotes_the_gamepad_of_its_namespace(self):
        states = Topic("/one/turn_arb/state", SteeringState).connected()
        explained = Topic("/one/teleop_logi/state", TeleopState).connected()
        gamepad = Sender("/one/joy", Joy)
        inputs = Repeater()
        for clean_up in (gamepad.close, explained.close, states.close, inputs.end):
            self.addCleanup(clean_up)
        inputs.hold(gamepad, joy(manual=1, axes=4))
        explained.wait_for(lambda state: state.cause == "joy incomplete")
        states.wait_for(lambda state: re.fullmatch(WRONG_MODE.reason, state.reason))


if __name__ == "__main__":
    rospy.init_node("gamepad_test")
    rostest.rosrun("car_interface", "gamepad_test", "__main__")
