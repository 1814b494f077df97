#!/usr/bin/env python3
"""What a node does that refuses a parameter: by hand it ends; where roslaunch would start it again it waits."""
from __future__ import annotations

import os
import shutil
import tempfile
import time
import unittest

import rosgraph
import rospy
import rostest
import yaml
from car_interface.msg import SteeringState
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

from car_interface.common import causes
from virtual_car import PACKAGE
from waiting import NodeProcess, Topic, config, eventually, executable, set_params, start

REFUSED = "servo_left is 'x'; accepted: an integer from 0 to 65535"
WAITS = "This node waits, and reads its parameters again in 1 s, later every 30 s"
LAUNCH_S = 60
RESPAWN_S = 2.5  # roslaunch's, with a respawn_delay of 1 s
RESPAWNED = {"CAR_INTERFACE_RESPAWN": "true"}


def wait_for_fatal(launch, text=""):
    """The first FATAL line with a text; roslaunch takes its time on a busy computer."""
    return launch.stderr.wait_for(lambda line: "FATAL" in line and text in line, within_s=LAUNCH_S).what


def fatal_lines(process):
    return [line for line in process.stderr.since() if "FATAL" in line]


class Refused(unittest.TestCase):
    def setUp(self):
        self.reports = Topic("/diagnostics", DiagnosticArray)
        self.addCleanup(self.reports.close)

    def report(self, name, level, since=0):
        """The first report of a node's parameters at a level."""
        def wanted(array):
            return any(status.name == f"{name}: parameters" and status.level == level for status in array.status)
        return self.reports.wait_for(wanted, since).what.status[0]

    def launch(self, **changes):
        """Start turn_arb.launch with some parameters changed."""
        folder = tempfile.mkdtemp()
        self.addCleanup(shutil.rmtree, folder, ignore_errors=True)
        path = os.path.join(folder, "turn_arb.yaml")
        with open(path, "w", encoding="utf-8") as file:
            yaml.safe_dump({**config("turn_arb.yaml"), **changes}, file)
        self.addCleanup(rospy.delete_param, "/turn_arb")
        process = start(self, "roslaunch", "car_interface", "turn_arb.launch", f"config:={path}")
        self.addCleanup(lambda: process.runs() and process.end())  # with its node
        return process

    def test_under_respawn_it_says_so_once_and_starts_when_the_parameter_is_repaired(self):
        launch = self.launch(servo_left="x")
        line = wait_for_fatal(launch)
        self.assertTrue(line.endswith(f"{REFUSED}. {WAITS}"), line)
        refused_s = time.monotonic()
        report = self.report("turn_arb", DiagnosticStatus.ERROR)
        self.assertEqual(report.message, f"this node doesn't run, as it refuses a parameter: {REFUSED}")
        self.assertEqual({value.key: value.value for value in report.values},
                         {"cause": causes.PARAMETER_REFUSED, "parameter": "servo_left"})
        eventually(lambda: time.monotonic() - refused_s > 3 * RESPAWN_S, "three respawns")
        self.assertEqual(len(fatal_lines(launch)), 1, launch.stderr.since())
        self.assertTrue(rosgraph.Master("/test").lookupNode("/turn_arb"))
        state = Topic("/turn_arb/state", SteeringState)
        self.addCleanup(state.close)

        rospy.set_param("/turn_arb/servo_left", 70000)
        line = wait_for_fatal(launch, "70000")
        self.assertTrue(line.endswith(f"servo_left is 70000; accepted: an integer from 0 to 65535. {WAITS}"), line)
        rospy.set_param("/turn_arb/servo_left", 3800)
        launch.stdout.wait_for(lambda line: "the parameters are accepted now" in line, within_s=LAUNCH_S)
        state.wait_for(lambda message: True)
        self.report("turn_arb", DiagnosticStatus.OK)
        self.assertEqual(len(fatal_lines(launch)), 2)
        self.assertFalse([line for line in launch.stdout.since() + launch.stderr.since()
                          if "has died" in line or "has finished" in line or "Traceback" in line])
        self.assertEqual(launch.end(), 0)

    def test_by_hand_it_ends_at_once_with_one_line(self):
        set_params(self, "/turn_arb", {**config("turn_arb.yaml"), "servo_left": "x"})
        process = start(self, executable("turn_arb"))
        self.assertEqual(process.wait_for_exit(), 1)
        self.assertEqual(len(fatal_lines(process)), 1)
        self.assertTrue(fatal_lines(process)[0].endswith(REFUSED), process.stderr.since())

    def test_a_signal_ends_its_wait(self):
        launch = self.launch(servo_left="x")
        wait_for_fatal(launch)
        self.assertEqual(launch.end(), 0)
        self.assertFalse([line for line in launch.stderr.since() if "Traceback" in line or "escalating" in line])

    def test_in_one_process_the_others_run_meanwhile(self):
        for part, values in (("turn_arb", {**config("turn_arb.yaml"), "servo_left": "x"}),
                             ("pca9685", {**config("pca9685.yaml"), "device": "virtual"}),
                             ("teensy_sensor_hub", {**config("teensy_sensor_hub.yaml"), "port": "/absent"}),
                             ("generic_value_converter", {**config("generic_value_converter.yaml"),
                                                          "csv_path_value_map": f"{PACKAGE}/config/value_map.csv"})):
            set_params(self, f"/one/{part}", values)
        process = NodeProcess(executable("car_nodes"), "__ns:=one", env=RESPAWNED)
        self.addCleanup(process.clean_up)
        line = process.wait_for_line("FATAL")
        self.assertTrue(line.endswith(f"turn_arb: {REFUSED}. {WAITS}"), line)
        self.report("one/turn_arb", DiagnosticStatus.ERROR)
        mark = self.reports.mark()
        for name in ("one/pca9685: servo board", "one/generic_value_converter: converter"):
            self.reports.wait_for(lambda array, name=name: any(status.name == name for status in array.status), mark)
        rospy.set_param("/one/turn_arb/servo_left", 3800)
        process.wait_for_info("turn_arb: NO_HUMAN")
        self.assertEqual(len(fatal_lines(process)), 1)
        self.assertEqual(process.end(), 0)


if __name__ == "__main__":
    rospy.init_node("refused_test")
    rostest.rosrun("car_interface", "refused_test", "__main__")
