#!/usr/bin/env python3
"""Random faults of every kind on the running virtual car while it drives, for as many minutes as asked for.

It is gamepad and planner of ``demo.launch drive:=false`` on the master in ROS_MASTER_URI. It injects one fault at a
time, checks that the car stops where it must and drives again afterwards, and prints a report. Exit code 0: no output
moved that must not, the car recovered from each fault, and no node leaked.

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
import statistics
import sys
import time
import xmlrpc.client
from collections import defaultdict
from functools import partial

import rosgraph
import rosnode
import rospy
from car_interface.srv import InjectFault
from soak_car import ESC, RADIUS_M, STEERING, STOPPED_WITHIN_S, Inputs, Observer
from std_srvs.srv import Trigger

NODES = ("/turn_arb", "/throttle_arb", "/pca9685", "/generic_value_converter", "/teensy_sensor_hub", "/teleop_logi")
RECOVERED_WITHIN_S = 15.0
DRIVES_FOR_S = 1.5  # between two faults
WARM_UP_RATIO = 0.4  # of the time: nodes are killed only until then, and what grows afterwards is a leak
MAX_GROWTH_MB = 1.0
STOPS_AFTER_RESTART = ("/turn_arb", "/teleop_logi")
STAYS_STOPPED_S = 2.0  # a second in which it waits for e_stop, and one in which it might drive off
INPUT_FAULTS = {  # an attribute of Inputs, its value, the channels that must be at neutral then, and how much later
    "human lets go": ("deadman", False, ()), "gamepad silent": ("deadman", None, ()),
    "gamepad axis NaN": ("joy_axis", math.nan, ()), "e_stop on": ("e_stop", True, ()),
    "e_stop silent": ("e_stop", None, (), 1.0),
    "planner silent": ("radius_m", None, (STEERING,)), "planner NaN": ("radius_m", math.nan, (STEERING,)),
    "commands silent": ("acceleration", None, (ESC,)), "command NaN": ("acceleration", math.nan, (ESC,))}
INJECTED = {
    "chip: one transfer not acknowledged": ("/pca9685", "nack", 1),
    "chip: five not acknowledged": ("/pca9685", "nack", 5), "chip: registers reset": ("/pca9685", "brownout", 0),
    "Teensy unplugged": ("/car_sim", "unplug", 1.0), "Teensy silent": ("/car_sim", "silence", 2.0),
    "Teensy reboots": ("/car_sim", "reboot", 0), "line at another baud rate": ("/car_sim", "scramble", 1.0),
    "line cut in mid-frame": ("/car_sim", "cut", 50), "line flooded": ("/car_sim", "flood", 1.0),
    "Teensy's receiver out of step": ("/car_sim", "out_of_step", 0)}


class Soak:
    """One run: faults until the time is over, then the report."""

    def __init__(self, minutes, seed):
        self._random = random.Random(seed)
        self._end_s = time.monotonic() + 60 * minutes
        self._kill_until_s = time.monotonic() + WARM_UP_RATIO * 60 * minutes
        self._inputs = Inputs()
        self._observer = Observer(self._inputs)
        self._recoveries = defaultdict(list)
        self._failures: list = []
        self._faults = self._all_faults()
        self._pending: list = []

    # --- faults: each is injected, waits for its effect, and is undone ---

    def _all_faults(self):
        faults = {name: partial(self._change_input, *fault) for name, fault in INPUT_FAULTS.items()}
        faults.update({name: partial(self._inject, *fault) for name, fault in INJECTED.items()})
        faults.update({
            "chip: without power": lambda: self._disconnect_board("power", 0, 1),
            "bus held down": lambda: self._disconnect_board("hold", 1, 0),
            "sonar not connected": lambda: self._sonar("sonar_missing"),
            "sonar's echo stuck high": lambda: self._sonar("sonar_stuck"),
            "bit errors": self._bit_errors, "counters asked for all the time": self._request_counters})
        for node in NODES:
            faults[f"{node[1:]} frozen for a second"] = partial(self._freeze, node)
            faults[f"{node[1:]} killed"] = partial(self._kill, node)
        return faults

    def _change_input(self, name, value, channels, allow_s=0.0):
        setattr(self._inputs, name, value)
        self._await(lambda: self._observer.is_neutral(*channels), STOPPED_WITHIN_S + allow_s, f"{channels} at neutral")
        if allow_s:
            self._inputs.may_move_until_s = time.monotonic()

    def _inject(self, node, fault, value):
        answer = rospy.ServiceProxy(f"{node}/inject_fault", InjectFault)(fault, value)
        if not answer.success:
            raise RuntimeError(f"{node} refuses {fault} {value}: {answer.message}")

    def _disconnect_board(self, fault, on, off):
        self._observer.board_unreachable = True
        self._inject("/pca9685", fault, on)
        time.sleep(self._random.uniform(0.3, 1.5))
        self._inject("/pca9685", fault, off)

    def _bit_errors(self):
        self._inject("/car_sim", "bit_errors", 1e-3)
        time.sleep(2.0)
        self._inject("/car_sim", "bit_errors", 0)

    def _sonar(self, fault):
        sensor = self._random.randrange(6)
        self._inject("/car_sim", fault, sensor)
        time.sleep(self._random.uniform(0.5, 2.0))
        self._inject("/car_sim", "sonar_fine", sensor)

    def _request_counters(self):
        call = rospy.ServiceProxy("/teensy_sensor_hub/get_counters", Trigger)
        answers = [call().success for _ in range(20)]
        if sum(answers) > 1:
            raise RuntimeError(f"{sum(answers)} of 20 requests for counters were granted")

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
        if node in STOPS_AFTER_RESTART:  # it must not accept the deadman, which is held all the time
            time.sleep(STAYS_STOPPED_S)
            self._await(self._observer.is_neutral, 0.0, f"neutral after {node} was started again")

    # --- the run ---

    def run(self):
        self._await(lambda: self._observer.state is not None and self._observer.output is not None, 30, "the nodes")
        self._recover()
        before = None
        while time.monotonic() < self._end_s:
            kills = time.monotonic() < self._kill_until_s
            if not kills and before is None:
                before = {node: Footprint(node) for node in NODES}
            self._try_fault(self._next_fault(kills))
        after = {node: Footprint(node) for node in NODES}
        return self._report(before or {}, after)

    def _next_fault(self, kills):
        """Return the next fault: each comes once, in random order, before any is repeated."""
        pending = [name for name in self._pending if kills or "killed" not in name]
        if not pending:
            self._pending = sorted(self._faults)
            self._random.shuffle(self._pending)
            return self._next_fault(kills)
        self._pending.remove(pending[0])
        return pending[0]

    def _try_fault(self, name):
        begun_s = time.monotonic()
        try:
            self._faults[name]()
            self._recover()
        except (AssertionError, RuntimeError, rospy.ServiceException) as error:
            self._failures.append(f"{name}: {error}")
            print(f"  {name}: {error}", flush=True)
            self._undo()
            return
        took_s = time.monotonic() - begun_s
        self._recoveries[name].append(took_s)
        print(f"{time.strftime('%H:%M:%S')}  {name:42} drives again after {took_s:5.2f} s", flush=True)
        time.sleep(self._random.uniform(0.5, DRIVES_FOR_S))

    def _undo(self):
        inputs = self._inputs
        inputs.radius_m, inputs.acceleration, inputs.joy_axis, inputs.e_stop = RADIUS_M, 0.0, 0.0, False

    def _recover(self):
        """Release the deadman and hold it again, until the car drives and the Teensy answers."""
        self._undo()
        deadline_s = time.monotonic() + RECOVERED_WITHIN_S
        while True:
            self._inputs.deadman = False
            time.sleep(0.3)
            self._inputs.deadman = True
            try:
                self._await(self._observer.drives, 2.0, "the car to drive")
                break
            except AssertionError:
                if time.monotonic() > deadline_s:
                    raise
        self._observer.board_unreachable = False
        pongs = self._observer.link.pongs if self._observer.link else 0
        self._await(lambda: self._observer.link and self._observer.link.open and self._observer.link.pongs > pongs,
                    RECOVERED_WITHIN_S, "a pong")

    def _await(self, condition, within_s, what):
        deadline_s = time.monotonic() + within_s
        while not condition():
            if time.monotonic() > deadline_s:
                output, state = self._observer.output or (), self._observer.state
                raise AssertionError(f"not within {within_s:.1f} s: {what} (output {list(output)[:2]}, "
                                     f"{state.reason if state else 'no state'})")
            time.sleep(0.01)

    def _report(self, before, after):
        print(f"\n{'fault':44} {'times':>5} {'median s':>9} {'worst s':>8}")
        for name, times_s in sorted(self._recoveries.items()):
            print(f"{name:44} {len(times_s):5} {statistics.median(times_s):9.2f} {max(times_s):8.2f}")
        leaks = [leak for node in before for leak in before[node].leaks_until(after[node])]
        for node in before:
            print(f"{node:44} {before[node]} before, {after[node]} after")
        print(f"faults {sum(map(len, self._recoveries.values())) + len(self._failures)}, not recovered "
              f"{len(self._failures)}, unsafe moments {len(self._observer.unsafe)}, leaks {len(leaks)}, "
              f"driven {self._observer.distance_m:.0f} m")
        for text in (*self._failures, *(f"unsafe: {moment}" for moment in self._observer.unsafe[:5]), *leaks):
            print(f"  {text}")
        return not (self._failures or self._observer.unsafe or leaks)


class Footprint:
    def __init__(self, node):
        self._node = node
        self.pid = pid_of(node)
        folder = f"/proc/{self.pid}"
        self.fds = len(os.listdir(f"{folder}/fd"))
        self.threads = len(os.listdir(f"{folder}/task"))
        with open(f"{folder}/statm", encoding="ascii") as file:
            self.memory_mb = int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6

    def __str__(self):
        return f"{self.memory_mb:5.1f} MB, {self.threads} threads, {self.fds} files"

    def leaks_until(self, later):
        if later.pid != self.pid:
            return [f"{self._node} is not the process that it was"]
        has_grown = (later.memory_mb - self.memory_mb > MAX_GROWTH_MB or later.threads > self.threads + 1
                     or later.fds > self.fds + 2)
        return [f"{self._node} has {later}, and had {self}"] if has_grown else []


def pid_of(node):
    """Return a node's process id, or None while it cannot be reached."""
    try:
        uri = rosnode.get_api_uri(rosgraph.Master("/soak_rosnode"), node, skip_cache=True)
        return xmlrpc.client.ServerProxy(uri).getPid("/soak")[2] if uri else None
    except (OSError, xmlrpc.client.Error, rosnode.ROSNodeIOException):
        return None


def main():
    parser = argparse.ArgumentParser(description="Random faults on the running virtual car.")
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=random.SystemRandom().randrange(10 ** 6),
                        help="the same faults in the same order")
    arguments = parser.parse_args(rospy.myargv()[1:])
    rospy.init_node("soak")
    print(f"seed {arguments.seed}", flush=True)
    sys.exit(0 if Soak(arguments.minutes, arguments.seed).run() else 1)


if __name__ == "__main__":
    main()
