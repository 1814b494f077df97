#!/usr/bin/env python3
"""The car_display node on its topics: what it draws of the car, its trail and its steering."""
from __future__ import annotations

import math
import unittest

import rospy
import rostest
from car_interface.msg import SteeringState
from geometry_msgs.msg import Quaternion
from nav_msgs.msg import Odometry
from visualization_msgs.msg import Marker, MarkerArray

from waiting import PATIENCE_S, Repeater, Sender, Topic, eventually, rate_hz, retried, set_params, start, start_node

LINE, HEAD, WORDS = 0, 1, 2  # ids of what shows the steering
FRONT_LEFT, FRONT_RIGHT = 2, 3  # of the wheels


class Picture:
    """What one car's node draws, and what it hears."""

    def __init__(self, name="car_display", ns=""):
        self.markers = Topic(f"{ns}/{name}/markers", MarkerArray).connected()
        self.odometry = Sender(f"{ns}/odom", Odometry)
        self.states = Sender(f"{ns}/turn_arb/state", SteeringState)

    def wait_for(self, ns, index, wanted, within_s=PATIENCE_S):
        """The first marker of that name from now on that is ``wanted``."""
        def found(array):
            return [marker for marker in array.markers if (marker.ns, marker.id) == (ns, index) and wanted(marker)]
        return found(self.markers.wait_for(found, self.markers.mark(), within_s).what)[0]

    def go_to(self, x_m, y_m):
        message = Odometry()
        message.pose.pose.position.x, message.pose.pose.position.y = x_m, y_m
        message.pose.pose.orientation = Quaternion(0, 0, 0, 1)
        self.odometry.publish(message)

    def trail(self, length):
        """The trail's points, once there are that many."""
        marker = self.wait_for("trail", 0, lambda marker: len(marker.points) == length)
        return [(round(point.x, 3), round(point.y, 3)) for point in marker.points]


def heading_rad(wheel):
    """Where a wheel's cylinder, which lies on its side, rolls."""
    return 2 * math.atan2(wheel.pose.orientation.y, wheel.pose.orientation.x)


class CarDisplayTest(unittest.TestCase):
    """One node without a namespace and one with."""

    @classmethod
    def setUpClass(cls):
        cls.car, cls.car1 = Picture(), Picture(ns="/car1")

    def steer(self, radius_m, source=SteeringState.PLANNER):
        repeater = Repeater()
        self.addCleanup(repeater.end)
        repeater.hold(self.car.states, SteeringState(source=source, turn_radius=radius_m))

    def test_picture_comes_ten_times_a_second_and_at_once_to_whoever_comes_late(self):
        def steady():
            rate = rate_hz(self.car.markers, 3.0)
            self.assertGreater(rate, 9.0)
            self.assertLess(rate, 11.0)
        retried(steady)
        Topic("/car_display/markers", MarkerArray).connected().wait_for_count(1)

    def test_car_stands_on_the_ground_at_base_link(self):
        body = self.car.wait_for("body", 0, lambda _: True)
        self.assertEqual((body.header.frame_id, body.header.stamp), ("base_link", rospy.Time()))
        self.assertTrue(body.frame_locked)
        for index in range(4):
            wheel = self.car.wait_for("wheels", index, lambda _: True)
            self.assertAlmostEqual(wheel.pose.position.z, wheel.scale.x / 2)

    def test_frames_of_a_car_with_a_namespace_are_its_own(self):
        self.assertEqual(self.car1.wait_for("body", 0, lambda _: True).header.frame_id, "car1/base_link")
        self.assertEqual(self.car1.wait_for("trail", 0, lambda _: True).header.frame_id, "car1/odom")

    def test_arrow_bends_to_the_left_on_the_commanded_arc(self):
        self.steer(2.0)
        line = self.car.wait_for("steering", LINE, lambda marker: marker.points and marker.points[-1].y > 0)
        nose_m = line.points[0].x
        self.assertAlmostEqual(line.points[0].y, 0.0)
        for point in line.points:  # all of them as far from the middle of the turn as the nose
            self.assertAlmostEqual(math.hypot(point.x, point.y - 2.0), math.hypot(nose_m, 2.0), places=5)
        words = self.car.wait_for("steering", WORDS, lambda marker: marker.action == Marker.ADD)
        self.assertEqual(words.text, "PLANNER: left 2.0 m")

    def test_arrow_bends_to_the_right_and_the_front_wheels_look_there(self):
        self.steer(-1.0, SteeringState.TELEOP)
        self.car.wait_for("steering", WORDS, lambda marker: marker.text == "TELEOP: right 1.0 m")
        line = self.car.wait_for("steering", LINE, lambda marker: bool(marker.points))
        self.assertLess(line.points[-1].y, -0.3)
        left, right = (self.car.wait_for("wheels", index, lambda _: True) for index in (FRONT_LEFT, FRONT_RIGHT))
        # The wheelbase over each wheel's distance from the middle of the turn: 0.148 m more, or less, than 1 m.
        self.assertAlmostEqual(heading_rad(left), -math.atan(0.324 / 1.148), places=5)
        self.assertAlmostEqual(heading_rad(right), -math.atan(0.324 / 0.852), places=5)

    def test_arrow_of_a_car_that_shall_go_straight_on_is_straight(self):
        self.steer(math.inf)
        self.car.wait_for("steering", WORDS, lambda marker: marker.text == "PLANNER: straight on")
        line = self.car.wait_for("steering", LINE, lambda marker: marker.action == Marker.ADD)
        self.assertEqual({point.y for point in line.points}, {0.0})
        self.assertAlmostEqual(line.points[-1].x - line.points[0].x, 1.0)

    def test_arrow_goes_when_the_radius_is_unknown_or_the_command_falls_silent(self):
        self.steer(math.nan)
        self.car.wait_for("steering", LINE, lambda marker: marker.action == Marker.DELETE)
        self.steer(3.0)
        self.car.wait_for("steering", LINE, lambda marker: marker.action == Marker.ADD)
        self.doCleanups()
        for index in (LINE, HEAD, WORDS):
            self.car.wait_for("steering", index, lambda marker: marker.action == Marker.DELETE)

    def test_trail_has_a_point_every_five_centimetres_and_begins_anew_after_a_jump(self):
        car = self.car1
        car.go_to(100.0, 0.0)
        car.wait_for("trail", 0, lambda marker: marker.action == Marker.DELETE)  # a single point is no line
        for step in range(64):
            car.go_to(100 + step / 64, 0.0)
        car.go_to(math.nan, 0.0)
        self.assertEqual(car.trail(16), [(round(100 + step / 64, 3), 0.0) for step in range(0, 64, 4)])
        car.go_to(0.0, 0.0)
        car.go_to(0.0, 0.1)
        self.assertEqual(car.trail(2), [(0.0, 0.0), (0.0, 0.1)])

    def test_trail_has_the_newest_two_thousand_points(self):
        start_node(self, "car_display", "odom:=long_odom", name="long_trail")
        car = Picture("long_trail")
        car.odometry = Sender("/long_odom", Odometry)
        for index in range(2100):
            car.go_to(0.1 * index, 0.0)
            if index % 50 == 0:  # not faster than it can be taken
                eventually(lambda: car.markers.mark() >= index // 50, "another picture")
        self.assertEqual(car.trail(2000)[-1], (209.9, 0.0))

    def test_impossible_parameter_ends_the_node_with_one_line_that_names_it(self):
        set_params(self, "/odd_car", {"wheelbase": 0})
        node = start_node(self, "car_display", name="odd_car")
        self.assertEqual(node.wait_for_exit(), 1)
        node.wait_for_line(r"wheelbase is 0; accepted: a number above 0")

    def test_computer_without_a_screen_logs_one_line_instead_of_rviz_and_the_markers_are_there(self):
        launch = start(self, "env", "-u", "DISPLAY", "-u", "QT_QPA_PLATFORM", "roslaunch", "car_interface",
                       "display.launch", "ns:=blind")
        self.addCleanup(launch.end)
        line = launch.wait_for_line("no rviz")
        self.assertEqual(line, (
            "[WARN] no rviz: there is no screen (DISPLAY isn't set). The car's markers are published all the same: on "
            "a computer with a screen and this master, roslaunch car_interface display.launch"))
        Topic("/blind/car_display/markers", MarkerArray).wait_for(lambda message: True)
        self.assertNotIn("Traceback", "\n".join(launch.stderr.since() + launch.stdout.since()))


if __name__ == "__main__":
    rospy.init_node("car_display_test")
    rostest.rosrun("car_interface", "car_display_test", "__main__")
