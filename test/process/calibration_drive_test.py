#!/usr/bin/env python3
"""calibration_drive on a terminal of its own: it drives the virtual car while the deadman is held, and only then."""
from __future__ import annotations

import glob
import math
import os
import re
import signal
import tempfile
import time
from contextlib import suppress

import rospy
import rostest
from car_interface.msg import PlannerState, SteeringState
from std_msgs.msg import Float32

from calibration_person import AUTONOMOUS, COUNT, MANUAL, DriveTest, ProgramTest, shown
from terminal import Terminal
from virtual_car import Chip
from waiting import NodeProcess, Sender, config, eventually, executable, set_params
from witness import measured

CENTER, NEUTRAL = round(5100 / COUNT), round(4915 / COUNT)  # counts on the chip's channels 0 and 1
LET_GO_S = 0.3  # from the button to the chip; without the deadman it would take 0.5 s until a request is stale
SLOW = os.path.join(os.path.dirname(os.path.abspath(__file__)), "slow_calibration_drive.py")
STALE_S = 0.8  # from the end of the program to the chip: 0.5 s, and what it takes as above


def tearDownModule():
    os.remove(rospy.get_param("/pca9685/virtual_log"))


def processes_with(text):
    """The command lines, of all processes, in which a text is found."""
    found = []
    for path in glob.glob("/proc/[0-9]*/cmdline"):
        with suppress(OSError), open(path, encoding="utf-8", errors="replace") as file:
            line = file.read().replace("\0", " ")
            found += [line] if text in line else []
    return found


class Refusals(ProgramTest):
    def test_car_that_is_not_launched_is_told_so(self):
        lines = self.ended(self.start("-o", self.table, ns="/nowhere"), 1)
        self.assertIn("turn_arb's calibration isn't known: its parameter servo_left is missing", lines[-1])
        self.assertIn("Is the car launched, and in this namespace (ROS_NAMESPACE)?", lines[-1])

    def test_package_s_own_files_and_bad_parameters_are_named(self):
        first, second = self.start(), self.start("-o", self.table, "--radius", "1")
        self.assertIn("the car runs on the package's own files, which are not to be changed: copy them",
                      self.ended(first, 1)[-1])
        self.assertIn("radius is 1.0; accepted: a number from 2.5 to 100", self.ended(second, 1)[-1])

    def test_help_needs_no_master(self):
        terminal = Terminal(executable("calibration_drive"), "--help", env={"ROS_MASTER_URI": "http://127.0.0.1:1"})
        self.addCleanup(terminal.clean_up)
        self.assertTrue(self.ended(terminal, 0)[0].startswith("usage: rosrun car_interface calibration_drive "))

    def test_all_that_is_missing_and_another_program_that_steers_are_listed_with_the_remedy(self):
        set_params(self, "/bare/turn_arb", config("turn_arb.yaml"))
        set_params(self, "/bare/throttle_arb", {**config("throttle.yaml"), "sonar_hub": config("sonars.yaml")})
        planner = rospy.Publisher("/bare/planner_interface/state", PlannerState, queue_size=1, latch=True)
        self.addCleanup(planner.unregister)
        planner.publish(PlannerState(source="drive"))
        other = rospy.Publisher("/bare/av_turnrad_req", Float32, queue_size=1, latch=True)
        self.addCleanup(other.unregister)
        timer = rospy.Timer(rospy.Duration(0.2), lambda _: other.publish(math.inf))
        self.addCleanup(timer.shutdown)
        lines = self.ended(self.start("-o", self.table, ns="/bare"), 1)
        text = " ".join(" ".join(lines).split())
        for begin in ("- turn_arb isn't heard: is the car launched", "- /servo/output isn't heard: is pca9685",
                      "- there is no odometry on odom: is teensy_sensor_hub running",
                      "- throttle_arb isn't heard, which drives the ESC: launch with throttle:=true",
                      "- planner_interface obeys drive, not speeds: launch with planner:=speed in its place",
                      "- no range of the sonars front_right, front_middle, ",
                      f"- {rospy.get_name()} publishes /bare/av_turnrad_req, too: end it",
                      "- teleop_logi isn't heard, which reads the gamepad"):
            self.assertIn(begin, text)
        self.assertLess(max(len(line) for line in lines if line.startswith("  ")), 80)
        self.assertIn("it can't begin: these are missing, see above", lines[-1])
        self.assertEqual(os.listdir(self.folder), [])


class Drive(DriveTest):
    def setUp(self):
        super().setUp()
        self.chip = Chip(rospy.get_param("/pca9685/virtual_log"))

    def begin(self, *arguments):
        return super().begin("--no-sonars", *arguments)

    def drive(self):
        """Hold the deadman until the car drives and steers."""
        self.hold()
        eventually(lambda: self.chip.counts(0) != CENTER and self.chip.counts(1) != NEUTRAL, "a car that steers")

    def rest_after_s(self, at_s):
        """How long after a time steering and ESC were at rest, s."""
        since_ns = round(at_s * 1e9)
        return max(self.chip.wait_for(channel, lambda counts, rest=rest: counts == rest, since_ns)
                   for channel, rest in ((0, CENTER), (1, NEUTRAL))) / 1e9 - at_s

    def let_go(self):
        """Let go; how long it took until steering and ESC were at rest, s."""
        at_s = time.monotonic()
        self.press(None)
        return self.rest_after_s(at_s)

    def check_rest(self, since_s):
        """Hold against the chip that nothing was obeyed since then."""
        for channel, rest in ((0, CENTER), (1, NEUTRAL)):
            self.assertLessEqual(set(self.chip.values_since(channel, round(since_s * 1e9))), {rest})

    def recording(self):
        """The bag's name, closed, and nothing else left in the folder."""
        eventually(lambda: not glob.glob(os.path.join(self.folder, "*.active")), "a closed bag")
        (bag,) = os.listdir(self.folder)
        self.assertTrue(re.fullmatch(r"turn_arb_[\d_-]+\.bag", bag), bag)
        self.assertGreater(os.path.getsize(os.path.join(self.folder, bag)), 10_000)
        return bag

    def test_it_drives_while_the_deadman_is_held_and_only_then_and_refuses_what_is_too_little(self):
        terminal = self.begin()
        self.assertEqual((self.requests.since(), self.speeds.since()), ([], []))
        self.hold()
        self.assertTrue(self.steering.wait_for(lambda state: state.source == SteeringState.PLANNER,
                                               self.steering.mark()).what.reason.startswith("av_steer_req is"))
        self.wait_for_line(terminal, "^it (measures|steers to|turns back) ")
        circle = self.marker("area", 0)
        self.assertEqual({round(math.hypot(point.x - circle.points[18].x, point.y - circle.points[0].y), 2)
                          for point in circle.points}, {3.0})

        def attempt():
            self.drive()
            self.assertLess(self.let_go(), LET_GO_S)
        measured(attempt)
        at_rest_s = time.monotonic()
        self.wait_for_line(terminal, "^paused: no deadman is held; hold the autonomous deadman and it goes on",
                           terminal.lines.mark() - 20)
        mark = self.requests.mark()
        other = Sender("/av_steer_req", Float32), Sender("/av_speed_req", Float32)
        for sender in other:
            self.addCleanup(sender.close)
            self.inputs.hold(sender, Float32(1.0))
        self.throttle.wait_for(lambda state: abs(state.speed) < 0.05, self.throttle.mark())
        self.inputs.drop(*other)
        self.check_rest(at_rest_s)  # it paused, and nobody else is obeyed either
        self.assertEqual({request.data for request in self.requests.since(mark)}, {1.0})  # it asks for nothing
        self.drive()
        self.wait_for_line(terminal, "^it (measures|steers to|turns back) ", terminal.lines.mark())
        mark = self.speeds.mark()
        terminal.type(b"f")
        self.wait_for_line(terminal, r"^ended by hand after \d+ s\. You can let go\. Calibrating")
        self.assertEqual(self.speeds.wait_for(lambda speed: speed.data == 0.0, mark).what.data, 0.0)
        self.wait_until_it_stands()  # though it is still held
        lines = self.ended(terminal, 1)
        self.assertRegex(lines[-1], r"^\[WARN\] .*: no calibration is written: (what is missing stands above: |"
                                    r".*: no steering can be told from this: )")
        bag, page = (next(line.partition(": ")[2] for line in lines if line.startswith(what))
                     for what in ("recording: ", "report: "))
        self.assertEqual(sorted(os.listdir(self.folder)), sorted(map(os.path.basename, (bag, page))))

    def test_ctrl_c_stops_the_car_restores_the_terminal_and_writes_nothing_but_the_recording(self):
        terminal = self.begin()
        self.drive()
        terminal.type(b"\x03")
        lines = self.ended(terminal, 1)
        self.assertIn("ended before it was over: nothing is written", lines[-1])
        self.wait_until_it_stands()  # though it is still held
        self.assertIn(f"recording: {self.folder}/{self.recording()}", lines)
        self.assertEqual(terminal.settings(), terminal.settings_before)
        self.assertEqual(self.marker_actions(), {3})  # DELETEALL: rviz shows nothing of it any more

    def test_terminal_that_is_closed_stops_the_car_and_leaves_the_recording_and_no_process(self):
        descriptor, errors = tempfile.mkstemp(prefix="calibration_drive")
        os.close(descriptor)
        self.addCleanup(os.remove, errors)
        shell = self.terminal = Terminal("bash", "--norc", "--noprofile", "-i")
        self.addCleanup(shell.clean_up)
        shell.type(f"{executable('calibration_drive')} -o {self.table} --no-sonars 2>{errors}\n".encode())
        self.wait_for_line(shell, "^waits: no deadman is held; hold the autonomous deadman and it begins")
        self.drive()
        at_s = time.monotonic()
        shell.hang_up()
        self.assertLess(self.rest_after_s(at_s), STALE_S)
        at_rest_s = time.monotonic()
        eventually(lambda: not processes_with(self.folder), lambda: f"the end of {processes_with(self.folder)}")
        self.wait_until_it_stands()  # though it is still held
        self.check_rest(at_rest_s)
        self.recording()
        self.assertEqual(self.marker_actions(), {3})
        with open(errors, encoding="utf-8") as file:
            said = file.read()
        self.assertIn("ended before it was over: nothing is written", said)
        self.assertNotIn("Traceback", said)

    def marker_actions(self):
        return {marker.action for marker in self.markers.since()[-1].markers}

    def test_program_that_is_killed_leaves_a_car_that_stops_and_a_closed_recording(self):
        terminal = self.begin()

        def attempt():
            self.drive()
            os.kill(terminal.pid, signal.SIGKILL)
            self.assertLess(self.rest_after_s(time.monotonic()), STALE_S)
        attempt()
        at_rest_s = time.monotonic()
        terminal.wait_for_exit()
        self.wait_until_it_stands()  # though it is still held
        self.check_rest(at_rest_s)
        self.recording()

    def test_person_with_the_stick_is_told_where_to_hold_it_and_nothing_is_asked_for(self):
        terminal = self.start("-o", self.table, "--stick")
        self.wait_for_line(terminal, "^no deadman is held; hold the manual deadman")
        self.press(MANUAL)
        self.wait_for_line(terminal, "^drive slowly, about 1 m/s, with the stick at 100% left")
        self.press(MANUAL, 0.5, 0.6)
        self.truth.wait_for(lambda truth: truth.twist.twist.linear.x > 0.3, self.truth.mark())
        mark = terminal.lines.mark()
        self.press(MANUAL, 0.5, 0.45)
        self.wait_for_line(terminal, "^hold the stick still at 100% left", mark)
        self.wait_for_line(terminal, r"^left \|V-+o-+\+-+\| right", mark)
        self.wait_for_line(terminal, "^     hold at 100% left; it is at 50% left", mark)
        self.assertEqual(self.marker("text", 0).text, "0%, hold the stick still at\n100% left")
        self.press(MANUAL, 1.0, 0.45)
        self.wait_for_line(terminal, r"^hold 100% left: \d s more at this speed", mark)
        self.wait_for_line(terminal, r"^left \|X-+\+-+\| right", mark)
        self.assertEqual((self.requests.since(), self.speeds.since()), ([], []))
        self.press(None)
        terminal.type(b"q")
        self.assertIn("ended before it was over: nothing is written", self.ended(terminal, 1)[-1])

    def test_what_comes_after_its_end_is_no_part_of_the_calibration(self):
        terminal = Terminal(SLOW, "-o", self.table, "--stick")
        self.addCleanup(terminal.clean_up)
        self.wait_for_line(terminal, "; hold the manual deadman")
        terminal.type(b"f")
        self.ended(terminal, 1)
        begun, ended = (re.findall(r"\d+ odometries, \d+ duties", shown(self.wait_for_line(terminal, f"^{when}: ")))
                        for when in ("at its end", "later"))
        self.assertEqual(begun, ended)
        self.assertNotEqual(begun, ["0 odometries, 0 duties"])

    def test_without_a_terminal_there_are_plain_lines_of_what_it_waits_for_and_does(self):
        process = NodeProcess(executable("calibration_drive"), "-o", self.table, "--no-sonars")
        self.addCleanup(process.clean_up)
        process.wait_for_info("^  0%, 0:00 driven, about 4:00 left; waiting: .* hold the autonomous deadman ")
        self.press(AUTONOMOUS)
        process.wait_for_info(r"^ +\d+%, \d:\d\d driven, .* left; (settling|measuring|turning): ")
        self.press(None)
        process.wait_for_info("^ .* left; paused: no deadman is held; hold the autonomous deadman and it goes on")
        self.assertEqual(process.end(), 1)
        self.assertFalse([line for line in process.stdout.since() if "\x1b[J" in line])

    def test_gamepad_that_is_off_is_waited_for(self):
        self.inputs.drop(self.joy)
        terminal = self.start("-o", self.table)
        self.wait_for_line(terminal, "^waits: the gamepad isn't there .joy silent for")
        self.press(None)
        self.wait_for_line(terminal, "^waits: .*; hold the autonomous deadman and it begins")
        terminal.type(b"q")
        self.assertRegex(self.ended(terminal, 1)[-1], r"^\[WARN\] .*: ended before it was over: nothing is written$")


if __name__ == "__main__":
    rospy.init_node("calibration_drive_test")
    rostest.rosrun("car_interface", "calibration_drive_test", "__main__")
