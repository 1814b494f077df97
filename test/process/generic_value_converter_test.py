#!/usr/bin/env python3
"""generic_value_converter by its topics: started by its launch file, with the map that it ships with."""
from __future__ import annotations

import csv
import math
import os
import re
import tempfile
import unittest

import rospkg
import rospy
import rostest
from car_interface.msg import Control, ConverterState, Float64Stamped
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Log

from waiting import Repeater, Sender, Topic, delete_param, retried, start_node

NAN, INF = math.nan, math.inf
LOWEST, HIGHEST = -5.0, 3.0  # the shipped min_value and max_value
DAY_S = 86_400
TOLERANCE = 1e-9

# Accelerations in m/s² that a float32 holds exactly, and velocities in m/s: on the map's points, between, and beyond.
LOOKUPS = [(acceleration, velocity)
           for acceleration in (-100.0, -8.0, -4.25, -1.125, -0.5, 0.0, 0.25, 1.0, 2.875, 5.0, 100.0)
           for velocity in (-1.0, 0.0, 0.5, 1.0, 3.75, 7.0, 9.99, 10.0, 50.0)]


def shipped_map():
    path = os.path.join(rospkg.RosPack().get_path("car_interface"), "config", "value_map.csv")
    with open(path, encoding="utf-8") as file:
        rows = list(csv.reader(file))
    return ([float(row[0]) for row in rows[1:]], [float(cell) for cell in rows[0][1:]],
            [[float(cell) for cell in row[1:]] for row in rows[1:]])


def lerp_saturated(x, xs, ys):
    """Looks at every interval: slow, and another way than the one under test."""
    if x <= xs[0]:
        return ys[0]
    for x0, x1, y0, y1 in zip(xs, xs[1:], ys, ys[1:]):
        if x <= x1:
            return y0 + (y1 - y0) * ((x - x0) / (x1 - x0))
    return ys[-1]


def naive_value(acceleration, velocity, values, velocities, rows):
    """The two steps of the description: each row at the velocity, then value over acceleration."""
    at_velocity = [lerp_saturated(velocity, velocities, row) for row in rows]
    return lerp_saturated(acceleration, at_velocity, values)


def control(acceleration, stamp_s=None):
    message = Control()
    message.stamp = rospy.Time.now() if stamp_s is None else rospy.Time(stamp_s)
    message.longitudinal.acceleration = acceleration
    return message


def odometry(velocity, stamp_s=None):
    message = Odometry()
    message.header.stamp = rospy.Time.now() if stamp_s is None else rospy.Time(stamp_s)
    message.twist.twist.linear.x = velocity
    return message


class ConverterTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.values = Topic("/generic/output/value", Float64Stamped).connected()
        cls.log = Topic("/rosout", Log).connected(2)
        cls.command = Sender("/control/command/control_cmd", Control)
        cls.odometry = Sender("/odom", Odometry)

    def setUp(self):
        self.inputs = Repeater(period_s=0.04)
        self.addCleanup(self.inputs.end)

    def wait_for_warning(self, pattern):
        self.log.wait_for(lambda entry: entry.name == "/generic_value_converter" and entry.level == Log.WARN
                          and re.search(pattern, entry.msg))

    def wait_for_value(self, value):
        """Repeated commands and odometry arrive in any order: until this is the answer to both."""
        self.values.wait_for(lambda output: abs(output.data - value) <= TOLERANCE, self.values.mark())

    def expect_last_value(self, acceleration, value):
        """One command more, and its output: what was sent before has been answered, or won't be."""
        mark = self.values.mark()
        self.command.publish(control(acceleration))
        return self.values.wait_for(lambda output: output.data == value, mark)


class Conversion(ConverterTest):
    def test_values_are_those_of_the_map(self):
        values, velocities, rows = shipped_map()
        for acceleration, velocity in LOOKUPS:
            with self.subTest(acceleration=acceleration, velocity=velocity):
                expected = naive_value(acceleration, velocity, values, velocities, rows)
                self.inputs.hold(self.odometry, odometry(velocity))
                self.inputs.hold(self.command, control(acceleration))
                self.wait_for_value(min(HIGHEST, max(LOWEST, expected)))

    def test_each_command_has_one_output(self):
        self.inputs.hold(self.odometry, odometry(1.0))
        self.inputs.hold(self.command, control(0.0))
        self.values.wait_for(lambda _: True, self.values.mark())
        self.inputs.drop(self.command)
        self.expect_last_value(100.0, HIGHEST)
        mark = self.values.mark()
        for number in range(50):
            self.command.publish(control(1.479))  # the map's own point for 1.2
            self.values.wait_for_count(number + 1, mark)  # a burst longer than the queues loses its oldest, by design
        self.expect_last_value(-100.0, LOWEST)
        outputs = self.values.since(mark)
        self.assertEqual(len(outputs), 51)
        self.assertAlmostEqual(outputs[0].data, 1.2, delta=1e-6)  # the command is a float32
        self.assertLess(abs((outputs[0].stamp - rospy.Time.now()).to_sec()), 5)

    def test_odometry_that_falls_silent_ends_the_output_and_comes_back(self):
        self.inputs.hold(self.odometry, odometry(1.0))
        self.inputs.hold(self.command, control(100.0))
        self.wait_for_value(HIGHEST)
        self.inputs.drop(self.odometry)
        self.wait_for_warning(r"no output: odometry silent for \d+\.\d\d s")
        mark = self.values.mark()
        commands = Topic("/control/command/control_cmd", Control)
        self.addCleanup(commands.close)
        commands.wait_for_count(10)
        self.assertEqual(self.values.since(mark), [])
        self.inputs.hold(self.odometry, odometry(1.0))
        self.wait_for_value(HIGHEST)

    def test_numbers_that_are_none_have_no_output(self):
        self.inputs.hold(self.odometry, odometry(1.0))
        self.expect_eventually(100.0, HIGHEST)
        mark = self.values.mark()
        for number in (NAN, INF, -INF):
            self.command.publish(control(number))
        self.expect_last_value(-100.0, LOWEST)
        self.assertEqual(len(self.values.since(mark)), 1)
        self.wait_for_warning("no output: the commanded acceleration is nan")
        self.inputs.hold(self.odometry, odometry(NAN))
        self.wait_for_warning("the velocity in the odometry is nan")

    def test_odd_stamps_are_told_and_obeyed(self):
        now_s = rospy.Time.now().to_sec()
        self.inputs.hold(self.odometry, odometry(1.0))
        self.expect_eventually(100.0, HIGHEST)
        for stamp_s in (0, now_s - DAY_S, now_s + DAY_S):
            mark = self.values.mark()
            self.command.publish(control(-100.0, stamp_s))
            self.values.wait_for(lambda output: output.data == LOWEST, mark)
        self.wait_for_warning("the stamp of control_cmd is zero; it's obeyed")
        for stamp_s in (0, now_s - DAY_S, now_s + DAY_S):
            self.inputs.hold(self.odometry, odometry(2.0, stamp_s))
            self.expect_eventually(100.0, HIGHEST)

    def expect_eventually(self, acceleration, value):
        """The odometry that is held may still be on its way when the first command is sent."""
        self.inputs.hold(self.command, control(acceleration))
        self.wait_for_value(value)
        self.inputs.drop(self.command)
        self.expect_last_value(acceleration, value)


class State(ConverterTest):
    """What throttle_arb stops by at once, and what people read."""

    def setUp(self):
        super().setUp()
        self.states = Topic("/generic_value_converter/state", ConverterState).connected()
        self.addCleanup(self.states.close)

    def wait_for_state(self, cause, mark):
        return self.states.wait_for(lambda state: state.cause == cause, mark).what

    def test_state_has_the_value_or_why_there_is_none(self):
        self.inputs.hold(self.odometry, odometry(1.0))
        self.inputs.hold(self.command, control(100.0))
        state = self.wait_for_state("converting", self.states.mark())
        self.assertEqual((state.value, state.reason), (HIGHEST, "the value is 3.000"))
        mark = self.states.mark()
        self.inputs.hold(self.command, control(NAN))
        state = self.wait_for_state("command not finite", mark)
        self.assertTrue(math.isnan(state.value))
        self.assertEqual(state.reason, "the commanded acceleration is nan")
        mark = self.states.mark()
        self.inputs.hold(self.command, control(100.0))
        self.wait_for_state("converting", mark)
        self.inputs.drop(self.odometry)
        self.assertRegex(self.wait_for_state("odometry silent", mark).reason, r"odometry silent for \d\.\d\d s")

    def test_state_comes_once_a_second_while_nothing_changes(self):
        mark = self.states.mark()
        times = [state.stamp.to_sec() for state in self.states.wait_for_count(3, mark)]
        retried(lambda: self.assertAlmostEqual(times[-1] - times[-2], 1.0, delta=0.3))

    def test_diagnostics_carry_the_cause(self):
        reports = Topic("/diagnostics", DiagnosticArray)
        self.addCleanup(reports.close)

        def status(cause):
            def is_of_cause(array):
                return (array.status[0].name == "generic_value_converter: converter"
                        and {pair.key: pair.value for pair in array.status[0].values}["cause"] == cause)
            return reports.wait_for(is_of_cause, reports.mark()).what.status[0]
        self.inputs.hold(self.odometry, odometry(1.0))
        self.inputs.hold(self.command, control(1.0))
        self.assertEqual(status("converting").level, DiagnosticStatus.OK)
        self.inputs.hold(self.command, control(NAN))
        no_number = status("command not finite")
        self.assertEqual((no_number.level, no_number.message),
                         (DiagnosticStatus.WARN, "no output: the commanded acceleration is nan"))


class ConverterByItself(unittest.TestCase):
    """Nodes that the test starts with parameters of its own."""

    def expect_refusals(self, cases):
        """Each (parameters, texts): exit code 1 and one line on stderr, with these texts in it."""
        started = []
        for number, (parameters, texts) in enumerate(cases):
            name = f"refused_{number}"
            self.addCleanup(delete_param, f"/{name}")
            started.append((texts, start_node(self, "generic_value_converter", *parameters, name=name)))
        for texts, process in started:
            with self.subTest(texts):
                self.assertEqual(process.wait_for_exit(), 1)
                lines = process.stderr.since()
                self.assertEqual(len(lines), 1, lines)
                for text in texts:
                    self.assertIn(text, lines[0])

    def map_file(self, text):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        path = os.path.join(folder.name, "map.csv")
        with open(path, "w", encoding="utf-8") as file:
            file.write(text)
        return path

    def test_a_bad_map_ends_the_node_with_one_line_that_says_where(self):
        cases = [((f"_csv_path_value_map:={path}",), (path, where)) for path, where in (
            (self.map_file("default,0,1\n0,0,0\n1,1"), "line 3 has 2 columns"),
            (self.map_file("default,0,1\n0,0,0\n1,x,1\n"), "line 3, column 2 is 'x'"),
            (self.map_file("default,0,1\n0,0,0\n1,-1,1\n"), "velocity 0.0 m/s, from value 0.0 to 1.0 falls"),
            (self.map_file("default,0,1\n0,0,0\n1,0,1\n"), "stays level at 0.0"),
            ("/nowhere.csv", "csv_path_value_map is '/nowhere.csv'; accepted: a file that can be read (No such file"),
            ("/tmp", "Is a directory"))]
        self.expect_refusals([*cases, ((), ("csv_path_value_map is missing",))])

    def test_passthrough_is_clamped_and_needs_neither_map_nor_odometry(self):
        process = start_node(self, "generic_value_converter", "_convert_value_cmd:=false", name="passthrough")
        self.addCleanup(delete_param, "/passthrough")
        command = Sender("/passthrough/input/control_cmd", Control)
        values = Topic("/passthrough/output/value", Float64Stamped)
        inputs = Repeater()
        self.addCleanup(inputs.end)
        for acceleration, value in ((1.5, 1.5), (100.0, HIGHEST), (-100.0, LOWEST), (0.0, 0.0)):
            inputs.hold(command, control(acceleration))
            values.wait_for(lambda output, value=value: output.data == value, values.mark())
        self.assertEqual({output.data for output in values.since()}, {1.5, HIGHEST, LOWEST, 0.0})
        self.assertEqual(process.end(), 0)
        self.assertEqual(process.stderr.since(), [])

    def test_parameters_of_the_esc_are_refused_by_name(self):
        """They are throttle_arb's."""
        self.expect_refusals([(("_convert_value_cmd:=false", "_servo/channel:=1"),
                               ("unknown parameter servo/channel is 1",))])


if __name__ == "__main__":
    rospy.init_node("generic_value_converter_test")
    rostest.rosrun("car_interface", "generic_value_converter_test", "__main__")
