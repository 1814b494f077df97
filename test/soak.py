#!/usr/bin/env python3
"""Random faults of every kind on the running virtual car while it drives, for as many minutes as asked for.

It is gamepad and planner of ``demo.launch drive:=false`` on the master in ROS_MASTER_URI. It injects one fault at a
time and has the car drive again. Exit code 0: no output moved that must not, the car recovered from each fault, and no
node leaked. How each input's fault stops the car, and what a restarted node does, graph/test_chain.py tests exactly.

Unsafe is servo or ESC off neutral, on the board, longer after the human's evidence ended than every timeout of the
chain. The time in which the servo board cannot be reached is not checked, since nothing can change its outputs then;
such faults are injected while the car may drive.
"""
from __future__ import annotations

import argparse
import math
import os
import random
import signal
import sys
import time
from functools import partial
from pathlib import Path
from typing import NamedTuple

import rospy
from car_interface.msg import Control, LinkStatus, SteeringState
from car_interface.srv import InjectFault
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Joy
from std_msgs.msg import Bool, Float32, Int32MultiArray

sys.path.append(str(Path(__file__).resolve().parent / "process"))
from closing import pid_of
from waiting import Repeater, eventually

NODES = ("/turn_arb", "/throttle_arb", "/pca9685", "/generic_value_converter", "/teensy_sensor_hub", "/teleop_logi")
NEUTRALS = {0: 5104, 1: 4912}  # of steering and ESC, by channel, on the chip: 319 and 307 counts
COUNT = 16  # duty of one count of the chip
RADIUS_M, SPEED_MPS = 1.6, 1.0  # what the planner asks for
PERIOD_S = 0.02
STOPPED_WITHIN_S = 1.0  # 0.25 s joy, 0.5 s human, and time for a busy machine
RECOVERED_WITHIN_S = 15.0
MAX_GROWTH_MB = 1.0
INPUT_FAULTS = {  # attribute of Inputs, its value, and for how long
    "human lets go": ("deadman", False, 1.5), "gamepad silent": ("deadman", None, 2.0),
    "gamepad axis NaN": ("joy_axis", math.nan, 1.5), "e_stop on": ("e_stop", True, 1.5),
    "planner silent": ("radius_m", None, 1.0), "commands silent": ("acceleration", None, 1.0)}
INJECTED = {  # node, fault, value, and a second value after a while
    "chip: five not acknowledged": ("/pca9685", "nack", 5), "chip: registers reset": ("/pca9685", "brownout", 0),
    "chip: without power": ("/pca9685", "power", 0, 1), "bus held down": ("/pca9685", "hold", 1, 0),
    "Teensy unplugged": ("/car_sim", "unplug", 1.0), "Teensy silent": ("/car_sim", "silence", 2.0),
    "Teensy reboots": ("/car_sim", "reboot", 0), "line at another baud rate": ("/car_sim", "scramble", 1.0),
    "line cut in mid-frame": ("/car_sim", "cut", 50), "line flooded": ("/car_sim", "flood", 1.0),
    "bit errors": ("/car_sim", "bit_errors", 1e-3, 0), "Teensy's receiver out of step": ("/car_sim", "out_of_step", 0)}


class Inputs:
    """Gamepad, planner and emergency stop: publishes its attributes at 50 Hz; None = nothing is published."""

    def __init__(self):
        self.speed_mps = 0.0
        self.may_move_until_s = math.inf  # when the human's evidence ended
        self.undo()
        self._topics = [rospy.Publisher(topic, kind, queue_size=10) for topic, kind in (
            ("joy", Joy), ("av_turnrad_req", Float32), ("control/command/control_cmd", Control), ("e_stop", Bool))]
        repeater = Repeater(PERIOD_S)
        repeater.hold(self, None)
        self.end = repeater.end

    def publish(self, _):
        """Publish all of it, as the sender that a Repeater has."""
        permits = bool(self.deadman) and self.e_stop is False and math.isfinite(self.joy_axis)
        self.may_move_until_s = math.inf if permits else min(self.may_move_until_s, time.monotonic())
        joy = command = None
        if self.deadman is not None:
            joy = Joy(axes=[self.joy_axis] * 8, buttons=[0] * 11)
            joy.buttons[5] = int(self.deadman)
        if self.acceleration is not None:
            command = Control(stamp=rospy.Time.now())
            control = 1.5 * (SPEED_MPS - self.speed_mps)
            command.longitudinal.acceleration = self.acceleration + max(-2.0, min(2.0, control))
        for topic, message in zip(self._topics, (joy, self.radius_m, command, self.e_stop)):
            if message is not None:
                topic.publish(message)

    def undo(self):
        self.deadman: bool | None = True
        self.radius_m: float | None = RADIUS_M
        self.acceleration: float | None = 0.0  # added to that of the speed control
        self.e_stop: bool | None = False
        self.joy_axis = 0.0


class Observer:
    """The car's newest state, and each moment at which an output was off neutral that must not be."""

    def __init__(self, inputs):
        self._inputs = inputs
        self.output = self.state = self.link = None
        self.unsafe: list = []
        self.board_unreachable = False
        for topic, kind, name in (("turn_arb/state", SteeringState, "state"),
                                  ("teensy_sensor_hub/link", LinkStatus, "link")):
            rospy.Subscriber(topic, kind, partial(setattr, self, name))
        rospy.Subscriber("/servo/output", Int32MultiArray, lambda message: setattr(self, "output", message.data))
        rospy.Subscriber("car_sim/truth", Odometry, self._on_truth)

    def _on_truth(self, message):
        self._inputs.speed_mps = message.twist.twist.linear.x
        passed_s = time.monotonic() - self._inputs.may_move_until_s
        is_judged = self.output is not None and not self.board_unreachable and passed_s >= STOPPED_WITHIN_S
        if is_judged and any(self.output[channel] not in (neutral, 0, -1) for channel, neutral in NEUTRALS.items()):
            self.unsafe.append((passed_s, self.output[:2]))

    def drives(self):
        return (self.state is not None and self.state.source == SteeringState.PLANNER
                and self.output is not None and abs(self.output[0] - self.state.duty) <= COUNT / 2
                and abs(self._inputs.speed_mps) > 0.3)

    def has_pong(self, after):
        return self.link is not None and self.link.open and self.link.pongs > after


class Soak:
    """One run: faults until the time is over, then the report."""

    def __init__(self, minutes, seed):
        self._random = random.Random(seed)
        self._end_s = time.monotonic() + 60 * minutes
        self._kill_until_s = time.monotonic() + 0.4 * 60 * minutes  # what grows afterwards is a leak
        self._inputs = Inputs()
        self.end = self._inputs.end
        self._observer = Observer(self._inputs)
        self._failures: list = []
        self._faults = {name: partial(self._change_input, *fault) for name, fault in INPUT_FAULTS.items()}
        self._faults.update({name: partial(self._inject, *fault) for name, fault in INJECTED.items()})
        for node in NODES:
            self._faults[f"{node[1:]} frozen for a second"] = partial(self._freeze, node)
            self._faults[f"{node[1:]} killed"] = partial(self._kill, node)

    def _change_input(self, name, value, lasts_s):
        setattr(self._inputs, name, value)
        time.sleep(lasts_s)

    def _inject(self, node, fault, *values):
        self._observer.board_unreachable = node == "/pca9685"
        for value in values:
            answer = rospy.ServiceProxy(f"{node}/inject_fault", InjectFault)(fault, value)
            if not answer.success:
                raise RuntimeError(f"{node} refuses {fault} {value}: {answer.message}")
            time.sleep(self._random.uniform(0.3, 1.5))

    def _freeze(self, node):
        self._observer.board_unreachable = node == "/pca9685"
        pid = pid_of(node)
        os.kill(pid, signal.SIGSTOP)
        time.sleep(1.0)
        os.kill(pid, signal.SIGCONT)

    def _kill(self, node):
        self._observer.board_unreachable = node == "/pca9685"
        pid = pid_of(node)
        os.kill(pid, signal.SIGKILL)
        self._await(lambda: pid_of(node) not in (None, pid), RECOVERED_WITHIN_S, f"another {node}")

    def run(self):
        self._recover()
        before = None
        for name in self._names():
            if "killed" not in name and before is None and time.monotonic() > self._kill_until_s:
                time.sleep(5.0)  # until all are connected again
                before = {node: footprint(node) for node in NODES}
            self._try_fault(name)
        return self._report(before or {}, {node: footprint(node) for node in NODES})

    def _names(self):
        """Until the end, each fault once, in random order, before any is repeated."""
        while True:
            for name in self._random.sample(sorted(self._faults), len(self._faults)):
                now_s = time.monotonic()
                if now_s > self._end_s:
                    return
                if "killed" not in name or now_s < self._kill_until_s:
                    yield name

    def _try_fault(self, name):
        begun_s = time.monotonic()
        try:
            self._faults[name]()
            self._recover()
        except (AssertionError, RuntimeError, rospy.ServiceException) as error:
            self._failures.append(f"{name}: {error}")
            print(f"  {name}: {error}", flush=True)
            self._inputs.undo()
            return
        print(f"{time.strftime('%X')}  {name:42} drives again after {time.monotonic() - begun_s:5.2f} s", flush=True)
        time.sleep(self._random.uniform(0.5, 1.5))

    def _recover(self):
        """Release the deadman and hold it again, until the car drives and the Teensy answers."""
        self._inputs.undo()
        deadline_s = time.monotonic() + RECOVERED_WITHIN_S
        while not self._observer.drives():
            self._inputs.deadman = False
            time.sleep(0.3)
            self._inputs.deadman = True
            try:
                self._await(self._observer.drives, 2.0, "the car to drive")
            except AssertionError:
                if time.monotonic() > deadline_s:
                    raise
        self._observer.board_unreachable = False
        pongs = self._observer.link.pongs if self._observer.link else 0
        self._await(lambda: self._observer.has_pong(pongs), RECOVERED_WITHIN_S, "a pong")

    def _await(self, condition, within_s, what):
        def missing():
            output, state = self._observer.output or (), self._observer.state
            return f"{what} (output {list(output)[:2]}, {state.reason if state else 'no state'})"
        eventually(condition, missing, within_s)

    def _report(self, before, after):
        leaks = [f"leak: {node}" for node in before if before[node].has_grown_until(after[node])]
        for node in before:
            print(f"{node:44} {before[node]} before, {after[node]} after")
        for text in (*self._failures, *(f"unsafe: {moment}" for moment in self._observer.unsafe[:5]), *leaks):
            print(f"  {text}")
        print(f"not recovered {len(self._failures)}, unsafe moments {len(self._observer.unsafe)}, leaks {len(leaks)}")
        return not (self._failures or self._observer.unsafe or leaks)


class Footprint(NamedTuple):
    pid: int
    memory_mb: float
    threads: int
    files: int

    def __str__(self):
        return f"{self.memory_mb:.1f} MB, {self.threads} threads, {self.files} files"

    def has_grown_until(self, later):
        return (later.pid != self.pid or later.memory_mb - self.memory_mb > MAX_GROWTH_MB
                or later.threads > self.threads + 1 or later.files > self.files + 2)


def footprint(node):
    pid = pid_of(node)
    with open(f"/proc/{pid}/statm", encoding="ascii") as file:
        memory_mb = int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6
    return Footprint(pid, memory_mb, *(len(os.listdir(f"/proc/{pid}/{name}")) for name in ("task", "fd")))


def main():
    parser = argparse.ArgumentParser(description="Random faults on the running virtual car.")
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=random.SystemRandom().randrange(10 ** 6),
                        help="the same faults in the same order")
    arguments = parser.parse_args(rospy.myargv()[1:])
    rospy.init_node("soak")
    print(f"seed {arguments.seed}", flush=True)
    soak = Soak(arguments.minutes, arguments.seed)
    try:
        sys.exit(0 if soak.run() else 1)
    finally:
        soak.end()


if __name__ == "__main__":
    main()
