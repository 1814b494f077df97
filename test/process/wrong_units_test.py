#!/usr/bin/env python3
"""Planners whose units are wrong, through planner_interface to turn_arb: what is obeyed, and what is told.

The car turns on 1 m to either side by the shipped table; its wheelbase is 0.324 m.
"""
from __future__ import annotations

import itertools
import math
import threading
import time
import unittest

import rospy
import rostest
from car_interface.msg import PlannerState, SteeringState
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Log
from std_msgs.msg import Bool, Float32

from planner_interface_test import Drive
from waiting import Repeater, Sender, Topic

LEFT, RIGHT = 3800, 6700  # the duties of the tightest turns
PERIOD_S = 0.05


def drive(angle_rad):
    message = Drive()
    message.drive.steering_angle, message.drive.speed = angle_rad, 1.0
    return message


def twist(linear, angular):
    message = Twist()
    message.linear.x, message.angular.z = linear, angular
    return message


def too_tight(radius, side="left"):
    return f"asks for {radius} m, this car turns on 1.00 m to the {side}: rad? rad/s? wheelbase?"


class Planner:
    """Publishes one message after the other, 20 times a second."""

    def __init__(self, test, sender, messages):
        self._sender, self._messages, self._ending = sender, iter(messages), threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()
        test.addCleanup(self.end)

    def _run(self):
        while not self._ending.wait(PERIOD_S):
            self._sender.publish(next(self._messages))

    def end(self):
        self._ending.set()
        self._thread.join()


class WrongUnits(unittest.TestCase):
    NAMESPACE, TOPIC, TYPE = "", "", None

    def setUp(self):
        if not self.NAMESPACE:
            self.skipTest("the base of the others")
        space = self.NAMESPACE
        self.states = Topic(f"{space}/planner_interface/state", PlannerState).connected()
        self.steering = Topic(f"{space}/turn_arb/state", SteeringState).connected()
        self.radii = Topic(f"{space}/av_turnrad_req", Float32).connected()
        self.diagnostics = Topic("/diagnostics", DiagnosticArray)
        self.log = Topic("/rosout", Log)
        for topic in (self.states, self.steering, self.radii, self.diagnostics, self.log):
            self.addCleanup(topic.close)
        self.planner = Sender(f"{space}/{self.TOPIC}", self.TYPE)
        self.addCleanup(self.planner.close)
        self.inputs = Repeater()
        self.addCleanup(self.inputs.end)
        odometry = Odometry()
        odometry.twist.twist.linear.x = 1.0
        self.inputs.hold(Sender(f"{space}/odom", Odometry, 2), odometry)
        self.inputs.hold(Sender(f"{space}/e_stop", Bool), Bool(False))
        human = Sender(f"{space}/teleop_logi/human_in_loop", Bool)
        self.inputs.hold(human, Bool(False))
        self.steering.wait_for(lambda state: state.cause == "human absent", self.steering.mark())
        self.inputs.hold(human, Bool(True))
        self.steering.wait_for(lambda state: state.source == SteeringState.NEUTRAL, self.steering.mark())

    def send(self, *messages):
        """Have the planner send these in turn from now on, and nothing else."""
        return Planner(self, self.planner, itertools.cycle(messages))

    def wait_for(self, wanted, topic=None, since=None):
        topic = topic or self.states
        return topic.wait_for(wanted, topic.mark() if since is None else since).what

    def report(self, name, wanted):
        """The first report of this name from now on that is wanted, and its values."""
        name = f"{self.NAMESPACE[1:]}/{name}"
        array = self.wait_for(lambda array: any(status.name == name and wanted(status) for status in array.status),
                              self.diagnostics)
        status = next(status for status in array.status if status.name == name and wanted(status))
        return status, {value.key: value.value for value in status.values}


class Angles(WrongUnits):
    """Ackermann angles in degrees."""

    NAMESPACE, TOPIC, TYPE = "/angles", "drive", Drive

    def test_a_swing_of_3_rad_is_refused_in_each_half_wave_until_it_was_sane_for_2_s(self):
        wave = [drive(3.0 * math.cos(2 * math.pi * tick / 40)) for tick in range(40)]
        degrees = self.send(*wave)
        first = self.wait_for(lambda state: state.cause == "request refused")
        self.assertRegex(first.reason, r"^drive: drive\.steering_angle of -?\d\S* rad \(degrees\?\): no wheel turns so "
                                       r"far; refused until it was sane for 2 s")
        marks = self.states.mark(), self.steering.mark(), self.radii.mark()
        self.wait_for(lambda state: state.refused > first.refused + 120)
        obeyed = [state for state in self.states.since(marks[0]) if state.cause == "planner"]
        steered = [state for state in self.steering.since(marks[1]) if state.source == SteeringState.PLANNER]
        radii = [message.data for message in self.radii.since(marks[2]) if message.data]
        self.assertEqual((obeyed, steered, radii), ([], [], []))
        self.report("planner_interface: planner", lambda status: status.level == DiagnosticStatus.WARN
                    and "(degrees?)" in status.message)
        degrees.end()
        self.planner.publish(drive(3.0))  # the wave may have ended among angles that wheels have
        began_s = time.monotonic()
        self.send(drive(0.2))
        self.wait_for(lambda state: state.cause == "request refused" and state.reason.endswith(" s more"))
        again = self.states.wait_for(lambda state: state.cause == "planner", self.states.mark())
        self.assertGreaterEqual(again.at_s - began_s, 2.0)
        self.wait_for(lambda state: state.source == SteeringState.PLANNER and state.turn_radius > 0, self.steering)

    def test_an_angle_that_a_wheel_might_have_and_this_car_has_not_is_cut_and_told(self):
        self.send(drive(-1.2))
        state = self.wait_for(lambda state: state.limit == "too tight", self.steering)
        self.assertEqual((state.duty, state.limit_reason), (RIGHT, too_tight("0.13", "right")))


class Rates(WrongUnits):
    """Twists, at 1 m/s."""

    NAMESPACE, TOPIC, TYPE = "/rates", "cmd_vel", Twist

    def test_degrees_per_second_are_cut_and_told_everywhere_and_once_in_the_log(self):
        mark = self.log.mark()
        self.send(twist(1.0, 5.73), twist(1.0, 0.0), twist(1.0, -5.73), twist(1.0, 0.0))
        for radius, side, duty in ((0.1745, "left", LEFT), (-0.1745, "right", RIGHT)):
            state = self.wait_for(lambda state, duty=duty: state.limit == "too tight" and state.duty == duty,
                                  self.steering)
            self.assertEqual((state.source, state.cause, state.limit_reason),
                             (SteeringState.PLANNER, "planner", too_tight("0.17", side)))
            self.assertAlmostEqual(state.asked_radius, radius, delta=1e-3)
            self.assertEqual((abs(state.turn_radius), state.max_speed), (1.0, 2.0))
        self.wait_for(lambda state: state.cause == "planner" and "this car turns on 1.00 m" in state.reason)
        swings = self.wait_for(lambda state: state.cuts > 20, self.steering)
        for name in ("turn_arb: steering", "planner_interface: planner"):
            _, values = self.report(name, lambda status: status.level == DiagnosticStatus.WARN
                                    and "this car turns on 1.00 m" in status.message)
            self.assertIn("degrees", values["remedy"])
        _, values = self.report("turn_arb: steering", lambda status: True)
        self.assertLess(int(values["warnings of too tight"]), swings.cuts / 4)  # one, unless this test stood still
        entries = [entry for entry in self.log.since(mark) if entry.name == "/rates/turn_arb"
                   and "this car turns on" in entry.msg]
        self.assertEqual([(entry.level, entry.msg) for entry in entries[:1]],
                         [(Log.WARN, f"the planner {too_tight('0.17')}")])

    def test_teleop_twist_keyboard_s_defaults_are_told_and_its_turn_on_the_spot_traps_nobody(self):
        """Its keys u, j and i, at its speed of 0.5 m/s and its turn of 1 rad/s."""
        u_key = self.send(twist(0.5, 1.0))
        state = self.wait_for(lambda state: state.limit == "too tight", self.steering)
        self.assertEqual((state.duty, state.limit_reason), (LEFT, too_tight("0.50")))
        u_key.end()
        j_key = self.send(twist(0.0, 1.0))
        state = self.wait_for(lambda state: state.cause == "request refused")
        self.assertEqual(state.reason, "cmd_vel: angular.z is 1 rad/s at linear.x 0 m/s: a car can't turn on the spot")
        j_key.end()
        mark = self.states.mark()
        self.send(twist(0.5, 0.0))
        self.wait_for(lambda state: state.cause == "planner" and state.turn_radius == math.inf)
        self.assertFalse([state.reason for state in self.states.since(mark) if "refused until" in state.reason])

    def test_the_car_s_own_tightest_turn_and_one_slightly_tighter_bother_nobody(self):
        for angular in (1.0, -1.0, 1.05, -1.05):
            planner = self.send(twist(1.0, angular))
            state = self.wait_for(lambda state, angular=angular: state.source == SteeringState.PLANNER
                                  and state.duty == (LEFT if angular > 0 else RIGHT), self.steering)
            self.assertEqual((state.limit, round(state.asked_radius, 3)), ("", round(1 / angular, 3)))
            planner.end()


if __name__ == "__main__":
    rospy.init_node("wrong_units_test")
    rostest.rosrun("car_interface", "wrong_units_test", "__main__")
