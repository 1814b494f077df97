"""Random faults of every kind on a car that drives: nothing moves that must not, and it drives again afterwards.

``./dev soak`` does the like to the processes, in real time.
"""
from __future__ import annotations

import math
import os
import random

import pytest
from car_interface.msg import Control, SteeringState
from car_interface.srv import InjectFaultRequest
from std_msgs.msg import Bool, Float32

from car import ADDRESS, CENTER, CONTROL, ESC, ESC_NEUTRAL, STEERING, Car
from graph import NS_PER_S

ROUNDS = 20 if os.environ.get("CAR_INTERFACE_ALL") else 1
SEED = int(os.environ.get("CAR_INTERFACE_SEED", random.SystemRandom().randrange(10 ** 6) if ROUNDS > 1 else 1))
LINK = "/teensy_sensor_hub/link"
NODES = ("/turn_arb", "/throttle_arb", "/pca9685", "/generic_value_converter", "/teensy_sensor_hub", "/teleop_logi")
KEEPS_STOPPED = ("/turn_arb", "/teleop_logi")  # started again under a deadman that is held
RADIUS_M, SPEED_MPS = 1.6, 1.0
OFF = 0  # counts of a pin that is off
PINS_AT_REST = {STEERING: (CENTER, OFF), ESC: (ESC_NEUTRAL, OFF)}
JOY_S, E_STOP_S, TIMER_S, INPUT_S = 0.25, 1.0, 0.06, 0.5


class Soak:
    """A whole virtual car, a person and a planner, and what can go wrong."""

    def __init__(self, choose):
        self.choose = choose
        self.car = Car().whole(collisions=False)
        self.graph = self.car.graph
        self.graph.record(LINK)
        self.plan()

    def plan(self, radius_m=RADIUS_M, extra_mps2=0.0):
        def command():
            message = Control()
            control_mps2 = 1.5 * (SPEED_MPS - self.car.speed_mps)
            message.longitudinal.acceleration = extra_mps2 + max(-2.0, min(2.0, control_mps2))
            return message
        self.graph.hold("/av_turnrad_req", Float32(radius_m), 50, "/planner")
        self.graph.hold(CONTROL, command, 50, "/planner")

    def undo(self):
        self.car.joy()
        self.graph.hold("/e_stop", Bool(False), 10)
        self.plan()

    def at_rest(self, *pins):
        return all(self.car.board.counts[pin] in PINS_AT_REST[pin] for pin in pins)

    def drives(self):
        return (self.graph.newest("/turn_arb/state").source == SteeringState.PLANNER and self.car.speed_mps > 0.3
                and self.car.board.counts[STEERING] < CENTER and self.car.board.counts[ESC] > ESC_NEUTRAL)

    def recover(self):
        """Let go of the deadman and hold it again, until the car drives and the Teensy answers."""
        self.undo()
        for attempt in range(5):
            self.car.pad()
            self.graph.run(0.3)
            self.car.pad(autonomous=True)
            try:
                self.graph.run_until(self.drives, 3.0)
                break
            except AssertionError:
                if attempt == 4:
                    raise
        pongs = self.graph.newest(LINK).pongs
        self.graph.run_until(lambda: self.graph.newest(LINK).open and self.graph.newest(LINK).pongs > pongs, 8.0)
        self.graph.run(self.choose.uniform(0.3, 1.5))

    def stopped(self, within_s, *pins):
        self.graph.run_until(lambda: self.at_rest(*pins), within_s + TIMER_S)
        since_ns = self.graph.now_ns
        self.graph.run(self.choose.uniform(0.2, 2.0))
        assert self.at_rest(*pins)
        for pin in pins:
            assert {counts for _, counts in self.car.board.since(since_ns, pin)} <= set(PINS_AT_REST[pin])

    # --- faults ---

    def faults(self):
        car, graph = self.car, self.graph
        both = (STEERING, ESC)
        found = {
            "human lets go": lambda: (car.pad(), self.stopped(0.0, *both)),
            "gamepad silent": lambda: (car.joy(False), self.stopped(JOY_S, *both)),
            "gamepad axis NaN": lambda: (car.pad(autonomous=True, steering=math.nan), self.stopped(0.0, *both)),
            "e_stop on": lambda: (graph.hold("/e_stop", Bool(True), 10), self.stopped(0.0, *both)),
            "e_stop silent": lambda: (graph.silence("/e_stop"), self.stopped(E_STOP_S, *both)),
            "planner silent": lambda: (graph.silence("/av_turnrad_req", sender="/planner"),
                                       self.stopped(INPUT_S, STEERING)),
            "planner NaN": lambda: (self.plan(math.nan), self.stopped(0.0, STEERING)),
            "commands silent": lambda: (graph.silence(CONTROL, sender="/planner"), self.stopped(2 * INPUT_S, ESC)),
            "command NaN": lambda: (self.plan(extra_mps2=math.nan), self.stopped(0.0, ESC)),
            "chip: one transfer not acknowledged": lambda: self.nacks(1),
            "chip: five not acknowledged": lambda: self.nacks(5),
            "chip: registers reset": lambda: (car.board.brown_out(), graph.run(0.5)),
            "chip: without power": self.power,
            "bus held down": lambda: (self.hold(True), graph.run(self.choose.uniform(0.3, 1.5)), self.hold(False)),
        }
        for name, value, duration_s in (("unplug", 1.0, 1.1), ("silence", 2.0, 2.0), ("reboot", 0, 0.5),
                                        ("flood", 1.0, 1.0),
                                        ("scramble", 1.0, 1.0), ("cut", 50, 0.1), ("out_of_step", 0, 0.1),
                                        ("bit_errors", 1e-3, 2.0)):
            found[f"line: {name}"] = lambda name=name, value=value, duration_s=duration_s: (
                self.inject(name, value), graph.run(duration_s), self.inject("bit_errors", 0))
        for name in ("sonar_missing", "sonar_stuck", "sonar_blink"):
            found[name] = lambda name=name: self.sonar(name)
        for node in NODES:
            found[f"{node} frozen"] = lambda node=node: (graph.nodes[node].stall(1.0, frozen=True), graph.run(1.1))
            found[f"{node} killed"] = lambda node=node: self.kill(node)
        return found

    def nacks(self, count):
        self.car.board.bus.nacks_left = count
        self.graph.run(0.5)

    def hold(self, held):
        self.car.board.bus.held = held

    def power(self):
        chip = self.car.board.bus.remove(ADDRESS)
        self.graph.run(self.choose.uniform(0.3, 1.5))
        chip.power_up()
        self.car.board.bus.attach(ADDRESS, chip)

    def inject(self, fault, value):
        answer = self.graph.call("/car_sim/inject_fault", InjectFaultRequest(fault, value))
        assert answer.success, answer.message

    def sonar(self, fault):
        sensor = self.choose.randrange(6)
        self.inject(fault, sensor)
        self.graph.run(self.choose.uniform(0.5, 2.0))
        self.inject("sonar_fine", sensor)

    def kill(self, node):
        self.graph.nodes[node].kill()
        self.graph.run(1.0)
        self.graph.nodes[node].start()
        if node in KEEPS_STOPPED:
            self.stopped(0.5, STEERING, ESC)
            self.graph.run(2.0)
            assert self.at_rest(STEERING, ESC)


@pytest.mark.once
@pytest.mark.parametrize("number", range(ROUNDS))
def test_car_stops_at_each_fault_that_takes_the_human_away_and_drives_again_after_all(number):
    choose = random.Random(SEED + number)
    soak = Soak(choose)
    soak.graph.run(3.0)
    soak.recover()
    names = sorted(soak.faults())
    choose.shuffle(names)
    for name in names:
        try:
            soak.faults()[name]()
            soak.recover()
        except AssertionError as error:
            state = soak.graph.newest("/turn_arb/state")
            raise AssertionError(f"CAR_INTERFACE_SEED={SEED + number}: {name}: {error}; {state.reason}, ESC "
                                 f"{soak.graph.newest('/throttle_arb/state').esc_reason}") from error
        assert [(node.name, node.fault) for node in soak.graph.nodes.values() if not node.is_alive] == []
    assert soak.graph.now_ns / NS_PER_S > 1000 + 3 * len(names)
