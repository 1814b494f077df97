#!/usr/bin/env python3
"""The servo board's guard as a process: what it does on the bus when its node is killed or frozen, and publishes."""
import os
import select
import shutil
import signal
import subprocess
import tempfile
import time
import unittest

import rosgraph
import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticArray
from std_msgs.msg import Int32MultiArray

from car_interface.nodes.pca9685.pca9685_guard import RelayLink
from virtual_car import FakeBus, free_port, guard_of, has_ended
from waiting import NodeProcess, Repeater, Sender, Topic, eventually, executable

TIMEOUT_VALUES, DRIVING = [5104, 4912] + [0] * 14, [3808, 6000] + [-1] * 14
OFF = [0] * 16
LED0 = 6
DRIVEN = bytes.fromhex("0000ee0000007701")  # registers of 238 and 375 counts
# Registers of 319, 307 counts and 14 full-off bits.
SAFE = ["write 06 00003f0100003301" + "00000010" * 6, "write 26 " + "00000010" * 8]
FULL_OFF = "write fd 10"


class Guarded(unittest.TestCase):
    """Nodes of rostest's master, and a command that is repeated also while no node listens."""

    def setUp(self):
        self.folder = tempfile.mkdtemp()
        self.addCleanup(shutil.rmtree, self.folder, ignore_errors=True)
        self.inputs = Repeater(period_s=0.02)
        self.addCleanup(self.inputs.end)

    def start(self, name, *arguments, env=None):
        process = NodeProcess(executable("pca9685"), f"__name:={name}", f"/servo/output:=/{name}/output",
                              f"_timeout_value:={TIMEOUT_VALUES}", *arguments, env=env)
        self.addCleanup(process.clean_up)
        return process

    def drive(self):
        self.inputs.hold(Sender("/servo/cmdVector", Int32MultiArray), Int32MultiArray(data=DRIVING))


class OnABus(Guarded):
    """As on a car, with smbus2 and the kernel's calls, which fake_i2c.c answers."""

    def setUp(self):
        super().setUp()
        self.bus = FakeBus(self.folder)

    def start_on_bus(self, name, *arguments):
        return self.start(name, f"_device:={self.bus.path}", *arguments, env=self.bus.env)

    def start_and_drive(self, name, *arguments):
        process = self.start_on_bus(name, *arguments)
        process.wait_for_info("running at 50.03 Hz")
        self.drive()
        eventually(lambda: self.bus.registers(LED0, 8) == DRIVEN, "the command in the chip")
        guard = eventually(lambda: guard_of(process.pid), "a guard")
        eventually(lambda: "read 00 20" in self.bus.texts(guard), "the guard found the chip")
        return process, guard

    def test_guard_makes_the_chip_of_a_killed_node_safe_verifies_that_and_switches_it_off(self):
        process, guard = self.start_and_drive("killed", "_guard_off_after:=0.5")
        self.assertEqual(self.bus.texts(process.pid)[:3], ["open", "lock 40: 0", "address 40"])
        self.assertEqual(self.bus.texts(guard)[:2], ["open", "address 40"])
        self.bus.hold(True)
        held_ns = time.monotonic_ns()
        eventually(lambda: self.bus.texts(guard, held_ns).count("held") >= 1, "the guard tries")
        process.send(signal.SIGKILL)
        self.bus.hold(False)
        eventually(lambda: has_ended(guard), "the guard's end")
        done = self.bus.texts(guard, held_ns)
        self.assertIn("holder of 40: 0", done)
        self.assertEqual([text for text in done if text.startswith("write")][-3:], [*SAFE, FULL_OFF])
        written = len(done) - 1 - done[::-1].index(SAFE[1])
        self.assertEqual(done[written + 1:written + 3], [text.replace("write", "read") for text in SAFE])
        self.assertEqual({each & 0x10 for each in self.bus.registers(LED0 + 3, 61)[::4]}, {0x10})

    def test_guard_overrules_a_frozen_node_in_spite_of_its_lock_and_leaves_the_board_to_the_next_node(self):
        process, guard = self.start_and_drive("frozen")
        frozen_ns = time.monotonic_ns()
        process.send(signal.SIGSTOP)
        eventually(lambda: SAFE[1] in self.bus.texts(guard, frozen_ns), "timeout values")
        self.assertIn(f"holder of 40: {process.pid}", self.bus.texts(guard, frozen_ns))
        process.send(signal.SIGCONT)
        # Without a duration where it was woken before it could notice one by itself.
        process.wait_for_line("node stood still( for .*)?: PCA9685 at 0x40 on .* is at its timeout values; commands "
                              "count from now on")
        eventually(lambda: self.bus.registers(LED0, 8) == DRIVEN, "the node drives again")
        successor = self.start_on_bus("second")
        successor.wait_for_line("another pca9685 node has this board")
        process.send(signal.SIGKILL)
        successor.wait_for_info("running at")
        eventually(lambda: has_ended(guard), "the guard's end")
        self.assertIn(f"holder of 40: {successor.pid}", self.bus.texts(guard))
        eventually(lambda: self.bus.registers(LED0, 8) == DRIVEN, "the second node drives")
        self.assertEqual(successor.end(), 0)


class Relayed(Guarded):
    """What a guard is as a process, and /servo/output while no pca9685 node can publish it."""

    def start_and_drive(self, name, *arguments):
        outputs = Topic(f"/{name}/output", Int32MultiArray)
        self.addCleanup(outputs.close)
        process = self.start(name, "_device:=virtual", f"_virtual_chip:={self.folder}/chip", *arguments)
        process.wait_for_info("running at")
        self.drive()
        outputs.wait_for(lambda output: list(output.data[:2]) == DRIVING[:2])
        return process, outputs, eventually(lambda: guard_of(process.pid), "a guard")

    @staticmethod
    def told(outputs, data, sender, since):
        """The first message with these duties from a node."""
        return outputs.wait_for(lambda output: list(output.data) == data
                                and output._connection_header["callerid"] == sender, since).what

    def test_guard_is_small_and_no_signal_that_ends_a_node_ends_it(self):
        process, _, guard = self.start_and_drive("small")
        self.assertEqual(os.getsid(guard), guard)
        self.assertLessEqual(int(status_of(guard, "VmRSS")), 12_000)  # kB
        signals = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
        eventually(lambda: ignores(guard, signals), "a guard that ignores signals: it has just been started")
        for number in signals:
            os.kill(guard, number)
        reports = Topic("/diagnostics", DiagnosticArray)
        self.addCleanup(reports.close)
        reports.wait_for(lambda array: any(
            status.name == "small: guard" and status.values[0].value == str(guard_of(process.pid))
            for status in array.status))
        if guard_of(process.pid) != guard:  # on a machine that stood still
            process.wait_for_line("it doesn't answer")
        self.assertEqual(process.end(), 0)
        eventually(lambda: has_ended(guard), "the guard's end")

    def test_output_of_a_killed_node_is_published_in_its_place_until_another_one_has_the_board(self):
        process, outputs, _ = self.start_and_drive("orphan", "_guard_off_after:=60.0")  # a relay may start slowly
        mark = outputs.mark()
        process.send(signal.SIGKILL)
        told = self.told(outputs, TIMEOUT_VALUES, "/orphan_guard", mark)
        self.assertEqual(told._connection_header["latching"], "1")
        self.assertEqual([(dim.label, dim.size, dim.stride) for dim in told.layout.dim], [("pwm_channel", 16, 1)])
        relay, = relays("/orphan/output")
        self.assertEqual(os.getsid(relay), relay)
        process.wait_for_exit()
        successor = self.start("orphan", "_device:=virtual", f"_virtual_chip:={self.folder}/chip",
                               "_guard_off_after:=1.0")
        eventually(lambda: not relays("/orphan/output"), "the relay's end")
        outputs.wait_for(lambda output: list(output.data[:2]) == DRIVING[:2], mark)
        ended = outputs.mark()
        outputs.wait_for_count(2, ended)
        self.assertEqual({each._connection_header["callerid"] for each in outputs.since(ended)}, {"/orphan"})
        published, _, _ = rosgraph.Master("/guard_test").getSystemState()
        self.assertEqual(dict(published)["/orphan/output"], ["/orphan"])
        successor.send(signal.SIGKILL)  # and now nobody takes over
        successor.wait_for_exit()

    def test_output_of_a_frozen_node_is_published_until_it_goes_on_and_once_more_when_all_is_off(self):
        process, outputs, _ = self.start_and_drive("sleeper", "_guard_off_after:=2.0")
        mark = outputs.mark()
        process.send(signal.SIGSTOP)
        self.told(outputs, OFF, "/sleeper_guard", mark)  # before it the timeout values, if its publisher was there
        process.send(signal.SIGCONT)
        # It publishes OFF, too, unless it was about to write as it was frozen: then it has written first.
        self.told(outputs, TIMEOUT_VALUES, "/sleeper", mark)
        eventually(lambda: not relays("/sleeper/output"), "the relay's end")
        self.assertEqual(process.end(), 0)

    def test_relay_without_a_master_waits_in_silence_publishes_once_there_is_one_and_ends(self):
        port, log = free_port(), os.path.join(self.folder, "log")
        saved = os.dup(2), signal.getsignal(signal.SIGCHLD), os.environ["ROS_MASTER_URI"]
        try:
            with open(log, "wb") as file:
                os.dup2(file.fileno(), 2)
            os.environ["ROS_MASTER_URI"] = f"http://127.0.0.1:{port}"
            links = {name: RelayLink(f"/{name}", f"/{name}/output", print) for name in ("alone", "ended")}
            for link in links.values():
                link.tell([(319, 307) + (0,) * 14])
        finally:
            os.dup2(saved[0], 2)
            os.close(saved[0])
            signal.signal(signal.SIGCHLD, saved[1])
            os.environ["ROS_MASTER_URI"] = saved[2]
        eventually(lambda: relays("/alone/output") and relays("/ended/output"), "the relays")
        links["ended"].end()
        eventually(lambda: not relays("/ended/output"), "the end of one that waits")
        master = NodeProcess(shutil.which("rosmaster"), "--core", "-p", str(port))
        self.addCleanup(master.clean_up)

        def published():
            try:
                state = rosgraph.Master("/test", master_uri=f"http://127.0.0.1:{port}").getSystemState()
            except OSError:
                return False
            return dict(state[0]).get("/alone/output") == ["/alone_guard"]
        eventually(published, "the relay's topic")
        master.clean_up()
        links["alone"].end()
        eventually(lambda: not relays("/alone/output"), "its end without a master")
        with open(log, encoding="utf-8") as file:
            self.assertEqual(file.read(), "")

    def test_terminal_that_takes_no_more_lines_holds_nothing_up_and_little_memory_is_told(self):
        """As after Ctrl-S, or when the ssh connection to it breaks: here a pipe that is full, and stays so."""
        read_end, write_end = os.pipe()
        self.addCleanup(os.close, read_end)
        os.set_blocking(write_end, False)
        while select.select([], [write_end], [], 0)[1]:
            os.write(write_end, b" " * 512)
        os.set_blocking(write_end, True)
        outputs = Topic("/gagged/output", Int32MultiArray)
        self.addCleanup(outputs.close)
        node = subprocess.Popen(
            ["sh", "-c", 'ulimit -v 400000; exec "$0" "$@"', executable("pca9685"), "_device:=virtual",
             "__name:=gagged", "/servo/output:=/gagged/output", "command:=/gagged/command"],
            stdout=write_end, stderr=write_end)
        self.addCleanup(lambda: node.poll() is None and node.kill())
        os.close(write_end)
        command = Sender("/gagged/command", Int32MultiArray)
        self.inputs.hold(command, Int32MultiArray(data=[6000] * 15 + [70000]))  # is warned of
        outputs.wait_for(lambda output: output.data == (6000,) * 15 + (0,))
        self.inputs.hold(command, Int32MultiArray(data=[5200] * 16))
        outputs.wait_for(lambda output: output.data[0] == 5200)
        node.send_signal(signal.SIGTERM)
        self.assertEqual(node.wait(30), 0)
        eventually(lambda: outputs.newest.data == (0,) * 16, "its last word")
        poor = NodeProcess("sh", "-c", 'ulimit -v 300000; exec "$0" "$@"', executable("pca9685"), "_device:=virtual")
        self.addCleanup(poor.clean_up)
        self.assertEqual(poor.wait_for_exit(), 1)
        self.assertEqual("\n".join(poor.stderr.since()), (
            "pca9685: it needs 380 MB of address space, and its limit is 292 MB: raise that in the shell that starts "
            "it (ulimit -v unlimited)"))


def status_of(pid, name):
    """A value that the system has of a process."""
    with open(f"/proc/{pid}/status", encoding="ascii") as file:
        return next(line.split()[1] for line in file if line.startswith(name))


def ignores(pid, signals):
    """Whether a process ignores all of these signals."""
    mask = int(status_of(pid, "SigIgn"), 16)
    return all(mask >> number - 1 & 1 for number in signals)


def relays(topic):
    """The processes that publish a topic in the place of its node."""
    found = []
    for name in filter(str.isdigit, os.listdir("/proc")):
        try:
            with open(f"/proc/{name}/cmdline", "rb") as file:
                arguments = file.read().decode().split("\0")
        except OSError:
            continue  # it has just ended
        if "car_interface.nodes.pca9685.output_relay" in arguments and f"/servo/output:={topic}" in arguments:
            found.append(int(name))
    return found


if __name__ == "__main__":
    rospy.init_node("guard_test")
    rostest.rosrun("car_interface", "guard_test", "__main__")
