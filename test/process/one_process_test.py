#!/usr/bin/env python3
"""car_nodes: the four nodes as one process look and drive as four do, and a fault of one leaves the others alone."""
from __future__ import annotations

import os
import re
import shutil
import signal
import sys
import tempfile
import threading
import time
import unittest

import rosnode
import rospy
import rostest
from car_interface.msg import Control, Float64Stamped, SteeringState, ThrottleState, Wheel
from car_interface.srv import InjectFault
from diagnostic_msgs.msg import DiagnosticArray
from std_msgs.msg import Bool, Empty, Float32, Int32MultiArray
from std_srvs.srv import Trigger

from virtual_car import HERE, Chip
from waiting import (
    PATIENCE_S,
    Repeater,
    Sender,
    Topic,
    config,
    eventually,
    one_process_params,
    retried,
    set_params,
    start,
    start_node,
)

PARTS = ("turn_arb", "pca9685", "teensy_sensor_hub", "generic_value_converter", "throttle_arb")
FAULTY = os.path.join(HERE, "faulty_car_nodes.py")
REMAPPED = ("/servo/output", "/servo/cmdVector", "/teleop_logi/human_in_loop", "/teleop_logi/tele_steer_req",
            "/teleop_logi/tele_throt_req")
LEFT, CENTER, RIGHT, ESC_NEUTRAL, OFF = 238, 319, 419, 307, 0  # counts of 3800, 5100, 6700, 4915
WITHIN_MS = 500  # what takes one on an idle machine
DRIVE_WITHIN_S = 120


def graph_of(namespace, nodes):
    """What nodes have on the ROS graph: topics that they publish and hear, and services; without the namespace."""
    _, _, state = rospy.get_master().getSystemState()
    paths = {f"{namespace}/{node}" for node in nodes}
    found = []
    for names in state:
        ours = {name for name, users in names if paths & set(users)}
        found.append({name[len(namespace):] if name.startswith(f"{namespace}/") else name for name in ours
                      if not re.search("/rosout$|/get_loggers$|/set_logger_level$", name)})
    return found


class TheSameCar(unittest.TestCase):
    """Two cars by demo.launch: /four by four processes, /one by one."""

    def test_both_have_the_same_topics_services_and_parameters(self):
        def both():
            return graph_of("/four", PARTS), graph_of("/one", ["car_nodes"])
        eventually(lambda: both()[0] == both()[1] and len(both()[0][2]) >= 8, lambda: f"the same names: {both()}")
        published, heard, services = both()[1]
        self.assertIn("/turn_arb/state", published)
        self.assertIn("/servo/cmdVector", heard)
        self.assertIn("/teensy_sensor_hub/ping", services)
        self.assertIn("/pca9685/inject_fault", services)
        for part in PARTS:
            four, one = (rospy.get_param(f"/{namespace}/{part}") for namespace in ("four", "one"))
            for own in ("port", "frame_prefix"):
                self.assertEqual(own in four, own in one)
                four.pop(own, None), one.pop(own, None)
            self.assertEqual(four, one)
        self.assertNotIn("/one/turn_arb", rosnode.get_node_names())

    def test_both_report_under_the_same_names(self):
        names = {"four": set(), "one": set()}
        heard = Topic("/diagnostics", DiagnosticArray)
        self.addCleanup(heard.close)

        # Each part reports once a second by itself: what two parts have in common by chance isn't all.
        expected = {"turn_arb: steering", "pca9685: servo board", "teensy_sensor_hub: Teensy link",
                    "generic_value_converter: converter", "throttle_arb: throttle"}

        def same():
            for array in heard.since():
                for status in array.status:
                    namespace, _, name = status.name.partition("/")
                    names[namespace].add(re.sub("_four|_one", "", name))
            return expected <= names["one"] and names["four"] == names["one"]
        eventually(same, lambda: f"the same names: {names}")

    def test_latecomer_hears_where_both_channels_rest(self):
        """A topic latches one message in a process, and in the one two parts publish."""
        for namespace in ("four", "one"):
            neutrals = Topic(f"/{namespace}/servo/neutral", Int32MultiArray)
            self.addCleanup(neutrals.close)
            for channel in (0, 1):
                neutrals.wait_for(lambda neutral, channel=channel: neutral.data[channel] != -1)

    def test_the_doctor_sees_all_parts(self):
        def attempt():
            doctor = start_node(self, "doctor", "--ns", "/one")
            doctor.wait_for_exit()
            shown = "\n".join(doctor.stdout.since())
            self.assertRegex(shown, "turn_arb, pca9685, teensy_sensor_hub, generic_value_converter, throttle_arb, .* "
                                    "run in /one")
            self.assertNotIn("not running", shown)
            self.assertNotIn("doesn't report", shown)
        retried(attempt)

    def test_the_one_drives_as_planned(self):
        drive = start_node(self, "demo_drive", "__ns:=one", *(f"{name}:={name[1:]}" for name in REMAPPED))
        code = drive.wait_for_exit(DRIVE_WITHIN_S)
        shown = "\n".join(drive.stdout.since() + drive.stderr.since())
        self.assertEqual(code, 0, shown)
        self.assertIn("as planned: yes", shown)


class AProcess(unittest.TestCase):
    """A car_nodes of the test's own."""

    def setUp(self):
        self.folder = tempfile.mkdtemp()
        self.addCleanup(shutil.rmtree, self.folder, ignore_errors=True)
        self.port = os.path.join(self.folder, "teensy")
        self.chip = Chip(os.path.join(self.folder, "chip"))

    def set_params(self, namespace="", **changes):
        """The shipped ones, with a chip in software."""
        values = one_process_params(self.folder, virtual_log=self.chip.path)
        for part, more in changes.items():
            values[part].update(more)
        for part in PARTS:
            set_params(self, f"{namespace}/{part}", values[part])
        set_params(self, f"{namespace}/car_nodes", {"throttle": True})


class Drives(AProcess):
    """It drives a car_sim."""

    def setUp(self):
        super().setUp()
        self.set_params()
        start_node(self, "car_sim", f"_port:={self.port}").wait_for_info("a virtual Teensy")
        self.process = start(self, sys.executable, FAULTY,
                             "generic_value_converter/input/control_cmd:=control/command/control_cmd",
                             "generic_value_converter/input/odometry:=odom", "throttle_arb/input/odometry:=odom",
                             "throttle_arb/input/value:=generic_value_converter/output/value")
        self.repeater = Repeater(0.02)
        self.addCleanup(self.repeater.end)
        # Two parts hear each of the first two, but by one connection: they are in one process.
        self.human = self.sender("/teleop_logi/human_in_loop", Bool)
        self.lock = self.sender("/e_stop", Bool)
        self.steering = self.sender("/teleop_logi/tele_steer_req", Float32)
        self.acceleration = self.sender("/control/command/control_cmd", Control)
        self.repeater.hold(self.steering, Float32(1.0))
        command = Control(stamp=rospy.Time.now())
        command.longitudinal.acceleration = 0.3
        self.repeater.hold(self.acceleration, command)
        self.topics = {"turn_arb": self.topic("/turn_arb/state", SteeringState),
                       "pca9685": self.topic("/servo/output", Int32MultiArray),
                       "teensy_sensor_hub": self.topic("/teensy_wheel", Wheel),
                       "generic_value_converter": self.topic("/generic_value_converter/output/value", Float64Stamped),
                       "throttle_arb": self.topic("/throttle_arb/state", ThrottleState)}
        self.arm()

    def sender(self, name, message_type):
        sender = Sender(name, message_type)
        self.addCleanup(sender.close)
        return sender

    def topic(self, name, message_type):
        topic = Topic(name, message_type).connected()
        self.addCleanup(topic.close)
        return topic

    def arm(self):
        """Let go and hold again until the car drives: topics come in any order."""
        def attempt():
            self.repeater.hold(self.human, Bool(False))
            self.wait_until_neutral(time.monotonic_ns())
            self.repeater.hold(self.human, Bool(True))
            now_ns = time.monotonic_ns()
            self.chip.wait_for(0, lambda counts: counts == LEFT, now_ns, 5.0)
            self.chip.wait_for(1, lambda counts: counts > ESC_NEUTRAL, now_ns, 5.0)
        retried(attempt)

    def wait_until_neutral(self, since_ns):
        """When servo and ESC were, ms after."""
        return max(self.chip.wait_for(channel, lambda counts, neutral=neutral: counts == neutral, since_ns) - since_ns
                   for channel, neutral in ((0, CENTER), (1, ESC_NEUTRAL))) / 1e6

    def fail(self, part):
        """Have a part fail; the process's own line about that."""
        sender = Sender(f"/fail/{part}", Empty)
        mark = self.process.stderr.mark()
        sender.publish()
        line = self.process.wait_for_line(f"{part}: a fault in this node itself.*ZeroDivisionError", mark)
        sender.close()
        return line

    def test_letting_go_and_the_lock_stop_it(self):
        self.repeater.hold(self.lock, Bool(False))
        for sender, message, undo in ((self.human, Bool(False), None), (self.lock, Bool(True), Bool(False))):
            def attempt(sender=sender, message=message, undo=undo):
                stopped_ns = time.monotonic_ns()
                self.repeater.hold(sender, message)
                took_ms = self.wait_until_neutral(stopped_ns)
                if undo is not None:
                    self.repeater.hold(sender, undo)
                self.arm()
                self.assertLess(took_ms, WITHIN_MS)
            retried(attempt)

    def test_a_part_that_fails_comes_back_and_the_others_go_on(self):
        before = graph_of("", ["car_nodes"])
        for part in PARTS:
            others = [name for name in PARTS if name != part]
            mark = self.process.stderr.mark()
            marks = {name: self.topics[name].mark() for name in PARTS}
            self.assertIn("Starting it anew", self.fail(part))
            failed_ns = time.monotonic_ns()
            self.assertNotIn(f"/fail/{part}", graph_of("", ["car_nodes"])[1])
            if part == "turn_arb":
                self.assertLess(self.wait_until_neutral(failed_ns), 300 + WITHIN_MS)  # as pca9685's timeout has it
            elif part == "pca9685":
                self.assertEqual(self.chip.counts(0), OFF)
            eventually(lambda: graph_of("", ["car_nodes"]) == before, f"{part} is back")
            self.assertGreater((time.monotonic_ns() - failed_ns) / 1e9, 0.8)
            for name in PARTS:
                self.topics[name].wait_for_count(1, marks[name])
            self.arm()
            lines = self.process.stderr.since(mark)
            self.assertEqual(sum("a fault in this node itself" in line for line in lines), 1, lines)
            self.assertFalse([line for line in lines for name in others if f"{name}: a fault" in line], lines)
            self.assertFalse([line for line in lines if "Traceback" in line], lines)

    def test_the_others_publish_while_a_part_is_away(self):
        for part in PARTS:
            others = {name: topic for name, topic in self.topics.items() if name not in (part, "pca9685")}
            self.fail(part)
            marks = {name: topic.mark() for name, topic in others.items()}
            for name, topic in others.items():
                topic.wait_for_count(3, marks[name], within_s=0.9)
            eventually(lambda part=part: f"/fail/{part}" in graph_of("", ["car_nodes"])[1], f"{part} is back")
        self.arm()

    def test_lives_of_parts_leave_nothing_behind(self):
        def all_fail():
            for part in PARTS:
                self.fail(part)
                eventually(lambda part=part: f"/fail/{part}" in graph_of("", ["car_nodes"])[1], f"{part} is back")

        def leftovers():
            return (len(os.listdir(f"/proc/{self.process.pid}/fd")), len(os.listdir(f"/proc/{self.process.pid}/task")))
        all_fail()
        self.arm()
        files, threads = leftovers()
        for _ in range(3):
            all_fail()
        self.arm()
        # Some wait for Python's next round of garbage; what stayed for good would be a dozen for each of these lives.
        eventually(lambda: leftovers() <= (files + 12, threads + 4), lambda: f"{files, threads}; now {leftovers()}")

    def test_who_waits_for_an_answer_of_a_part_that_fails_is_told(self):
        ping = rospy.ServiceProxy("/teensy_sensor_hub/ping", Trigger)
        eventually(lambda: ping().success, "the Teensy answers")
        self.assertTrue(rospy.ServiceProxy("/car_sim/inject_fault", InjectFault)("silence", 60).success)

        def attempt():
            answers = []
            thread = threading.Thread(target=lambda: answers.append(ping()), daemon=True)
            thread.start()
            self.fail("teensy_sensor_hub")
            thread.join(5)
            back = eventually(lambda: "/fail/teensy_sensor_hub" in graph_of("", ["car_nodes"])[1], "it is back")
            self.assertTrue(back)
            self.assertEqual([(answer.success, answer.message) for answer in answers], [(False, "the node ends")])
        retried(attempt)

    def test_who_asks_a_part_that_is_away_is_told(self):
        """By a connection that outlives the part, which a client may ask for."""
        inject = rospy.ServiceProxy("/pca9685/inject_fault", InjectFault, persistent=True)
        self.assertFalse(inject("nonsense", 0).success)
        self.fail("pca9685")
        with self.assertRaisesRegex(rospy.ServiceException, "the node has ended"):
            inject("nonsense", 0)
        inject.close()
        again = rospy.ServiceProxy("/pca9685/inject_fault", InjectFault)
        again.wait_for_service(PATIENCE_S)
        self.assertFalse(again("nonsense", 0).success)

    def test_a_part_that_hangs_keeps_neither_the_others_nor_the_end(self):
        hang = self.sender("/hang/teensy_sensor_hub", Float32)
        hung_ns = time.monotonic_ns()
        hang.publish(Float32(60.0))
        self.chip.wait_for(1, lambda counts: counts == ESC_NEUTRAL, hung_ns)  # without odometry
        self.repeater.hold(self.steering, Float32(-1.0))
        self.chip.wait_for(0, lambda counts: counts == RIGHT, hung_ns)
        ended_ns = int(self.process.send(signal.SIGTERM) * 1e9)
        off_ns = self.chip.wait_for(0, lambda counts: counts == OFF, ended_ns)
        self.assertLess((off_ns - ended_ns) / 1e6, 300 + WITHIN_MS)
        self.assertEqual(self.process.wait_for_exit(), 1)
        self.process.wait_for_line("teensy_sensor_hub: it hangs and can't be shut down")

    def check_end(self, end):
        """Center and neutral for two periods, then off; exit code 0."""
        ended_ns = time.monotonic_ns()
        end()
        neutral_ns = [self.chip.wait_for(channel, lambda counts, neutral=neutral: counts == neutral, ended_ns)
                      for channel, neutral in ((0, CENTER), (1, ESC_NEUTRAL))]
        off_ns = self.chip.wait_for(0, lambda counts: counts == OFF, max(neutral_ns))
        self.assertEqual(self.process.wait_for_exit(), 0)
        self.assertLess((max(neutral_ns) - ended_ns) / 1e6, 100 + WITHIN_MS)
        self.assertLess((off_ns - ended_ns) / 1e6, 300 + WITHIN_MS)
        self.assertGreater((off_ns - max(neutral_ns)) / 1e6, 35)
        self.assertEqual((self.chip.counts(0), self.chip.counts(1)), (OFF, OFF))
        self.assertEqual(self.process.stderr.since(), [line for line in self.process.stderr.since() if "WARN" in line])

    def test_sigterm_makes_all_safe(self):
        self.check_end(lambda: self.process.send(signal.SIGTERM))

    def test_sigint_makes_all_safe(self):
        self.check_end(lambda: self.process.send(signal.SIGINT))

    def test_rosnode_kill_makes_all_safe(self):
        self.check_end(lambda: rosnode.kill_nodes(["/car_nodes"]))
        self.assertNotIn("/turn_arb/state", graph_of("", ["car_nodes"])[0])


class Parameters(AProcess):
    def test_a_bad_one_of_any_part_ends_it_with_one_line(self):
        for part, name, value in (("turn_arb", "servo_left", "x"), ("pca9685", "timeout", -1),
                                  ("teensy_sensor_hub", "baud", 0), ("generic_value_converter", "max_valeu", 1),
                                  ("throttle_arb", "human_scale", 2)):
            self.set_params("/bad", **{part: {name: value}})
            process = start_node(self, "car_nodes", "__ns:=bad")
            self.assertEqual(process.wait_for_exit(), 1)
            fatal = [line for line in process.stderr.since() if "FATAL" in line]
            self.assertEqual(len(fatal), 1, process.stderr.since())
            self.assertRegex(fatal[0], rf"{part}: .*{name}.*accepted")
            self.assertNotIn("Traceback", "".join(process.stderr.since()))
            rospy.delete_param(f"/bad/{part}/{name}")

    def test_it_has_none_of_its_own(self):
        self.set_params()
        process = start_node(self, "car_nodes", "_servo_left:=1")
        self.assertEqual(process.wait_for_exit(), 1)
        process.wait_for_line("unknown parameter servo_left")

    def test_those_of_the_original_are_found_outside(self):
        self.set_params("/outer")
        for name, value in config("turn_arb.yaml").items():
            rospy.delete_param(f"/outer/turn_arb/{name}")
            if name.startswith(("servo_", "m_turnrad", "k_pwmcmd")):
                set_params(self, "/outer", {name: value})
        process = start_node(self, "car_nodes", "__ns:=outer")
        state = Topic("/outer/turn_arb/state", SteeringState)
        self.assertEqual(state.wait_for(lambda _: True).what.duty, config("turn_arb.yaml")["servo_center"])
        state.close()
        self.assertEqual(process.end(signal.SIGTERM), 0)


if __name__ == "__main__":
    rospy.init_node("one_process_test")
    rostest.rosrun("car_interface", "one_process_test", "__main__")
