"""A stall of each node at each time of a story: a person holds the deadman, a planner drives, the person stops.

Each stall has a process of its own, forked from the one that plays the story at that time, and each way to stop another
one, forked when the person stops. What holds in each of them:

- After the person let go or sent an e-stop, and the timeouts, the servo is at its center and the ESC at neutral.
- The car never goes backward, and the ESC is never made to.
- Throttle is given while the board doesn't do what turn_arb commands for no longer than the board watch tolerates.
- A node that obeys a person obeys nothing after its stall until the person has let go and held again; then it drives.
"""
from __future__ import annotations

import gc
import json
import os
import sys
import traceback
from functools import partial
from typing import Callable

import pytest
from std_msgs.msg import Bool, Float32

from car import CENTER, ESC, ESC_NEUTRAL, STEERING, Car
from car_interface.pca9685.registers import counts_of_duty
from graph import NS_PER_S

MS = 1_000_000
STORY_MS, STALL_MS, STOP_MS = 2000, 600, 1400  # the person stops at STOP_MS
STEP_MS = 10 if os.environ.get("CAR_INTERFACE_ALL") else 250
AFTER_MS = 120  # of what is judged after the stall and the timeouts
NOISE_MPS = 0.02
# How long after the person's stop a stall of the node may delay it: the timeout of who waits for it, and a timer.
DELAYS_MS = {
    "/turn_arb": 250 + 10,  # the servo board's
    "/throttle_arb": 250 + 10,
    "/teleop_logi": 500 + 20,  # of the deadman, in the arbiters
    "/pca9685": 250 + 50,  # its guard's
    "/planner_interface": 0, "/generic_value_converter": 0, "/teensy_sensor_hub": 0, "/car_sim": 0,
}
JOY_MS = 20
TOLERANCE_MS = 500 + 40  # of the board watch, and throttle_arb's timer
STOPS = {"lets_go": lambda car: car.pad(), "e_stop": lambda car: car.graph.hold("/e_stop", Bool(True), 10)}
OBEYS = {"/turn_arb": (STEERING, ESC), "/teleop_logi": (STEERING, ESC), "/throttle_arb": (ESC,)}  # a person: their pins


class Story:
    """The car, and the story from its beginning to its end."""

    def __init__(self):
        self.car = Car().whole("speed", {"pca9685": {"guard": True},
                                         "throttle_arb": {"esc": {"profile": "brake_then_reverse"}}},
                               esc_kind="brake_then_reverse", obstacles=False, collisions=False)
        self.graph = self.car.graph
        self.graph.hold("/av_turnrad_req", Float32(2.0), 20, sender="/planner")
        self.graph.hold("/av_speed_req", Float32(1.0), 20, sender="/planner")
        self.graph.run(2.5)
        self.begin_ns = self.graph.now_ns
        self.graph.record("/servo/cmdVector")
        del self.car.board.changes[:-1]
        self.car.pad(autonomous=True)

    def ns(self, at_ms):
        return self.begin_ns + at_ms * MS

    def run_to(self, at_ms):
        self.graph.run((self.ns(at_ms) - self.graph.now_ns) / NS_PER_S)

    def pins(self, from_ms, to_ms=10 ** 6):
        """The counts of both pins in a time, as they began and after each change."""
        before = [each for each in self.car.board.changes if each[0] <= self.ns(from_ms)][-1:]
        within = [each for each in self.car.board.changes if self.ns(from_ms) < each[0] <= self.ns(to_ms)]
        return [counts[:2] for _, counts in before + within]

    # --- what holds ---

    def check(self, node, stalled_ms):
        """Each of the rules, for a node that was stalled; empty = none."""
        safe_ms = STOP_MS + JOY_MS + (DELAYS_MS[node] if node else 0)
        assert all(steering == CENTER and esc <= ESC_NEUTRAL for steering, esc in self.pins(safe_ms)), (
            f"not safe {safe_ms - STOP_MS} ms after the stop: {self.pins(safe_ms)}")
        self._check_direction()
        self._check_agreement()
        went_on_ms = stalled_ms + STALL_MS
        if node in OBEYS and went_on_ms < STOP_MS:
            for steering, esc in self.pins(went_on_ms, STOP_MS):
                assert STEERING not in OBEYS[node] or steering == CENTER, f"it steers to {steering} without re-arming"
                assert esc <= ESC_NEUTRAL, f"the ESC has {esc} without re-arming"

    def _check_direction(self):
        slowest = min(message.twist.twist.linear.x for message in self.graph.messages("/car_sim/truth", self.begin_ns))
        assert slowest > -NOISE_MPS, f"it went backward at {slowest:.2f} m/s"
        assert "REVERSE" not in {state.esc for state in self.graph.messages("/throttle_arb/state", self.begin_ns)}

    def _check_agreement(self):
        events = [(at_ns, 0, counts) for at_ns, counts in self.car.board.changes]
        events += [(record.at_ns, 1, record.message.data[0]) for record in self.graph.recorded["/servo/cmdVector"]
                   if record.message.data[0] != -1]
        pins, commanded, since_ns = self.car.board.changes[0][1], None, None
        for at_ns, is_command, value in sorted(events, key=lambda event: event[:2]):
            pins, commanded = (pins, value) if is_command else (value, commanded)
            if commanded is None or pins[ESC] <= ESC_NEUTRAL or pins[STEERING] == counts_of_duty(commanded):
                since_ns = None
            elif since_ns is None:
                since_ns = at_ns
            assert since_ns is None or at_ns - since_ns <= TOLERANCE_MS * MS, "throttle without steering"

    def check_that_it_drives_again(self):
        self.graph.hold("/e_stop", Bool(False), 10)
        self.car.pad()
        self.graph.run(1.2)  # the ESC may have to find its neutral again
        self.car.pad(autonomous=True)
        counts = self.car.board.changes
        self.graph.run_until(lambda: counts[-1][1][STEERING] < CENTER and counts[-1][1][ESC] > ESC_NEUTRAL, 2.0)
        self.graph.run_until(lambda: self.car.speed_mps > 0.3, 2.0)


def forked(act: Callable[[], list]) -> list:
    """Have something done in a process of its own; return the faults that it found."""
    read_fd, write_fd = os.pipe()
    pid = os.fork()
    if not pid:
        gc.disable()
        try:
            faults = act()
        except BaseException:
            faults = [traceback.format_exc(limit=-2)]
        try:
            with os.fdopen(write_fd, "w", encoding="utf-8") as file:
                json.dump(faults, file)
        finally:
            os._exit(0)
    os.close(write_fd)
    with os.fdopen(read_fd, encoding="utf-8") as file:
        text = file.read()
    _, status = os.waitpid(pid, 0)
    return json.loads(text) if text and not status else [f"status {status}"]


def with_each_stop(story, act):
    """Have the person stop in each way, each in a process of its own."""
    def stopped(stop):
        stop(story.car)
        return act()
    story.run_to(STOP_MS)
    return [f"{name}: {fault}" for name, stop in STOPS.items() for fault in forked(partial(stopped, stop))]


def stalled(story, node, at_ms, number):
    """Stall a thread or, each second time, a process; play the rest of the story, and judge it."""
    story.graph.nodes[node].stall(STALL_MS / 1e3, frozen=number % 2 == 1, after_step=number % 4 > 1)

    def judged():
        story.run_to(max(at_ms + STALL_MS, STOP_MS + JOY_MS + DELAYS_MS[node]) + AFTER_MS)
        story.check(node, at_ms)
        if number % 8 == 4:
            story.check_that_it_drives_again()
        return []
    return judged() if at_ms >= STOP_MS else with_each_stop(story, judged)


def stalled_at_each(story, node, times_ms):
    faults = []
    for number, at_ms in times_ms:
        story.run_to(at_ms)
        faults += [f"at {at_ms} ms: {fault}" for fault in forked(partial(stalled, story, node, at_ms, number))]
    return faults


def whole_story(node):
    """Play the story without a terminal, with a stall at each time; return the faults."""
    sys.stdin = None
    story = Story()
    gc.collect()
    gc.freeze()  # children share the pages
    times_ms = list(enumerate(range(7 * list(DELAYS_MS).index(node) % STEP_MS, STORY_MS, STEP_MS)))

    def end():
        faults = stalled_at_each(story, node, [time for time in times_ms if time[1] >= STOP_MS])
        story.run_to(STORY_MS)
        story.check("", STORY_MS)
        return faults
    return (stalled_at_each(story, node, [time for time in times_ms if time[1] < STOP_MS])
            + with_each_stop(story, end))


@pytest.mark.once
@pytest.mark.parametrize("node", DELAYS_MS)
def test_stall_of_0_6_s_at_each_time_leaves_the_car_safe(forker, node):
    assert forker.submit(forked, partial(whole_story, node)).result() == []
