#!/usr/bin/env python3
"""Captures of the original firmware at their recorded pace, through ptys, into real hubs: what comes out is true.

All of them are played at the same time, each to a hub of its own. The bytes are the firmware's, but its pongs: those
answered another host. Here the hubs' own pings are answered, with the tick that the Teensy's clock had in the capture.
"""
from __future__ import annotations

import math
import os
import pty
import re
import select
import sys
import tempfile
import time
import tty
import unittest
from bisect import bisect_left

import rospkg
import rospy
import rostest
from car_interface.msg import Distance, LinkStatus, TeensyClock, Wheel
from nav_msgs.msg import Odometry
from sensor_msgs.msg import JointState, Range
from tf2_msgs.msg import TFMessage

sys.path.append(os.path.join(rospkg.RosPack().get_path("car_interface"), "test", "unit"))
from captures import load
from waiting import Topic, eventually, start_node
from witness import LATE_S

QUICK = {"stop_go": None, "reboot_rolling": None, "far_young": None, "wrap": None, "drive_reverse": 25.0}
WHOLE = dict.fromkeys((*QUICK, "far", "missing_sonars", "stuck_sonar", "stuck_old", "sonar_start", "line_busy",
                       "drive"))
PLAYED = WHOLE if os.environ.get("CAR_INTERFACE_ALL") else QUICK  # name: seconds, None = all of it
SONARS = ("front_right", "front_middle", "front_left", "rear_right", "rear_middle", "rear_left")
FLAG = b"\x7e"
PONG_BODY = re.compile(rb"(?<=\x7e)\x01\x02\x02\x00[^\x7e]*(?=\x7e)")
PING_HEADER = bytes.fromhex("02010100")
PING_SIZE = 4 + 8


class Player:
    """One capture's Teensy: its bytes at their times, and pongs for whoever pings it."""

    def __init__(self, name, path, seconds):
        self.name, self.path = name, path
        self.capture = load(name)
        self.end_us = self.capture.duration_us if seconds is None else round(seconds * 1e6)
        self.truth_us = [row.t_us for row in self.capture.truth]
        self.chunks = [(t_us, data) for t_us, data in self.capture.chunks() if t_us <= self.end_us]
        self.reboots_us = [event["t_us"] for event in self.capture.events if event["event"] == "reboot"]
        self.begin_s = 0.0
        self.pongs = self.pings = 0
        self.latest_s = 0.0  # how much too late a byte was written, at the worst
        self._master, slave = pty.openpty()
        tty.setraw(slave)
        os.set_blocking(self._master, False)
        os.symlink(os.ttyname(slave), path)
        self._sent = b""  # by the hub
        self._waiting = []  # timestamp1 of pings that wait for a gap between frames
        self._between = True
        # A pong of the capture's own host leaves its flags behind: an empty frame.
        whole = b"".join(data for _, data in self.chunks)
        self._kept = bytearray(b"\x01" * len(whole))
        for pong in PONG_BODY.finditer(whole):
            self._kept[pong.start():pong.end()] = bytes(pong.end() - pong.start())
        self._place = self._next = 0

    def fileno(self):
        return self._master

    @property
    def due_s(self):
        """When the next bytes are to be written; inf at the end."""
        return self.begin_s + self.chunks[self._next][0] / 1e6 if self._next < len(self.chunks) else math.inf

    def read(self):
        """Take what the hub sends."""
        try:
            self._sent += os.read(self._master, 4096)
        except (BlockingIOError, OSError):
            return
        *frames, self._sent = self._sent.split(FLAG)
        for frame in frames:
            body = re.sub(b"\x7d(.)", lambda match: bytes((match.group(1)[0] ^ 0x20,)), frame, flags=re.DOTALL)
            if body.startswith(PING_HEADER) and len(body) == PING_SIZE + 1:
                self.pings += 1
                self._waiting.append(body[4:8])

    def is_open(self):
        """Whether a hub has opened the port, and pings."""
        self.read()
        return self.pings > 0

    def write(self, now_s):
        """Write what is due."""
        while self.due_s <= now_s:
            self.latest_s = max(self.latest_s, now_s - self.due_s)
            t_us, data = self.chunks[self._next]
            self._next += 1
            out = bytearray()
            for byte in data:
                if self._kept[self._place]:
                    out.append(byte)
                self._place += 1
                if byte == FLAG[0] and self._waiting and not self._is_off(t_us):
                    out += b"".join(self._pong(timestamp1, t_us) for timestamp1 in self._waiting)
                    self._waiting.clear()
            try:
                os.write(self._master, bytes(out))
            except BlockingIOError:
                pass  # the hub doesn't read; that is its fault to be found

    def _is_off(self, t_us):
        return any(reboot_us <= t_us < reboot_us + 300_000 for reboot_us in self.reboots_us)

    def _pong(self, timestamp1, t_us):
        """As the firmware frames it: flags, one's-complement sum with carry, escapes."""
        self.pongs += 1
        body = b"\x01\x02\x02\x00" + timestamp1 + int(self.millis(t_us)).to_bytes(4, "little")
        total = sum(body)
        while total > 0xFF:
            total = (total & 0xFF) + (total >> 8)
        body += bytes((0xFF - total,))
        return FLAG + body.replace(b"\x7d", b"\x7d\x5d").replace(b"\x7e", b"\x7d\x5e") + FLAG

    def millis(self, t_us):
        """The Teensy's clock: from the nearest row of the truth, for it wraps and begins anew between rows."""
        row = self.capture.truth[max(0, bisect_left(self.truth_us, t_us) - 1)]
        return (row.millis + (t_us - row.t_us) / 1000) % 2 ** 32


class Outputs:
    """What one hub publishes."""

    def __init__(self, name):
        self.odom = Topic(f"/{name}/odom", Odometry)
        self.wheels = Topic(f"/{name}/teensy_wheel", Wheel)
        self.distances = Topic(f"/{name}/teensy_distance", Distance)
        self.clock = Topic(f"/{name}/teensy_clock", TeensyClock)
        self.joints = Topic(f"/{name}/joint_states", JointState)
        self.link = Topic(f"/{name}/teensy_sensor_hub/link", LinkStatus)
        self.ranges = {sonar: Topic(f"/{name}/sonar/{sonar}", Range) for sonar in SONARS}

    def connected(self):
        for topic in (self.odom, self.wheels, self.distances, self.clock, self.joints, self.link,
                      *self.ranges.values()):
            topic.connected()


class CapturesTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        # What is needed of a TestCase to start nodes; they end with the class.
        cls.owner = unittest.TestCase()
        folder = tempfile.TemporaryDirectory()
        cls.owner.addCleanup(folder.cleanup)
        cls.players = {name: Player(name, f"{folder.name}/{name}", seconds) for name, seconds in PLAYED.items()}
        cls.outputs = {name: Outputs(name) for name in cls.players}
        cls.tf = Topic("/tf", TFMessage)
        for name, player in cls.players.items():
            start_node(cls.owner, "teensy_sensor_hub", f"__ns:={name}", f"_port:={player.path}", "_odom_rate:=0",
                       f"_frame_prefix:={name}/", "_sonar_restart:=0")
        for outputs in cls.outputs.values():
            outputs.connected()
        # A hub throws away what arrived before it opened its port; then it pings.
        eventually(lambda: all(player.is_open() for player in cls.players.values()), "hubs that have opened their port")
        cls.ros_s = rospy.Time.now().to_sec() - time.monotonic()
        cls.play()
        for name, player in cls.players.items():
            last = [frame for frame in player.capture.frames if frame["frame"] == "wheel"
                    and frame["t_us"] <= player.end_us - 50_000 and not frame.get("cut")][-1]
            eventually(lambda name=name, last=last: any(
                message.left.when == last["left"]["when"] for message in cls.outputs[name].wheels.since()[-20:]),
                f"the last report of {name}")

    @classmethod
    def tearDownClass(cls):
        cls.owner.doCleanups()

    @classmethod
    def play(cls):
        """All captures, from now on."""
        players = list(cls.players.values())
        begin_s = time.monotonic() + 0.2
        for player in players:
            player.begin_s = begin_s
        while any(player.due_s < math.inf for player in players):
            due_s = min(player.due_s for player in players)
            for player in select.select(players, [], [], max(0.0, due_s - time.monotonic()))[0]:
                player.read()
            for player in players:
                player.write(time.monotonic())

    def for_each(self, check):
        for name, player in self.players.items():
            with self.subTest(name):
                check(player, self.outputs[name])

    def truth_at(self, player, stamp):
        """Where the car was at a ROS time."""
        return player.capture.truth_at((stamp.to_sec() - self.ros_s - player.begin_s) * 1e6)

    def test_each_frame_is_published_as_the_firmware_meant_it(self):
        def check(player, outputs):
            frames = [frame for frame in player.capture.frames if not frame.get("cut")
                      and frame["t_us"] < player.end_us - 100_000]
            sent = [tuple(frame[side][field] for side in ("left", "right")
                          for field in ("speed", "direction", "when", "dist", "dist_abs"))
                    for frame in frames if frame["frame"] == "wheel"]
            got = [(one.speed, one.direction, one.when, one.dist, one.dist_abs,
                    other.speed, other.direction, other.when, other.dist, other.dist_abs)
                   for one, other in ((message.left, message.right) for message in outputs.wheels.since())]
            self.assertEqual(got[:len(sent)], sent)
            echoes = [(frame["sensor"], frame["distance"], frame["when"]) for frame in frames
                      if frame["frame"] == "sonar"]
            self.assertEqual([(message.sensor, message.distance, message.when)
                              for message in outputs.distances.since()][:len(echoes)], echoes)
        self.for_each(check)

    def test_pings_are_answered_and_no_frame_is_corrupt(self):
        def check(player, outputs):
            status = outputs.link.since()[-1]
            self.assertGreater(player.pongs, player.end_us / 1e6 / 3)
            # A machine that is busy with other things answers some pings later than a hub waits for a pong.
            late = player.pongs // 4 if player.latest_s > LATE_S else 0
            self.assertGreaterEqual(status.pongs, player.pongs - 2 - late)
            self.assertLessEqual(status.bad_frames, len(player.reboots_us))
        self.for_each(check)

    def test_odometry_goes_on_while_frames_come(self):
        def check(player, outputs):
            times_s = [heard.at_s for heard in outputs.odom.heard_since()]
            begin_s = player.begin_s
            for before_s, after_s in zip(times_s, times_s[1:]):
                is_reboot = any(before_s - 1 < begin_s + reboot_us / 1e6 <= after_s for reboot_us in player.reboots_us)
                self.assertLessEqual(after_s - before_s, (1.0 if is_reboot else 0.5) + player.latest_s + 0.1)
            self.assertLess(begin_s + player.end_us / 1e6 - times_s[-1], 0.6)
        self.for_each(check)

    def test_car_is_where_it_is(self):
        def check(player, outputs):
            odoms = outputs.odom.since()
            start, end = (self.truth_at(player, odoms[index].header.stamp) for index in (0, -1))
            cos, sin = math.cos(start.yaw_rad), math.sin(start.yaw_rad)
            dx, dy = end.x_m - start.x_m, end.y_m - start.y_m
            position = odoms[-1].pose.pose.position
            off_m = math.hypot(position.x - (cos * dx + sin * dy), position.y - (cos * dy - sin * dx))
            # How long the Teensy was away the hub knows by its bytes' arrival only: what came late adds to that,
            # and on such a machine the hub reads it about as late.
            late_m = 3.0 * player.latest_s * len(player.reboots_us)
            self.assertLessEqual(off_m, max(0.04, 0.005 * player.capture.distance_m()) + late_m)
            orientation = odoms[-1].pose.pose.orientation
            yaw = 2 * math.atan2(orientation.z, orientation.w) - (end.yaw_rad - start.yaw_rad)
            self.assertLessEqual(abs(math.degrees(math.remainder(yaw, 2 * math.pi))), 3.0)
        self.for_each(check)

    def test_stamps_rise_strictly(self):
        def check(player, outputs):
            topics = [outputs.odom, outputs.joints, *outputs.ranges.values()]
            stamps = [[message.header.stamp for message in topic.since()] for topic in topics]
            stamps.append([message.stamp for message in outputs.clock.since()])
            stamps.append([transform.header.stamp for message in self.tf.since() for transform in message.transforms
                           if transform.child_frame_id == f"{player.name}/base_link"])
            self.assertGreater(min(map(len, stamps[:2] + stamps[-2:])), 10)
            for one in stamps:
                self.assertTrue(all(earlier < later for earlier, later in zip(one, one[1:])))
        self.for_each(check)

    def test_ranges_are_true(self):
        def check(player, outputs):
            for sensor, sonar in enumerate(SONARS):
                for heard in outputs.ranges[sonar].heard_since():
                    stamp_us = (heard.what.header.stamp.to_sec() - self.ros_s - player.begin_s) * 1e6
                    pulses_us = {pulse_us for at_us, of, pulse_us in player.capture.echoes
                                 if of == sensor and abs(at_us - stamp_us) < 500_000}
                    nothing = not pulses_us or None in pulses_us
                    truths_m = {pulse_us * 1e-6 * 343.42 / 2 for pulse_us in pulses_us if pulse_us}
                    if math.isinf(heard.what.range):
                        self.assertTrue(nothing or max(truths_m) > 2.0, (sonar, pulses_us))
                    else:
                        self.assertTrue(any(abs(heard.what.range - truth_m) < 1e-3 for truth_m in truths_m),
                                        (sonar, heard.what.range, truths_m))
        self.for_each(check)


if __name__ == "__main__":
    rospy.init_node("captures_test")
    rostest.rosrun("car_interface", "captures_test", CapturesTest)
