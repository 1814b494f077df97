#!/usr/bin/env python3
"""The car's nodes and ROS itself: names that are taken, parameters that are lost or refused, sockets, several hosts.

Two cars run by demo.launch: /four of four processes and more, /one of one process.
"""
from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import unittest
from xmlrpc.client import ServerProxy

import rosgraph
import rosnode
import rospy
import rostest
import yaml
from car_interface.msg import SteeringState, ThrottleState
from car_interface.srv import InjectFault
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from sensor_msgs.msg import Joy
from std_msgs.msg import Bool, Empty, Float32, Int32MultiArray

from car_interface.common import causes
from car_interface.teleop.gamepad import REARM_TEXT
from virtual_car import CENTER, ESC_NEUTRAL, HERE, LEFT, PACKAGE, RIGHT, Car, Chip, FakeBus
from waiting import (
    NodeProcess,
    Repeater,
    Sender,
    Topic,
    config,
    eventually,
    executable,
    one_process_params,
    set_params,
    skip,
    start,
    start_node,
)

LAUNCH_S = 60
STRICT = bool(os.environ.get("CAR_INTERFACE_ALL"))
PARTS = ("turn_arb", "pca9685", "teensy_sensor_hub", "generic_value_converter", "throttle_arb")
NODES = ("turn_arb", "pca9685", "teensy_sensor_hub", "generic_value_converter", "teleop_logi")
BARE = os.path.join(PACKAGE, "test", "bench", "bare.py")
PEERS, FAULTY = (os.path.join(HERE, name) for name in ("half_open_peers.py", "faulty_car_nodes.py"))
LEFT_DUTY, OFF = 238 * 16, 0
RESPAWNED = {"CAR_INTERFACE_RESPAWN": "true"}
BY_LAUNCH = "by the launch file that started this process"
REFUSED = "servo_left is 'x'; accepted: an integer from 0 to 65535"
HOSTS = {"car": "10.213.77.1", "laptop": "10.213.77.2"}


def ask(node, method, *arguments):
    """What a node answers; ``None`` without the node."""
    try:
        return getattr(ServerProxy(rosgraph.Master("/test").lookupNode(node)), method)("/test", *arguments)[2]
    except (rosgraph.MasterException, OSError):
        return None


def pid_of(node):
    """The process of a node that answers."""
    return ask(node, "getPid")


def graph_of(namespace, nodes):
    """What nodes have on the ROS graph: topics that they publish and hear, and services; without the namespace."""
    paths = {f"{namespace}/{node}" for node in nodes}
    found = []
    for names in rospy.get_master().getSystemState()[2]:
        ours = {name for name, users in names if paths & set(users)}
        found.append({name[len(namespace):] if name.startswith(f"{namespace}/") else name for name in ours
                      if not re.search("/rosout$|/get_loggers$|/set_logger_level$", name)})
    return found


def joy(held):
    """The stick to the left with the manual deadman, or all let go."""
    return Joy(axes=[float(held)] + [0.0] * 7, buttons=[int(held and index == 4) for index in range(11)])


def output_of(process):
    """All lines of a process so far."""
    return process.stdout.since() + process.stderr.since()


class Closing(unittest.TestCase):
    """What a test makes ends with it."""

    def setUp(self):
        self.folder = tempfile.mkdtemp()
        self.addCleanup(shutil.rmtree, self.folder, ignore_errors=True)
        self.repeater = Repeater(0.02)

    def tearDown(self):
        self.repeater.end()  # before its senders are closed

    def topic(self, name, message_type):
        topic = Topic(name, message_type)
        self.addCleanup(topic.close)
        return topic

    def sender(self, name, message_type):
        sender = Sender(name, message_type)
        self.addCleanup(sender.close)
        return sender

    def launch(self, *arguments, env=None):
        """Start a launch file of this package."""
        process = NodeProcess("roslaunch", "car_interface", *arguments, env=env)
        self.addCleanup(lambda: process.runs() and process.end())  # with its nodes
        return process

    def wait_s(self, seconds):
        began_s = time.monotonic()
        eventually(lambda: time.monotonic() - began_s > seconds, f"{seconds} s")


class TwoCars(Closing):
    def test_both_have_the_same_topics_services_parameters_and_reports_and_the_doctor_sees_all_parts(self):
        heard, names = self.topic("/diagnostics", DiagnosticArray), {"four": set(), "one": set()}

        def both():
            return graph_of("/four", PARTS), graph_of("/one", ["car_nodes"])
        eventually(lambda: both()[0] == both()[1] and len(both()[0][2]) >= 8, lambda: f"the same names: {both()}")
        published, subscribed, services = both()[1]
        self.assertLessEqual({"/turn_arb/state"}, published)
        self.assertLessEqual({"/servo/cmdVector"}, subscribed)
        self.assertLessEqual({"/teensy_sensor_hub/ping", "/pca9685/inject_fault"}, services)
        for part in PARTS:
            four, one = ({name: value for name, value in rospy.get_param(f"/{namespace}/{part}").items()
                          if name not in ("port", "frame_prefix")} for namespace in ("four", "one"))
            self.assertEqual(four, one)
        self.assertNotIn("/one/turn_arb", rosnode.get_node_names())
        for namespace in names:  # a topic latches one message in a process, and in the one two parts publish
            neutrals = self.topic(f"/{namespace}/servo/neutral", Int32MultiArray)
            for channel in (0, 1):
                neutrals.wait_for(lambda neutral, channel=channel: neutral.data[channel] != -1)

        def same_reports():
            for array in heard.since():
                for status in array.status:
                    namespace, _, name = status.name.partition("/")
                    names.setdefault(namespace, set()).add(re.sub("_four|_one", "", name))
            return names["four"] == names["one"] and len(names["one"]) > 12
        eventually(same_reports, lambda: f"the same names: {names}")
        doctor = start_node(self, "doctor", "--ns", "/one")
        doctor.wait_for_exit()
        shown = "\n".join(doctor.stdout.since())
        self.assertRegex(shown, f"{', '.join(PARTS)}, .* run in /one")
        self.assertNotIn("not running", shown)

    def test_publishers_of_the_wrong_type_on_an_unknown_host_or_killed_are_told_by_name(self):
        set_params(self, "/late/turn_arb", config("turn_arb.yaml"))
        reports = self.topic("/diagnostics", DiagnosticArray)
        master = rosgraph.Master("/ros_test")
        lost = ("env", "--unset=ROS_IP", "ROS_HOSTNAME=no-such-host.invalid")
        publishers = {topic: start(self, *before, "rostopic", "pub", "-r", "10", topic, f"std_msgs/{kind}", "2.0")
                      for topic, kind, before in (
                          ("/late/av_turnrad_req", "Float64", ()), ("/late/av_steer_req", "Float32", lost),
                          ("/one/av_turnrad_req", "Float64", ()), ("/four/av_turnrad_req", "Float64", ()))}

        def name_on(topic):
            return next((name for name in dict(master.getSystemState()[0]).get(topic, []) if "rostopic" in name), None)
        names = {topic: eventually(lambda topic=topic: name_on(topic), topic, LAUNCH_S) for topic in publishers}
        start_node(self, "turn_arb", "__ns:=/late")  # the master takes the first publisher's type for the topic's

        def wait_until(node, *texts, level=DiagnosticStatus.ERROR):
            def wanted(array):
                return any(status.name == f"{node}: command topics" and status.level == level
                           and all(text in f"{status.message} {status.values}" for text in texts)
                           for status in array.status)
            reports.wait_for(wanted, reports.mark())
        wait_until("late/turn_arb", "set ROS_IP",
                   f"{names['/late/av_turnrad_req']} on 127.0.0.1 publishes std_msgs/Float64 on /late/av_turnrad_req",
                   f"{names['/late/av_steer_req']} publishes on /late/av_steer_req from a computer that it calls "
                   "no-such-host.invalid, which can't be looked up here: none of its messages is received")
        for car in ("one", "four"):
            topic = f"/{car}/av_turnrad_req"
            wait_until(f"{car}/turn_arb", names[topic], f"publishes std_msgs/Float64 on {topic}, which takes "
                       "std_msgs/Float32: none of its messages is received")
            publishers[topic].end(signal.SIGKILL)
            wait_until(f"{car}/turn_arb", "each has the publishers that it should have", level=DiagnosticStatus.OK)
            self.assertEqual(name_on(topic), names[topic])  # it is still registered

    def test_nodes_come_back_while_silent_connections_are_opened_on_the_others_again_and_again(self):
        stick, output = self.sender("/four/joy", Joy), self.topic("/four/servo/output", Int32MultiArray)
        states = self.topic("/four/turn_arb/state", SteeringState)

        def drive():
            while True:
                self.repeater.hold(stick, joy(False))
                states.wait_for(lambda state: state.cause == causes.HUMAN_ABSENT, states.mark())
                self.wait_s(0.3)  # the stick's rest
                self.repeater.hold(stick, joy(True))
                try:
                    return output.wait_for(lambda message: message.data[0] == LEFT_DUTY, output.mark(), 3.0)
                except AssertionError:  # a connection was not there yet
                    if time.monotonic() - began_s > LAUNCH_S:
                        raise
        began_s = time.monotonic()
        drive()
        published = {"/four/turn_arb": "/four/turn_arb/state", "/four/throttle_arb": "/four/throttle_arb/state",
                     "/four/teleop_logi": "/four/teleop_logi/human_in_loop"}
        ports = [str(eventually(lambda node=node, topic=topic: ask(node, "requestTopic", topic, [["TCPROS"]]), node)[2])
                 for node, topic in published.items()]
        for mode in ("hold", "reopen"):
            peers = start(self, PEERS, *ports, "200", mode)
            peers.stdout.wait_for(lambda line: line == "open")
            mark, killed_s = output.mark(), time.monotonic()
            os.kill(pid_of("/four/pca9685"), signal.SIGKILL)
            output.wait_for(lambda message: message.data[0] != LEFT_DUTY, mark)  # its guard
            back = output.wait_for(lambda message: message.data[0] == LEFT_DUTY, output.mark())
            print(f"{mode}: pca9685 is back after {back.at_s - killed_s:.2f} s", flush=True)
            if STRICT:
                self.assertLess(back.at_s - killed_s, 5.0)
            if mode == "hold":
                peers.clean_up()
        os.kill(pid_of("/four/turn_arb"), signal.SIGKILL)
        mark = states.mark()
        states.wait_for(lambda state: state.cause == causes.NOT_REARMED, mark)  # it hears teleop_logi
        began_s = time.monotonic()
        drive()


class Parts(Closing):
    """A car_nodes of the test's own, whose parts fail on request, without a Teensy."""

    def setUp(self):
        super().setUp()
        self.chip = Chip(os.path.join(self.folder, "chip"))
        self.set_params("")

    def set_params(self, namespace, **changes):
        values = one_process_params(self.folder, virtual_log=self.chip.path)
        for part in PARTS:
            set_params(self, f"{namespace}/{part}", {**values[part], **changes.get(part, {})})
        set_params(self, f"{namespace}/car_nodes", {"throttle": True})

    def start(self):
        self.process = start(self, sys.executable, FAULTY)
        eventually(lambda: {f"/fail/{part}" for part in PARTS} <= graph_of("", ["car_nodes"])[1],
                   lambda: f"all parts: {output_of(self.process)}")
        human, steering = self.sender("/teleop_logi/human_in_loop", Bool), self.sender("/teleop_logi/tele_steer_req",
                                                                                        Float32)
        self.repeater.hold(steering, Float32(1.0))
        # Let go for a while whenever a part has just started.
        self.repeater.hold(human, lambda: Bool(time.monotonic() % 0.6 > 0.2))
        self.chip.wait_for(0, lambda counts: counts == LEFT)

    def fail(self, part):
        mark = self.process.stderr.mark()
        sender = self.sender(f"/fail/{part}", Empty)
        sender.publish()
        line = self.process.wait_for_line(f"{part}: a fault in this node itself.*ZeroDivisionError", mark)
        self.assertIn("Starting it anew", line)
        sender.close()

    def test_part_that_fails_is_started_anew_while_the_others_go_on_and_leaves_nothing_behind(self):
        self.start()
        before = graph_of("", ["car_nodes"])
        states = {"turn_arb": self.topic("/turn_arb/state", SteeringState),
                  "throttle_arb": self.topic("/throttle_arb/state", ThrottleState)}
        inject = rospy.ServiceProxy("/pca9685/inject_fault", InjectFault, persistent=True)
        self.assertFalse(inject("nonsense", 0).success)
        proc, sizes = f"/proc/{self.process.pid}", []
        for life in range(3):
            for part in PARTS:
                failed_ns, marks = time.monotonic_ns(), {name: topic.mark() for name, topic in states.items()}
                self.fail(part)
                for name, topic in states.items():
                    if name != part:
                        topic.wait_for_count(3, marks[name])
                if part == "turn_arb":
                    self.chip.wait_for(0, lambda counts: counts == CENTER, failed_ns)
                elif part == "pca9685" and not life:
                    with self.assertRaisesRegex(rospy.ServiceException, "the node has ended"):
                        inject("nonsense", 0)
                    inject.close()
                eventually(lambda: graph_of("", ["car_nodes"]) == before, f"{part} is back")
                states.get(part, states["turn_arb"]).wait_for_count(1, marks.get(part, 0))
            sizes.append([len(os.listdir(f"{proc}/{kind}")) for kind in ("fd", "task")])
        # Some wait for Python's next round of garbage; what stayed for good would be a dozen for each of these lives.
        self.assertLessEqual((sizes[2][0] - sizes[0][0], sizes[2][1] - sizes[0][1]), (12, 4))
        self.assertFalse([line for line in output_of(self.process) if "Traceback" in line])
        self.chip.wait_for(0, lambda counts: counts == LEFT, time.monotonic_ns())
        self.check_end(lambda: rosnode.kill_nodes(["/car_nodes"]), 0)

    def test_part_that_hangs_keeps_neither_the_others_nor_the_end(self):
        self.start()
        self.sender("/hang/teensy_sensor_hub", Float32).publish(Float32(60.0))
        self.repeater.hold(self.sender("/teleop_logi/tele_steer_req", Float32), Float32(-1.0))
        self.chip.wait_for(0, lambda counts: counts == RIGHT)
        self.check_end(lambda: self.process.send(signal.SIGTERM), 1)
        self.process.wait_for_line("teensy_sensor_hub: it hangs and can't be shut down")

    def check_end(self, end, code):
        """Center and neutral for two periods, then off."""
        ended_ns = time.monotonic_ns()
        end()
        for channel, neutral in ((0, CENTER), (1, ESC_NEUTRAL)):
            at_ns = self.chip.wait_for(channel, lambda counts, neutral=neutral: counts == neutral, ended_ns)
            off_ns = self.chip.wait_for(channel, lambda counts: counts == OFF, at_ns)
            self.assertGreater(off_ns - at_ns, 35e6)
        self.assertEqual(self.process.wait_for_exit(), code)

    def test_bad_parameter_of_any_part_ends_the_process_with_one_line_and_it_has_none_of_its_own(self):
        wrong = {"turn_arb": ("servo_left", "x"), "pca9685": ("timeout", -1), "teensy_sensor_hub": ("baud", 0),
                 "generic_value_converter": ("max_valeu", 1), "throttle_arb": ("human_scale", 2)}
        started = {}
        for part, (name, value) in wrong.items():
            self.set_params(f"/bad_{part}", **{part: {name: value}})
            started[rf"{part}: .*{name}.*accepted"] = start_node(self, "car_nodes", f"__ns:=bad_{part}")
        started["unknown parameter servo_left"] = start_node(self, "car_nodes", "__ns:=bad_name", "_servo_left:=1")
        for pattern, process in started.items():
            self.assertEqual(process.wait_for_exit(), 1)
            line, = (line for line in process.stderr.since() if "FATAL" in line)
            self.assertRegex(line, pattern)
            self.assertNotIn("Traceback", "".join(output_of(process)))


class Names(Closing):
    """A name that another node has."""

    def test_launch_file_that_is_started_twice_waits_undisturbing_and_takes_over_when_the_first_ends(self):
        def launched(name):
            folder = os.path.join(self.folder, name)
            shutil.copytree(os.path.join(PACKAGE, "config"), folder)
            chip = Chip(os.path.join(folder, "chip"))
            with open(os.path.join(folder, "pca9685.yaml"), "w", encoding="utf-8") as file:
                yaml.safe_dump({**config("pca9685.yaml"), "virtual_log": chip.path}, file)
            return self.launch("car.launch", "i2c:=virtual", "gamepad:=false", f"config:={folder}",
                               f"port:={folder}/absent"), chip
        first, chip = launched("first")
        eventually(lambda: all(pid_of(f"/{name}") for name in NODES), "all nodes", LAUNCH_S)
        pids = {name: pid_of(f"/{name}") for name in NODES}
        commands, stick = self.topic("/servo/cmdVector", Int32MultiArray).connected(), self.sender("/joy", Joy)

        def drive(on):
            while on.counts(0) != LEFT:
                self.repeater.hold(stick, joy(False))
                self.wait_s(0.4)
                self.repeater.hold(stick, joy(True))
                self.wait_s(1.0)
        drive(chip)
        second, second_chip = launched("second")
        for name, pid in pids.items():
            line = second.stderr.wait_for(lambda line, name=name: f"/{name} is already running" in line,
                                          within_s=LAUNCH_S).what
            self.assertRegex(line, rf"^\[WARN\] \[\d+\.\d+\]: /{name} is already running on \S+ \(this computer\), "
                             rf"process {pid}\. This node waits, and sends nothing, until that one ends; then it takes "
                             r"over\. If a launch file was started twice, end one of the two$")
        mark = commands.mark()
        commands.wait_for_count(200, mark)
        self.assertLessEqual({each._connection_header["callerid"] for each in commands.since(mark)}, {"/turn_arb"})
        self.assertEqual({name: pid_of(f"/{name}") for name in NODES}, pids)
        self.assertIsNone(second_chip.counts(0))
        self.assertFalse([line for line in output_of(first) if "shutdown request" in line or "has died" in line])
        self.assertEqual(first.end(), 0)
        for name, pid in pids.items():
            second.wait_for_line(rf"/{name} on .*process {pid} has ended: taking over")
        # The button is held since before its start.
        eventually(lambda: any(REARM_TEXT in line for line in output_of(second)), "it says how to re-arm")
        self.wait_s(0.5)
        self.assertLessEqual(set(second_chip.values_since(0, 0)), {OFF, CENTER})
        drive(second_chip)
        self.assertFalse([line for line in output_of(second) if "Traceback" in line])

    def test_frozen_node_is_replaced_after_ten_seconds_a_killed_one_at_once_and_of_two_starting_one_runs(self):
        for namespace in ("", "/other"):
            set_params(self, f"{namespace}/turn_arb", config("turn_arb.yaml"))
        frozen = start_node(self, "turn_arb")
        frozen.wait_for_info("NO_HUMAN")
        log = eventually(lambda: pid_of("/turn_arb") == frozen.pid, "it is registered")
        self.assertTrue(log)
        self.wait_s(0.5)  # a line on /rosout: it has nothing more to register when it wakes
        frozen.send(signal.SIGSTOP)
        self.addCleanup(frozen.send, signal.SIGCONT)
        heir = start_node(self, "turn_arb")
        heir.wait_for_line("/turn_arb is registered on .*, and doesn't answer. This node takes over if it doesn't for "
                           "10 s")

        both = [start_node(self, "turn_arb", "__ns:=other") for _ in range(2)]

        def one_runs():
            waits = [process for process in both if any("already running" in line for line in output_of(process))]
            ended = [process for process in both if not process.runs()]
            return len(waits) + len(ended) == 1 and pid_of("/other/turn_arb") in {
                process.pid for process in both if process not in waits + ended}
        eventually(one_runs, "one of two")
        running = next(process for process in both if process.pid == pid_of("/other/turn_arb"))
        waiting = start_node(self, "turn_arb", "__ns:=other")
        waiting.wait_for_line(f"/other/turn_arb is already running on .* process {running.pid}\\.")
        self.assertEqual(waiting.end(signal.SIGTERM), 0)  # without another word
        self.assertEqual(len(output_of(waiting)), 1, output_of(waiting))
        for process in both:
            process.end(signal.SIGKILL)
        successor = start_node(self, "turn_arb", "__ns:=other")
        successor.wait_for_info("NO_HUMAN")
        self.assertFalse([line for line in output_of(successor) if "already" in line or "doesn't answer" in line])

        def node():
            return start(self, executable("wait_for_name"), sys.executable, BARE, "__name:=joy_node")
        first = node()
        eventually(lambda: pid_of("/joy_node") == first.pid, "the first")
        second = node()
        second.wait_for_line(f"/joy_node is already running on .* process {first.pid}\\.")
        first.end()
        eventually(lambda: pid_of("/joy_node") == second.pid, "the second")
        for arguments, code, text in ((["ls"], 2, "usage: wait_for_name"),
                                      (["/no/such", "__name:=a"], 1, "No such file")):
            process = start(self, executable("wait_for_name"), *arguments)
            self.assertEqual(process.wait_for_exit(), code)
            self.assertRegex("\n".join(process.stderr.since()), text)

        line = heir.wait_for_line("taking over")
        self.assertIn("hasn't answered for 10 s: taking over. If it is only frozen, the ROS master ends it", line)
        heir.wait_for_info("NO_HUMAN")
        frozen.send(signal.SIGCONT)
        self.assertEqual(frozen.wait_for_exit(), 0)
        eventually(lambda: pid_of("/turn_arb") == heir.pid, "the node that took over, by its name")


class LostParameters(Closing):
    """Nodes that are started again after their parameters were deleted or exchanged open no real car's devices."""

    def setUp(self):
        super().setUp()
        self.bus = FakeBus(self.folder)

    def parameters(self, name):
        """A node's parameters, which are gone with the test."""
        self.addCleanup(lambda: rospy.has_param(name) and rospy.delete_param(name))
        return rospy.get_param(name)

    @staticmethod
    def refused(launch, mark, reason):
        line = launch.stderr.wait_for(lambda line: "FATAL" in line and reason in line, mark, LAUNCH_S).what
        assert f"{reason}. This node waits, and reads its parameters again in" in line, line

    def test_board_is_not_exchanged_for_another_one_also_not_when_the_master_was_replaced(self):
        car = Car(self.addCleanup)  # for its master
        master = rosgraph.Master("/test", car.env["ROS_MASTER_URI"])
        launch = self.launch("pca9685.launch", "device:=virtual", "address:=0x41", env={**car.env, **self.bus.env})
        launch.stdout.wait_for(lambda line: "running at" in line, within_s=LAUNCH_S)
        values = master.getParam("/pca9685")

        def replace_master():
            car.processes["master"].end(signal.SIGKILL)
            car.start_master()
            self.assertFalse(master.hasParam("/pca9685"))
        for change, reason in (
                (lambda: master.deleteParam("/pca9685"), f"device is missing; accepted: virtual, {BY_LAUNCH}"),
                (lambda: master.setParam("/pca9685/device", "/dev/i2c-1"),
                 f"device is '/dev/i2c-1'; accepted: virtual, {BY_LAUNCH}"),
                (lambda: master.setParam("/pca9685/address", 0x40), f"address is 64; accepted: 0x41, {BY_LAUNCH}"),
                (lambda: master.setParam("/pca9685/virtual_chip", f"{self.folder}/chip"),
                 (f"virtual_chip is '{self.folder}/chip'; accepted: none, {BY_LAUNCH}; its argument virtual_chip sets "
                  "it")),
                (replace_master, f"device is missing; accepted: virtual, {BY_LAUNCH}")):
            with self.subTest(reason):
                pid = ServerProxy(master.lookupNode("/pca9685")).getPid("/test")[2]
                change()
                marks = launch.stderr.mark(), launch.stdout.mark()
                os.kill(pid, signal.SIGKILL)
                self.refused(launch, marks[0], reason)
                if change is replace_master:
                    doctor = NodeProcess(executable("doctor"), env=car.env)
                    doctor.wait_for_exit()
                    shown = "\n".join(doctor.stdout.since())
                    self.assertIn(reason, shown)
                    self.assertNotIn("/dev/i2c-1", shown)
                master.setParam("/pca9685", values)
                launch.stdout.wait_for(lambda line: "the parameters are accepted now" in line, marks[1], LAUNCH_S)
                launch.stdout.wait_for(lambda line: "running at" in line, marks[1])
        self.assertFalse(os.path.exists(f"{self.folder}/chip"))
        self.assertEqual(self.bus.lines(), [])
        self.assertFalse([line for line in output_of(launch) if "Traceback" in line])
        real = self.launch("pca9685.launch", env={**car.env, **self.bus.env, "ROS_NAMESPACE": "/real"})
        real.stderr.wait_for(lambda line: "already running" in line, within_s=LAUNCH_S)
        self.assertEqual(launch.end(), 0)
        real.stdout.wait_for(lambda line: "running at" in line)  # what was looked for is there to be found
        self.assertTrue([line for line in self.bus.lines() if line.endswith("lock 40: 0")])

    def test_parts_of_one_process_refuse_each_for_itself_and_the_others_run(self):
        port = os.path.join(self.folder, "my teensy")  # a path may have a space
        states, outputs = self.topic("/turn_arb/state", SteeringState), self.topic("/servo/output", Int32MultiArray)
        reports = self.topic("/diagnostics", DiagnosticArray)
        launch = self.launch("car_nodes.launch", "device:=virtual", f"port:={port}", "throttle:=true", env=self.bus.env)
        outputs.wait_for(lambda output: output.data[0] > 0, within_s=LAUNCH_S)
        values = {name: self.parameters(f"/{name}") for name in (*PARTS, "car_nodes")}
        for path in ("/pca9685/device", "/teensy_sensor_hub", "/car_nodes/throttle"):
            rospy.delete_param(path)
        marks = launch.stderr.mark(), launch.stdout.mark()
        os.kill(pid_of("/car_nodes"), signal.SIGKILL)
        self.refused(launch, marks[0], f"throttle is missing; accepted: true, {BY_LAUNCH}")
        rospy.set_param("/car_nodes/throttle", True)
        for part, parameter, reason in (
                ("pca9685", "device", f"device is missing; accepted: virtual, {BY_LAUNCH}"),
                ("teensy_sensor_hub", "port", f"port is missing; accepted: {port}, {BY_LAUNCH}")):
            self.refused(launch, marks[0], reason)
            status = next(status for status in reports.wait_for(lambda array, part=part: any(
                status.name == f"{part}: parameters" and status.level == DiagnosticStatus.ERROR
                for status in array.status)).what.status)
            self.assertEqual(status.message, f"this node doesn't run, as it refuses a parameter: {reason}")
            self.assertEqual({value.key: value.value for value in status.values},
                             {"cause": causes.PARAMETER_REFUSED, "parameter": parameter})
            states.wait_for(lambda _: True, states.mark())  # another part
            rospy.set_param(f"/{part}", values[part])
            launch.stdout.wait_for(lambda line, part=part: f"{part}: the parameters are accepted now" in line, marks[1],
                                   LAUNCH_S)
        outputs.wait_for(lambda output: output.data[0] > 0, outputs.mark())
        eventually(lambda: "/throttle_arb/state" in dict(rospy.get_published_topics()), "throttle_arb")
        self.assertEqual(self.bus.lines(), [])
        self.assertEqual(launch.end(), 0)

    def test_node_under_respawn_that_refuses_a_parameter_says_so_once_and_starts_when_it_is_repaired(self):
        path = os.path.join(self.folder, "turn_arb.yaml")
        with open(path, "w", encoding="utf-8") as file:
            yaml.safe_dump({**config("turn_arb.yaml"), "servo_left": "x"}, file)
        reports = self.topic("/diagnostics", DiagnosticArray)
        launch = self.launch("turn_arb.launch", f"config:={path}")
        line = launch.stderr.wait_for(lambda line: "FATAL" in line, within_s=LAUNCH_S).what
        self.parameters("/turn_arb")
        self.assertTrue(line.endswith(
            f"{REFUSED}. This node waits, and reads its parameters again in 1 s, later every 30 s"), line)
        reports.wait_for(lambda array: array.status[0].name == "turn_arb: parameters"
                         and array.status[0].level == DiagnosticStatus.ERROR)
        by_hand = start_node(self, "turn_arb", "__ns:=by_hand", "_servo_left:=x")
        self.assertEqual(by_hand.wait_for_exit(), 1)
        self.assertEqual(len([line for line in by_hand.stderr.since() if "FATAL" in line]), 1)
        state = self.topic("/turn_arb/state", SteeringState)
        rospy.set_param("/turn_arb/servo_left", 3800)
        launch.stdout.wait_for(lambda line: "the parameters are accepted now" in line, within_s=LAUNCH_S)
        state.wait_for(lambda message: True)
        reports.wait_for(lambda array: array.status[0].name == "turn_arb: parameters"
                         and array.status[0].level == DiagnosticStatus.OK)
        self.assertEqual(len([line for line in launch.stderr.since() if "FATAL" in line]), 1)
        self.assertFalse([line for line in output_of(launch) if "has died" in line or "Traceback" in line])
        rospy.set_param("/turn_arb/servo_left", "x")
        mark = launch.stderr.mark()
        os.kill(pid_of("/turn_arb"), signal.SIGKILL)
        launch.stderr.wait_for(lambda line: "FATAL" in line, mark, LAUNCH_S)
        self.assertEqual(launch.end(), 0)  # a signal ends its wait
        self.assertFalse([line for line in launch.stderr.since() if "escalating" in line])


def run(*command):
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


class TwoHosts(Car):
    """The car's nodes and the master in one network namespace, the gamepad and a listener in another."""

    def __init__(self, add_cleanup):
        self._names = {host: f"{host}{os.getpid()}" for host in HOSTS}
        for host, name in self._names.items():
            run("ip", "netns", "add", name)
            add_cleanup(subprocess.run, ["ip", "netns", "delete", name], check=False)
            run("ip", "-n", name, "link", "set", "lo", "up")
            run("ip", "netns", "exec", name, "true")  # takes mounts, which a chroot refuses
            if host == "laptop":
                run("ip", "link", "add", "name", "car0", "netns", self._names["car"], "type", "veth", "peer", "name",
                    "laptop0", "netns", name)
        for host, name in self._names.items():
            run("ip", "-n", name, "address", "add", f"{HOSTS[host]}/24", "dev", f"{host}0")
        self.set_link("up")
        super().__init__(add_cleanup)

    def set_link(self, state):
        """The cable in or out; when it was, ns."""
        for host, name in self._names.items():
            run("ip", "-n", name, "link", "set", f"{host}0", state)
        return time.monotonic_ns()

    def on_host(self, name, command):
        host = "laptop" if name in ("pad", "listener") else "car"
        return ("ip", "netns", "exec", self._names[host], "env", f"ROS_IP={HOSTS[host]}",
                f"ROS_MASTER_URI=http://{HOSTS['car']}:{self._port}", *command)

    def _master_answers(self):
        probe = ("bash", "-c", f"exec 3<>/dev/tcp/{HOSTS['car']}/{self._port}")
        return subprocess.run(self.on_host("master", probe), check=False, stderr=subprocess.DEVNULL).returncode == 0


class LinkIsCut(unittest.TestCase):
    """Skipped, and counted as skipped, where namespaces are not allowed."""

    def test_what_was_on_the_other_host_counts_as_lost_and_the_car_stands_when_it_is_back(self):
        try:
            car = TwoHosts(self.addCleanup)
        except (OSError, subprocess.CalledProcessError):
            skip(self, "no network namespaces here")
        car.load_actors()
        car.pca9685()
        car.turn_arb()
        pad = car.driver("pad", "human", "steering")
        car.driver("listener", "joy")  # somebody over there who listens, too, must hold nothing up
        car.sent(pad, "steering", "1.0")

        def drive():
            while car.chip.counts(0) != LEFT:
                car.sent(pad, "human", "0")
                time.sleep(0.1)
                car.sent(pad, "human", "1")
                try:
                    car.chip.wait_for(0, lambda counts: counts == LEFT, time.monotonic_ns(), 2.0)
                except AssertionError:
                    self.assertTrue(pad.runs())
        drive()
        cut_ns = car.set_link("down")
        at_ns = car.chip.wait_for(0, lambda counts: counts == CENTER, cut_ns)
        print(f"link cut | servo | 1 | {(at_ns - cut_ns) / 1e6:.2f}", flush=True)
        if STRICT:
            self.assertLess((at_ns - cut_ns) / 1e6, 700)
        back_ns = car.set_link("up")
        turn_arb = car.processes["turn_arb"]
        eventually(lambda: any("let go once" in line for line in output_of(turn_arb)), "the deadman is heard again")
        self.assertLessEqual(set(car.chip.values_since(0, back_ns)), {CENTER}, "it drove off by itself")
        drive()


if __name__ == "__main__":
    rospy.init_node("ros_test")
    rostest.rosrun("car_interface", "ros_test", "__main__")
