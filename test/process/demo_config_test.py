#!/usr/bin/env python3
"""The demo with a car's own files, the package's files that it leaves alone, its port, and the walls of its room."""
from __future__ import annotations

import hashlib
import os
import shutil
import signal
import tempfile
import unittest
from pathlib import Path

import rospy
import rostest
import yaml
from dynamic_reconfigure.client import Client
from nav_msgs.msg import Odometry
from std_msgs.msg import Int32, Int32MultiArray
from std_srvs.srv import Trigger

from waiting import PACKAGE, Sender, Topic, config, start, start_node

DRIVE_WITHIN_S = 120
SHIPPED = Path(PACKAGE) / "config"
NEUTRAL, FORWARD, REVERSE, STRAIGHT, FULL_LEFT = 4915, 5500, 4300, 5070, 3800
WALL_M, NOSE_M = 6.0, 0.426  # the room's, along x; from the rear axle


def digests(folder):
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(folder.iterdir())}


def rewrite(path, **changes):
    """Change values at the top of a YAML file."""
    values = yaml.safe_load(path.read_text(encoding="utf-8"))
    path.write_text(yaml.safe_dump({**values, **changes}), encoding="utf-8")


class DemoTest(unittest.TestCase):
    def setUp(self):
        self.folder = Path(tempfile.mkdtemp(prefix="demo_config_test"))
        self.addCleanup(shutil.rmtree, str(self.folder))
        self.port = str(self.folder / "teensy")

    def launch(self, *arguments):
        """The demo; each in a namespace of its own, so that nothing of an earlier one is taken for it."""
        demo = start(self, "roslaunch", "car_interface", "demo.launch", f"port:={self.port}", *arguments)
        self.addCleanup(demo.end)
        return demo

    def call(self, service):
        rospy.wait_for_service(service, 30)
        return rospy.ServiceProxy(service, Trigger)()


class DemoWithOwnFiles(DemoTest):
    def my_car(self):
        """Files of a car that differs in everything: channels, a reversed servo, ESC, wheels, gamepad."""
        mine = self.folder / "my_car"
        shutil.copytree(str(SHIPPED), str(mine))
        steering, throttle = config("turn_arb.yaml"), config("throttle.yaml")
        rewrite(mine / "turn_arb.yaml", servo_channel=6, servo_left=6600, servo_center=5200, servo_right=3900,
                k_pwmcmd_left_table_servo=[duty - 100 for duty in steering["k_pwmcmd_right_table_servo"][:-1]] + [5200],
                k_pwmcmd_right_table_servo=[duty + 100 for duty in steering["k_pwmcmd_left_table_servo"]])
        servo = throttle["servo"]
        rewrite(mine / "throttle.yaml", servo={**servo, "channel": 9, "neutral": servo["neutral"] + 80,
                                               "duty_table": [duty + 80 for duty in servo["duty_table"]]})
        rewrite(mine / "teensy_sensor_hub.yaml", wheel_diameter=0.12, track=0.25, pulses_per_revolution=12)
        rewrite(mine / "teleop_logi.yaml", steer_axis=9, manual_button=1, autonomous_button=12, steer_scale=-1.0)
        return mine

    def test_every_node_takes_the_files_that_config_names_and_the_drive_goes_as_planned(self):
        mine, before = self.my_car(), digests(SHIPPED)
        outputs = Topic("/mine/servo/output", Int32MultiArray)
        demo = self.launch("ns:=mine", f"config:={mine}")
        outputs.wait_for(lambda message: message.data[6] > 6000, within_s=60)  # the human's circle, to the left
        self.assertEqual(rospy.get_param("/mine/teensy_sensor_hub/wheel_diameter"), 0.12)
        self.assertEqual(rospy.get_param("/mine/turn_arb/servo_channel"), 6)
        Client("/mine/turn_arb", timeout=15).update_configuration({"servo_center": 5205})
        answer = self.call("/mine/turn_arb/save")
        self.assertTrue(answer.success, answer.message)
        self.assertRegex(answer.message, f"^saved to {mine}/turn_arb.yaml, the old one is {mine}/turn_arb.yaml.bak-")
        demo.wait_for_exit(DRIVE_WITHIN_S)
        shown = "\n".join(demo.stdout.since() + demo.stderr.since())
        self.assertIn("as planned: yes", shown)
        self.assertNotIn("Traceback", shown)
        self.assertNotIn("ran into something", shown)
        self.assertEqual(digests(SHIPPED), before)


class DemoWithThePackagesFiles(DemoTest):
    def test_save_leaves_the_package_as_it_is_by_whatever_path_it_is_named(self):
        link = self.folder / "package"
        link.symlink_to(PACKAGE)
        before = digests(SHIPPED)
        for number, (shown, arguments) in enumerate(((SHIPPED, ()), (link / "config", ("one_process:=true",)))):
            with self.subTest(str(shown)):
                ns = f"shipped{number}"
                named = [f"config:={shown}"] if arguments else []
                demo = self.launch(f"ns:={ns}", "drive:=false", *named, *arguments)
                for node, name in (("turn_arb", "turn_arb"), ("throttle_arb", "throttle")):
                    answer = self.call(f"/{ns}/{node}/save")
                    self.assertFalse(answer.success)
                    self.assertEqual(answer.message, (
                        f"not saved: {shown}/{name}.yaml is the package's own, which the demo leaves as it is. Copy "
                        f"the folder (cp -r {shown} ~/my_car) and start the demo with config:=$HOME/my_car"))
                demo.end()
        self.assertEqual(digests(SHIPPED), before)


class TwoDemos(DemoTest):
    def test_second_demo_on_the_same_port_ends_with_one_line_and_the_first_drives_on(self):
        first = start_node(self, "car_sim", "__ns:=first", f"_port:={self.port}")
        first.wait_for_info("a virtual Teensy is on")
        link = os.readlink(self.port)
        second = self.launch("ns:=second", "drive:=false")
        second.wait_for_exit(60)
        lines = [line for line in second.stderr.since() + second.stdout.since() if "in use by another car_sim" in line]
        self.assertEqual(len(lines), 1, lines)
        self.assertRegex(lines[0], rf"port {self.port} is in use by another car_sim \(process \d+\); accepted: a path "
                                   rf"that no other car_sim uses: end that one, or start this one with another port, "
                                   rf"e\.g\. port:={self.port}_2")
        self.assertNotIn("Traceback", "\n".join(second.stderr.since() + second.stdout.since()))
        self.assertEqual(os.readlink(self.port), link)
        self.assertTrue(first.runs())

    def test_link_that_a_killed_car_sim_left_behind_is_replaced(self):
        killed = start_node(self, "car_sim", "__ns:=killed", f"_port:={self.port}")
        killed.wait_for_info("a virtual Teensy is on")
        link = os.readlink(self.port)
        killed.end(signal.SIGKILL)
        self.assertEqual(os.readlink(self.port), link)
        start_node(self, "car_sim", "__ns:=after", f"_port:={self.port}").wait_for_info("a virtual Teensy is on")
        self.assertTrue(os.path.exists(self.port))


class Walls(DemoTest):
    def test_wall_stops_the_car_which_is_logged_once_and_it_backs_out(self):
        node = start_node(self, "car_sim", "__ns:=walls", f"_port:={self.port}", "_start:=[4.5, 0, 0]",
                          "/servo/output:=servo/output")
        truth = Topic("/walls/car_sim/truth", Odometry).connected()
        collisions = Topic("/walls/car_sim/collisions", Int32).connected()
        output = Sender("/walls/servo/output", Int32MultiArray)
        collisions.wait_for(lambda message: message.data == 0)
        output.publish(self.duties(FORWARD))
        collisions.wait_for(lambda message: message.data == 1)
        standing = truth.wait_for(lambda message: message.twist.twist.linear.x == 0.0, truth.mark()).what
        self.assertAlmostEqual(standing.pose.pose.position.x, WALL_M - NOSE_M, delta=0.01)
        mark = truth.mark()
        pushing = truth.wait_for_count(50, mark)  # a second
        self.assertLess(abs(pushing[-1].pose.pose.position.x - WALL_M + NOSE_M), 0.01)
        output.publish(self.duties(REVERSE))
        truth.wait_for(lambda message: message.pose.pose.position.x < 5.0)
        self.assertEqual([message.data for message in collisions.since()], [0, 1])
        warnings = [line for line in node.stderr.since() if "ran into something" in line]
        self.assertEqual(len(warnings), 1, warnings)
        self.assertRegex(warnings[0], r"the car ran into something at \d\.\d\d m/s and stands, its wheels stalled "
                                      r"\(collision 1\): drive it out the way it came")

    def test_a_turn_too_fast_tips_the_car_over_which_is_counted_and_logged(self):
        node = start_node(self, "car_sim", "__ns:=tips", f"_port:={self.port}", "_collisions:=false",
                          "_rollover:=3.0", "/servo/output:=servo/output")
        rollovers = Topic("/tips/car_sim/rollovers", Int32).connected()
        output = Sender("/tips/servo/output", Int32MultiArray)
        rollovers.wait_for(lambda message: message.data == 0)
        output.publish(self.duties(FORWARD, FULL_LEFT))
        rollovers.wait_for(lambda message: message.data == 1)
        line = node.wait_for_line("tipped over")
        self.assertRegex(line, r"the car would have tipped over: 3\.\d m/s² sideways at \d\.\d m/s \(rollover 1\)")

    @staticmethod
    def duties(esc, steering=STRAIGHT):
        return Int32MultiArray(data=[steering, esc] + [-1] * 14)

    def test_car_that_would_start_in_a_wall_is_refused(self):
        node = start_node(self, "car_sim", "__ns:=inside", f"_port:={self.port}", "_start:=[5.9, 0, 0]")
        self.assertEqual(node.wait_for_exit(), 1)
        line = node.wait_for_line("start is")
        self.assertIn("start is [5.9, 0.0, 0.0]; accepted: a place where the car touches no wall, box or post, or "
                      "collisions: false", line)


if __name__ == "__main__":
    rospy.init_node("demo_config_test")
    rostest.rosrun("car_interface", "demo_config_test", "__main__")
