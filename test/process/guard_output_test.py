#!/usr/bin/env python3
"""/servo/output while no pca9685 node can publish it: what the guard reads back, by a process that it starts."""
from __future__ import annotations

import os
import shutil
import signal
import socket
import tempfile
import time
import unittest

import rosgraph
import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_updater import DiagnosticStatusWrapper
from std_msgs.msg import Int32MultiArray

import guard_test
from car_interface.common.publishers import REPORT
from car_interface.ros.command_topics import CommandTopics
from car_interface.ros.inbox import Inbox
from car_interface.ros.relay_link import RelayLink
from car_interface.ros.topics import subscribe
from waiting import NodeProcess, Topic, eventually, executable, one_process_params, set_params

TIMEOUT_VALUES = guard_test.TIMEOUT_VALUES
SAFE_COUNTS = (319, 307) + (0,) * 14
OFF = [0] * 16
DRIVING = guard_test.DRIVING
TOLD_S = 2.0 + (0 if os.environ.get("CAR_INTERFACE_ALL") else 6.0)  # a rospy process starts: 0.5 s on an idle computer


def relays(topic):
    """The processes that publish a topic in the place of its node."""
    found = []
    for name in filter(str.isdigit, os.listdir("/proc")):
        try:
            with open(f"/proc/{name}/cmdline", "rb") as file:
                arguments = file.read().decode().split("\0")
        except OSError:
            continue  # it has just ended
        if "car_interface.ros.output_relay" in arguments and f"/servo/output:={topic}" in arguments:
            found.append(int(name))
    return found


def nodes_of(topic):
    """The nodes that publish a topic, by the master."""
    published, _, _ = rosgraph.Master("/guard_output_test").getSystemState()
    return sorted(dict(published).get(topic, []))


class OutputTest(guard_test.Guarded):
    def outputs_of(self, topic):
        outputs = Topic(topic, Int32MultiArray)
        self.addCleanup(outputs.close)
        self.addCleanup(lambda: eventually(lambda: not relays(topic), "the relay's end"))
        return outputs

    def told(self, outputs, data, relay, since):
        """The first message with these duties from a relay."""
        return outputs.wait_for(lambda output: list(output.data) == data
                                and output._connection_header["callerid"] == relay, since)

    def senders(self, outputs, since):
        return {output._connection_header["callerid"] for output in outputs.since(since)}


class OfOneNode(OutputTest):
    def start_virtual(self, name, *arguments):
        process = self.start(name, "_device:=virtual", f"_virtual_chip:={self.folder}/chip", *arguments)
        process.wait_for_info("running at")
        return process

    def drive_guarded(self, name, outputs, *arguments):
        """A node that drives, with its guard."""
        process = self.start_virtual(name, *arguments)
        self.drive()
        outputs.wait_for(lambda output: list(output.data[:2]) == DRIVING[:2])
        self.guard_of(process)
        return process

    def test_node_that_is_killed_and_not_started_again(self):
        outputs = self.outputs_of("/orphan/output")
        process = self.drive_guarded("orphan", outputs, "_guard_off_after:=8.0")
        mark = outputs.mark()
        killed_s = process.send(signal.SIGKILL)
        process.wait_for_exit()
        told = self.told(outputs, TIMEOUT_VALUES, "/orphan_guard", mark)
        print(f"pca9685 killed: told after {told.at_s - killed_s:.2f} s", flush=True)
        self.assertLess(told.at_s - killed_s, TOLD_S)
        self.assertEqual(told.what._connection_header["latching"], "1")
        self.assertEqual([(dim.label, dim.size, dim.stride) for dim in told.what.layout.dim], [("pwm_channel", 16, 1)])
        relay, = relays("/orphan/output")
        with open(f"/proc/{relay}/status", encoding="ascii") as file:
            print(next(line for line in file if line.startswith("VmRSS")), flush=True)
        self.assertEqual(os.getsid(relay), relay)
        late = self.outputs_of("/orphan/output")
        late.wait_for(lambda output: list(output.data) == TIMEOUT_VALUES)
        off = self.told(outputs, OFF, "/orphan_guard", mark)
        self.assertGreater(off.at_s - killed_s, 8.0)
        eventually(lambda: not relays("/orphan/output"), "the relay's end")
        self.assertEqual([name for name in nodes_of("/orphan/output") if name.endswith("_guard")], [])
        told = [list(output.data) for output in outputs.since(mark)
                if output._connection_header["callerid"] == "/orphan_guard"]
        self.assertEqual(told, [TIMEOUT_VALUES] * (len(told) - 1) + [OFF])
        self.assertIn(len(told), range(3, 111))  # on change, and ten times a second for ten

    def test_node_that_takes_over_ends_it_and_nothing_old_comes_after_that(self):
        outputs = self.outputs_of("/heir/output")
        process = self.drive_guarded("heir", outputs)
        mark = outputs.mark()
        process.send(signal.SIGKILL)
        process.wait_for_exit()
        self.told(outputs, TIMEOUT_VALUES, "/heir_guard", mark)
        successor = self.start_virtual("heir")
        eventually(lambda: not relays("/heir/output"), "the relay's end")
        outputs.wait_for(lambda output: list(output.data[:2]) == DRIVING[:2], mark)
        ended = outputs.mark()
        outputs.wait_for_count(2, ended)
        self.assertEqual(self.senders(outputs, ended), {"/heir"})
        self.assertEqual(nodes_of("/heir/output"), ["/heir"])
        self.assertEqual(successor.end(), 0)

    def test_node_that_is_frozen_and_goes_on_has_a_namespace_and_its_reports_are_no_second_command(self):
        outputs = self.outputs_of("/servo/output")
        process = NodeProcess(executable("pca9685"), "__ns:=/car", "__name:=frozen", "_device:=virtual",
                              f"_virtual_chip:={self.folder}/chip", f"_timeout_value:={TIMEOUT_VALUES}")
        self.addCleanup(process.clean_up)
        process.wait_for_info("running at")
        self.drive()
        outputs.wait_for(lambda output: list(output.data[:2]) == DRIVING[:2])
        self.guard_of(process)
        inbox = Inbox("/listener")
        self.addCleanup(inbox.close)
        report = self.watch(inbox)
        mark = outputs.mark()
        frozen_s = process.send(signal.SIGSTOP)
        told = self.told(outputs, TIMEOUT_VALUES, "/car/frozen_guard", mark)
        self.assertLess(told.at_s - frozen_s, TOLD_S + 0.75)
        eventually(lambda: "frozen_guard" in str(report().values), "the watch has found the guard")
        self.assertEqual(report().level, DiagnosticStatus.OK, report().message)
        process.send(signal.SIGCONT)
        eventually(lambda: not relays("/servo/output"), "the relay's end")
        outputs.wait_for(lambda output: list(output.data[:2]) == DRIVING[:2], mark)
        ended = outputs.mark()
        outputs.wait_for_count(2, ended)
        self.assertEqual(self.senders(outputs, ended), {"/car/frozen"})
        self.assertEqual(process.end(), 0)

    def watch(self, inbox):
        """What a node that receives /servo/output reports on its publishers."""
        subscribe("/servo/output", Int32MultiArray, inbox, lambda message, now_ns: None)
        watch = CommandTopics(inbox)
        watch.start(lambda: None)

        def report():
            inbox.dispatch()
            return watch.reports[REPORT](DiagnosticStatusWrapper())
        return report


class OfOneProcess(OutputTest):
    """car_nodes, killed and frozen."""

    def start_car_nodes(self):
        values = {**one_process_params(self.folder, virtual_chip=f"{self.folder}/chip", guard_off_after=8.0),
                  "car_nodes": {"throttle": True}}
        for part, parameters in values.items():
            set_params(self, f"/{part}", parameters)
        process = NodeProcess(executable("car_nodes"))
        self.addCleanup(process.clean_up)
        process.wait_for_info("running at")
        self.guard_of(process)
        return process

    def lose(self, number):
        """The process, its outputs, and where they stood when it got the signal."""
        outputs = self.outputs_of("/servo/output")
        process = self.start_car_nodes()
        outputs.wait_for(lambda output: list(output.data) == TIMEOUT_VALUES)
        mark = outputs.mark()
        lost_s = process.send(number)
        told = self.told(outputs, TIMEOUT_VALUES, "/pca9685_guard", mark)
        print(f"car_nodes, signal {number}: told after {told.at_s - lost_s:.2f} s", flush=True)
        self.assertLess(told.at_s - lost_s, TOLD_S + 0.75)
        self.told(outputs, OFF, "/pca9685_guard", mark)
        return process, outputs

    def test_killed(self):
        self.lose(signal.SIGKILL)
        eventually(lambda: not relays("/servo/output"), "the relay's end")

    def test_frozen(self):
        process, outputs = self.lose(signal.SIGSTOP)
        process.send(signal.SIGCONT)
        eventually(lambda: not relays("/servo/output"), "the relay's end")
        ended = outputs.mark()
        outputs.wait_for_count(2, ended)
        self.assertEqual(self.senders(outputs, ended), {"/car_nodes"})
        self.assertEqual(process.end(), 0)


class WithoutAMaster(unittest.TestCase):
    """The relay by itself."""

    def setUp(self):
        self.folder = tempfile.mkdtemp()
        self.addCleanup(shutil.rmtree, self.folder, ignore_errors=True)
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = probe.getsockname()[1]
        self.log = os.path.join(self.folder, "log")
        self.link = self.start()
        self.addCleanup(lambda: eventually(lambda: not relays("/alone/output"), "the relay's end"))
        self.addCleanup(self.link.end)

    def start(self):
        """A link whose relay has a master at a port where there is none, and a file for its standard error."""
        saved = os.dup(2), signal.getsignal(signal.SIGCHLD), os.environ["ROS_MASTER_URI"]
        try:
            with open(self.log, "wb") as file:
                os.dup2(file.fileno(), 2)
            os.environ["ROS_MASTER_URI"] = f"http://127.0.0.1:{self.port}"
            link = RelayLink("/alone", "/alone/output", print)
            link.tell([SAFE_COUNTS])
        finally:
            os.dup2(saved[0], 2)
            os.close(saved[0])
            signal.signal(signal.SIGCHLD, saved[1])
            os.environ["ROS_MASTER_URI"] = saved[2]
        eventually(lambda: relays("/alone/output"), "the relay")
        return link

    def said(self):
        with open(self.log, encoding="utf-8") as file:
            return file.read()

    def wait_s(self, seconds):
        began_s = time.monotonic()
        eventually(lambda: time.monotonic() - began_s > seconds, f"{seconds} s")

    def test_it_waits_in_silence_and_publishes_once_there_is_one(self):
        self.wait_s(2.0)
        self.link.tell([SAFE_COUNTS])
        self.assertTrue(relays("/alone/output"))
        self.assertEqual(self.said(), "")
        master = NodeProcess(shutil.which("rosmaster"), "--core", "-p", str(self.port))
        self.addCleanup(master.clean_up)

        def published():
            try:
                state = rosgraph.Master("/test", master_uri=f"http://127.0.0.1:{self.port}").getSystemState()
            except OSError:
                return False
            return dict(state[0]).get("/alone/output") == ["/alone_guard"]
        eventually(published, "the relay's topic")
        master.clean_up()
        self.link.tell([OFF])
        self.wait_s(1.5)
        self.assertTrue(relays("/alone/output"))
        self.link.end()
        eventually(lambda: not relays("/alone/output"), "its end")
        self.assertEqual(self.said(), "")

    def test_it_ends_while_it_waits(self):
        self.wait_s(1.0)
        self.link.end()
        eventually(lambda: not relays("/alone/output"), "its end")
        self.assertEqual(self.said(), "")


if __name__ == "__main__":
    rospy.init_node("guard_output_test")
    rostest.rosrun("car_interface", "guard_output_test", "__main__")
