#!/usr/bin/env python3
"""calibration_drive on a terminal of its own: it drives the virtual car while the deadman is held, and only then."""
from __future__ import annotations

import math
import os
import re
import shutil
import tempfile
import time
import unittest

import rospy
import rostest
import yaml
from car_interface.msg import PlannerState, SteeringState, ThrottleState
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Joy
from std_msgs.msg import Float32, Int32MultiArray
from visualization_msgs.msg import Marker, MarkerArray

from car_interface.common.units import yaw_rad
from terminal import Terminal
from waiting import PACKAGE, NodeProcess, Repeater, Sender, Topic, config, eventually, executable, set_params, skip
from witness import measured

AUTONOMOUS, MANUAL = 5, 4  # buttons, as config/teleop_logi.yaml has them
CENTER, NEUTRAL, COUNT = 5100, 4915, 16
LET_GO_S = 0.3  # from the button to the chip; without the deadman it would take 0.5 s until a request is stale
START_S = 90
ESCAPES = re.compile(r"\x1b\[[0-9;]*[A-Za-z]|\r")
WHOLE = bool(os.environ.get("CAR_INTERFACE_ALL"))
WHOLE_S = 600
STEERING = {3800: 1.05, 4100: 0.83, 4400: 0.58, 4700: 0.28, 4980: 0.0, 5300: -0.24, 5700: -0.52, 6200: -0.82,
            6700: -1.05}  # curvature by duty, as practice.launch has it


def gamepad(button=None, steering=0.0, throttle=0.0):
    """A deadman held, or none, and the sticks."""
    message = Joy(axes=[0.0] * 8, buttons=[int(index == button) for index in range(11)])
    message.axes[0], message.axes[4] = steering, throttle
    return message


def shown(line):
    """A line without what draws it over others, and without colours."""
    return ESCAPES.sub("", line)


def is_at_rest(output):
    """Whether steering and ESC are where a stop puts them, as the board's counts have it."""
    return abs(output.data[0] - CENTER) < COUNT and abs(output.data[1] - NEUTRAL) < COUNT


class Base(unittest.TestCase):
    def setUp(self):
        self.folder = tempfile.mkdtemp(prefix="calibration_drive")
        self.addCleanup(shutil.rmtree, self.folder, ignore_errors=True)
        self.table = os.path.join(self.folder, "turn_arb.yaml")

    def start(self, *arguments, ns="/"):
        terminal = self.terminal = Terminal(executable("calibration_drive"), *arguments, env={"ROS_NAMESPACE": ns})
        self.addCleanup(terminal.clean_up)
        return terminal

    def newest(self):
        """The last lines, for a failure."""
        return [shown(line) for line in self.terminal.lines.since()[-9:]]

    def ended(self, terminal, code):
        """What it had printed when it ended."""
        self.assertEqual(terminal.wait_for_exit(), code, terminal.lines.since()[-10:])
        return [shown(line) for line in terminal.lines.since()]

    def wait_for_line(self, terminal, pattern, since=0):
        return terminal.lines.wait_for(lambda line: re.search(pattern, shown(line)), since).what


class Refusals(Base):
    def test_car_that_is_not_launched_is_told_so(self):
        lines = self.ended(self.start("-o", self.table, ns="/nowhere"), 1)
        self.assertIn("turn_arb's calibration isn't known: its parameter servo_left is missing", lines[-1])
        self.assertIn("Is the car launched, and in this namespace (ROS_NAMESPACE)?", lines[-1])

    def test_package_s_own_files_are_not_written(self):
        lines = self.ended(self.start(), 1)
        self.assertIn("the car runs on the package's own files, which are not to be changed: copy them", lines[-1])

    def test_bad_parameter_is_named(self):
        lines = self.ended(self.start("-o", self.table, "--radius", "1"), 1)
        self.assertIn("radius is 1.0; accepted: a number from 2.5 to 100", lines[-1])

    def test_help_needs_no_master(self):
        terminal = Terminal(executable("calibration_drive"), "--help", env={"ROS_MASTER_URI": "http://127.0.0.1:1"})
        self.addCleanup(terminal.clean_up)
        self.assertTrue(self.ended(terminal, 0)[0].startswith("usage: rosrun car_interface calibration_drive "))

    def test_all_that_is_missing_is_listed_with_the_remedy(self):
        set_params(self, "/bare/turn_arb", config("turn_arb.yaml"))
        set_params(self, "/bare/throttle_arb", {**config("throttle.yaml"), "sonar_hub": config("sonars.yaml")})
        planner = rospy.Publisher("/bare/planner_interface/state", PlannerState, queue_size=1, latch=True)
        self.addCleanup(planner.unregister)
        planner.publish(PlannerState(source="drive"))
        lines = self.ended(self.start("-o", self.table, ns="/bare"), 1)
        for begin in ("  - turn_arb isn't heard: is the car launched", "  - /servo/output isn't heard: is pca9685",
                      "  - there is no odometry on odom: is teensy_sensor_hub running",
                      "  - throttle_arb isn't heard, which drives the ESC: launch with throttle:=true",
                      "  - planner_interface obeys drive, not speeds: launch with planner:=speed in its place",
                      "  - no range of the sonars front_right, front_middle, ",
                      "  - teleop_logi isn't heard, which reads the gamepad"):
            self.assertTrue([line for line in lines if line.startswith(begin)], (begin, lines))
        self.assertIn("it can't begin: these are missing, see above", lines[-1])
        self.assertEqual(os.listdir(self.folder), [])


class Drive(Base):
    def setUp(self):
        super().setUp()
        self.truth = Topic("/car_sim/truth", Odometry)
        self.outputs = Topic("/servo/output", Int32MultiArray)
        self.steering = Topic("/turn_arb/state", SteeringState)
        self.throttle = Topic("/throttle_arb/state", ThrottleState)
        self.requests = Topic("/av_steer_req", Float32)
        self.speeds = Topic("/av_speed_req", Float32)
        self.markers = Topic("/calibration_drive/markers", MarkerArray)
        for topic in (self.truth, self.outputs, self.steering, self.throttle, self.requests, self.speeds, self.markers):
            self.addCleanup(topic.close)
        for topic in (self.truth, self.outputs, self.steering, self.throttle):
            topic.wait_for(lambda _: True, 0, START_S)
        self.joy = Sender("/joy", Joy)
        self.addCleanup(self.joy.close)
        self.inputs = Repeater(0.02)
        self.addCleanup(self.inputs.end)
        self.press(None)
        self.throttle.wait_for(lambda state: state.cause == "human absent" and state.esc != "ARMING",
                               self.throttle.mark(), START_S)

    def press(self, button, *sticks):
        self.inputs.hold(self.joy, gamepad(button, *sticks))

    def hold(self):
        """Hold the autonomous deadman until it drives. A gamepad that this computer was too busy for is let go of."""
        mark = self.truth.mark()

        def drives():
            if any(message.twist.twist.linear.x > 0.3 for message in self.truth.since(mark)):
                return True
            self.hold_anew()
            return False
        self.press(AUTONOMOUS)
        eventually(drives, lambda: f"a car that drives; {self.newest()}", START_S)

    def hold_anew(self):
        """Hold the autonomous deadman; let go of it first where an arbiter asks for that."""
        if any(line.startswith("blocked: ") for line in self.newest()):
            self.drive_to_the_middle()
        reasons = self.steering.since()[-1].reason, self.throttle.since()[-1].reason
        self.press(None if any("let go" in reason for reason in reasons) else AUTONOMOUS)
        time.sleep(0.2)

    def drive_to_the_middle(self):
        """As the program asks for where it can't go on: by the manual deadman, to the middle of the area."""
        circle = self.marker("area", 0).points[:-1]
        x_m, y_m = (sum(getattr(point, axis) for point in circle) / len(circle) for axis in "xy")

        def is_there():
            pose, speed = self.truth.since()[-1].pose.pose, self.truth.since()[-1].twist.twist.linear.x
            dx_m, dy_m = x_m - pose.position.x, y_m - pose.position.y
            off_rad = math.remainder(math.atan2(dy_m, dx_m) - yaw_rad(pose.orientation), 2 * math.pi)
            self.press(MANUAL, max(-1.0, min(1.0, 1.5 * off_rad)), 0.55 if speed < 0.9 else 0.0)
            time.sleep(0.05)
            return math.hypot(dx_m, dy_m) < 0.7
        eventually(is_there, "the car in the middle", START_S)
        self.press(MANUAL)
        self.throttle.wait_for(lambda state: abs(state.speed) < 0.05, self.throttle.mark())
        self.press(None)
        self.throttle.wait_for(lambda state: state.cause == "human absent", self.throttle.mark())

    def let_go(self):
        """Let go; how long it took until steering and ESC were at rest, in s."""
        mark, at_s = self.outputs.mark(), time.monotonic()
        self.press(None)
        return self.outputs.wait_for(is_at_rest, mark).at_s - at_s

    def begin(self, *arguments):
        terminal = self.start("-o", self.table, "--no-sonars", *arguments)
        self.wait_for_line(terminal, "^waits: hold the autonomous deadman and it begins: human_in_loop is false: ")
        return terminal

    def test_it_drives_while_the_deadman_is_held_and_only_then_and_refuses_what_is_too_little(self):
        terminal = self.begin()
        self.assertEqual((self.requests.since(), self.speeds.since()), ([], []))
        self.hold()
        self.assertTrue(self.steering.wait_for(lambda state: state.source == SteeringState.PLANNER,
                                               self.steering.mark()).what.reason.startswith("av_steer_req is"))
        self.wait_for_line(terminal, "^it (measures|steers to) ")
        circle = self.marker("area", 0)
        self.assertEqual({round(math.hypot(point.x - circle.points[18].x, point.y - circle.points[0].y), 2)
                          for point in circle.points}, {3.0})

        def attempt():
            self.hold()
            self.assertLess(self.let_go(), LET_GO_S)
        measured(attempt)
        self.wait_for_line(terminal, "^paused: hold the autonomous deadman and it goes on: human_in_loop is false",
                           terminal.lines.mark() - 20)
        mark = self.requests.mark()
        self.throttle.wait_for(lambda state: abs(state.speed) < 0.05, self.throttle.mark())
        self.assertEqual(self.requests.since(mark), [])  # it paused, and asks for nothing
        self.hold()
        mark = terminal.lines.mark()
        self.wait_for_line(terminal, "^it (measures|steers to|turns back) ", mark)
        terminal.type(b"f")
        self.wait_for_line(terminal, r"^ended by hand after \d+ s\. You can let go\. Calibrating")
        self.assertEqual(self.speeds.wait_for(lambda speed: speed.data == 0.0, mark).what.data, 0.0)
        self.throttle.wait_for(lambda state: abs(state.speed) < 0.05, self.throttle.mark())  # still held, and it stands
        lines = self.ended(terminal, 1)
        self.assertIn("no calibration is written: ", lines[-1])
        bag, page = (next(line.partition(": ")[2] for line in lines if line.startswith(what))
                     for what in ("recording: ", "report: "))
        self.assertEqual(sorted(os.listdir(self.folder)), sorted(map(os.path.basename, (bag, page))))
        self.assertTrue(re.search(r"/turn_arb_[\d_-]+\.bag$", bag))

    def marker(self, ns, index):
        def found(array):
            return [one for one in array.markers if (one.ns, one.id, one.action) == (ns, index, Marker.ADD)]
        return found(self.markers.wait_for(found, self.markers.mark()).what)[0]

    def test_another_program_that_steers_is_named(self):
        other = Sender("/av_turnrad_req", Float32)
        self.addCleanup(other.close)
        self.inputs.hold(other, Float32(math.inf))
        lines = self.ended(self.start("-o", self.table), 1)
        self.assertIn(f"  - {rospy.get_name()} publishes /av_turnrad_req, too: end it", lines)

    def test_giving_up_stops_the_car_and_writes_nothing_but_the_recording(self):
        terminal = self.begin()
        self.hold()
        terminal.type(b"q")
        lines = self.ended(terminal, 1)
        self.assertIn("ended before it was over: nothing is written", lines[-1])
        self.throttle.wait_for(lambda state: abs(state.speed) < 0.05, self.throttle.mark())
        (bag,) = os.listdir(self.folder)
        self.assertIn(f"recording: {self.folder}/{bag}", lines)

    def test_person_with_the_stick_is_told_where_to_hold_it_and_nothing_is_asked_for(self):
        terminal = self.start("-o", self.table, "--stick")
        self.wait_for_line(terminal, "^drive slowly, about 1 m/s, with the stick at 100% left")
        self.press(MANUAL, 0.5, 0.6)
        self.truth.wait_for(lambda truth: truth.twist.twist.linear.x > 0.3, self.truth.mark())
        mark = terminal.lines.mark()
        self.press(MANUAL, 0.5, 0.45)
        self.wait_for_line(terminal, "^hold the stick still at 100% left", mark)
        self.wait_for_line(terminal, r"^left \|V-+o-+\+-+\| right", mark)
        self.wait_for_line(terminal, "^     hold at 100% left; it is at 50% left", mark)
        self.press(MANUAL, 1.0, 0.45)
        self.wait_for_line(terminal, r"^hold 100% left: \d s more at this speed", mark)
        self.wait_for_line(terminal, r"^left \|X-+\+-+\| right", mark)
        self.assertEqual((self.requests.since(), self.speeds.since()), ([], []))
        self.press(None)
        terminal.type(b"q")
        self.assertIn("ended before it was over: nothing is written", self.ended(terminal, 1)[-1])

    def test_without_a_terminal_there_are_plain_lines_of_what_it_waits_for_and_does(self):
        process = NodeProcess(executable("calibration_drive"), "-o", self.table, "--no-sonars")
        self.addCleanup(process.clean_up)
        process.wait_for_info("^  0%, 0:00 driven, about 3:20 left; waiting: hold the autonomous deadman and it begins")
        self.press(AUTONOMOUS)
        process.wait_for_info("^  0%, 0:0. driven, .* left; (settling|measuring): ")
        self.press(None)
        process.wait_for_info("^ .* left; paused: hold the autonomous deadman and it goes on: human_in_loop is false")
        self.assertEqual(process.end(), 1)
        self.assertFalse([line for line in process.stdout.since() if "\x1b[J" in line])

    def test_gamepad_that_is_off_is_waited_for(self):
        self.inputs.drop(self.joy)
        terminal = self.start("-o", self.table)
        self.wait_for_line(terminal, "^waits: the gamepad isn't there .joy silent for")
        self.press(None)
        self.wait_for_line(terminal, "^waits: hold the autonomous deadman and it begins")
        terminal.type(b"q")
        self.ended(terminal, 1)

    def test_whole_drive_replaces_the_table_after_a_question_and_the_car_turns_as_it_says(self):
        if not WHOLE:
            skip(self, "a drive of some minutes: ./dev test --all")
        shutil.copy(os.path.join(PACKAGE, "config", "turn_arb.yaml"), self.table)
        terminal = self.begin()

        def is_over():
            self.hold_anew()
            return any(shown(line).startswith("Replace ") for line in terminal.lines.since())
        eventually(is_over, lambda: f"the end; {self.newest()}", WHOLE_S)
        self.press(None)
        terminal.type(b"y")
        lines = self.ended(terminal, 0)
        self.assertTrue([line for line in lines if line.startswith(f"written: {self.table}; the old one is ")], lines)
        with open(self.table, encoding="utf-8") as file:
            table = yaml.safe_load(file)
        self.assertLess(abs(table["servo_center"] - 4980), 2 * COUNT)
        duties = sorted(STEERING)
        for side, name in ((1, "k_pwmcmd_left_table_servo"), (-1, "k_pwmcmd_right_table_servo")):
            for radius_m, duty in zip(table["m_turnrad_axis_servo"], table[name]):
                if 1.0 < radius_m < 5.0:
                    low = max(index for index in range(len(duties) - 1) if duties[index] <= duty)
                    ratio = (duty - duties[low]) / (duties[low + 1] - duties[low])
                    curvature = (1 - ratio) * STEERING[duties[low]] + ratio * STEERING[duties[low + 1]]
                    self.assertLess(abs(side * radius_m * curvature - 1), 0.08, (side, radius_m, duty))


if __name__ == "__main__":
    rospy.init_node("calibration_drive_test")
    rostest.rosrun("car_interface", "calibration_drive_test", "__main__")
