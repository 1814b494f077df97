#!/usr/bin/env python3
"""Random faults of every kind on the running virtual car while it drives, for as many minutes as asked for.

It plays gamepad and planner against ``demo.launch drive:=false`` on the master in ROS_MASTER_URI, breaks one thing at
a time, sees that the car stops where it must and drives again afterwards, and prints a report. Exit code 0 only if
nothing moved that must not, everything recovered, and nothing leaked.

Unsafe is: servo or ESC off neutral, on the board, although the human's evidence has been gone for longer than every
timeout on the way. Not judged is the time in which the servo board itself cannot be reached, for then nothing can move
its outputs; such faults are made while the car may drive.
"""
from __future__ import annotations

import argparse
import math
import os
import random
import signal
import statistics
import sys
import threading
import time
import xmlrpc.client
from collections import defaultdict

import rosgraph
import rosnode
import rospy
from car_interface.msg import Control, LinkStatus, SteeringState
from car_interface.srv import InjectFault
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Joy
from std_msgs.msg import Bool, Float32, Int32MultiArray
from std_srvs.srv import Trigger

NODES = ("/turn_arb", "/pca9685", "/generic_value_converter", "/teensy_sensor_hub", "/teleop_logi")
STEERING, ESC = 0, 1
CENTER, ESC_NEUTRAL = 5104, 4912  # on the chip: 319 and 307 counts
LEFT = 3824  # for the radius below
RADIUS_M, SPEED_MPS = 1.6, 1.0
PERIOD_S = 0.02
STOPPED_WITHIN_S = 1.0  # 0.25 s joy, 0.5 s human, and room for a busy machine
RECOVERED_WITHIN_S = 15.0
DRIVES_FOR_S = 1.5  # between two faults
WARM_UP_SHARE = 0.4  # of the time: nodes are killed only until then, and what grows afterwards is a leak
MOST_GROWTH_MB = 1.0
AUTONOMOUS_BUTTON = 5
GRANTING = ("/turn_arb", "/teleop_logi")  # one that was started again stops the whole car
STAYS_STOPPED_S = 2.0  # a second in which it waits for e_stop, and one in which it might drive off


class Person:
    """Gamepad, planner and emergency stop: what it is told to hold it publishes at 50 Hz; None = silent."""

    def __init__(self):
        self.deadman: bool | None = True
        self.radius_m: float | None = RADIUS_M
        self.acceleration: float | None = 0.0  # None = silent; a number is added to what the speed asks for
        self.e_stop: bool | None = False
        self.joy_axis = 0.0
        self.speed_mps = 0.0
        self.may_move_until_s = math.inf  # since when the evidence has been gone
        self._joy = rospy.Publisher("joy", Joy, queue_size=10)
        self._radius = rospy.Publisher("av_turnrad_req", Float32, queue_size=10)
        self._command = rospy.Publisher("control/command/control_cmd", Control, queue_size=10)
        self._e_stop = rospy.Publisher("e_stop", Bool, queue_size=10)
        threading.Thread(target=self._live, daemon=True).start()

    def _live(self):
        try:
            self._publish_for_ever()
        except rospy.ROSException:
            pass  # this node ends

    def _publish_for_ever(self):
        while not rospy.is_shutdown():
            grants = bool(self.deadman) and self.e_stop is False and math.isfinite(self.joy_axis)
            self.may_move_until_s = math.inf if grants else min(self.may_move_until_s, time.monotonic())
            if self.deadman is not None:
                buttons = [0] * 11
                buttons[AUTONOMOUS_BUTTON] = int(self.deadman)
                self._joy.publish(Joy(axes=[self.joy_axis] * 8, buttons=buttons))
            if self.radius_m is not None:
                self._radius.publish(self.radius_m)
            if self.acceleration is not None:
                command = Control()
                command.stamp = rospy.Time.now()
                wanted = 1.5 * (SPEED_MPS - self.speed_mps)
                command.longitudinal.acceleration = self.acceleration + max(-2.0, min(2.0, wanted))
                self._command.publish(command)
            if self.e_stop is not None:
                self._e_stop.publish(self.e_stop)
            time.sleep(PERIOD_S)


class Watch:
    """What the car does."""

    def __init__(self, person):
        self._person = person
        self.output = self.state = self.link = None
        self.unsafe: list = []
        self.board_out_of_reach = False
        self.pose = None
        self.distance_m = 0.0
        rospy.Subscriber("/servo/output", Int32MultiArray, self._on_output)
        rospy.Subscriber("turn_arb/state", SteeringState, self._on_state)
        rospy.Subscriber("teensy_sensor_hub/link", LinkStatus, self._on_link)
        rospy.Subscriber("car_sim/truth", Odometry, self._on_truth)

    def _on_output(self, message):
        self.output = message.data

    def _on_state(self, message):
        self.state = message

    def _on_link(self, message):
        self.link = message

    def _on_truth(self, message):
        position = message.pose.pose.position
        if self.pose is not None:
            self.distance_m += math.hypot(position.x - self.pose[0], position.y - self.pose[1])
        self.pose = (position.x, position.y)
        self._person.speed_mps = message.twist.twist.linear.x
        self._judge()

    def _judge(self):
        gone_s = time.monotonic() - self._person.may_move_until_s
        if self.output is None or self.board_out_of_reach or gone_s < STOPPED_WITHIN_S:
            return
        if not self.is_neutral():
            self.unsafe.append((gone_s, self.output[STEERING], self.output[ESC]))

    def is_neutral(self):
        return (self.output[STEERING] in (CENTER, 0, -1)) and self.output[ESC] in (ESC_NEUTRAL, 0, -1)

    def drives(self):
        return (self.state is not None and self.state.source == SteeringState.PLANNER
                and self.output[STEERING] == LEFT and abs(self._person.speed_mps) > 0.3)


class Soak:
    def __init__(self, minutes, seed):
        self._random = random.Random(seed)
        self._end_s = time.monotonic() + 60 * minutes
        self._kill_until_s = time.monotonic() + WARM_UP_SHARE * 60 * minutes
        self._person = Person()
        self._watch = Watch(self._person)
        self._recoveries = defaultdict(list)
        self._failures: list = []
        self._faults = self._all_faults()
        self._deck: list = []

    # --- faults: each makes itself, waits for what must follow, and undoes itself ---

    def _all_faults(self):
        person = self._person
        faults = {
            "human lets go": lambda: self._stopped(lambda: setattr(person, "deadman", False)),
            "gamepad silent": lambda: self._stopped(lambda: setattr(person, "deadman", None)),
            "gamepad axis NaN": lambda: self._stopped(lambda: setattr(person, "joy_axis", math.nan)),
            "e_stop on": lambda: self._stopped(lambda: setattr(person, "e_stop", True)),
            "e_stop silent": lambda: self._stopped(lambda: setattr(person, "e_stop", None), allow_s=1.0),
            "planner silent": lambda: self._centered(lambda: setattr(person, "radius_m", None)),
            "planner NaN": lambda: self._centered(lambda: setattr(person, "radius_m", math.nan)),
            "commands silent": lambda: self._esc_neutral(lambda: setattr(person, "acceleration", None)),
            "command NaN": lambda: self._esc_neutral(lambda: setattr(person, "acceleration", math.nan)),
            "counters asked for all the time": self._ask_for_counters,
        }
        for name, fault, value in (
                ("chip: one transfer not acknowledged", "nack", 1), ("chip: five not acknowledged", "nack", 5),
                ("chip: registers reset", "brownout", 0)):
            faults[name] = lambda fault=fault, value=value: self._inject("/pca9685", fault, value)
        for name, fault, on, off in (("chip: without power", "power", 0, 1), ("bus held down", "hold", 1, 0)):
            faults[name] = lambda fault=fault, on=on, off=off: self._away(fault, on, off)
        for name, fault, value in (
                ("Teensy unplugged", "unplug", 1.0), ("Teensy silent", "silence", 2.0), ("Teensy reboots", "reboot", 0),
                ("line at another baud rate", "scramble", 1.0), ("line cut in mid-frame", "cut", 50),
                ("line flooded", "flood", 1.0), ("Teensy's receiver out of step", "out_of_step", 0)):
            faults[name] = lambda fault=fault, value=value: self._inject("/car_sim", fault, value)
        for name, fault in (("sonar not connected", "sonar_missing"), ("sonar's echo stuck high", "sonar_stuck")):
            faults[name] = lambda fault=fault: self._sonar(fault)
        faults["bit errors"] = self._bit_errors
        for node in NODES:
            faults[f"{node[1:]} frozen for a second"] = lambda node=node: self._freeze(node)
            faults[f"{node[1:]} killed"] = lambda node=node: self._kill(node)
        return faults

    def _inject(self, node, fault, value):
        answer = rospy.ServiceProxy(f"{node}/inject_fault", InjectFault)(fault, value)
        if not answer.success:
            raise RuntimeError(f"{node} refuses {fault} {value}: {answer.message}")

    def _stopped(self, fault, allow_s=0.0):
        fault()
        self._await(self._watch.is_neutral, STOPPED_WITHIN_S + allow_s, "neutral")
        if allow_s:
            self._person.may_move_until_s = time.monotonic()

    def _centered(self, fault):
        fault()
        self._await(lambda: self._watch.output[STEERING] == CENTER, STOPPED_WITHIN_S, "the steering at its center")

    def _esc_neutral(self, fault):
        fault()
        self._await(lambda: self._watch.output[ESC] == ESC_NEUTRAL, STOPPED_WITHIN_S, "the ESC at neutral")

    def _away(self, fault, on, off):
        self._watch.board_out_of_reach = True
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

    def _ask_for_counters(self):
        call = rospy.ServiceProxy("/teensy_sensor_hub/get_counters", Trigger)
        answers = [call().success for _ in range(20)]
        if sum(answers) > 1:
            raise RuntimeError(f"{sum(answers)} of 20 requests for counters were granted")

    def _freeze(self, node):
        self._watch.board_out_of_reach = node == "/pca9685"
        pid = pid_of(node)
        os.kill(pid, signal.SIGSTOP)
        time.sleep(1.0)
        os.kill(pid, signal.SIGCONT)

    def _kill(self, node):
        self._watch.board_out_of_reach = node == "/pca9685"
        pid = pid_of(node)
        os.kill(pid, signal.SIGKILL)
        self._await(lambda: pid_of(node) not in (None, pid), RECOVERED_WITHIN_S, f"another {node}")
        if node in GRANTING:  # the deadman is held all the time, and must not count for the new one
            time.sleep(STAYS_STOPPED_S)
            self._await(self._watch.is_neutral, 0.0, f"neutral after {node} was started again")

    # --- the run ---

    def run(self):
        self._await(lambda: self._watch.state is not None and self._watch.output is not None, 30, "the nodes")
        self._recover()
        before = None
        while time.monotonic() < self._end_s:
            kills = time.monotonic() < self._kill_until_s
            if not kills and before is None:
                before = {node: Footprint(node) for node in NODES}
            self._make_one(self._next_fault(kills))
        after = {node: Footprint(node) for node in NODES}
        return self._report(before or {}, after)

    def _next_fault(self, kills):
        """Each comes once, in another order, before any comes again."""
        deck = [name for name in self._deck if kills or "killed" not in name]
        if not deck:
            self._deck = sorted(self._faults)
            self._random.shuffle(self._deck)
            return self._next_fault(kills)
        self._deck.remove(deck[0])
        return deck[0]

    def _make_one(self, name):
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
        person = self._person
        person.radius_m, person.acceleration, person.joy_axis, person.e_stop = RADIUS_M, 0.0, 0.0, False

    def _recover(self):
        """Let go of the deadman, hold it again, and see the car drive and the Teensy answer."""
        self._undo()
        deadline_s = time.monotonic() + RECOVERED_WITHIN_S
        while True:
            self._person.deadman = False
            time.sleep(0.3)
            self._person.deadman = True
            try:
                self._await(self._watch.drives, 2.0, "the car to drive")
                break
            except AssertionError:
                if time.monotonic() > deadline_s:
                    raise
        self._watch.board_out_of_reach = False
        pongs = self._watch.link.pongs if self._watch.link else 0
        self._await(lambda: self._watch.link and self._watch.link.open and self._watch.link.pongs > pongs,
                    RECOVERED_WITHIN_S, "a pong")

    def _await(self, condition, within_s, what):
        deadline_s = time.monotonic() + within_s
        while not condition():
            if time.monotonic() > deadline_s:
                state = self._watch.state
                raise AssertionError(f"not within {within_s:.1f} s: {what} (output "
                                     f"{list(self._watch.output or ())[:2]}, {state.reason if state else 'no state'})")
            time.sleep(0.01)

    def _report(self, before, after):
        print(f"\n{'fault':44} {'times':>5} {'median s':>9} {'worst s':>8}")
        for name, times_s in sorted(self._recoveries.items()):
            print(f"{name:44} {len(times_s):5} {statistics.median(times_s):9.2f} {max(times_s):8.2f}")
        leaks = [leak for node in before for leak in before[node].leaks_until(after[node])]
        for node in before:
            print(f"{node:44} {before[node]} before, {after[node]} after")
        print(f"faults {sum(map(len, self._recoveries.values())) + len(self._failures)}, not recovered "
              f"{len(self._failures)}, unsafe moments {len(self._watch.unsafe)}, leaks {len(leaks)}, "
              f"driven {self._watch.distance_m:.0f} m")
        for text in (*self._failures, *(f"unsafe: {moment}" for moment in self._watch.unsafe[:5]), *leaks):
            print(f"  {text}")
        return not (self._failures or self._watch.unsafe or leaks)


class Footprint:
    """What a node's process takes now."""

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
        found = []
        if later.memory_mb - self.memory_mb > MOST_GROWTH_MB:
            found.append(f"{self._node} grew by {later.memory_mb - self.memory_mb:.1f} MB")
        if later.threads > self.threads + 1:
            found.append(f"{self._node} has {later.threads} threads, and had {self.threads}")
        if later.fds > self.fds + 2:
            found.append(f"{self._node} has {later.fds} files open, and had {self.fds}")
        return found


def pid_of(node):
    """A node's process id; None while it can't be reached."""
    try:
        uri = rosnode.get_api_uri(rosgraph.Master("/soak_rosnode"), node, skip_cache=True)
        return xmlrpc.client.ServerProxy(uri).getPid("/soak")[2] if uri else None
    except (OSError, xmlrpc.client.Error, rosnode.ROSNodeIOException):
        return None


def main():
    parser = argparse.ArgumentParser(description="Random faults on the running virtual car.")
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=None, help="the same faults in the same order")
    arguments = parser.parse_args(rospy.myargv()[1:])
    rospy.init_node("soak")
    seed = arguments.seed if arguments.seed is not None else random.SystemRandom().randrange(10 ** 6)
    print(f"seed {seed}", flush=True)
    sys.exit(0 if Soak(arguments.minutes, seed).run() else 1)


if __name__ == "__main__":
    main()
