#!/usr/bin/env python3
"""The examples of docs/planners.md, each on a virtual car: what it does with them, and what when they die."""
from __future__ import annotations

import os
import shutil
import signal
import tempfile
import unittest

import rospy
import rostest
from car_interface.msg import PlannerState, SteeringState, ThrottleState
from nav_msgs.msg import Odometry
from rospy import AnyMsg
from sensor_msgs.msg import Joy
from std_msgs.msg import Int32MultiArray

from waiting import PACKAGE, NodeProcess, Repeater, Sender, Topic, eventually, start
from witness import measured

EXAMPLES = os.path.join(PACKAGE, "docs", "examples")
PLANNER_BUTTON = 5  # as config/teleop_logi.yaml has it
CENTER, NEUTRAL, COUNT = 5100, 4915, 16
SILENT_MS = 550
LAUNCH_S, DRIVE_S = 60, 40
TOLERANCE = 0.2  # of the curvature: a count of the servo board is a sixth of it where the shipped table is steep
AVERAGED = 50  # messages of the true speed: a second


def gamepad(holds):
    """The planner's deadman, held or not, and the stick at rest."""
    return Joy(axes=[0.0] * 8, buttons=[int(holds and index == PLANNER_BUTTON) for index in range(11)])


class Stack(unittest.TestCase):
    """A car for one source, its deadman held.

    Attributes:
        SPACE: the car's namespace: nothing of another one is taken for this.
        PLANNER: the launch file's argument.
        EXAMPLE: the program, with its arguments.
        TOPICS: what it sends.
    """

    SPACE, PLANNER, EXAMPLE, TOPICS = "", "", (), ()

    def setUp(self):
        if not self.EXAMPLE:
            self.skipTest("the base of the others")
        folder = tempfile.mkdtemp(prefix="planners_test")
        self.addCleanup(shutil.rmtree, folder, ignore_errors=True)
        car = start(self, "roslaunch", "car_interface", "demo.launch", f"ns:={self.SPACE}", "drive:=false",
                    f"planner:={self.PLANNER}", "collisions:=false", f"port:={folder}/teensy", *self.launch_arguments())
        self.addCleanup(car.end)
        space = f"/{self.SPACE}"
        self.truth = Topic(f"{space}/car_sim/truth", Odometry)
        self.outputs = Topic(f"{space}/servo/output", Int32MultiArray)
        self.states = Topic(f"{space}/planner_interface/state", PlannerState)
        self.throttle = Topic(f"{space}/throttle_arb/state", ThrottleState)
        self.steering = Topic(f"{space}/turn_arb/state", SteeringState)
        self.sent = [Topic(f"{space}/{topic}", AnyMsg) for topic in self.TOPICS]
        joy = Sender(f"{space}/joy", Joy) if self.is_up(space) else None
        self.inputs = Repeater()
        self.addCleanup(self.inputs.end)
        self.inputs.hold(joy, gamepad(False))
        self.joy = joy
        self.throttle.wait_for(lambda state: state.cause == "human absent" and state.esc != "ARMING", 0, LAUNCH_S)
        self.inputs.hold(joy, gamepad(True))

    def launch_arguments(self):
        return ()

    def is_up(self, space):
        for topic in (self.truth, self.outputs, self.states, self.throttle, self.steering):
            topic.wait_for(lambda _: True, 0, LAUNCH_S)
        return eventually(lambda: rospy.get_param(f"{space}/teleop_logi", None), "teleop_logi's parameters", LAUNCH_S)

    def begin(self, *arguments):
        """Start the example."""
        process = NodeProcess("python3", os.path.join(EXAMPLES, self.EXAMPLE[0]), *self.EXAMPLE[1:], *arguments,
                              env={"ROS_NAMESPACE": f"/{self.SPACE}"})
        self.addCleanup(process.clean_up)
        return process

    def drives(self, speed, curvature):
        """Wait until the car drives so, in truth, by the mean of a second."""
        linear = angular = 0.0
        for _ in range(DRIVE_S):
            self.rearm()
            newest = [message.twist.twist for message in self.truth.wait_for_count(AVERAGED, self.truth.mark())]
            linear = sum(twist.linear.x for twist in newest) / len(newest)
            angular = sum(twist.angular.z for twist in newest) / len(newest)
            if abs(linear / speed - 1) < 0.03 and abs(angular / linear - curvature) < TOLERANCE * abs(curvature):
                return
        self.fail(f"{linear} m/s and {angular} rad/s; {self.states.since()[-1:]}, {self.throttle.since()[-1:]}, "
                  f"{self.steering.since()[-1:]}")

    def rearm(self):
        """On a busy machine the gamepad may have been silent: let go and hold again."""
        if "let go" in self.throttle.wait_for(lambda _: True, self.throttle.mark()).what.reason:
            self.inputs.hold(self.joy, gamepad(False))
            self.throttle.wait_for(lambda state: state.cause == "human absent" and "let go" not in state.reason,
                                   self.throttle.mark())
            self.inputs.hold(self.joy, gamepad(True))

    def stands(self):
        mark = self.truth.mark()
        self.truth.wait_for(lambda message: message.twist.twist.linear.x == 0.0, mark, DRIVE_S)

    def kill_it_and_measure(self, begin):
        """Kill the example while it drives, and measure until servo and ESC are neutral."""
        def attempt():
            self.rearm()
            process = begin()
            self.truth.wait_for(lambda message: abs(message.twist.twist.linear.x) > 0.3, self.truth.mark(), DRIVE_S)
            mark = self.outputs.mark()
            process.send(signal.SIGKILL)
            process.wait_for_exit()
            neutral = self.outputs.wait_for(self.is_neutral, mark, DRIVE_S)
            last_s = max(topic.heard_since()[-1].at_s for topic in self.sent)
            took_ms = 1000 * (neutral.at_s - last_s)
            print(f"{self.EXAMPLE[0]} killed: servo and ESC are neutral {took_ms:.0f} ms after its last message")
            self.assertLess(took_ms, SILENT_MS)
            self.stands()
        measured(attempt, restore=self.stands)

    @staticmethod
    def is_neutral(output):
        return abs(output.data[0] - CENTER) <= COUNT and abs(output.data[1] - NEUTRAL) <= COUNT


class F1tenth(Stack):
    SPACE, PLANNER, EXAMPLE, TOPICS = "f1tenth", "drive", ("f1tenth_drive.py",), ("drive",)

    def test_ackermann_commands_drive_the_car_and_their_end_stops_it(self):
        example = self.begin()
        self.drives(1.0, 1 / 2.0)
        example.end()
        self.states.wait_for(lambda state: state.cause == "planner silent", self.states.mark())
        self.stands()
        self.rearm()
        self.throttle.wait_for(lambda state: state.cause == "planner silent"
                               and state.reason.startswith("drive silent for "), self.throttle.mark())
        self.kill_it_and_measure(self.begin)
        # It began again twice. A node that really stood still says so of the deadman first, which is let go and held.
        self.assertEqual([state.reason for state in self.throttle.since()
                          if state.reason == "the planner's value was not heard since messages were dropped"], [])


class MoveBase(Stack):
    SPACE, PLANNER, EXAMPLE, TOPICS = "move_base_car", "cmd_vel", ("cmd_vel.py",), ("cmd_vel",)

    def test_twists_drive_the_car_forward_and_backward(self):
        example = self.begin()
        self.drives(0.5, 1 / 2.0)
        example.end()
        self.stands()
        example = self.begin("--back")
        self.drives(-0.5, 1 / 2.0)
        example.end()
        self.stands()
        self.kill_it_and_measure(self.begin)


class Autoware(Stack):
    SPACE, PLANNER, EXAMPLE = "autoware_car", "autoware", ("autoware_control.py",)
    TOPICS = ("control/command/control_cmd",)

    def launch_arguments(self):
        return ("one_process:=true",)

    def test_control_and_gear_drive_the_car_forward_and_backward(self):
        example = self.begin()
        self.drives(1.0, -1 / 2.0)
        example.end()
        self.stands()
        example = self.begin("--back")
        self.drives(-1.0, -1 / 2.0)
        example.end()
        self.stands()
        self.kill_it_and_measure(self.begin)


class EndToEnd(Stack):
    SPACE, PLANNER, EXAMPLE = "end_to_end_car", "speed", ("end_to_end.py",)
    TOPICS = ("av_steer_req", "av_speed_req")

    def test_steering_without_a_radius_and_a_speed_drive_the_car(self):
        example = self.begin()
        self.drives(0.8, -0.485)  # duty 6652, by the virtual car's own curve
        self.steering.wait_for(lambda state: state.reason == "av_steer_req is -0.970", 0)
        example.end()
        self.stands()
        self.kill_it_and_measure(self.begin)


if __name__ == "__main__":
    rospy.init_node("planners_test")
    rostest.rosrun("car_interface", "planners_test", "__main__")
