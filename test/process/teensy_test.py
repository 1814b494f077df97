#!/usr/bin/env python3
"""The Teensy's link as processes on real terminals: ptys, permissions, services, signals and keys.

What the hub makes of what comes, and when, is tested in test/graph.
"""
import os
import pty
import re
import select
import sys
import tempfile
import threading
import tty
import unittest

import rospy
import rostest
from car_interface.msg import Distance, Error, LinkStatus, Pong, Wheel
from car_interface.srv import InjectFault, SetSonarSequence, SetSonarWait
from std_srvs.srv import Trigger

from closing import HOLDER, pid_of
from terminal import Terminal
from waiting import PACKAGE, PATIENCE_S, Record, Topic, eventually, executable, start, start_node

sys.path.append(os.path.join(PACKAGE, "test"))
from bench.meters import CpuMeter, rss_mb

MAX_CPU_PERCENT, MAX_GROWTH_MB = 80, 6
FLAG = b"\x7e"
PING_HEADER = "02010100", "0201017d20"  # the other where the checksum would be 7d or 7e: see framing.encode
# Header, payload and checksum of what each key and each service sends.
SONAR_START, SONAR_STOP, WHEEL_RESET, GET_COUNTERS = "02010500f7", "02010400f8", "02010800f4", "02010a00f2"
SEQUENCE_015, SEQUENCE_ALL, WAIT_50_MS = "0201030003000105f0", "0201030006000102030405e4", "02010c0032000000be"
TYPED = [SONAR_START, SONAR_STOP, WHEEL_RESET, GET_COUNTERS, SEQUENCE_015, SEQUENCE_ALL, SONAR_START]


def call(hub, name, service_type=Trigger, *arguments):
    rospy.wait_for_service(f"/{hub}/{name}", PATIENCE_S)
    answer = rospy.ServiceProxy(f"/{hub}/{name}", service_type)(*arguments)
    return answer.success, answer.message


class Usage:
    """What a process uses, from now on."""

    def __init__(self, pid):
        self._pid, self._cpu, self._before_mb = pid, CpuMeter(pid), rss_mb(pid)

    def check(self, test, what):
        """It leaves CPU to others and does not grow."""
        percent, growth_mb = self._cpu.percent(), rss_mb(self._pid) - self._before_mb
        print(f"{what}: {percent:.0f} % CPU, {growth_mb:.1f} MB more")
        test.assertLess(percent, MAX_CPU_PERCENT)
        test.assertLess(growth_mb, MAX_GROWTH_MB)


def are_among(wanted, found):
    """Whether they are all found, in this order."""
    rest = iter(found)
    return all(each in rest for each in wanted)


class Line:
    """The Teensy's end of a pty behind a link at ``path``. It answers nothing; what is sent is kept, in hex."""

    def __init__(self, path):
        self._master, self.slave = pty.openpty()
        tty.setraw(self.slave)
        self.frames = Record(f"frames on {path}")
        os.symlink(os.ttyname(self.slave), path)
        threading.Thread(target=self._read, daemon=True).start()

    def write(self, data):
        while data:
            select.select([], [self._master], [])
            data = data[os.write(self._master, data):]

    def wait_for(self, frame, since=0):
        return self.frames.wait_for(lambda one: one.startswith(frame), since)

    def commands(self, since=0):
        return [frame for frame in self.frames.since(since) if not frame.startswith(PING_HEADER)]

    def _read(self):
        rest = b""
        while True:
            *segments, rest = (rest + os.read(self._master, 4096)).split(FLAG)
            for segment in segments:
                if segment.strip(b"\0"):
                    self.frames.add(segment.hex())


class LaunchedCar(unittest.TestCase):

    @classmethod
    def setUpClass(cls):
        cls.port = rospy.get_param("~port")
        cls.links = Topic("/teensy_sensor_hub/link", LinkStatus).connected()
        rospy.wait_for_service("/car_sim/inject_fault", PATIENCE_S)
        cls.inject = rospy.ServiceProxy("/car_sim/inject_fault", InjectFault)

    def setUp(self):
        self.links.wait_for(lambda link: link.state == "fine", max(0, self.links.mark() - 1))

    def fault(self, name, value=0.0):
        """Begin a fault; return the place of the next status."""
        mark = self.links.mark()
        self.assertTrue(self.inject(name, value).success)
        return mark

    def test_raw_topics_have_the_original_names_and_types(self):
        types = dict(rospy.get_published_topics())
        topics = {}
        for name, message_type in (("pong", Pong), ("wheel", Wheel), ("distance", Distance), ("error", Error)):
            self.assertEqual(types[f"/teensy_{name}"], f"car_interface/{name.capitalize()}")
            topics[name] = Topic(f"/teensy_{name}", message_type).connected()
        eventually(lambda: call("teensy_sensor_hub", "get_counters")[0], "a request that isn't too early")
        for topic in topics.values():
            topic.wait_for_count(1)

    def test_services_answer_as_on_a_terminal(self):
        eventually(lambda: re.match(r"pong after \d+\.\d ms$", call("teensy_sensor_hub", "ping")[1]), "a pong in time")
        for name, service_type, arguments in (
                ("sonar_stop", Trigger, ()), ("wheel_reset", Trigger, ()), ("sonar_start", Trigger, ()),
                ("set_sonar_sequence", SetSonarSequence, (range(6),)), ("set_sonar_wait", SetSonarWait, (50,))):
            self.assertEqual(call("teensy_sensor_hub", name, service_type, *arguments), (True, "sent"))
        self.assertEqual(call("teensy_sensor_hub", "set_sonar_sequence", SetSonarSequence, [0, 6]),
                         (False, "there is no sonar 6: ids go from 0 to 5"))

    def test_port_that_is_unplugged_is_opened_again_under_another_name_behind_its_link(self):
        device, before = os.readlink(self.port), self.links.since()[-1]
        mark = self.fault("unplug")
        link = self.links.wait_for(lambda link: link.state == "port absent", mark).what
        self.assertIn("ls /dev/serial/by-id", link.next_step)
        self.assertEqual(call("teensy_sensor_hub", "sonar_start"), (False, "the Teensy's port is not open"))
        mark = self.fault("plug")
        link = self.links.wait_for(lambda link: link.state == "fine", mark).what
        self.assertNotEqual(os.readlink(self.port), device)
        self.assertEqual(link.reconnects, before.reconnects + 1)
        eventually(lambda: call("teensy_sensor_hub", "ping")[0], "a pong in time")

    def test_flood_leaves_services_answering_and_cpu_to_others_and_memory_as_it_is(self):
        usage = Usage(pid_of("/teensy_sensor_hub"))
        mark = self.fault("flood", 60)
        self.addCleanup(self.inject, "flood", 0)
        self.assertIn("baud can carry", self.links.wait_for(lambda link: link.state == "no frames", mark).what.words)
        self.assertTrue(call("teensy_sensor_hub", "sonar_start")[0])
        self.assertRegex(call("teensy_sensor_hub", "ping")[1], "no pong came back|pong after")
        self.links.wait_for_count(1, self.links.mark())
        usage.check(self, "hub in a flood")


class ByItself(unittest.TestCase):

    def setUp(self):
        directory = tempfile.TemporaryDirectory()
        self.addCleanup(directory.cleanup)
        os.chmod(directory.name, 0o777)
        self.directory = directory.name
        self.port = os.path.join(self.directory, "teensy")

    def hub(self, name, *arguments):
        return start_node(self, "teensy_sensor_hub", f"_port:={self.port}", f"__ns:={name}", *arguments)

    def link_of(self, name):
        topic = Topic(f"/{name}/teensy_sensor_hub/link", LinkStatus)
        self.addCleanup(topic.close)
        return topic

    def test_port_that_another_program_holds_is_told_with_its_name_and_taken_when_that_ends(self):
        Line(self.port)
        script = os.path.join(self.directory, "terminal_program")
        with open(script, "w", encoding="ascii") as file:
            file.write(HOLDER)
        holder = start(self, "/usr/bin/python3", script, self.port)
        holder.wait_for_info("open")
        hub, links = self.hub("busy"), self.link_of("busy")
        link = links.wait_for(lambda link: link.state == "port busy").what
        self.assertEqual(link.words, f"another program has it open: terminal_program (process {holder.pid})")
        self.assertIn(f"fuser -v {self.port}", link.next_step)
        hub.wait_for_line(re.escape(link.words))
        holder.end()
        links.wait_for(lambda link: link.open)
        self.assertEqual(hub.end(), 0)

    def test_port_without_permission_is_told_with_its_group(self):
        line = Line(self.port)
        os.fchmod(line.slave, 0o060)  # its group only: not its owner either, who may well be this test's user
        # Root opens everything, but for these capabilities; as another user it couldn't read a workspace of root's.
        as_root = os.geteuid() == 0
        if as_root:
            os.fchown(line.slave, 65534, 5)
        without = "-dac_override,-dac_read_search"
        denied = ["setpriv", f"--bounding-set={without}", f"--inh-caps={without}", "--clear-groups"] if as_root else []
        start(self, "env", f"ROS_HOME={self.directory}", f"ROS_LOG_DIR={self.directory}/log", *denied,
              executable("teensy_sensor_hub"), f"_port:={self.port}", "__ns:=denied")
        link = self.link_of("denied").wait_for(lambda link: link.state == "no permission").what
        self.assertRegex(link.words, "^no permission to open it.* its group, ")
        # A user's group counts for nothing while he owns the port, so what is said of the group depends on who runs it.
        self.assertIn("sudo usermod -aG " if as_root else "", link.next_step)

    def test_what_it_cannot_start_with_ends_it_with_one_line(self):
        nodes = [(self.hub(f"refused{index}", argument), text) for index, (argument, text) in enumerate((
            ("_ping_period:=0", "ping_period is 0; accepted: a number from 0.01 to 3600"),
            ("_required:=true", f"Teensy on {self.port}: there is no such port")))]
        for node, text in nodes:
            self.assertEqual(node.wait_for_exit(), 1)
            line, = node.stderr.since()
            self.assertRegex(line, f"FATAL.*: {text}")

    def test_flood_into_the_virtual_teensy_by_a_program_that_never_reads_does_it_no_harm(self):
        sim = start_node(self, "car_sim", f"_port:={self.port}", "__ns:=flooded")
        eventually(lambda: os.path.exists(self.port), "a virtual Teensy")
        port = os.open(self.port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        self.addCleanup(os.close, port)
        tty.setraw(port)
        rospy.wait_for_service("/flooded/car_sim/inject_fault", PATIENCE_S)
        usage, truth = Usage(sim.pid), Topic("/flooded/car_sim/truth", rospy.AnyMsg).connected()

        def flooded():
            if select.select([], [port], [], 0)[1]:
                os.write(port, bytes(range(256)) * 4)
            return truth.mark() >= 100
        eventually(flooded, "two seconds of the car's")
        usage.check(self, "car_sim in a flood")

    def test_keys_send_their_commands_and_the_terminal_is_restored_by_q_and_by_control_c(self):
        line = Line(self.port)
        for name, end in (("keys", b"Q"), ("ended", b"\x03")):
            mark = line.frames.mark()
            terminal = Terminal("rosrun", "car_interface", "teensy_sensor_hub", f"_port:={self.port}", f"__ns:={name}",
                                "_ping_period:=60")
            self.addCleanup(terminal.clean_up)
            terminal.wait_for_line("keys: P ping, S sonar start")
            line.wait_for(PING_HEADER, mark)
            self.assertNotEqual(terminal.settings(), terminal.settings_before)
            terminal.type(b"SNRCXYs")
            line.wait_for(SEQUENCE_ALL, mark)
            # The hub itself may start the sonars meanwhile, since this Teensy never reports any.
            eventually(lambda mark=mark: are_among(TYPED, line.commands(mark)),
                       lambda mark=mark: f"{TYPED} among {line.frames.since(mark)}")
            mark = line.frames.mark()
            terminal.type(b"P")
            line.wait_for(PING_HEADER, mark)
            terminal.type(end)
            self.assertEqual(terminal.wait_for_exit(), 0)
            self.assertEqual(terminal.settings(), terminal.settings_before)

    def test_under_roslaunch_the_terminal_is_left_alone(self):
        line = Line(self.port)
        terminal = Terminal("roslaunch", "car_interface", "teensy_sensor_hub.launch", "ns:=launched",
                            f"port:={self.port}")
        self.addCleanup(terminal.clean_up)
        line.wait_for(PING_HEADER)
        terminal.type(b"SNRCXYSNRCXY")
        self.assertTrue(call("launched/teensy_sensor_hub", "set_sonar_wait", SetSonarWait, 50)[0])
        line.wait_for(WAIT_50_MS)
        # The hub itself starts the sonars after 3 s, since this Teensy never reports any.
        self.assertEqual([command for command in line.commands() if command != SONAR_START], [WAIT_50_MS])
        self.assertEqual(terminal.settings(), terminal.settings_before)
        terminal.type(b"\x03")
        self.assertEqual(terminal.wait_for_exit(), 0)
        self.assertEqual(terminal.settings(), terminal.settings_before)


if __name__ == "__main__":
    rospy.init_node("teensy_test")
    rostest.rosrun("car_interface", "teensy_test", "__main__")
