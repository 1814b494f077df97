"""The black box: which stops have a recording written, and what is in it."""
from __future__ import annotations

import errno
import os
import time

import pytest
import rosbag
from car_interface.msg import SteeringState, TeleopState, ThrottleState
from geometry_msgs.msg import Twist
from sensor_msgs.msg import Joy
from std_msgs.msg import Bool, Float32

from car import Car
from car_interface.black_box.folder import TIME_FORMAT
from car_interface.common import causes
from car_interface.nodes.black_box import BlackBox
from graph import NS_PER_S

STOPPED = {SteeringState.LOCKED, SteeringState.NO_HUMAN, SteeringState.NEUTRAL}


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "black_box"


@pytest.fixture(autouse=True)
def _time_by_the_graph(monkeypatch, graph):
    """A recording's name carries the graph's time."""
    monkeypatch.setattr("graph.NodeClocks.local_time", lambda self, form: time.strftime(
        form, time.gmtime(self.ros_now().to_sec())))


def black_box(graph, folder):
    return graph.add(BlackBox, "black_box", {"folder": str(folder)})


def names(folder):
    """Return what each recording is of."""
    return [name[len("2023-11-14_22-30-00_"):] for name in sorted(os.listdir(folder))] if folder.exists() else []


def steering(source=SteeringState.PLANNER, cause=causes.PLANNER, **fields):
    return SteeringState(source=source, cause=cause, speed=1.0, **fields)


def throttle(source=ThrottleState.PLANNER, cause=causes.PLANNER, granted=0.3, **fields):
    return ThrottleState(source=source, cause=cause, granted=granted, speed=1.0, **fields)


def drive(graph):
    """Have the arbiters say that the planner has the car, and a hand hold the deadman."""
    graph.hold("/turn_arb/state", steering(), 20)
    graph.hold("/throttle_arb/state", throttle(), 10)
    graph.hold("/teleop_logi/state", TeleopState(human_in_loop=True, cause=causes.AUTONOMOUS), 10)
    graph.run(1.0)


@pytest.mark.parametrize("cause", sorted(causes.LOSSES - {causes.ESC_MOTION}))
@pytest.mark.parametrize("topic, state", [("/turn_arb/state", steering), ("/throttle_arb/state", throttle)])
def test_stop_by_a_loss_is_recorded_under_its_name(graph, folder, topic, state, cause):
    black_box(graph, folder)
    drive(graph)
    graph.hold(topic, state(SteeringState.NEUTRAL, cause), 10)
    graph.run(4.9)
    assert names(folder) == []  # it waits for how it ends
    graph.run(0.3)
    assert names(folder) == [cause.replace(" ", "_").replace("-", "_") + ".bag"]


@pytest.mark.parametrize("source, cause", [
    (SteeringState.NO_HUMAN, causes.HUMAN_ABSENT), (SteeringState.LOCKED, causes.E_STOP),
    (SteeringState.NEUTRAL, causes.NO_RADIUS), (SteeringState.NEUTRAL, causes.REQUEST_REFUSED),
    (SteeringState.NEUTRAL, causes.STEERING_STOPPED), (SteeringState.NO_HUMAN, causes.STARTING)])
def test_stop_that_was_asked_for_is_not(graph, folder, source, cause):
    black_box(graph, folder)
    drive(graph)
    graph.hold("/turn_arb/state", steering(source, cause), 20)
    graph.hold("/throttle_arb/state", throttle(source, cause, 0.0), 10)
    graph.run(1.0)
    # What falls silent after it has stopped nothing.
    graph.hold("/turn_arb/state", steering(source, causes.HUMAN_STALE), 20)
    graph.hold("/throttle_arb/state", throttle(source, causes.PLANNER_STALE, 0.0), 10)
    graph.hold("/teleop_logi/state", TeleopState(human_in_loop=False, cause=causes.NO_DEADMAN), 10)
    graph.run(10.0)
    assert names(folder) == []
