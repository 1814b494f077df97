#!/usr/bin/env python3
"""teensy_sensor_hub on a pty: what real firmware sent becomes messages, and what the hub sends is what firmware takes.

The bytes that are expected of the hub are written by hand from the protocol, not made by the package's own encoder.
"""
from __future__ import annotations

import fcntl
import json
import os
import pty
import re
import select
import signal
import struct
import tempfile
import threading
import tty
import unittest
from xmlrpc.client import ServerProxy

import rosgraph
import rosnode
import rospkg
import rospy
import rostest
from car_interface.msg import Distance, Error, Pong, TeensyClock, Wheel
from car_interface.srv import SetSonarSequence, SetSonarWait
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from terminal import Terminal
from waiting import PATIENCE_S, Record, Topic, eventually, retried, start_node

FILLER = bytes(39)
FLAG = b"\x7e"
PING_HEADER = bytes.fromhex("02010100")
PING_SIZE = 4 + 8  # header, timestamp1, timestamp2
CHUNK = 997  # of the capture at once: under 100 frames, the depth of the hub's queues, and no frame boundary
FLAGLESS_BYTES = 5_000_000
MOST_GROWTH_KB = 5_000

# Header, payload and checksum of each command. None of them carries or escapes: both checksums are the same.
SONAR_START, SONAR_STOP, WHEEL_RESET, GET_COUNTERS = "02010500f7", "02010400f8", "02010800f4", "02010a00f2"
SEQUENCE_015 = "0201030003000105f0"
SEQUENCE_ALL = "0201030006000102030405e4"
WAIT_50_MS = "02010c0032000000be"


def read_capture():
    """The capture's bytes, and what the firmware put into each of its frames; the boot frame is left out."""
    data = os.path.join(rospkg.RosPack().get_path("car_interface"), "test", "data")
    with open(os.path.join(data, "capture_mixed.bin"), "rb") as file:
        stream = file.read()
    with open(os.path.join(data, "capture_mixed.jsonl"), encoding="utf-8") as file:
        frames = [json.loads(line) for line in file]
    return stream, [frame for frame in frames if frame["cmd"] is not None]


def fields_of_frame(frame):
    """What a frame's message must hold, in order, from the firmware's own account."""
    if frame["cmd"] == 2:
        return frame["timestamp1"], frame["timestamp2"]
    if frame["cmd"] == 6:
        return frame["sensor"], frame["distance"], frame["when"]
    if frame["cmd"] == 7:
        return tuple(tuple(frame[side][name] for name in ("speed", "direction", "when", "dist", "dist_abs"))
                     for side in ("left", "right"))
    return frame["count"], frame["name"]


def fields_of_message(message):
    return tuple(fields_of_message(value) if hasattr(value, "__slots__") else value
                 for value in (getattr(message, name) for name in message.__slots__))


def receiver_sum(on_wire):
    """What the shipped receiver adds up: wire bytes without carry, the 7d of an escape left out. ff is accepted."""
    return sum(byte for byte in on_wire if byte != 0x7D) % 256


def unescaped(on_wire):
    return re.sub(b"\x7d(.)", lambda match: bytes((match.group(1)[0] ^ 0x20,)), on_wire, flags=re.DOTALL)


def is_ping(frame):
    """Whether a frame, in hex, is one; its reserved byte may be escaped so that its checksum need not be."""
    return unescaped(bytes.fromhex(frame)).startswith(PING_HEADER)


def frame_from_teensy(body):
    """A frame as the firmware sends it: one's-complement checksum, stuffed. For bodies of small numbers."""
    chk = 0xFF - sum(body) % 0xFF
    stuffed = b"".join(bytes((0x7D, byte ^ 0x20)) if byte in (0x7D, 0x7E) else bytes((byte,))
                       for byte in body + bytes((chk,)))
    return FLAG + stuffed + FLAG


class Line:
    """The Teensy's end of a serial line: a pty behind a link at ``path``, and all that the hub sends through it."""

    def __init__(self, path, answers=True):
        self.path = path
        self.answers = answers  # a pong for every ping
        self.received = b""
        self._frames = Record(f"frames on {path}")
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self._sending = threading.Lock()
        self._wake_read, self._wake_write = os.pipe()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        os.symlink(os.ttyname(self._slave), f"{path}.new")
        os.rename(f"{path}.new", path)

    def frames(self, since=0):
        """The frames so far, in hex, without their flags."""
        return self._frames.since(since)

    def mark(self):
        """The place after the newest frame."""
        return self._frames.mark()

    def wait_for_frame(self, frame, since=0):
        """Until this one came."""
        self._frames.wait_for(lambda one: one == frame, since)

    def ping_after(self, since=0):
        """The first ping from ``since`` on, in hex, and when it came."""
        return self._frames.wait_for(is_ping, since)

    def wait_for_ping(self, since=0):
        """The bytes of the first ping from ``since`` on, without flags."""
        return bytes.fromhex(self.ping_after(since).what)

    def opened(self):
        """Wait until the hub has opened it and sent its first ping."""
        self.wait_for_ping()
        return self

    def send(self, data):
        """Put bytes on the line as fast as it takes them."""
        with self._sending:
            while data:
                _, writable, _ = select.select([], [self._master], [], PATIENCE_S)
                if not writable:
                    raise AssertionError(f"nobody reads {self.path}")
                data = data[os.write(self._master, data):]

    def lock(self):
        """Keep the port to oneself, as another program would."""
        fcntl.flock(self._slave, fcntl.LOCK_EX | fcntl.LOCK_NB)

    def unlock(self):
        """Let others have it."""
        fcntl.flock(self._slave, fcntl.LOCK_UN)

    def pull_out(self):
        """Pull the plug; once is enough."""
        if self._reader.is_alive():
            os.unlink(self.path)
            os.write(self._wake_write, b"0")
            self._reader.join()
            for fd in (self._master, self._slave, self._wake_read, self._wake_write):
                os.close(fd)

    def _read(self):
        rest = b""
        while True:
            ready, _, _ = select.select([self._master, self._wake_read], [], [])
            if self._wake_read in ready:
                return
            data = os.read(self._master, 4096)
            self.received += data
            *segments, rest = (rest + data).split(FLAG)
            for segment in segments:
                if segment.strip(b"\0"):
                    self._answer(segment)
                    self._frames.add(segment.hex())

    def _answer(self, segment):
        body = unescaped(segment)
        if self.answers and body.startswith(PING_HEADER):
            self.send(frame_from_teensy(bytes.fromhex("01020200") + body[4:8] + bytes(4)))


class HubUnderRoslaunch(unittest.TestCase):
    """One hub; each test is another Teensy that gets plugged in at its port."""

    @classmethod
    def setUpClass(cls):
        cls.port = rospy.get_param("~port")
        cls.pongs = Topic("/teensy_pong", Pong).connected()
        cls.wheels = Topic("/teensy_wheel", Wheel).connected()
        cls.sonars = Topic("/teensy_distance", Distance).connected()
        cls.errors = Topic("/teensy_error", Error).connected()
        cls.topics = {2: cls.pongs, 6: cls.sonars, 7: cls.wheels, 9: cls.errors}

    def plug_in(self, answers=True):
        line = Line(self.port, answers)
        self.addCleanup(line.pull_out)
        return line.opened()

    @staticmethod
    def call(name, service_type, *arguments):
        path = f"/teensy_sensor_hub/{name}"
        rospy.wait_for_service(path, PATIENCE_S)
        return rospy.ServiceProxy(path, service_type)(*arguments)

    def test_opening_sends_the_filler_and_then_a_ping_that_the_shipped_receiver_takes(self):
        line = self.plug_in()
        self.assertEqual(line.received[:40], FILLER + FLAG)
        ping = line.wait_for_ping()
        self.assertEqual(line.received[39:], FLAG + ping + FLAG)
        self.assertEqual(receiver_sum(ping), 0xFF)
        body = unescaped(ping)
        self.assertEqual(len(body), PING_SIZE + 1)
        timestamp1, timestamp2 = struct.unpack_from("<II", body, 4)
        self.assertLess((rospy.Time.now().to_nsec() // 1_000_000 - timestamp1) % 2 ** 32, 5000)
        self.assertEqual(timestamp2, 0)

    def test_every_frame_of_the_capture_becomes_its_message(self):
        stream, frames = read_capture()
        self.assertEqual(len(frames), 795)
        line = self.plug_in(answers=False)
        marks = {cmd: topic.mark() for cmd, topic in self.topics.items()}
        for start in range(0, len(stream), CHUNK):
            line.send(stream[start: start + CHUNK])
            whole = sum(frame["end"] < start + CHUNK for frame in frames)
            eventually(lambda: sum(topic.mark() - marks[cmd] for cmd, topic in self.topics.items()) >= whole,
                       f"messages of {whole} frames")
        for cmd, count in ((2, 101), (6, 218), (7, 445), (9, 31)):
            expected = [fields_of_frame(frame) for frame in frames if frame["cmd"] == cmd]
            self.assertEqual(len(expected), count)
            self.assertEqual([fields_of_message(message) for message in self.topics[cmd].since(marks[cmd])], expected)

    def test_pings_come_once_a_second(self):
        line = self.plug_in()

        def attempt():
            mark = line.mark()
            first_s, second_s = (line.ping_after(mark + index).at_s for index in range(2))
            self.assertAlmostEqual(second_s - first_s, 1.0, delta=0.1)
        retried(attempt)
        self.assertEqual(line.received.count(FILLER), 1)

    def test_the_ping_after_an_unanswered_one_comes_behind_the_filler(self):
        line = self.plug_in(answers=False)
        eventually(lambda: line.received.count(FILLER + FLAG + PING_HEADER) >= 3, "the filler before a ping")

    def test_services_send_their_commands(self):
        line = self.plug_in()
        for name, service_type, arguments, frame in (
                ("sonar_start", Trigger, (), SONAR_START), ("sonar_stop", Trigger, (), SONAR_STOP),
                ("wheel_reset", Trigger, (), WHEEL_RESET), ("get_counters", Trigger, (), GET_COUNTERS),
                ("set_sonar_sequence", SetSonarSequence, ([0, 1, 5],), SEQUENCE_015),
                ("set_sonar_sequence", SetSonarSequence, (range(6),), SEQUENCE_ALL),
                ("set_sonar_wait", SetSonarWait, (50,), WAIT_50_MS)):
            with self.subTest(name):
                mark = line.mark()
                response = self.call(name, service_type, *arguments)
                self.assertTrue(response.success, response.message)
                line.wait_for_frame(frame, mark)
        self.assertIn(bytes.fromhex("7e" + SONAR_START + "7e" + "7e" + SONAR_STOP + "7e"), line.received)

    def test_bad_arguments_are_refused_with_the_reason_and_nothing_is_sent(self):
        line = self.plug_in()
        mark = line.mark()
        for name, service_type, argument, reason in (
                ("set_sonar_sequence", SetSonarSequence, [0, 6], "there is no sonar 6: ids go from 0 to 5"),
                ("set_sonar_sequence", SetSonarSequence, [-1], "there is no sonar -1: ids go from 0 to 5"),
                ("set_sonar_sequence", SetSonarSequence, [], "a sonar sequence has 1 to 24 entries, not 0"),
                ("set_sonar_sequence", SetSonarSequence, [0] * 25, "a sonar sequence has 1 to 24 entries, not 25"),
                ("set_sonar_wait", SetSonarWait, -1, "a sonar wait is 0 to 2147483647 ms, not -1"),
                ("set_sonar_wait", SetSonarWait, 2 ** 31, "a sonar wait is 0 to 2147483647 ms, not 2147483648")):
            with self.subTest(reason):
                response = self.call(name, service_type, argument)
                self.assertEqual((response.success, response.message), (False, reason))
        self.assertTrue(self.call("set_sonar_wait", SetSonarWait, 50).success)
        line.wait_for_frame(WAIT_50_MS, mark)
        commands = [frame for frame in line.frames(mark) if not is_ping(frame)]
        self.assertEqual(commands, [WAIT_50_MS])

    def test_counters_asked_for_twice_within_a_second_are_refused_once(self):
        self.plug_in()
        eventually(lambda: self.call("get_counters", Trigger).success, "counters that may be asked for")
        response = self.call("get_counters", Trigger)
        self.assertFalse(response.success)
        self.assertIn("asked less than a second ago", response.message)

    def test_ping_service_waits_for_its_pong(self):
        line = self.plug_in()
        response = self.call("ping", Trigger)
        self.assertTrue(response.success, response.message)
        self.assertRegex(response.message, r"^pong after \d+\.\d ms$")
        line.answers = False
        response = self.call("ping", Trigger)
        self.assertEqual((response.success, response.message), (False, "no pong came back"))

    def test_ping_service_says_so_when_the_port_is_lost_while_it_waits(self):
        line = self.plug_in(answers=False)
        mark = line.mark()
        answers = []
        caller = threading.Thread(target=lambda: answers.append(self.call("ping", Trigger)))
        caller.start()
        line.wait_for_ping(mark)
        line.pull_out()
        caller.join(PATIENCE_S)
        self.assertFalse(answers[0].success)
        self.assertRegex(answers[0].message, "no pong came back|the port was lost|the port is not open")

    def test_megabytes_without_a_flag_do_no_harm(self):
        stream, frames = read_capture()
        line = self.plug_in()
        flagless = bytes(byte for byte in range(256) if byte != FLAG[0])
        before_kb = self.memory_kb()
        line.send((flagless * (FLAGLESS_BYTES // len(flagless) + 1))[:FLAGLESS_BYTES])
        mark = self.sonars.mark()
        line.send(FLAG + b"".join(stream[frame["start"]: frame["end"] + 1] for frame in frames[:50]))
        expected = [fields_of_frame(frame) for frame in frames[:50] if frame["cmd"] == 6]
        self.assertEqual([fields_of_message(message) for message in self.sonars.wait_for_count(len(expected), mark)],
                         expected)
        self.assertLess(self.memory_kb() - before_kb, MOST_GROWTH_KB)

    @staticmethod
    def memory_kb():
        """The hub's resident memory."""
        uri = rosnode.get_api_uri(rosgraph.Master(rospy.get_name()), "/teensy_sensor_hub")
        _, _, pid = ServerProxy(uri).getPid(rospy.get_name())
        with open(f"/proc/{pid}/status", encoding="ascii") as file:
            return int(re.search(r"VmRSS:\s+(\d+) kB", file.read()).group(1))

    def test_a_port_that_goes_and_comes_back_under_its_name_is_opened_again(self):
        self.plug_in().pull_out()
        response = self.call("sonar_stop", Trigger)
        eventually(lambda: not self.call("sonar_stop", Trigger).success, "a hub that knows of the loss")
        response = self.call("sonar_stop", Trigger)
        self.assertEqual((response.success, response.message), (False, "the Teensy's port is not open"))
        line = self.plug_in()
        self.assertEqual(line.received[:40], FILLER + FLAG)
        mark = self.sonars.mark()
        line.send(frame_from_teensy(bytes.fromhex("01020600" + "0200" + "1027" + "01000000")))
        message = self.sonars.wait_for(lambda _: True, mark).what
        self.assertEqual(fields_of_message(message), (2, 10000, 1))


class HubByItself(unittest.TestCase):
    def setUp(self):
        directory = tempfile.TemporaryDirectory()
        self.addCleanup(directory.cleanup)
        self.directory = directory.name
        self.port = os.path.join(self.directory, "teensy")

    def plug_in(self):
        line = Line(self.port)
        self.addCleanup(line.pull_out)
        return line

    def terminal(self, *command):
        terminal = Terminal(*command)
        self.addCleanup(terminal.clean_up)
        return terminal

    def start(self, name, *arguments):
        return start_node(self, "teensy_sensor_hub", f"_port:={self.port}", *arguments, name=name)

    def test_a_second_hub_on_the_port_is_refused_and_gets_it_when_the_first_ends(self):
        line = self.plug_in()
        first = self.start("first")
        line.opened()
        second = self.start("second")
        second.wait_for_line(f"WARN.*Teensy on {self.port}: another program has it open.*fuser -v {self.port}")
        pings = line.mark()
        self.assertEqual(first.end(), 0)
        second.wait_for_info("the Teensy's port is open")
        line.wait_for_ping(pings)
        self.assertEqual(second.end(signal.SIGTERM), 0)
        self.assertEqual(len(second.stderr.since()), 1, second.stderr.since())

    def test_the_last_report_before_a_silence_is_told_though_it_came_too_soon(self):
        stream, frames = read_capture()
        wheels = [frame for frame in frames if frame["cmd"] == 7]
        # A pulse of the left wheel alone, and not one of the first two, whose direction the firmware doesn't know.
        before, after = next((one, other) for one, other in zip(wheels, wheels[1:])
                             if one["left"]["dist_abs"] > 2 and one["left"]["dist_abs"] < other["left"]["dist_abs"]
                             and one["right"] == other["right"] and other["left"]["direction"] == 0)
        stood, rolled = [stream[frame["start"]:frame["end"] + 1] for frame in (before, after)]
        line = self.plug_in()
        self.start("silent", "__ns:=silent", "_odom_rate:=5")
        clock = Topic("/silent/teensy_clock", TeensyClock).connected()
        joints = Topic("/silent/joint_states", JointState).connected()
        # Before the first tick there is no odometry. Later pongs contradict it: this line's tick stands still.
        clock.wait_for(lambda sync: True)
        line.send(stood + rolled)
        first, last = joints.wait_for_count(2)
        self.assertGreater(last.position[0], first.position[0])
        self.assertEqual(last.position[1], first.position[1])

    def test_a_port_that_cannot_be_one_is_told_in_one_line_and_the_hub_goes_on(self):
        file = os.path.join(self.directory, "file")
        with open(file, "wb"):
            pass
        cases = [
            ("missing", os.path.join(self.directory, "none"), "there is no such port. .*ls /dev/serial/by-id"),
            ("directory", self.directory, "this is a directory, not a serial port. .*ls /dev/serial/by-id"),
            ("file", file, "this is not a serial port. .*ls /dev/serial/by-id"),
        ]
        started = [(*case, start_node(self, "teensy_sensor_hub", f"_port:={case[1]}", name=case[0])) for case in cases]
        for name, path, pattern, process in started:
            with self.subTest(name):
                process.wait_for_line(f"WARN.*Teensy on {path}: {pattern}.* Trying again")
                rospy.wait_for_service(f"/{name}/sonar_start", PATIENCE_S)
                response = rospy.ServiceProxy(f"/{name}/sonar_start", Trigger)()
                self.assertEqual((response.success, response.message), (False, "the Teensy's port is not open"))
        for name, _, _, process in started:
            with self.subTest(name):
                self.assertEqual(process.end(), 0)
                self.assertEqual(len(process.stderr.since()), 1, process.stderr.since())

    def test_what_it_cannot_work_with_ends_it_with_one_line(self):
        cases = [
            ("checksum", "_firmware_checksum:=right",
             "firmware_checksum is 'right'; accepted: one of auto, shipped, corrected"),
            ("period", "_ping_period:=0", "ping_period is 0; accepted: a number from 0.01 to 3600"),
            ("unknown", "_bauds:=9600", "unknown parameter bauds is 9600; accepted: only base_frame, baud,"),
            ("required", "_required:=true", f"Teensy on {self.port}: there is no such port"),
        ]
        started = [(name, pattern, self.start(name, argument)) for name, argument, pattern in cases]
        for name, pattern, process in started:
            with self.subTest(name):
                self.assertEqual(process.wait_for_exit(), 1)
                lines = process.stderr.since()
                self.assertEqual(len(lines), 1, lines)
                self.assertRegex(lines[0], f"FATAL.*: {pattern}")

    def test_keys_on_a_terminal_of_its_own_send_their_commands_and_q_restores_it(self):
        line = self.plug_in()
        terminal = self.terminal("rosrun", "car_interface", "teensy_sensor_hub", f"_port:={self.port}",
                                 "_ping_period:=60",
                                 "__name:=with_keys")
        terminal.wait_for_line("keys: P ping, S sonar start")
        line.opened()
        self.assertNotEqual(terminal.settings(), terminal.settings_before)
        for key, frame in (("S", SONAR_START), ("N", SONAR_STOP), ("R", WHEEL_RESET), ("C", GET_COUNTERS),
                           ("X", SEQUENCE_015), ("Y", SEQUENCE_ALL), ("s", SONAR_START)):
            with self.subTest(key):
                mark = line.mark()
                terminal.type(key.encode())
                line.wait_for_frame(frame, mark)
        mark = line.mark()
        terminal.type(b"P")
        ping = line.wait_for_ping(mark)
        self.assertEqual((len(unescaped(ping)), receiver_sum(ping)), (PING_SIZE + 1, 0xFF))
        mark = line.mark()
        terminal.type(b"NRX")
        line.wait_for_frame(SEQUENCE_015, mark)
        self.assertEqual(line.frames(mark), [SONAR_STOP, WHEEL_RESET, SEQUENCE_015])
        terminal.type(b"Q")
        self.assertEqual(terminal.wait_for_exit(), 0)
        self.assertEqual(terminal.settings(), terminal.settings_before)

    def test_control_c_on_a_terminal_of_its_own_restores_it(self):
        terminal = self.terminal("rosrun", "car_interface", "teensy_sensor_hub", f"_port:={self.port}", "__name:=ended")
        terminal.wait_for_line("keys: P ping, S sonar start")
        terminal.type(b"\x03")
        self.assertEqual(terminal.wait_for_exit(), 0)
        self.assertEqual(terminal.settings(), terminal.settings_before)

    def test_under_roslaunch_the_terminal_is_left_alone(self):
        line = self.plug_in()
        terminal = self.terminal("roslaunch", "car_interface", "teensy_sensor_hub.launch", "ns:=launched",
                                 f"port:={self.port}")
        line.opened()
        mark = line.mark()
        terminal.type(b"SNRCXYSNRCXY")
        rospy.ServiceProxy("/launched/teensy_sensor_hub/set_sonar_wait", SetSonarWait)(50)
        line.wait_for_frame(WAIT_50_MS, mark)
        commands = [frame for frame in line.frames(mark) if not frame.startswith(PING_HEADER.hex())]
        self.assertEqual(commands, [WAIT_50_MS])
        self.assertEqual(terminal.settings(), terminal.settings_before)
        terminal.type(b"\x03")
        self.assertEqual(terminal.wait_for_exit(), 0)
        self.assertEqual(terminal.settings(), terminal.settings_before)


if __name__ == "__main__":
    rospy.init_node("teensy_sensor_hub_test")
    rostest.rosrun("car_interface", "teensy_sensor_hub_test", "__main__")
