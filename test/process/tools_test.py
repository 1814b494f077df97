#!/usr/bin/env python3
"""Programs beside a car, as people start them: terminals, keys, a gamepad's device, recordings, live tuning."""
import glob
import os
import re
import shutil
import signal
import sys
import tempfile
import threading
import time
import unittest
from contextlib import suppress

import rosbag
import rosgraph
import rospy
import rostest
from car_interface.msg import SteeringState, ThrottleState
from dynamic_reconfigure.client import Client
from dynamic_reconfigure.msg import Config, DoubleParameter, GroupState, IntParameter, StrParameter
from dynamic_reconfigure.srv import Reconfigure
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Joy
from std_srvs.srv import Trigger

from car_interface.nodes.planner_interface.ackermann_messages import ackermann_drive_class
from closing import pid_of
from pages import first_planner
from terminal import Terminal
from waiting import PACKAGE, NodeProcess, Repeater, Sender, Topic, eventually, executable, set_params, start

AUTONOMOUS, LB = 5, 4  # buttons, as config/teleop_logi.yaml has them
LEFT, CENTER, RIGHT = 3800, 5100, 6700
ESCAPES = re.compile(r"\x1b\[[0-9;]*[A-Za-z]|\r")
READY = "To drive: "
WAITS = "^waits: no deadman is held; hold the autonomous deadman and it begins"
NOWHERE = "http://127.0.0.1:1"
ATTEMPTS, ATTEMPT_S = 6, 20


class Hand:
    """Holds one key of a terminal, which repeats as on a desktop."""

    def __init__(self, test, terminal, key):
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, args=(terminal, key), daemon=True)
        self._thread.start()
        test.addCleanup(self.let_go)

    def _run(self, terminal, key):
        pause_s = 0.5
        terminal.type(key)
        while not self._ending.wait(pause_s):
            terminal.type(key)
            pause_s = 0.033

    def let_go(self):
        self._ending.set()
        self._thread.join()


def processes_with(text):
    """The command lines, of all processes, in which a text is found."""
    found = []
    for path in glob.glob("/proc/[0-9]*/cmdline"):
        with suppress(OSError), open(path, encoding="utf-8", errors="replace") as file:
            line = file.read().replace("\0", " ")
            found += [line] if text in line else []
    return found


class Tools(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.truth = Topic("/car_sim/truth", Odometry).connected()
        cls.steering = Topic("/turn_arb/state", SteeringState).connected()
        cls.throttle = Topic("/throttle_arb/state", ThrottleState).connected()
        cls.throttle.wait_for(lambda state: state.esc != "ARMING")
        cls.steering.wait_for(lambda _: True)

    def setUp(self):
        self.folder = tempfile.mkdtemp(prefix="tools_test")
        self.addCleanup(shutil.rmtree, self.folder, ignore_errors=True)

    def terminal(self, *command, env=None):
        terminal = Terminal(*command, env=env)
        self.addCleanup(terminal.clean_up)
        return terminal

    def wait_for_steering(self, source):
        return self.steering.wait_for(lambda state: state.source == source, self.steering.mark()).what

    def wait_until_it_stands(self):
        self.truth.wait_for(lambda truth: truth.twist.twist.linear.x == 0.0, self.truth.mark())

    # --- keys ---

    def hold_until_it_drives(self, terminal):
        """Deadman, then the key that goes faster; again where a node stood still, which then waits for the release."""
        for _ in range(ATTEMPTS):
            hand, mark = Hand(self, terminal, b"m"), self.truth.mark()
            try:
                terminal.lines.wait_for(lambda line: "steers: TELEOP, tele_steer_req" in line, terminal.lines.mark(),
                                        ATTEMPT_S)
                hand.let_go()
                hand = Hand(self, terminal, b"w")
                self.truth.wait_for(lambda truth: truth.twist.twist.linear.x > 0.3, mark, ATTEMPT_S)
                return hand
            except AssertionError:
                hand.let_go()
                self.wait_for_steering(SteeringState.NO_HUMAN)
        raise AssertionError("it doesn't drive")

    def test_keyboard_drives_the_car_and_is_alone_and_its_terminal_is_restored(self):
        terminal = self.terminal(executable("keyboard_drive"))
        terminal.wait_for_line(READY)
        self.assertNotEqual(terminal.settings(), terminal.settings_before)
        terminal.wait_for_line("steers: NO_HUMAN, human_in_loop is false: no deadman is held")
        faster = self.hold_until_it_drives(terminal)
        second = self.terminal(executable("keyboard_drive"), "__name:=second")
        second.wait_for_line("/keyboard_drive publishes /joy already. End it first: rosnode kill /keyboard_drive")
        self.assertEqual(second.wait_for_exit(), 1)
        faster.let_go()
        self.wait_for_steering(SteeringState.NO_HUMAN)
        self.wait_until_it_stands()
        self.assertEqual((terminal.wait_for_exit(b"q"), terminal.settings()), (0, terminal.settings_before))

    def test_keyboard_restores_its_terminal_however_it_ends_and_is_refused_without_one(self):
        endings = {"ctrl-c": lambda terminal: terminal.type(b"\x03"),
                   "terminate": lambda terminal: os.kill(terminal.pid, signal.SIGTERM),
                   "hang_up": lambda terminal: os.kill(terminal.pid, signal.SIGHUP),
                   "q": lambda terminal: terminal.wait_for_exit(b"q")}
        terminals = {}
        for name in (*endings, "pipe"):
            set_params(self, f"/{name}/pca9685", {"device": "virtual"})
        for name in endings:
            terminals[name] = self.terminal(executable("keyboard_drive"), f"__ns:=/{name}")
        piped = start(self, executable("keyboard_drive"), "__ns:=/pipe")
        for name, end in endings.items():
            terminal = terminals[name]
            terminal.wait_for_line(READY)
            self.assertNotEqual(terminal.settings(), terminal.settings_before)
            end(terminal)
            eventually(lambda terminal=terminal: terminal.settings() == terminal.settings_before, "the settings")
            self.assertEqual(terminal.wait_for_exit(), 0, name)
            self.assertNotIn("Traceback", "\n".join(terminal.lines.since()))
        piped.wait_for_line("no terminal to read keys from: start it by rosrun in a terminal of its own, not by "
                            "roslaunch and not in the background")
        self.assertEqual(piped.wait_for_exit(), 1)

    def test_keyboard_in_the_background_lets_go_and_in_the_foreground_goes_on(self):
        set_params(self, "/job/pca9685", {"device": "virtual"})
        joy = Topic("/job/joy", Joy)
        self.addCleanup(joy.close)

        def wait_for_deadman(is_held):
            joy.wait_for(lambda message: message.buttons[LB] == is_held, joy.mark())
        shell = self.terminal(sys.executable, os.path.join(PACKAGE, "test", "process", "one_job.py"),
                              executable("keyboard_drive"), "__ns:=/job")
        shell.wait_for_line(READY)
        joy.connected()
        hand = Hand(self, shell, b"m")
        wait_for_deadman(1)
        shell.type(b"\x1a")
        os.kill(shell.pid, signal.SIGUSR1)
        shell.wait_for_line("bg")
        wait_for_deadman(0)
        mark = joy.mark()
        self.assertEqual({message.buttons[LB] for message in joy.wait_for_count(30, mark)}, {0})  # m is typed on
        hand.let_go()
        os.kill(shell.pid, signal.SIGUSR2)
        shell.wait_for_line("fg")
        Hand(self, shell, b"m")
        wait_for_deadman(1)

    # --- a gamepad ---

    def press(self, button=None):
        """Hold a deadman of the gamepad from now on, but while an arbiter asks to let go of it; ``None`` = let go."""
        def joy():
            has_to_let_go = any("let go" in topic.newest.reason for topic in (self.steering, self.throttle))
            held = None if has_to_let_go else button
            return Joy(axes=[0.0] * 8, buttons=[int(index == held) for index in range(11)])
        self.inputs.hold(self.joy, joy)

    def take_gamepad(self):
        self.joy, self.inputs = Sender("/joy", Joy), Repeater(0.02)
        self.addCleanup(self.joy.close)
        self.addCleanup(self.inputs.end)
        self.press()
        self.wait_for_steering(SteeringState.NO_HUMAN)

    def hold(self):
        """Hold the autonomous deadman until the car drives."""
        mark = self.truth.mark()
        self.press(AUTONOMOUS)
        self.truth.wait_for(lambda truth: truth.twist.twist.linear.x > 0.3, mark, 90)

    # --- planners ---

    def test_first_planners_of_the_page_run_as_they_stand_there(self):
        for topic, message_type, speed in (("cmd_vel", Twist, lambda message: message.linear.x),
                                           ("drive", ackermann_drive_class(), lambda message: message.drive.speed)):
            path = os.path.join(self.folder, "first_planner.py")
            with open(path, "w", encoding="utf-8") as file:
                file.write(first_planner(topic))
            process = NodeProcess("python3", path)
            self.addCleanup(process.clean_up)
            sent = Topic(f"/{topic}", message_type)
            self.addCleanup(sent.close)
            sent.wait_for(lambda message: speed(message) == 0.5)  # both sonars have reported, and it drives
            process.end(signal.SIGINT)

    # --- calibration_drive ---

    def begin(self, folder, *arguments):
        terminal = self.terminal(executable("calibration_drive"), "-o", os.path.join(folder, "turn_arb.yaml"),
                                 "--no-sonars", *arguments)
        terminal.lines.wait_for(lambda line: re.search(WAITS, ESCAPES.sub("", line)))
        return terminal

    def wait_until_recorded(self, count):
        """Wait until so many recorders have had turn_arb's state for a while."""
        master = rosgraph.Master("/tools_test")
        eventually(lambda: sum("record" in name for name in dict(master.getSystemState()[1])["/turn_arb/state"])
                   >= count, f"{count} recorders")
        self.steering.wait_for_count(20, self.steering.mark())

    def recording(self, folder):
        """The bag's name, closed, and nothing else left in the folder, and no process."""
        eventually(lambda: not processes_with(folder), lambda: f"the end of {processes_with(folder)}")
        (bag,) = os.listdir(folder)
        self.assertRegex(bag, r"^turn_arb_[\d_-]+\.bag$")
        with rosbag.Bag(os.path.join(folder, bag)) as recorded:
            self.assertIn("/turn_arb/state", recorded.get_type_and_topic_info().topics)
        return os.path.join(folder, bag)

    def test_calibration_drive_drives_while_the_deadman_is_held_and_ctrl_c_ends_it_with_a_closed_recording(self):
        self.take_gamepad()
        terminal = self.begin(self.folder)
        self.hold()
        self.assertRegex(self.wait_for_steering(SteeringState.PLANNER).reason, "^av_steer_req is")
        self.wait_until_recorded(1)
        terminal.type(b"\x03")
        self.assertEqual(terminal.wait_for_exit(), 1)
        lines = [ESCAPES.sub("", line) for line in terminal.lines.since()]
        self.assertIn("ended before it was over: nothing is written", lines[-1])
        self.wait_until_it_stands()  # though it is still held
        self.assertIn(f"recording: {self.recording(self.folder)}", lines)
        self.assertEqual(terminal.settings(), terminal.settings_before)

    def test_calibration_drive_that_is_killed_or_loses_its_terminal_leaves_a_closed_recording_and_no_process(self):
        self.take_gamepad()
        folders = [os.path.join(self.folder, name) for name in ("killed", "hung_up")]
        for folder in folders:
            os.mkdir(folder)
        killed, hung_up = (self.begin(folder, f"__name:={os.path.basename(folder)}") for folder in folders)
        self.wait_until_recorded(2)
        help_text = start(self, "env", f"ROS_MASTER_URI={NOWHERE}", executable("calibration_drive"), "--help")
        os.kill(killed.pid, signal.SIGKILL)
        hung_up.hang_up()
        for folder in folders:
            self.recording(folder)
        self.assertEqual(help_text.wait_for_exit(), 0)  # needs no master
        self.assertRegex(help_text.stdout.since()[0], "^usage: rosrun car_interface calibration_drive ")

    # --- first_check ---

    def test_first_check_tunes_the_neutral_kills_the_board_s_node_and_writes_its_page(self):
        folder = os.path.join(self.folder, "my_car")
        shutil.copytree(os.path.join(PACKAGE, "config"), folder)
        self.addCleanup(rospy.set_param, "/turn_arb/config_folder", rospy.get_param("/turn_arb/config_folder"))
        rospy.set_param("/turn_arb/config_folder", folder)
        self.take_gamepad()
        terminal = self.terminal(executable("first_check"))
        terminal.wait_for_line("1 of 20: the car on a box")
        terminal.type(b"y")
        terminal.wait_for_line("2 of 20: the deadman")
        terminal.type(b"sssss")
        self.press(LB)
        terminal.wait_for_line(r"Now: the ESC gets \+0\.00 of")  # the rest may be on the next line
        terminal.type(b"+")
        eventually(lambda: rospy.get_param("/throttle_arb/servo/neutral") == 4920, "the new neutral")
        self.press()
        self.wait_for_steering(SteeringState.NO_HUMAN)
        terminal.type(b"ep")
        terminal.wait_for_line("20 of 20: killing the servo board's node")
        self.press(AUTONOMOUS)
        self.steering.wait_for(lambda state: state.reason == "av_steer_req is 0.500", self.steering.mark())
        before, mark = pid_of("/pca9685"), terminal.lines.mark()

        def killed():
            terminal.type(b"k")  # until the board has turned the wheels
            time.sleep(0.2)
            return pid_of("/pca9685") != before
        eventually(killed, "the end of pca9685")
        terminal.wait_for_line("Y yes   N no", mark)
        terminal.type(b"y")
        terminal.wait_for_line("Nothing in the files is to be changed")
        terminal.type(b"y")
        self.assertEqual((terminal.wait_for_exit(), terminal.settings()), (0, terminal.settings_before))
        self.assertIn("reported the center", " ".join(terminal.lines.since()))
        self.assertEqual(rospy.get_param("/throttle_arb/servo/neutral"), 4915)
        self.assertEqual(len(glob.glob(os.path.join(folder, "first_check_*.html"))), 1)

    # --- live tuning ---

    def test_steering_is_tuned_by_dynamic_reconfigure_and_a_node_that_roslaunch_starts_again_keeps_that(self):
        def client(name):
            made = Client(name, timeout=30)
            self.addCleanup(made.close)
            return made
        steering, esc = client("/turn_arb"), client("/throttle_arb/servo")
        described = {each["name"]: (each["min"], each["max"], each["default"])
                     for each in (*steering.get_parameter_descriptions(), *esc.get_parameter_descriptions())}
        self.assertEqual(described, {"servo_left": (3300, 4300, LEFT), "servo_center": (4600, 5600, CENTER),
                                     "servo_right": (6200, 7200, RIGHT), "neutral": (4815, 5015, 4915)})
        ask = rospy.ServiceProxy("/turn_arb/set_parameters", Reconfigure)
        for odd in (Config(), Config(strs=[StrParameter("servo_center", "straight")]),
                    Config(doubles=[DoubleParameter("servo_center", float("nan"))]),
                    Config(ints=[IntParameter("servo_channel", 3), IntParameter("groups", 1)]),
                    Config(groups=[GroupState("odd", True, 7, 9)])):
            self.assertEqual({value.name: value.value for value in ask(odd).config.ints},
                             {"servo_left": LEFT, "servo_center": CENTER, "servo_right": RIGHT})
        self.assertEqual(steering.update_configuration({"servo_center": 5150})["servo_center"], 5150)
        self.addCleanup(lambda: client("/turn_arb").update_configuration({"servo_center": CENTER}))
        # Of what is published; the requests before may still be on their way.
        eventually(lambda: steering.get_configuration(timeout=30)["servo_center"] == 5150, "the new center")
        self.assertEqual(esc.get_configuration(timeout=30)["neutral"], 4915)
        answer = rospy.ServiceProxy("/turn_arb/save", Trigger)()
        self.assertFalse(answer.success)
        self.assertIn("turn_arb.yaml is the package's own, which the demo leaves as it is", answer.message)

        before = pid_of("/turn_arb")
        os.kill(before, signal.SIGKILL)
        eventually(lambda: pid_of("/turn_arb") not in (None, before), "the new turn_arb")
        self.steering.wait_for(lambda state: state.source == SteeringState.NO_HUMAN and state.duty == 5150,
                               self.steering.mark())


if __name__ == "__main__":
    rospy.init_node("tools_test")
    rostest.rosrun("car_interface", "tools_test", "__main__")
