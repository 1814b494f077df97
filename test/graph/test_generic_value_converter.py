"""generic_value_converter: a value for each command, by the map that it ships with, or why there is none."""
import logging
import math
import os
import re

import pytest
import rospy
from diagnostic_msgs.msg import DiagnosticStatus

from car import CONFIG, config
from car_interface.nodes.generic_value_converter import GenericValueConverter
from graph import NS_PER_S, Graph
from inputs import control, odometry

NAN, INF = math.nan, math.inf
LOWEST, HIGHEST = -5.0, 3.0  # the shipped min_value and max_value
NAME = "/generic_value_converter"
VALUE, STATE = f"{NAME}/output/value", f"{NAME}/state"
MAP = os.path.join(CONFIG, "value_map.csv")


class Converter:
    """The node in a graph of its own, with the shipped parameters unless others are given."""

    def __init__(self, parameters=None, **changes):
        self.graph = Graph()
        self.run = self.graph.run
        self.graph.record(VALUE, STATE, "/diagnostics")
        shipped = {**config("generic_value_converter.yaml"), "csv_path_value_map": MAP, **changes}
        self.graph.add(GenericValueConverter, NAME, shipped if parameters is None else parameters)

    def command(self, *accelerations, stamp=None):
        """Send commands; return the values that they got."""
        since_ns, count = self.graph.now_ns, len(self.graph.recorded[VALUE])
        for acceleration in accelerations:
            message = control(acceleration)
            message.stamp = rospy.Time(nsecs=since_ns + self.graph.ros_ahead_ns) if stamp is None else stamp
            self.graph.publish(f"{NAME}/input/control_cmd", message)
        self.run(0.0)
        return [record.message.data for record in self.graph.recorded[VALUE][count:]]

    def odometry(self, velocity, stamp=None, age_s=0.0):
        """Repeat it from now on, stamped when it was measured."""
        def message():
            measured = odometry(velocity)
            measured_ns = self.graph.now_ns + self.graph.ros_ahead_ns - round(age_s * NS_PER_S)
            measured.header.stamp = rospy.Time(nsecs=measured_ns) if stamp is None else stamp
            return measured
        self.graph.hold(f"{NAME}/input/odometry", message, 25)
        self.run(0.0)

    @property
    def state(self):
        return self.graph.newest(STATE)

    def warnings(self):
        return self.graph.lines(NAME, 0, logging.WARNING)

    def report(self):
        self.run(1.0)
        return self.graph.report("generic_value_converter: converter")


def test_values_are_those_of_the_map_one_for_each_command_at_once():
    converter = Converter()
    converter.odometry(1.0)
    assert converter.command(1.479, 100.0, -100.0) == pytest.approx([1.2, HIGHEST, LOWEST], abs=1e-6)  # a map's point
    converter.odometry(10.0)
    assert converter.command(1.479)[0] > 1.5  # it takes more to go faster still
    stamp = converter.graph.newest(VALUE).stamp.to_nsec()
    assert stamp == pytest.approx(converter.graph.now_ns + converter.graph.ros_ahead_ns, abs=1000)


@pytest.mark.parametrize("parameters", [None, {"csv_path_value_map": MAP}], ids=["shipped", "defaults"])
def test_odometry_that_falls_silent_ends_the_output_after_its_timeout_and_comes_back(parameters):
    converter = Converter(parameters)
    converter.odometry(1.0)
    converter.graph.silence(f"{NAME}/input/odometry")
    converter.run(0.5)
    assert converter.command(100.0) == [HIGHEST]
    converter.run(1e-6)
    assert converter.command(100.0) == []
    assert converter.state.cause == "odometry silent" and math.isnan(converter.state.value)
    assert converter.state.reason == "odometry silent for 0.50 s"
    assert converter.warnings() == ["no output: odometry silent for 0.50 s"]
    converter.odometry(1.0)
    assert converter.command(100.0) == [HIGHEST]


@pytest.mark.parametrize("number", [NAN, INF, -INF])
def test_numbers_that_are_none_have_no_output_and_are_warned_of(number):
    converter = Converter()
    converter.odometry(1.0)
    assert converter.command(100.0, number, -100.0) == [HIGHEST, LOWEST]
    assert converter.warnings() == [f"no output: the commanded acceleration is {number}"]
    converter.odometry(number)
    assert converter.command(100.0) == []
    assert converter.warnings()[1:] == [f"the velocity in the odometry is {number}: no output"]
    assert converter.state.reason == f"the velocity in the odometry is {number}"


@pytest.mark.parametrize("stamp_s, text, of_odometry", [
    (0, "is zero", ""),
    (-86_400, "is 86400 s in the past", None),
    (86_400, "is 86400 s in the future",
     ("odometry: the stamp is 86400.00 s in the future: its age counts from arrival alone"))])
def test_odd_stamps_are_told_once_and_obeyed_but_an_old_velocity_isnt(stamp_s, text, of_odometry):
    converter = Converter()
    stamp = rospy.Time(nsecs=converter.graph.now_ns + converter.graph.ros_ahead_ns) + rospy.Duration(stamp_s)
    stamp = stamp if stamp_s else rospy.Time(0)
    converter.odometry(1.0, stamp)
    values = converter.command(-100.0, 100.0, stamp=stamp)
    assert values == ([LOWEST, HIGHEST] if of_odometry is not None else [])
    *told, of_command = [line for line in converter.warnings() if "no output" not in line]
    assert told == [of_odometry] * bool(of_odometry)
    assert re.match(f"the stamp of control_cmd {text}.*; it's obeyed all the same", of_command), of_command


@pytest.mark.parametrize("stamps_follow", [True, False], ids=["of_this_computer", "of_another_one"])
@pytest.mark.parametrize("step_s", [-3600, 3600])
def test_a_clock_that_is_set_makes_no_velocity_old(step_s, stamps_follow):
    converter = Converter()
    converter.odometry(1.0, age_s=0.1)
    converter.run(2.0)
    converter.graph.ros_ahead_ns += step_s * NS_PER_S
    converter.odometry(1.0, age_s=0.1 + (0 if stamps_follow else step_s))
    for _ in range(100):
        converter.run(0.02)
        assert len(converter.command(1.0)) == 1
    assert [line for line in converter.warnings() if "ROS time" in line] == [
        f"odometry: ROS time was set by {step_s:.1f} s: until the stamps agree with it ages count from arrival alone"]
    converter.odometry(1.0, age_s=0.55)
    assert not converter.command(1.0)
    assert converter.state.reason == "odometry is 0.55 s old by its stamp"


def test_state_has_the_value_or_why_there_is_none_when_the_cause_changes_and_once_a_second():
    converter = Converter()
    converter.run(0.5)
    assert (converter.state.cause, converter.state.reason) == ("no request", "waiting for the first command")
    converter.odometry(1.0)
    counts = []
    for acceleration, cause, value, reason in ((100.0, "converting", HIGHEST, "the value is 3.000"),
                                               (-100.0, "converting", HIGHEST, "the value is 3.000"),  # not yet
                                               (NAN, "command not finite", NAN, "the commanded acceleration is nan"),
                                               (NAN, "command not finite", NAN, "the commanded acceleration is nan"),
                                               (100.0, "converting", HIGHEST, "the value is 3.000")):
        converter.command(acceleration)
        assert (converter.state.cause, converter.state.reason) == (cause, reason)
        assert converter.state.value == value or math.isnan(value) and math.isnan(converter.state.value)
        counts.append(len(converter.graph.recorded[STATE]))
    assert counts == [2, 2, 3, 3, 4]
    converter.run(3.0)
    times = [record.at_ns for record in converter.graph.recorded[STATE][-3:]]
    assert [after - before for before, after in zip(times, times[1:])] == [NS_PER_S, NS_PER_S]
    assert converter.graph.publishers[STATE][0].latch


def test_diagnostics_carry_cause_and_counts_once_a_second():
    converter = Converter()
    level, message, values = converter.report()
    assert (level, message, values["age of odometry"]) == (
        DiagnosticStatus.OK, "waiting for the first command", "never heard")
    converter.odometry(1.0)
    converter.command(1.0)
    level, message, values = converter.report()
    assert (level, message, values["cause"], values["commands"], values["values sent"]) == (
        DiagnosticStatus.OK, "converting", "converting", "1", "1")
    converter.command(NAN, NAN)
    level, message, values = converter.report()
    assert (level, message, values["cause"], values["commands"], values["values sent"]) == (
        DiagnosticStatus.WARN, "no output: the commanded acceleration is nan", "command not finite", "3", "1")
    assert values["command not finite"] == "2"
    assert len(converter.graph.messages("/diagnostics")) == 3


def test_dropped_messages_take_the_speed_away():
    converter = Converter()
    converter.odometry(1.0)
    assert converter.command(1.0) != []
    converter.graph.silence(f"{NAME}/input/odometry")
    converter.graph.nodes[NAME].stall(2.0)
    converter.run(2.01)
    assert converter.command(1.0) == []
    assert converter.state.reason == "odometry was not heard since messages were dropped"


# --- parameters ---

@pytest.mark.parametrize("parameters", [{"convert_value_cmd": False}, {"use_value_ff": False}])
def test_passthrough_is_clamped_and_needs_neither_map_nor_odometry(parameters):
    converter = Converter(parameters)
    assert converter.command(1.5, 100.0, -100.0, 0.0) == [1.5, HIGHEST, LOWEST, 0.0]
    assert converter.warnings() == []


def test_map_with_values_beyond_the_limits_of_the_output_is_warned_of():
    assert re.fullmatch(r".*value_map\.csv has values from \S+ to \S+; min_value and max_value clamp them to -5 to 1",
                        Converter(max_value=1.0).warnings()[0])
    assert len(Converter(min_value=-4.99).warnings()) == 1
    assert Converter().warnings() == []
