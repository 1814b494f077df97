#!/usr/bin/env python3
"""What becomes of a node whose name another one has: a launch file that is started twice, killed and frozen nodes."""
from __future__ import annotations

import os
import re
import shutil
import signal
import sys
import tempfile
import time
import unittest
import xmlrpc.client

import rosgraph
import rospy
import rostest
import yaml
from rosgraph_msgs.msg import Log
from sensor_msgs.msg import Joy
from std_msgs.msg import Bool, Int32MultiArray

from car_interface.teleop.gamepad import REARM_TEXT
from virtual_car import PACKAGE, Chip
from waiting import Repeater, Sender, Topic, config, eventually, executable, retried, set_params, start, start_node
from witness import measured

NODES = ("turn_arb", "pca9685", "teensy_sensor_hub", "generic_value_converter", "teleop_logi")
LEFT_DUTY, LEFT, CENTER, OFF = 3800, 238, 319, 0  # counts of 3800, 5100
LAUNCH_S = 60
BOTH_S = 10  # how long both launch files run
REST_S = 0.3  # a stick that a node first sees off its center must rest for 0.15 s before it counts
MAX_GAP_S = 0.1  # of commands at 100 Hz; a channel times out after 0.25 s
RESPAWN_MS = 5000  # Python's start and rospy's, on a computer with other work; a silent node would add 10 s
BARE = os.path.join(PACKAGE, "test", "bench", "bare.py")


def pid_of(name):
    """The process of a node, None when there's none."""
    try:
        return xmlrpc.client.ServerProxy(rosgraph.Master("/test").lookupNode(name)).getPid("/test")[2]
    except (rosgraph.MasterException, OSError):
        return None


def joy(held):
    """The wheel to the left with the manual deadman, or all let go."""
    axes, buttons = [0.0] * 6, [0] * 11
    axes[0], buttons[4] = float(held), int(held)
    return Joy(axes=axes, buttons=buttons)


def output_of(process):
    """All lines of a process so far."""
    return process.stdout.since() + process.stderr.since()


class ALaunchFileStartedTwice(unittest.TestCase):
    def setUp(self):
        self.folder = tempfile.mkdtemp()
        self.addCleanup(shutil.rmtree, self.folder, ignore_errors=True)
        self.repeater = Repeater(0.02)
        self.addCleanup(self.repeater.end)

    def launch(self, name):
        """Start car.launch with a configuration and a virtual chip of its own."""
        folder = os.path.join(self.folder, name)
        shutil.copytree(os.path.join(PACKAGE, "config"), folder)
        chip = Chip(os.path.join(folder, "chip"))
        with open(os.path.join(folder, "pca9685.yaml"), "w", encoding="utf-8") as file:
            yaml.safe_dump({**config("pca9685.yaml"), "virtual_log": chip.path}, file)
        process = start(self, "roslaunch", "car_interface", "car.launch", "i2c:=virtual", "gamepad:=false",
                        f"config:={folder}", f"port:={folder}/absent")
        self.addCleanup(lambda: process.runs() and process.end())  # with its nodes
        return process, chip

    def drive(self, chip):
        """Let go and hold until the servo is at the left."""
        def attempt():
            self.repeater.hold(self.joy, joy(False))
            let_go_s = time.monotonic()
            eventually(lambda: chip.counts(0) == CENTER and time.monotonic() - let_go_s > REST_S, "let go", 3.0)
            self.repeater.hold(self.joy, joy(True))
            eventually(lambda: chip.counts(0) == LEFT, "the wheel at the left", 3.0)
        retried(attempt)

    def test_the_second_waits_undisturbing_and_takes_over_when_the_first_ends(self):
        first, chip = self.launch("first")
        eventually(lambda: all(pid_of(f"/{name}") for name in NODES), "all nodes", LAUNCH_S)
        self.joy = Sender("/joy", Joy)
        self.addCleanup(self.joy.close)
        self.drive(chip)
        pids = {name: pid_of(f"/{name}") for name in NODES}
        commands = Topic("/servo/cmdVector", Int32MultiArray).connected()
        self.addCleanup(commands.close)
        commands.wait_for_count(10)
        second, second_chip = self.launch("second")
        for name, pid in pids.items():
            line = second.stderr.wait_for(lambda line, name=name: f"/{name} is already running" in line,
                                          within_s=LAUNCH_S).what
            self.assertRegex(line, rf"^\[WARN\] \[\d+\.\d+\]: /{name} is already running on \S+ \(this computer\), "
                             rf"process {pid}\. This node waits, and sends nothing, until that one ends; then it takes "
                             r"over\. If a launch file was started twice, end one of the two$")

        def undisturbed():
            """Ten seconds of both."""
            mark, since_ns = commands.mark(), time.monotonic_ns()
            seen = {name: len(self.waits_of(second, name)) for name in NODES}
            eventually(lambda: time.monotonic_ns() - since_ns > BOTH_S * 1e9, "ten seconds", BOTH_S + 5)
            received = commands.heard_since(mark)
            self.assertEqual({each.what.data[0] for each in received if each.what.data[0] != -1}, {LEFT_DUTY})
            self.assertEqual(chip.values_since(0, since_ns), [])
            self.assertEqual({name: pid_of(f"/{name}") for name in NODES}, pids)
            gap_s = max(after.at_s - before.at_s for before, after in zip(received, received[1:]))
            self.assertLess(gap_s, MAX_GAP_S)
            for name in NODES:
                eventually(lambda name=name: len(self.waits_of(second, name)) > seen[name], f"{name} says it again")
        measured(undisturbed, restore=lambda: self.drive(chip))
        self.assertIsNone(second_chip.counts(0))
        self.assertFalse([line for line in output_of(first) if "shutdown request" in line or "has died" in line])

        self.assertEqual(first.end(), 0)
        for name, pid in pids.items():
            second.wait_for_line(rf"/{name} on .*process {pid} has ended: taking over")
        # The button is held since before its start.
        eventually(lambda: any(REARM_TEXT in line for line in output_of(second)), "it says how to re-arm")
        taken_over_ns = time.monotonic_ns()
        eventually(lambda: time.monotonic_ns() - taken_over_ns > 1e9, "a second")
        self.assertEqual((second_chip.counts(0), second_chip.counts(1)), (CENTER, OFF))
        self.assertLessEqual(set(second_chip.values_since(0, 0)), {OFF, CENTER})
        self.drive(second_chip)
        self.assertFalse([line for line in output_of(second) if "Traceback" in line])

    @staticmethod
    def waits_of(process, name):
        return [line for line in process.stderr.since() if f"/{name} is already running" in line]


class ANode(unittest.TestCase):
    """turn_arb by itself."""

    def setUp(self):
        set_params(self, "/turn_arb", config("turn_arb.yaml"))

    def start(self):
        return start_node(self, "turn_arb")

    def started(self):
        process = self.start()
        eventually(lambda: pid_of("/turn_arb") == process.pid, "it is registered")
        process.wait_for_info("NO_HUMAN")
        return process

    def test_a_signal_ends_its_wait_without_a_word(self):
        self.started()
        for number in (signal.SIGINT, signal.SIGTERM):
            second = self.start()
            second.wait_for_line("already running")
            self.assertEqual(second.end(number), 0)
            self.assertEqual(len(output_of(second)), 1, output_of(second))

    def test_registration_of_a_killed_node_delays_nobody(self):
        def attempt():
            first = self.started()
            first.end(signal.SIGKILL)
            second = self.start()
            second.wait_for_info("NO_HUMAN")
            took_ms = 1e3 * (time.monotonic() - second.started_s)
            self.assertFalse([line for line in output_of(second) if "already" in line or "doesn't answer" in line])
            second.end()
            self.assertLess(took_ms, RESPAWN_MS)
        measured(attempt)

    def test_frozen_node_is_replaced_after_ten_seconds_and_ends_when_it_wakes(self):
        log = Topic("/rosout", Log)
        self.addCleanup(log.close)
        first = self.started()
        e_stop = Sender("/e_stop", Bool)
        self.addCleanup(e_stop.close)
        # A line on /rosout: it has nothing more to register when it wakes, which would end its successor.
        eventually(lambda: e_stop.publish(Bool(True)) or any(line.name == "/turn_arb" for line in log.since()),
                   "a line on /rosout")
        first.send(signal.SIGSTOP)
        self.addCleanup(first.send, signal.SIGCONT)
        second = self.start()
        second.wait_for_line("/turn_arb is registered on .*, and doesn't answer. This node takes over if it doesn't "
                             "for 10 s")
        line = second.wait_for_line("taking over")
        self.assertIn("hasn't answered for 10 s: taking over. If it is only frozen, the ROS master ends it", line)
        second.wait_for_info("NO_HUMAN")
        first.send(signal.SIGCONT)
        self.assertEqual(first.wait_for_exit(), 0)
        eventually(lambda: pid_of("/turn_arb") == second.pid, "the node that took over, by its name")
        self.assertTrue(second.runs())

    def test_of_two_that_start_at_the_same_moment_one_drives(self):
        for _ in range(3):
            both = [self.start(), self.start()]

            def settled(both=both):
                waits = [process for process in both if any("already running" in line for line in output_of(process))]
                ended = [process for process in both if not process.runs()]
                return len(waits) + len(ended) == 1 and pid_of("/turn_arb") in {
                    process.pid for process in both if process not in waits + ended}
            eventually(settled, "one of two")
            registered = pid_of("/turn_arb")
            waiting, running = sorted(both, key=lambda process, pid=registered: process.pid == pid)
            self.assertEqual((waiting.end(), running.end()), (0, 0))
            lines = output_of(both[0]) + output_of(both[1])
            self.assertFalse([line for line in lines if "Traceback" in line or "Error" in line], lines)

    def test_name_in_another_namespace_or_remapped_is_another_name(self):
        self.started()
        for namespace, name, arguments in (("/other", "turn_arb", ["__ns:=other"]), ("/", "arb2", ["__name:=arb2"])):
            path = f"{namespace.rstrip('/')}/{name}"
            set_params(self, path, config("turn_arb.yaml"))
            first = start_node(self, "turn_arb", *arguments)
            first.wait_for_info("NO_HUMAN")
            second = start_node(self, "turn_arb", *arguments)
            second.wait_for_line(f"{path} is already running on .* process {first.pid}\\.")


class OthersNodes(unittest.TestCase):
    """Those of other packages wait by wait_for_name, as joy_node of the launch file does."""

    def test_command_becomes_the_node_when_the_other_one_ends(self):
        def node():
            return start(self, executable("wait_for_name"), sys.executable, BARE, "__name:=joy_node")
        first = node()
        eventually(lambda: pid_of("/joy_node") == first.pid, "the first")
        second = node()
        second.wait_for_line(f"/joy_node is already running on .* process {first.pid}\\.")
        self.assertEqual(pid_of("/joy_node"), first.pid)
        first.end()
        eventually(lambda: pid_of("/joy_node") == second.pid, "the second")

    def test_wrong_use_is_answered_in_a_line(self):
        for arguments, code, text in ((["ls"], 2, "usage: wait_for_name"),
                                      (["/no/such", "__name:=a"], 1, "No such file")):
            process = start(self, executable("wait_for_name"), *arguments)
            self.assertEqual(process.wait_for_exit(), code)
            self.assertTrue(re.search(text, "\n".join(process.stderr.since())), process.stderr.since())
            self.assertNotIn("Traceback", "".join(process.stderr.since()))


if __name__ == "__main__":
    rospy.init_node("second_start_test")
    rostest.rosrun("car_interface", "second_start_test", "__main__")
