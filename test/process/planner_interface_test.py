#!/usr/bin/env python3
"""planner_interface by its topics: started by its launch file, one for each source. The wheelbase is 0.324 m."""
from __future__ import annotations

import math
import signal
import time
import unittest

import rospy
import rostest
from car_interface.msg import Control, PlannerState, ThrottleState
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from genpy.dynamic import generate_dynamic
from geometry_msgs.msg import Twist, TwistStamped
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Log
from std_msgs.msg import Bool, Float32, UInt8

from waiting import Repeater, Sender, Topic, delete_param, retried, start, start_node
from witness import measured

NAN, INF = math.nan, math.inf
HALF = 0.4636476  # rad, whose tangent is a half: a radius of two wheelbases
SILENT_MS = 550  # from a planner's last message to servo and ESC; here to the node's own messages, and less
# As ackermann_msgs' users have it: rosmsg md5 ackermann_msgs/AckermannDriveStamped.
ACKERMANN_MD5 = "1fd5d7f58889cefd44d29f6653240d0c"
ACKERMANN = "ackermann_msgs/AckermannDriveStamped"
Drive = generate_dynamic(ACKERMANN, "\n".join((
    "Header header", "AckermannDrive drive", "=" * 80, "MSG: std_msgs/Header", "uint32 seq", "time stamp",
    "string frame_id", "=" * 80, "MSG: ackermann_msgs/AckermannDrive", "float32 steering_angle",
    "float32 steering_angle_velocity", "float32 speed", "float32 acceleration", "float32 jerk", "")))[ACKERMANN]


def drive(angle=0.0, speed=0.0, acceleration=0.0, stamp=None):
    message = Drive()
    message.header.stamp = rospy.Time.now() if stamp is None else stamp
    message.drive.steering_angle, message.drive.speed, message.drive.acceleration = angle, speed, acceleration
    return message


def twist(linear=0.0, angular=0.0):
    message = Twist()
    message.linear.x, message.angular.z = linear, angular
    return message


def stamped(linear=0.0, angular=0.0):
    return TwistStamped(twist=twist(linear, angular))


def control(angle=0.0, velocity=0.0, acceleration=0.0):
    message = Control(stamp=rospy.Time.now())
    message.lateral.steering_tire_angle = angle
    message.longitudinal.velocity, message.longitudinal.acceleration = velocity, acceleration
    return message


def odometry(speed):
    message = Odometry()
    message.twist.twist.linear.x = speed
    return message


class PlannerTest(unittest.TestCase):
    NAMESPACE, TOPIC, TYPE = "/of_drive", "drive", Drive

    def setUp(self):
        space = self.NAMESPACE
        self.states = Topic(f"{space}/planner_interface/state", PlannerState).connected()
        self.radii = Topic(f"{space}/av_turnrad_req", Float32)
        self.controls = Topic(f"{space}/planner_interface/output/control_cmd", Control).connected()
        self.planner = Sender(f"{space}/{self.TOPIC}", self.TYPE)
        self.odom = Sender(f"{space}/odom", Odometry)
        self.throttle = Sender(f"{space}/throttle_arb/state", ThrottleState)
        self.inputs = Repeater()
        self.addCleanup(self.planner.close)
        self.addCleanup(self.inputs.end)
        self.inputs.hold(self.odom, odometry(0.0))

    def ask(self, message):
        """Send it from now on; the state in which the node has taken it."""
        self.inputs.hold(self.planner, message)

    def wait_for(self, wanted, since=None):
        return self.states.wait_for(wanted, self.states.mark() if since is None else since).what

    def wait_for_reason(self, reason):
        return self.wait_for(lambda state: state.reason == reason)

    def wait_for_radius(self, radius):
        self.radii.wait_for(lambda message: message.data == radius or abs(message.data - radius) < 1e-3,
                            self.radii.mark())


class OfDrive(PlannerTest):
    def test_class_has_the_md5_of_its_package(self):
        self.assertEqual((Drive._type, Drive._md5sum), (ACKERMANN, ACKERMANN_MD5))
        self.assertEqual(self.planner.publish.__self__.get_num_connections(), 1)  # rospy compares the MD5s

    def test_command_becomes_radius_acceleration_and_gear(self):
        for angle, radius in ((HALF, 0.648), (-HALF, -0.648), (0.0, INF)):
            self.ask(drive(angle, 1.0))
            self.wait_for_radius(radius)
        state = self.wait_for_reason("drive asks for 1.00 m/s, straight on")
        self.assertEqual((state.source, state.cause, state.gear, state.speed), ("drive", "planner", "drive", 1.0))
        command = self.controls.wait_for(lambda message: message.longitudinal.acceleration > 1.0,
                                         self.controls.mark()).what
        self.assertEqual(command.lateral.steering_tire_angle, 0.0)
        self.assertTrue(command.longitudinal.is_defined_acceleration)
        self.assertLessEqual(command.longitudinal.velocity, 1.0)
        self.ask(drive(HALF, -1.0))
        state = self.wait_for(lambda state: state.gear == "reverse")
        self.controls.wait_for(lambda message: message.longitudinal.acceleration < -0.5, self.controls.mark())
        self.wait_for_radius(0.648)

    def test_gear_changes_at_standstill_only(self):
        self.inputs.hold(self.odom, odometry(0.0))
        self.ask(drive(0.0, 1.0))
        self.wait_for(lambda state: state.gear == "drive")
        self.inputs.hold(self.odom, odometry(2.0))
        self.ask(drive(0.0, -1.0))
        state = self.wait_for(lambda state: "it stops before REVERSE: it rolls at 2.00 m/s" in state.reason)
        self.assertEqual(state.gear, "drive")
        self.inputs.hold(self.odom, odometry(0.0))
        self.wait_for(lambda state: state.gear == "reverse" and state.reason.endswith("straight on"))

    def test_silence_is_a_radius_of_0_and_a_stop_at_once_and_then_nothing(self):
        def attempt():
            mark, radius_mark, control_mark = self.states.mark(), self.radii.mark(), self.controls.mark()
            self.ask(drive(HALF, 1.0))
            self.wait_for(lambda state: state.cause == "planner", mark)
            self.controls.wait_for(lambda message: message.longitudinal.acceleration > 0, control_mark)
            self.inputs.drop(self.planner)
            self.planner.publish(drive(HALF, 1.0))
            sent_s = time.monotonic()
            stopped = self.states.wait_for(lambda state: state.cause == "planner silent", mark)
            none = self.radii.wait_for(lambda message: message.data == 0.0, radius_mark)
            brake = self.controls.wait_for(lambda message: message.longitudinal.acceleration == -3.0, control_mark)
            self.assertRegex(stopped.what.reason, r"^drive silent for 0\.5\d s$")
            for message in (stopped, none, brake):
                self.assertLess(1000 * (message.at_s - sent_s), SILENT_MS)
                self.assertGreater(1000 * (message.at_s - sent_s), 480)
            quiet = self.radii.mark(), self.controls.mark()
            self.wait_for(lambda state: state.source_age > 1.0)
            self.assertEqual((self.radii.since(quiet[0]), self.controls.since(quiet[1])), ([], []))
        measured(attempt)

    def test_what_cannot_be_obeyed_stops_at_once_and_says_why(self):
        for message, cause, reason in (
                (drive(NAN, 1.0), "request not finite", "drive: drive.steering_angle is nan, no number to act on"),
                (drive(0.1, INF), "request not finite", "drive: drive.speed is inf, no number to act on"),
                (drive(20.0, 1.0), "request refused",
                 ("drive: drive.steering_angle of 20 rad (degrees?): no wheel turns so far; refused until it was sane "
                  "for 2 s"))):
            self.ask(drive(HALF, 1.0))
            self.wait_for(lambda state: state.cause == "planner")
            mark = self.radii.mark()
            self.ask(message)
            state = self.wait_for_reason(reason)
            self.assertEqual((state.cause, state.turn_radius, state.speed), (cause, 0.0, 0.0))
            self.radii.wait_for(lambda radius: radius.data == 0.0, mark)

    def test_without_odometry_the_steering_goes_on_and_the_state_is_a_stop(self):
        self.ask(drive(HALF, 1.0))
        self.wait_for(lambda state: state.cause == "planner")
        self.inputs.drop(self.odom)
        state = self.wait_for(lambda state: state.cause == "odometry silent")
        self.assertRegex(state.reason, "drive asks for 1.00 m/s, .*; odometry silent for 0.5. s")
        self.wait_for_radius(0.648)

    def test_sources_of_5_and_200_hz_are_followed(self):
        self.inputs.hold(self.odom, odometry(0.0))
        for period_s in (0.2, 0.005):
            source = Repeater(period_s)
            self.addCleanup(source.end)
            source.hold(self.planner, drive(HALF, 1.0))
            self.wait_for(lambda state: state.cause == "planner")

            def attempt():
                mark = self.states.mark()
                rospy.sleep(1.5)
                self.assertEqual({state.cause for state in self.states.since(mark)}, {"planner"})
            retried(attempt)
            source.end()

    def test_stamp_from_the_future_is_told_and_obeyed(self):
        log = Topic("/rosout", Log).connected(5)
        self.addCleanup(log.close)
        self.ask(drive(HALF, 1.0, stamp=rospy.Time.now() + rospy.Duration(1000)))
        self.wait_for(lambda state: state.cause == "planner")
        log.wait_for(lambda entry: entry.name.startswith("/of_drive") and entry.msg.startswith(
            "the stamp of drive is 1000 s in the future") or "999 s in the future" in entry.msg)

    def test_other_sources_are_counted_and_named_and_not_obeyed(self):
        other = Sender(f"{self.NAMESPACE}/cmd_vel", Twist)
        self.addCleanup(other.close)
        self.ask(drive(HALF, 1.0))
        for _ in range(3):
            other.publish(twist(2.0, 0.0))
        state = self.wait_for(lambda state: "cmd_vel: 3 messages" in state.others)
        self.assertEqual(state.others, f"cmd_vel: 3 messages, the last from {rospy.get_name()}")
        self.assertEqual(state.speed, 1.0)

    def test_limits_are_told(self):
        self.ask(drive(0.0, 9.0))
        self.wait_for_reason("drive asks for 9.00 m/s, straight on; 9.00 m/s is above max_speed 3 m/s")

    def test_while_a_human_drives_it_begins_anew_at_the_measured_speed(self):
        self.inputs.hold(self.throttle, ThrottleState(source=ThrottleState.TELEOP, asked=1.0, granted=1.0))
        self.inputs.hold(self.odom, odometry(1.5))
        self.ask(drive(0.0, 0.5))
        self.wait_for(lambda state: abs(state.reference_speed - 1.5) < 0.1)
        self.inputs.hold(self.throttle, ThrottleState(source=ThrottleState.PLANNER))
        self.wait_for(lambda state: abs(state.reference_speed - 0.5) < 0.01)


class OfRate(PlannerTest):
    NAMESPACE, TOPIC, TYPE = "/of_rate", "cmd_vel", Twist

    def test_rate_by_speed_is_the_curvature(self):
        for linear, angular, radius in ((1.0, 0.5, 2.0), (1.0, -0.5, -2.0), (-1.0, 0.5, -2.0), (-1.0, -0.5, 2.0),
                                        (1.0, 0.0, INF)):
            self.ask(twist(linear, angular))
            self.wait_for_radius(radius)
        self.ask(twist(0.0, 0.5))
        state = self.wait_for(lambda state: state.cause == "request refused")
        self.assertEqual(state.reason,
                         "cmd_vel: angular.z is 0.5 rad/s at linear.x 0 m/s: a car can't turn on the spot")
        diagnostics = Topic("/diagnostics", DiagnosticArray)
        self.addCleanup(diagnostics.close)
        diagnostics.wait_for(lambda array: any(
            status.name == "of_rate/planner_interface: planner" and status.level == DiagnosticStatus.WARN
            and status.message == state.reason for status in array.status))

    def test_second_publisher_is_named(self):
        diagnostics = Topic("/diagnostics", DiagnosticArray)
        self.addCleanup(diagnostics.close)
        self.ask(twist(1.0, 0.5))
        second = start(self, "rostopic", "pub", "-r", "5", "/of_rate/cmd_vel", "geometry_msgs/Twist", "{}")
        self.addCleanup(second.end)
        text = "2 nodes publish on /of_rate/cmd_vel, "
        diagnostics.wait_for(lambda array: any(
            status.name == "of_rate/planner_interface: command topics" and status.message.startswith(text)
            and rospy.get_name() in status.message for status in array.status), 0, 40)

    def test_zero_keeps_the_arc_that_it_stops_on(self):
        self.ask(twist(1.0, 0.5))
        self.wait_for_radius(2.0)
        self.ask(twist())
        self.wait_for_reason("cmd_vel asks for 0.00 m/s, a radius of 2.00 m")


class OfStamped(PlannerTest):
    NAMESPACE, TOPIC, TYPE = "/of_rate", "cmd_vel", TwistStamped

    def test_twist_with_a_stamp_is_taken_on_the_same_topic(self):
        self.ask(stamped(1.0, 0.5))
        self.wait_for_radius(2.0)
        self.wait_for_reason("cmd_vel asks for 1.00 m/s, a radius of 2.00 m")


class WrongType(PlannerTest):
    NAMESPACE, TOPIC, TYPE = "/of_rate", "cmd_vel", Bool

    def test_another_type_is_named_with_its_node_and_is_not_obeyed(self):
        diagnostics = Topic("/diagnostics", DiagnosticArray)
        self.addCleanup(diagnostics.close)
        self.ask(Bool(True))
        text = ("publishes std_msgs/Bool on /of_rate/cmd_vel, which takes geometry_msgs/Twist or "
                "geometry_msgs/TwistStamped: none of its messages is received")
        diagnostics.wait_for(lambda array: any(
            status.name == "of_rate/planner_interface: command topics" and status.level == DiagnosticStatus.ERROR
            and status.message.startswith(f"{rospy.get_name()} on ") and status.message.endswith(text)
            for status in array.status))
        self.wait_for(lambda state: state.cause in ("planner silent", "no request"))


class OfAngle(PlannerTest):
    NAMESPACE, TOPIC, TYPE = "/of_angle", "cmd_vel", Twist

    def test_angle_is_the_wheels_whichever_way_it_drives(self):
        for linear, radius in ((1.0, 0.648), (-1.0, 0.648), (0.0, 0.648)):
            self.ask(twist(linear, HALF))
            self.wait_for(lambda state, linear=linear: state.speed == linear)
            self.wait_for_radius(radius)


class OfAutoware(PlannerTest):
    NAMESPACE, TOPIC, TYPE = "/of_autoware", "control/command/control_cmd", Control

    def test_gear_says_which_way_and_its_acceleration_is_the_gear_s(self):
        gear = Sender(f"{self.NAMESPACE}/control/command/gear_cmd", UInt8)
        self.addCleanup(gear.close)
        self.inputs.hold(gear, UInt8(2))
        self.ask(control(HALF, 1.0, 0.5))
        self.wait_for_reason("autoware asks for 1.00 m/s, a radius of 0.65 m, gear DRIVE")
        self.controls.wait_for(lambda message: message.longitudinal.acceleration > 0.1, self.controls.mark())
        self.inputs.hold(gear, UInt8(20))
        self.wait_for_reason("autoware: longitudinal.velocity is 1 m/s in gear REVERSE")
        self.ask(control(HALF, -1.0, 0.5))
        state = self.wait_for_reason("autoware asks for -1.00 m/s, a radius of 0.65 m, gear REVERSE")
        self.assertEqual(state.gear, "reverse")
        self.controls.wait_for(lambda message: message.longitudinal.acceleration < -0.1, self.controls.mark())
        self.inputs.hold(gear, UInt8(1))
        self.wait_for(lambda state: state.gear == "neutral")
        self.inputs.hold(gear, UInt8(22))
        self.wait_for_reason("autoware asks for 0.00 m/s, a radius of 0.65 m, gear PARK")


class OfSpeed(PlannerTest):
    NAMESPACE, TOPIC, TYPE = "/of_speed", "av_speed_req", Float32

    def test_speed_alone_leaves_the_steering_to_others(self):
        self.ask(Float32(1.0))
        state = self.wait_for_reason("speed asks for 1.00 m/s")
        self.assertEqual(state.turn_radius, 0.0)
        self.controls.wait_for(lambda message: message.longitudinal.acceleration > 0.5, self.controls.mark())
        self.assertNotIn("/of_speed/av_turnrad_req", dict(rospy.get_published_topics("/of_speed")))
        self.ask(Float32(NAN))
        self.wait_for_reason("speed: av_speed_req is nan, no number to act on")


class ByItself(unittest.TestCase):
    def setUp(self):
        self.states = Topic("/alone/state", PlannerState)
        self.addCleanup(delete_param, "/alone")
        self.process = start_node(self, "planner_interface", "_source:=drive", "~input/odometry:=/odom",
                                  "drive:=/alone_drive", name="alone")
        self.planner, self.odom = Sender("/alone_drive", Drive), Sender("/odom", Odometry)
        self.inputs = Repeater()
        self.addCleanup(self.planner.close)
        self.addCleanup(self.inputs.end)
        self.inputs.hold(self.odom, odometry(0.0))
        self.inputs.hold(self.planner, drive(HALF, 1.0))
        self.states.wait_for(lambda state: state.cause == "planner", self.states.mark())

    def test_what_a_planner_sent_while_the_node_was_frozen_is_not_obeyed_later(self):
        self.process.send(signal.SIGSTOP)
        rospy.sleep(1.0)  # the planner goes on all that time, and dies before the node wakes
        self.inputs.drop(self.planner)
        self.planner.publish(drive(HALF, 1.0))
        mark = self.states.mark()
        self.process.send(signal.SIGCONT)
        self.states.wait_for(lambda state: state.source_age > 1.5, mark)
        self.assertEqual({state.cause for state in self.states.since(mark)}, {"planner silent"})
        self.process.wait_for_line(r"node stood still for \d\.\d\d s: what was sent meanwhile is dropped; what is sent "
                                   "from now on counts")
        self.inputs.hold(self.planner, drive(HALF, 1.0))
        self.states.wait_for(lambda state: state.cause == "planner", self.states.mark())

    def test_end_of_the_node_is_a_stop_in_its_state(self):
        mark = self.states.mark()
        self.process.send(signal.SIGINT)
        state = self.states.wait_for(lambda state: state.cause == "no request", mark).what
        self.assertEqual((state.reason, state.turn_radius), ("planner_interface has ended", 0.0))
        self.assertEqual(self.process.wait_for_exit(), 0)


class BadParameters(unittest.TestCase):
    def test_start_without_a_source_or_with_bad_numbers_is_refused_in_one_line(self):
        sources = "one of drive, cmd_vel, autoware, speed"
        for arguments, line in (((), f"source is missing; accepted: {sources}"),
                                (("_source:=joystick",), f"source is 'joystick'; accepted: {sources}"),
                                (("_source:=drive", "_max_speed:=0.05"),
                                 "max_speed is 0.05; accepted: a number from 0.2 to 100.0"),
                                (("_source:=drive", "_source_timeout:=2"),
                                 "source_timeout is 2; accepted: a number from 0.05 to 0.5"),
                                (("_source:=drive", "_max_sped:=2"), "unknown parameter max_sped is 2; .*")):
            process = start_node(self, "planner_interface", *arguments, name="refused_planner")
            process.wait_for_line(line)
            self.assertEqual(process.wait_for_exit(), 1)
            delete_param("/refused_planner")


if __name__ == "__main__":
    rospy.init_node("planner_interface_test")
    rostest.rosrun("car_interface", "planner_interface_test", "__main__")
