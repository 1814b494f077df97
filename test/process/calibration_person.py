"""The person of a calibration drive: a gamepad's deadmen and sticks, and what is read in the program's terminal."""
from __future__ import annotations

import math
import os
import re
import shutil
import tempfile
import time
import unittest

import yaml
from car_interface.msg import SteeringState, ThrottleState
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Joy
from std_msgs.msg import Float32
from visualization_msgs.msg import Marker, MarkerArray

from car_interface.common.units import yaw_rad
from terminal import Terminal
from waiting import Repeater, Sender, Topic, eventually, executable

AUTONOMOUS, MANUAL = 5, 4  # buttons, as config/teleop_logi.yaml has them
COUNT = 16  # of duty
START_S = 90
ESCAPES = re.compile(r"\x1b\[[0-9;]*[A-Za-z]|\r")
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


def curvature_of(duty):
    """The practice car's true curvature at a duty."""
    duties = sorted(STEERING)
    low = max(index for index in range(len(duties) - 1) if duties[index] <= duty)
    ratio = (duty - duties[low]) / (duties[low + 1] - duties[low])
    return (1 - ratio) * STEERING[duties[low]] + ratio * STEERING[duties[low + 1]]


class ProgramTest(unittest.TestCase):
    """Starts calibration_drive in a terminal of its own, with a folder for what it writes."""

    def setUp(self):
        self.folder = tempfile.mkdtemp(prefix="calibration_drive")
        self.addCleanup(shutil.rmtree, self.folder, ignore_errors=True)
        self.table = os.path.join(self.folder, "turn_arb.yaml")
        self.terminal = None

    def start(self, *arguments, ns="/"):
        """Start it with options, in a car's namespace."""
        terminal = self.terminal = Terminal(executable("calibration_drive"), *arguments, env={"ROS_NAMESPACE": ns})
        self.addCleanup(terminal.clean_up)
        return terminal

    def newest(self):
        """The last lines, for a failure."""
        return [shown(line) for line in self.terminal.lines.since()[-9:]] if self.terminal else []

    def ended(self, terminal, code):
        """What it had printed when it ended."""
        self.assertEqual(terminal.wait_for_exit(), code, terminal.lines.since()[-10:])
        return [shown(line) for line in terminal.lines.since()]

    def wait_for_line(self, terminal, pattern, since=0):
        """The first line from ``since`` on in which the pattern is found."""
        return terminal.lines.wait_for(lambda line: re.search(pattern, shown(line)), since).what

    def check_table(self, path, within=0.08):
        """Hold a table that was written against the practice car's true steering."""
        with open(path, encoding="utf-8") as file:
            table = yaml.safe_load(file)
        self.assertLess(abs(table["servo_center"] - 4980), 2 * COUNT)
        for side, name in ((1, "k_pwmcmd_left_table_servo"), (-1, "k_pwmcmd_right_table_servo")):
            for radius_m, duty in zip(table["m_turnrad_axis_servo"], table[name]):
                if 1.0 < radius_m < 5.0:
                    self.assertLess(abs(side * radius_m * curvature_of(duty) - 1), within, (side, radius_m, duty))


class DriveTest(ProgramTest):
    """The same with a virtual car that is launched, and a gamepad in hand."""

    def setUp(self):
        super().setUp()
        self.truth = Topic("/car_sim/truth", Odometry)
        self.steering = Topic("/turn_arb/state", SteeringState)
        self.throttle = Topic("/throttle_arb/state", ThrottleState)
        self.requests = Topic("/av_steer_req", Float32)
        self.speeds = Topic("/av_speed_req", Float32)
        self.markers = Topic("/calibration_drive/markers", MarkerArray)
        for topic in (self.truth, self.steering, self.throttle, self.requests, self.speeds, self.markers):
            self.addCleanup(topic.close)
        for topic in (self.truth, self.steering, self.throttle):
            topic.wait_for(lambda _: True, 0, START_S)
        self.joy = Sender("/joy", Joy)
        self.addCleanup(self.joy.close)
        self.inputs = Repeater(0.02)
        self.addCleanup(self.inputs.end)
        self.press(None)
        self.throttle.wait_for(lambda state: state.cause == "human absent" and state.esc != "ARMING",
                               self.throttle.mark(), START_S)

    def press(self, button, *sticks):
        """Hold a deadman, and the sticks; ``None`` = let go."""
        self.inputs.hold(self.joy, gamepad(button, *sticks))

    def hold(self):
        """Hold the autonomous deadman until the car drives. A gamepad that was late is let go of."""
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
        self.drive_to(*(sum(getattr(point, axis) for point in circle) / len(circle) for axis in "xy"))

    def drive_to(self, x_m, y_m):
        """By the manual deadman, forward, to somewhere in the room with walls far enough from the way; then let go."""
        def is_there():
            pose, speed = self.truth.since()[-1].pose.pose, self.truth.since()[-1].twist.twist.linear.x
            dx_m, dy_m = x_m - pose.position.x, y_m - pose.position.y
            off_rad = math.remainder(math.atan2(dy_m, dx_m) - yaw_rad(pose.orientation), 2 * math.pi)
            self.press(MANUAL, max(-1.0, min(1.0, 1.5 * off_rad)), 0.55 if speed < 0.9 else 0.0)
            time.sleep(0.05)
            return math.hypot(dx_m, dy_m) < 0.7
        eventually(is_there, "the car there", START_S)
        self.press(MANUAL)
        self.wait_until_it_stands()
        self.press(None)
        self.throttle.wait_for(lambda state: state.cause == "human absent", self.throttle.mark())

    def wait_until_it_stands(self):
        """By odometry."""
        self.throttle.wait_for(lambda state: abs(state.speed) < 0.05, self.throttle.mark())

    def begin(self, *arguments):
        """Start it without sonars, until it waits for the deadman."""
        terminal = self.start("-o", self.table, *arguments)
        self.wait_for_line(terminal, "^waits: no deadman is held; hold the autonomous deadman and it begins")
        return terminal

    def marker(self, ns, index):
        """One of the newest markers."""
        def found(array):
            return [one for one in array.markers if (one.ns, one.id, one.action) == (ns, index, Marker.ADD)]
        return found(self.markers.wait_for(found, self.markers.mark()).what)[0]


class StickPerson:
    """Drives by the manual deadman, and holds the stick where the program's terminal says, as a thumb does.

    Args:
        test: with a terminal in which --stick runs.
        rng: of the thumb.
    """

    LOOKS_S = 0.3  # between two looks at the terminal
    SPEED_MPS = 0.9
    WALLS_M, AHEAD_M = (4.9, 3.9), 1.3  # of practice.launch's room, less what the car is long; and how far one looks

    def __init__(self, test, rng):
        self._test, self._rng = test, rng
        self._looked_s, self._lets_go = 0.0, False
        self._stick = self._aim = self._bias = 0.0
        self._turns_to = 0.0  # away from a wall

    def step(self):
        """Look, and move the sticks; 20 times a second."""
        now_s = time.monotonic()
        if self._lets_go:  # as the program asks for where the gamepad was late
            self._lets_go = False
            self._test.press(None)
            time.sleep(0.2)
        if now_s - self._looked_s >= self.LOOKS_S:
            self._looked_s = now_s
            self._look()
        truth = self._test.truth.since()[-1]
        steering = self._turn_away(truth)
        if not steering:
            self._stick += max(-0.12, min(0.12, self._aim + self._bias - self._stick))
            steering = self._stick + self._rng.gauss(0.0, 0.002)
        throttle = 0.35 + 0.5 * (self.SPEED_MPS - truth.twist.twist.linear.x)
        self._test.press(MANUAL, max(-1.0, min(1.0, steering)), max(0.0, min(0.7, throttle)))
        time.sleep(0.05)

    def _look(self):
        lines = [shown(line) for line in self._test.terminal.lines.since()[-30:]]
        at = max((index for index, line in enumerate(lines) if line.startswith("     hold at ")), default=-1)
        if at < 2:
            return
        target, held = re.match(r" +hold at (.*?); it is at (.*?)(?:;.*)?$", lines[at]).groups()
        text = " ".join(" ".join(lines[max(0, at - 3):at - 1]).split())
        self._lets_go = "let go" in text
        pushes = re.search(r"push to (.*?) first", text)
        aim = _value(pushes.group(1) if pushes else target)
        if abs(aim - self._aim) > 0.005:  # another place: where exactly the thumb comes to rest, nobody knows
            self._aim, self._bias = aim, self._rng.gauss(0.0, 0.03)
        elif held != "?" and not self._turns_to and abs(self._stick - aim - self._bias) < 0.01:
            self._bias += 0.6 * (aim - _value(held))

    def _turn_away(self, truth):
        """Full lock from where a wall comes near until the car looks inward; 0 = it is free."""
        x_m, y_m, yaw = truth.pose.pose.position.x, truth.pose.pose.position.y, yaw_rad(truth.pose.pose.orientation)
        inward_rad = math.remainder(math.atan2(-y_m, -x_m) - yaw, 2 * math.pi)
        ahead = abs(x_m + self.AHEAD_M * math.cos(yaw)), abs(y_m + self.AHEAD_M * math.sin(yaw))
        if any(one > wall for one, wall in zip(ahead, self.WALLS_M)) and not self._turns_to:
            self._turns_to = math.copysign(1.0, inward_rad)
        if abs(inward_rad) < 0.5:
            self._turns_to = 0.0
        return self._turns_to


def _value(words):
    """A stick's position by what the terminal says of it."""
    if words == "the middle":
        return 0.0
    percent, side = words.split("% ")
    return float(percent) / (100 if side.startswith("left") else -100)
