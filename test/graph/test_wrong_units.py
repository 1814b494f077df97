"""Planners whose units are wrong, through planner_interface to turn_arb: what is obeyed, and what is told.

The car turns on 1 m to either side by the shipped table; its wheelbase is 0.324 m.
"""
from __future__ import annotations

import itertools
import logging

import pytest
from car_interface.msg import SteeringState
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from std_msgs.msg import Bool

from car import Car

LEFT, RIGHT = 3800, 6700  # the duties of the tightest turns
PLANNER_HZ = 21  # in each phase to the nodes' timers
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
def rates():
    return Planner("cmd_vel")


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


@pytest.mark.parametrize("angular", [1.0, -1.0, 1.05, -1.05])
def test_the_car_s_own_tightest_turn_and_one_slightly_tighter_bother_nobody(rates, angular):
    rates.send(twist(1.0, angular))
    state = rates.steering
    assert (state.source, state.duty) == (SteeringState.PLANNER, LEFT if angular > 0 else RIGHT)
    assert (state.limit, state.asked_radius) == ("", pytest.approx(1 / angular, abs=1e-3))
