"""Planners whose units are wrong, through planner_interface to turn_arb: what is obeyed, and what is told.

The car turns on 1 m to either side by the shipped table; its wheelbase is 0.324 m.
"""
from __future__ import annotations

import itertools
import logging
import math
import re

import pytest
from car_interface.msg import SteeringState
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from std_msgs.msg import Bool

from car import Car
from car_interface.ros.ackermann_messages import ackermann_drive_class

LEFT, RIGHT = 3800, 6700  # the duties of the tightest turns
PLANNER_HZ = 21  # in each phase to the nodes' timers
Drive = ackermann_drive_class()


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
    """planner_interface and turn_arb, armed, at 1 m/s; and a planner that sends one message after the other."""

    def __init__(self, topic):
        self.car = Car()
        self.graph = self.car.graph
        self.graph.record("/planner_interface/state", "/av_turnrad_req")
        self.car.planner_interface(topic)
        self.car.turn_arb()
        self.topic = f"/{topic}"
        odometry = Odometry()
        odometry.twist.twist.linear.x = 1.0
        self.graph.hold("/odom", odometry, 20)
        self.graph.hold("/e_stop", Bool(False), 20)
        for held in (False, True):
            self.graph.hold("/teleop_logi/human_in_loop", Bool(held), 20)
            self.graph.run(0.1)
        assert self.steering.source == SteeringState.NEUTRAL

    def send(self, *messages, lasts_s=1.0):
        """Send these in turn from now on, and nothing else."""
        source = itertools.cycle(messages)
        self.graph.hold(self.topic, lambda: next(source), PLANNER_HZ)
        self.graph.run(lasts_s)

    @property
    def state(self):
        return self.graph.newest("/planner_interface/state")

    @property
    def steering(self):
        return self.graph.newest("/turn_arb/state")


@pytest.fixture
def angles():
    return Planner("drive")


@pytest.fixture
def rates():
    return Planner("cmd_vel")


def test_a_swing_of_3_rad_is_refused_in_each_half_wave_until_it_was_sane_for_2_s(angles):
    """As of degrees that are taken for rad."""
    graph = angles.graph
    since_ns = graph.now_ns
    angles.send(*(drive(3.0 * math.cos(2 * math.pi * tick / 40)) for tick in range(40)), lasts_s=6.1)
    assert re.match(r"drive: drive\.steering_angle of -?\d\S* rad \(degrees\?\): no wheel turns so far; refused until "
                    "it was sane for 2 s", graph.messages("/planner_interface/state", since_ns)[2].reason)
    assert angles.state.refused > 120 and angles.state.cause == "request refused"
    assert [state for state in graph.messages("/planner_interface/state", since_ns) if state.cause == "planner"] == []
    assert SteeringState.PLANNER not in {state.source for state in graph.messages("/turn_arb/state", since_ns)}
    assert {message.data for message in graph.messages("/av_turnrad_req", since_ns)} <= {0.0}
    report = graph.report("planner_interface: planner")
    assert report.level == DiagnosticStatus.WARN and "(degrees?)" in report.message
    angles.send(drive(3.0), lasts_s=0.0)  # the wave may have ended among angles that wheels have
    refused_ns = graph.now_ns
    angles.send(drive(0.2), lasts_s=1.0)
    assert angles.state.cause == "request refused" and angles.state.reason.endswith(" s more")
    obeyed_ns = graph.run_until(lambda: angles.state.cause == "planner", 2.0)
    assert 2_000_000_000 <= obeyed_ns - refused_ns <= 2_070_000_000
    graph.run(0.01)
    assert angles.steering.source == SteeringState.PLANNER and angles.steering.turn_radius > 0


def test_an_angle_that_a_wheel_might_have_and_this_car_has_not_is_cut_and_told(angles):
    angles.send(drive(-1.2))
    assert (angles.steering.duty, angles.steering.limit, angles.steering.limit_reason) == (
        RIGHT, "too tight", too_tight("0.13", "right"))


def test_degrees_per_second_are_cut_and_told_everywhere_and_once_in_the_log(rates):
    graph = rates.graph
    rates.send(twist(1.0, 5.73), twist(1.0, 0.0), twist(1.0, -5.73), twist(1.0, 0.0), lasts_s=3.0)
    for radius, side, duty in ((0.1745, "left", LEFT), (-0.1745, "right", RIGHT)):
        state = next(state for state in reversed(graph.messages("/turn_arb/state"))
                     if (state.limit, state.duty) == ("too tight", duty))
        assert (state.source, state.cause, state.limit_reason) == (
            SteeringState.PLANNER, "planner", too_tight("0.17", side))
        assert state.asked_radius == pytest.approx(radius, abs=1e-3)
        assert (abs(state.turn_radius), state.max_speed) == (1.0, 2.0)
    assert rates.state.cause == "planner" and rates.steering.cuts > 20
    assert any("this car turns on 1.00 m" in state.reason for state in graph.messages("/planner_interface/state"))
    for name in ("turn_arb: steering", "planner_interface: planner"):
        report = graph.report(name)
        assert report.level == DiagnosticStatus.WARN and "this car turns on 1.00 m" in report.message
        assert "degrees" in report.values["remedy"]
    assert graph.report("turn_arb: steering").values["warnings of too tight"] == "1"
    assert [line for line in graph.lines("/turn_arb", 0, logging.WARNING) if "this car turns on" in line] == [
        f"the planner {too_tight('0.17')}"]


def test_teleop_twist_keyboard_s_defaults_are_told_and_its_turn_on_the_spot_traps_nobody(rates):
    """Its keys u, j and i, at its speed of 0.5 m/s and its turn of 1 rad/s."""
    rates.send(twist(0.5, 1.0))
    state = rates.steering
    assert (state.limit, state.duty, state.limit_reason) == ("too tight", LEFT, too_tight("0.50"))
    rates.send(twist(0.0, 1.0))
    assert (rates.state.cause, rates.state.reason) == (
        "request refused", "cmd_vel: angular.z is 1 rad/s at linear.x 0 m/s: a car can't turn on the spot")
    since_ns = rates.graph.now_ns
    rates.send(twist(0.5, 0.0), lasts_s=0.1)
    assert (rates.state.cause, rates.state.turn_radius) == ("planner", math.inf)
    assert not [state.reason for state in rates.graph.messages("/planner_interface/state", since_ns)
                if "refused until" in state.reason]


@pytest.mark.parametrize("angular", [1.0, -1.0, 1.05, -1.05])
def test_the_car_s_own_tightest_turn_and_one_slightly_tighter_bother_nobody(rates, angular):
    rates.send(twist(1.0, angular))
    state = rates.steering
    assert (state.source, state.duty) == (SteeringState.PLANNER, LEFT if angular > 0 else RIGHT)
    assert (state.limit, state.asked_radius) == ("", pytest.approx(1 / angular, abs=1e-3))
