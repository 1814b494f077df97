#!/usr/bin/env python3
"""The guard of the servo board: on an I²C bus, down to its system calls, and beside the node in everyday life.

There is no I²C bus in a test's computer: fake_i2c.c is preloaded into node and guard, which otherwise run as on a car,
with smbus2 and the kernel's interface.
"""
from __future__ import annotations

import os
import shutil
import signal
import subprocess
import tempfile
import time
import unittest

import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import Odometry
from std_msgs.msg import Int32MultiArray

from car_interface.nodes.pca9685 import Pca9685
from car_interface.sim.chip_link import ChipLink
from inbox_test import Built
from virtual_car import HERE, guard_of
from waiting import NodeProcess, Repeater, Sender, Topic, eventually, executable

FAKE_I2C = os.path.join(HERE, "fake_i2c.c")
TIMEOUT_VALUES = [5104, 4912] + [0] * 14
DRIVING = [3808, 6000] + [-1] * 14
# Registers of 319, 307 counts and 14 full-off bits; of 238 and 375 counts.
SAFE = ["write 06 00003f0100003301" + "00000010" * 6, "write 26 " + "00000010" * 8]
DRIVEN = bytes.fromhex("0000ee0000007701")
FULL_OFF = "write fd 10"
GUARDED_S = 0.35 + (0 if os.environ.get("CAR_INTERFACE_ALL") else 0.15)
LED0 = 6


class Transfers:
    """What processes did to the fake bus: its log, and the chip's registers."""

    def __init__(self, path):
        self.path = path
        registers = bytearray(256)  # the data sheet's reset values
        registers[0], registers[1], registers[254] = 0x11, 0x04, 0x1E
        registers[LED0 + 3:LED0 + 64:4] = bytes((0x10,)) * 16
        with open(path, "wb") as file:
            file.write(registers)

    def registers(self, first, length):
        with open(self.path, "rb") as file:
            return file.read()[first: first + length]

    def of(self, pid, since_ns=0):
        """What a process did, as (time in ns, text)."""
        with open(f"{self.path}.log", encoding="ascii") as file:
            lines = [line.split(" ", 2) for line in file.read().splitlines()]
        return [(int(at_ns), text) for at_ns, who, text in lines if int(who) == pid and int(at_ns) >= since_ns]

    def texts(self, pid, since_ns=0):
        return [text for _, text in self.of(pid, since_ns)]

    def hold(self, on):
        """Hold the bus down, or let it go."""
        if on:
            open(f"{self.path}.held", "wb").close()
        else:
            os.unlink(f"{self.path}.held")


class Guarded(unittest.TestCase):
    """Nodes that this test starts, and commands that are repeated for as long as it lasts."""

    def setUp(self):
        self.folder = tempfile.mkdtemp()
        self.addCleanup(shutil.rmtree, self.folder, ignore_errors=True)
        self.command = None
        self.inputs = Repeater(period_s=0.02)
        self.addCleanup(self.inputs.end)

    def start(self, name, *arguments, env=None):
        process = NodeProcess(executable("pca9685"), f"__name:={name}", f"/servo/output:=/{name}/output",
                              f"_timeout_value:={TIMEOUT_VALUES}", *arguments, env=env)
        self.addCleanup(process.clean_up)
        return process

    def drive(self):
        """Publish a command until the test ends, also while no node listens."""
        self.command = self.command or Sender("/servo/cmdVector", Int32MultiArray)
        self.inputs.hold(self.command, Int32MultiArray(data=DRIVING))

    def guard_of(self, process):
        return eventually(lambda: guard_of(process.pid), "a guard")


class OnABus(Guarded):
    """As on a car, with system calls on a fake device."""

    @classmethod
    def setUpClass(cls):
        cls.build = tempfile.mkdtemp()
        cls.library = os.path.join(cls.build, "fake_i2c.so")
        subprocess.run(["cc", "-shared", "-fPIC", "-o", cls.library, FAKE_I2C, "-ldl"], check=True)

    @classmethod
    def tearDownClass(cls):
        shutil.rmtree(cls.build)

    def setUp(self):
        super().setUp()
        self.bus = Transfers(os.path.join(self.folder, "i2c-1"))

    def start_on_bus(self, name, *arguments):
        return self.start(name, f"_device:={self.bus.path}", *arguments, env={
            "LD_PRELOAD": self.library, "FAKE_I2C": self.bus.path, "FAKE_I2C_LOG": f"{self.bus.path}.log"})

    def start_and_drive(self, name, *arguments):
        """A node that drives, and its guard, which has found the chip."""
        process = self.start_on_bus(name, *arguments)
        process.wait_for_info("running at 50.03 Hz")
        self.drive()
        eventually(lambda: self.bus.registers(LED0, 8) == DRIVEN, "the command in the chip")
        guard = self.guard_of(process)
        eventually(lambda: "read 00 20" in self.bus.texts(guard), "the guard found the chip")
        return process, guard

    def safe_after_s(self, guard, since_ns):
        """How long it took until the chip held the timeout values, by the guard."""
        def done():
            return [at_ns for at_ns, text in self.bus.of(guard, since_ns) if text == SAFE[1]]
        return (eventually(done, "timeout values")[0] - since_ns) / 1e9

    def test_node_that_is_killed(self):
        process, guard = self.start_and_drive("killed", "_guard_off_after:=0.5")
        self.assertEqual(self.bus.texts(process.pid)[:3], ["open", "lock 40: 0", "address 40"])
        self.assertEqual(self.bus.texts(guard)[:2], ["open", "address 40"])
        killed_ns = time.monotonic_ns()
        process.send(signal.SIGKILL)
        self.assertLessEqual(self.safe_after_s(guard, killed_ns), GUARDED_S)
        eventually(lambda: not os.path.exists(f"/proc/{guard}") or guard_is_zombie(guard), "the guard's end")
        done = self.bus.texts(guard, killed_ns)
        self.assertEqual(done[0], "holder of 40: 0")
        writes = [text for text in done if text.startswith("write")]
        self.assertEqual(writes, [*SAFE, FULL_OFF])
        verified = done[done.index(SAFE[1]) + 1: done.index(SAFE[1]) + 3]
        self.assertEqual(verified, [text.replace("write", "read") for text in SAFE])
        times_ns = {text: at_ns for at_ns, text in self.bus.of(guard, killed_ns)}
        self.assertGreater(times_ns[FULL_OFF] - times_ns[SAFE[1]], 0.4e9)
        self.assertEqual({each & 0x10 for each in self.bus.registers(LED0 + 3, 61)[::4]}, {0x10})

    def test_node_that_is_frozen_keeps_its_lock_and_is_overruled_all_the_same(self):
        process, guard = self.start_and_drive("frozen")
        frozen_ns = time.monotonic_ns()
        process.send(signal.SIGSTOP)
        self.assertLessEqual(self.safe_after_s(guard, frozen_ns), GUARDED_S)
        self.assertIn(f"holder of 40: {process.pid}", self.bus.texts(guard, frozen_ns))
        thawed_ns = time.monotonic_ns()
        process.send(signal.SIGCONT)
        process.wait_for_line("node stood still for .*: PCA9685 at 0x40 on .* is at its timeout values; commands count "
                              "from now on")
        eventually(lambda: self.bus.registers(LED0, 8) == DRIVEN, "the node drives again")
        self.assertEqual([text for text in self.bus.texts(guard, thawed_ns) if text.startswith("write")], [])
        self.assertEqual(process.end(), 0)

    def test_node_that_waits_for_the_board_takes_over_and_the_guard_leaves_it_alone(self):
        process, guard = self.start_and_drive("first")
        successor = self.start_on_bus("second")
        successor.wait_for_line("another pca9685 node has this board")
        process.send(signal.SIGKILL)
        successor.wait_for_info("running at")
        taken_ns = time.monotonic_ns()
        eventually(lambda: self.bus.registers(LED0, 8) == DRIVEN, "the second node drives")
        eventually(lambda: not os.path.exists(f"/proc/{guard}") or guard_is_zombie(guard), "the guard's end")
        self.assertIn(f"holder of 40: {successor.pid}", self.bus.texts(guard))
        eventually(lambda: time.monotonic_ns() - taken_ns > 0.5e9, "half a second")
        self.assertNotIn(SAFE[0], self.bus.texts(guard, taken_ns + 100_000_000))
        self.assertEqual(self.bus.registers(LED0, 8), DRIVEN)
        self.assertEqual(successor.end(), 0)

    def test_bus_that_is_held_is_tried_until_it_is_let_go(self):
        process, guard = self.start_and_drive("held", "_guard_off_after:=0.5")
        self.bus.hold(True)
        held_ns = time.monotonic_ns()
        eventually(lambda: self.bus.texts(guard, held_ns).count("held") >= 2, "the guard tries")
        process.send(signal.SIGKILL)
        self.bus.hold(False)
        self.assertLess(self.safe_after_s(guard, time.monotonic_ns()), 1.5)
        eventually(lambda: FULL_OFF in self.bus.texts(guard, held_ns), "full off")


def guard_is_zombie(pid):
    """Whether a process has ended and only waits for its parent to notice."""
    try:
        with open(f"/proc/{pid}/stat", encoding="utf-8") as file:
            return file.read().rpartition(")")[2].split()[0] == "Z"
    except OSError:
        return True


class BesideItsNode(Guarded):
    """On the virtual chip."""

    def setUp(self):
        super().setUp()
        self.chip = ChipLink(os.path.join(self.folder, "chip"), 0x40)
        self.addCleanup(self.chip.close)

    def start_virtual(self, name, *arguments):
        return self.start(name, "_device:=virtual", f"_virtual_chip:={self.folder}/chip", *arguments)

    def report(self, name, wanted):
        """The first report of a node's guard that ``wanted`` accepts."""
        reports = Topic("/diagnostics", DiagnosticArray)
        self.addCleanup(reports.close)

        def find(array):
            return next((status for status in array.status if status.name == f"{name}: guard" and wanted(status)), None)
        return find(reports.wait_for(find).what)

    def test_guard_is_small_and_has_a_session_of_its_own_and_ends_with_a_node_that_ends_well(self):
        process = self.start_virtual("small")
        status = self.report("small", lambda status: status.message == "watches")
        guard = guard_of(process.pid)
        self.assertIn(("process", str(guard)), [(pair.key, pair.value) for pair in status.values])
        self.assertEqual(os.getsid(guard), guard)
        with open(f"/proc/{guard}/status", encoding="ascii") as file:
            resident_kb = next(int(line.split()[1]) for line in file if line.startswith("VmRSS"))
        self.assertLessEqual(resident_kb, 12_000)
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            os.kill(guard, number)
        mark = process.stderr.mark()
        self.drive()
        time_ns = time.monotonic_ns()
        eventually(lambda: time.monotonic_ns() - time_ns > 0.5e9, "half a second")
        self.assertEqual(guard_of(process.pid), guard)
        self.assertEqual(process.stderr.since(mark), [])
        self.assertEqual(process.end(), 0)
        eventually(lambda: not os.path.exists(f"/proc/{guard}"), "the guard's end")

    def test_node_without_a_guard_says_what_that_means(self):
        process = self.start_virtual("alone", "_guard:=false")
        status = self.report("alone", lambda status: True)
        self.assertEqual((status.level, status.message), (
            DiagnosticStatus.OK, "off (guard: false): the board goes on pulsing if this node dies or hangs"))
        self.assertIsNone(guard_of(process.pid))
        self.assertEqual(process.end(), 0)

    def test_guard_that_is_killed_is_reported_and_started_anew(self):
        process = self.start_virtual("bereft")
        self.report("bereft", lambda status: status.message == "watches")
        os.kill(guard_of(process.pid), signal.SIGKILL)
        process.wait_for_line(
            r"WARN.*guard absent: it has ended \(killed by signal 9\)\. Until there is one PCA9685 at 0x40 on virtual "
            r"goes on pulsing if this node dies or hangs\. Starting it anew")
        process.wait_for_info("the guard of PCA9685 at 0x40 on virtual watches again after 0")
        status = self.report("bereft", lambda status: status.level == DiagnosticStatus.WARN)
        self.assertEqual(status.message, "it was lost (it has ended (killed by signal 9)) and started anew")
        self.assertIn(("cause", "guard absent"), [(pair.key, pair.value) for pair in status.values])
        self.assertEqual(process.end(), 0)

    def test_output_of_a_node_that_is_started_on_a_running_chip_begins_with_what_that_holds(self):
        process = self.start_virtual("ancestor")
        process.wait_for_info("running at")
        self.drive()
        self.chip.open()
        eventually(lambda: self.chip.read(LED0, 8) == DRIVEN, "the command in the chip")
        process.send(signal.SIGKILL)
        process.wait_for_exit()
        eventually(lambda: self.chip.read(LED0, 8) != DRIVEN, "the guard's timeout values")
        heir = Built(Pca9685, {"device": "virtual", "virtual_chip": f"{self.folder}/chip", "guard": False})
        heir.node.step(time.monotonic_ns())
        heir.node.shut_down()
        self.assertEqual([list(output.data) for output in heir.published["/servo/output"]][:2],
                         [TIMEOUT_VALUES, [0] * 16])

    def test_output_of_a_node_that_stood_still_tells_what_the_guard_wrote(self):
        outputs = Topic("/sleeper/output", Int32MultiArray)
        self.addCleanup(outputs.close)
        process = self.start_virtual("sleeper", "_guard_off_after:=0.5")
        self.drive()
        outputs.wait_for(lambda output: list(output.data[:2]) == DRIVING[:2])
        self.guard_of(process)
        self.chip.open()
        mark = outputs.mark()
        process.send(signal.SIGSTOP)
        eventually(lambda: self.chip.read(LED0 + 3, 1) == b"\x10", "full off")
        process.send(signal.SIGCONT)
        outputs.wait_for(lambda output: list(output.data) == TIMEOUT_VALUES, mark)
        changes = [list(output.data) for output in outputs.since(mark)]
        self.assertIn([0] * 16, changes[:changes.index(TIMEOUT_VALUES)])
        self.assertEqual(process.end(), 0)

    def test_what_another_program_writes_is_reported_and_written_anew(self):
        outputs = Topic("/disturbed/output", Int32MultiArray)
        self.addCleanup(outputs.close)
        process = self.start_virtual("disturbed")
        outputs.wait_for(lambda output: list(output.data) == TIMEOUT_VALUES)
        self.chip.open()
        self.chip.write(LED0, bytes((0, 0, 0x00, 0x01)))
        process.wait_for_line("WARN.*foreign write to PCA9685 at 0x40 on virtual: channel 0 holds 256 counts, not 319. "
                              "Written anew. See which other program writes to it")
        eventually(lambda: self.chip.read(LED0, 4) == bytes((0, 0, 0x3F, 0x01)), "the timeout value")
        self.assertEqual(process.end(), 0)

    def test_virtual_car_follows_the_chip_also_while_no_node_lives_and_stops_when_the_guard_acts(self):
        truths = Topic("/follower/truth", Odometry)
        self.addCleanup(truths.close)
        follower = NodeProcess(executable("car_sim"), "__name:=follower", f"_port:={self.folder}/teensy",
                               f"_virtual_chip:={self.folder}/chip", "/servo/output:=/nobody/output")
        self.addCleanup(follower.clean_up)
        process = self.start_virtual("leader", "_guard_off_after:=5.0")
        self.drive()
        truths.wait_for(lambda truth: truth.twist.twist.linear.x > 0.5)
        self.guard_of(process)
        self.chip.open()
        process.send(signal.SIGKILL)
        stopped = truths.wait_for(lambda truth: truth.twist.twist.linear.x == 0.0, truths.mark())
        self.assertEqual(self.chip.read(LED0 + 4, 4), bytes((0, 0, 0x33, 0x01)))  # 307 counts: neutral, not off
        mark = truths.mark()

        def moves():
            self.chip.write(LED0 + 4, bytes((0, 0, 0x77, 0x01)))  # for 50 ms at most, until the guard has seen it
            return any(truth.twist.twist.linear.x > 0.0 for truth in truths.since(mark))
        eventually(moves, "the car to follow the chip")
        self.assertIsNotNone(stopped)
        self.assertEqual(follower.end(), 0)


if __name__ == "__main__":
    rospy.init_node("guard_test")
    rostest.rosrun("car_interface", "guard_test", "__main__")
