#!/usr/bin/env python3
"""The demo's graph with throttle drives, stops, stands for a while, and drives again, three times.

The throttle needs odometry that is not older than half a second: it must go on while the car stands. While it drives
forward the sonars ahead fire more often, by sonar_sequence_ahead, and all six in turn while it stands.
"""
from __future__ import annotations

import math
import unittest

import rospy
import rostest
from car_interface.msg import Control, Distance
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Joy
from std_msgs.msg import Float32

from waiting import Repeater, Sender, Topic, eventually, retried

STRAIGHT_M = 300.0
DRIVE_MPS2, BRAKE_MPS2 = 1.5, -2.0
PLANNER_BUTTON = 5  # as config/teleop_logi.yaml has it
SETTING_OFF_S = 8.0
STANDING_S = 3.0  # longer than any timeout in the chain
ROUNDS = 3
AHEAD, ALL = [1, 0, 1, 2, 1, 4], list(range(6))  # the first as the launch file has it


def gamepad(holds):
    """The planner's deadman, held or not, and the stick at rest."""
    return Joy(axes=[0.0] * 8, buttons=[int(holds and index == PLANNER_BUTTON) for index in range(11)])


def fires(distances, sequence):
    """Whether the newest reports are of the sonars of a sequence, twice in its order."""
    sensors = [heard.what.sensor for heard in distances.heard_since(0)][-3 * len(sequence):]
    rounds = 2 * sequence
    return any(sensors[begin:begin + len(rounds)] == rounds for begin in range(len(sequence)))


def control(acceleration_mps2):
    command = Control()
    command.longitudinal.acceleration = acceleration_mps2
    return command


class StopAndGoTest(unittest.TestCase):
    def test_car_sets_off_again_after_each_stop(self):
        human = Sender("/joy", Joy)
        radius = Sender("/av_turnrad_req", Float32)
        planner = Sender("/control/command/control_cmd", Control)
        odom = Topic("/odom", Odometry).connected()
        distances = Topic("/teensy_distance", Distance).connected()
        truth = Topic("/car_sim/truth", Odometry).connected()
        inputs = Repeater()
        self.addCleanup(inputs.end)
        inputs.hold(radius, Float32(STRAIGHT_M))
        inputs.hold(planner, control(0.0))
        inputs.hold(human, gamepad(False))
        odom.wait_for(lambda message: True)
        rospy.sleep(1.5)  # the e-stop was never heard: its timeout has to pass before the deadman counts
        inputs.hold(human, gamepad(True))

        def set_off():
            """Drive. On a busy machine the gamepad may have been silent: it has to let go and hold again then."""
            try:
                truth.wait_for(lambda message: message.twist.twist.linear.x > 1.0, truth.mark(), SETTING_OFF_S)
            except AssertionError:
                inputs.hold(human, gamepad(False))
                rospy.sleep(0.5)
                inputs.hold(human, gamepad(True))
                raise
        for _ in range(ROUNDS):
            mark, true_mark = odom.mark(), truth.mark()
            inputs.hold(planner, control(DRIVE_MPS2))
            retried(set_off)
            odom.wait_for(lambda message: abs(message.twist.twist.linear.x - 1.0) < 0.2, mark)
            inputs.hold(planner, control(0.0))
            eventually(lambda: fires(distances, AHEAD), "the sonars ahead, more often")
            inputs.hold(planner, control(BRAKE_MPS2))
            truth.wait_for(lambda message: message.twist.twist.linear.x < 0.05, true_mark)
            inputs.hold(planner, control(0.0))
            stop_mark = truth.mark()
            truth.wait_for(lambda message: message.twist.twist.linear.x == 0.0, stop_mark)
            stood_s = truth.heard_since(stop_mark)[-1].at_s
            mark = odom.mark()
            eventually(lambda mark=mark, stood_s=stood_s: odom.heard_since(mark)
                       and odom.heard_since(mark)[-1].at_s > stood_s + STANDING_S, "odometry of a car that stands")
            standing = odom.heard_since(mark)
            times_s = [heard.at_s for heard in standing]
            self.assertLess(max(after - before for before, after in zip(times_s, times_s[1:])), 1.0)
            self.assertGreater(len(standing), 2 * STANDING_S)
            self.assertEqual(standing[-1].what.twist.twist.linear.x, 0.0)
            eventually(lambda: fires(distances, ALL), "all sonars in turn")
        seen, real = odom.since()[-1].pose.pose.position, truth.since()[-1].pose.pose.position
        self.assertLess(math.hypot(seen.x - real.x, seen.y - real.y), 0.1)


if __name__ == "__main__":
    rospy.init_node("stop_and_go_test")
    rostest.rosrun("car_interface", "stop_and_go_test", StopAndGoTest)
