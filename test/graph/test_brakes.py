"""What goes wrong with the nodes while a car brakes, at each moment of it: no kind of ESC drives it backward.

Each fault has a process of its own, forked from the one that plays the story at that time.
"""
import os
import sys
from functools import partial

import pytest

from car import Car, config
from graph import NS_PER_S
from test_stalls import forked

MS = 1_000_000
IS_EACH = bool(os.environ.get("CAR_INTERFACE_ALL"))  # moment of the stop, with each fault
STOP_MS, STEP_MS = 900, 30
SPEEDS_MPS = (1.2, 1.0, 0.9)  # the last at which kinds that may reverse are braked
AFTER_S = 1.2
BACKWARD_MPS = 0.03
# What is configured, and what the virtual ESC is.
ESCS = [("brake_then_reverse", "brake_then_reverse"), ("brake_becomes_reverse", "brake_becomes_reverse"),
        ("direct_reverse", "direct_reverse"), ("unverified", "brake_becomes_reverse"), ("unverified", "direct_reverse")]
STOPS = {"stick": {"manual": True, "throttle": -1.0}, "release": {}, "second pull": {"manual": True, "throttle": -0.9}}


def stalls(seconds):
    return lambda graph: graph.nodes["/throttle_arb"].stall(seconds)


def dies(graph):
    graph.nodes["/throttle_arb"].kill()


def late_output(graph):
    """A stall in which the board ends the pull, and says so late."""
    graph.link("/servo/output", receiver="/throttle_arb", delay_s=0.2)
    stalls(0.3)(graph)


def lost_output(graph):
    graph.link("/servo/output", receiver="/throttle_arb", loses=lambda message: True)
    stalls(0.5)(graph)


def late_odometry(graph):
    graph.link("/odom", delay_s=0.3)


def lost_odometry(graph):
    graph.link("/odom", loses=lambda message: True)


FAULTS = {"death": dies, "late output": late_output, "lost output": lost_output, "stall of 0.25 s": stalls(0.25),
          "late odometry": late_odometry, "lost odometry": lost_odometry, "stall of 0.6 s": stalls(0.6)}


class Story:
    """A car that a person drives to 2 m/s; then it is stopped in one of the ways."""

    def __init__(self, profile, kind):
        esc = {"profile": profile, "profile_measured": profile != "unverified"}
        nodes = {"throttle_arb": {"esc": esc}, "pca9685": {"esc": {**config("throttle.yaml"), "esc": esc}}}
        self.car = Car().whole(nodes=nodes, esc_kind=kind, obstacles=False, collisions=False)
        self.graph = self.car.graph
        self.graph.run(2.5)
        self.car.pad(manual=True)
        self.graph.run(0.3)
        self.car.pad(manual=True, throttle=1.0)
        self.graph.run_until(lambda: self.car.speed_mps > 2.0)

    def stop(self, stop):
        if stop == "second pull":
            self.graph.run_until(lambda: self.car.speed_mps > 3.0)
            self.car.pad(**STOPS["stick"])
            self.graph.run(0.2)
            self.car.pad(manual=True)
            self.graph.run(0.3)
        self.begin_ns = self.graph.now_ns
        self.car.pad(**STOPS[stop])

    def faulty(self, fault):
        fault(self.graph)
        self.graph.run(AFTER_S)
        slowest = min(message.twist.twist.linear.x for message in self.graph.messages("/car_sim/truth", self.begin_ns))
        return [] if slowest > -BACKWARD_MPS else [f"it went backward at {-slowest:.2f} m/s"]


def faults_while_braking(profile, kind):
    """Play the story without a terminal, with each fault at each moment of each stop; return what went wrong."""
    sys.stdin = None
    story = Story(profile, kind)
    return [f"{stop}: {fault}" for stop in STOPS for fault in forked(partial(faults_while, story, stop))]


def faults_while(story, stop):
    story.stop(stop)
    found = []
    for moment in range(0, STOP_MS, STEP_MS) if IS_EACH else SPEEDS_MPS:
        if IS_EACH:
            story.graph.run((story.begin_ns + moment * MS - story.graph.now_ns) / NS_PER_S)
        else:
            story.graph.run_until(lambda: story.car.speed_mps < moment)
        for name in FAULTS if IS_EACH else list(FAULTS)[:3]:
            for fault in forked(partial(story.faulty, FAULTS[name])):
                found.append(f"{name} at {story.car.speed_mps:.2f} m/s: {fault}")
    return found


@pytest.mark.once
@pytest.mark.parametrize("profile, kind", ESCS)
def test_no_fault_of_the_nodes_makes_a_brake_reverse(forker, profile, kind):
    found = forker.submit(faults_while_braking, profile, kind).result()
    assert not found, "\n".join(found)
