"""Captures of the original firmware, replayed into the hub with their times: what comes out is true.

How true, also of ranges and stamps, is in test/unit/teensy/sensing/test_captures.py. The bytes are the firmware's, but
its pongs: those answered another host. Here the hub's own pings are answered, with the tick that the Teensy's clock had
in the capture. What the host commanded then is commanded by the hub's service.
"""
from __future__ import annotations

import math
import os
import re
import sys
from bisect import bisect_left
from pathlib import Path

import pytest
from std_srvs.srv import TriggerRequest

from graph import NS_PER_S
from teensy import FLAG, Teensy

sys.path.append(str(Path(__file__).resolve().parents[1] / "unit"))
from captures import COMMAND_US, NAMES, load

SECONDS = {} if os.environ.get("CAR_INTERFACE_ALL") else {"drive": 20.0, "drive_reverse": 25.0}  # others: all of it
PONG_BODY = re.compile(rb"(?<=\x7e)\x01\x02\x02\x00[^\x7e]*(?=\x7e)")
BOOT_US = 300_000
BEGIN_S = 0.05
LINES = [(0.0, 0.0, (4096,)), (0.0004, 0.001, (4096, 5, 64))]  # delay, USB frames, sizes of reads


class Player(Teensy):
    """A capture's Teensy: its bytes at their times, and pongs for whoever pings it.

    Attributes:
        end_us: of what is played.
        pongs: how many were sent.
    """

    def __init__(self, car, name):
        super().__init__(car.graph, car.cable)
        self.capture = capture = load(name)
        self.end_us = round(SECONDS.get(name, capture.duration_us / 1e6) * 1e6)
        self.begin_ns = car.graph.now_ns + round(BEGIN_S * NS_PER_S)
        self.reboots_us = [event["t_us"] for event in capture.events if event["event"] == "reboot"]
        self.pongs = 0
        self._truth_us = [row.t_us for row in capture.truth]
        self._waiting: list[bytes] = []  # timestamp1 of pings that wait for a gap between frames
        chunks = [(t_us, data) for t_us, data in capture.chunks() if t_us <= self.end_us]
        # A pong of the capture's own host leaves its flags behind: an empty frame.
        whole = b"".join(data for _, data in chunks)
        kept = bytearray(b"\x01" * len(whole))
        for pong in PONG_BODY.finditer(whole):
            kept[pong.start():pong.end()] = bytes(pong.end() - pong.start())
        place = 0
        for t_us, data in chunks:
            part, place = bytes(byte for byte, keep in zip(data, kept[place:]) if keep), place + len(data)
            car.graph.at(self.begin_ns + 1000 * t_us, lambda t_us=t_us, part=part: self._play(t_us, part))
        for command in capture.commands:
            if command["host"] == "sonar_start":
                car.graph.at(self.begin_ns + 1000 * (command["t_us"] - COMMAND_US), self._start_sonars)

    def pinged(self, timestamp1):
        self._waiting.append(timestamp1)

    def _start_sonars(self):
        self._graph.begin_call("/teensy_sensor_hub/sonar_start", TriggerRequest())

    def _play(self, t_us, data):
        is_off = any(reboot_us <= t_us < reboot_us + BOOT_US for reboot_us in self.reboots_us)
        before, flag, after = data.partition(FLAG)
        if flag and self._waiting and not is_off:
            self.pongs += len(self._waiting)
            data = before + flag + b"".join(map(self.pong, self._waiting)) + after
            self._waiting.clear()
        self.write(data)

    @property
    def tick_ms(self):
        """From the nearest row of the truth, for the Teensy's clock wraps and begins anew between rows."""
        t_us = self.us_of(self._graph.now_ns)
        row = self.capture.truth[max(0, bisect_left(self._truth_us, t_us) - 1)]
        return int(row.millis + (t_us - row.t_us) / 1000) % 2 ** 32

    def us_of(self, at_ns):
        """The capture's time."""
        return (at_ns - self.begin_ns) / 1000

    def stamp_us(self, stamp):
        """The capture's time of a ROS time."""
        return self.us_of(stamp.to_nsec() - self._graph.ros_ahead_ns)


def check_frames(player, graph):
    """Each is published as the firmware meant it."""
    frames = [line for line in player.capture.frames if not line.get("cut") and line["t_us"] < player.end_us - 10_000]
    names = ("speed", "direction", "when", "dist", "dist_abs")
    wheels = [tuple(line[side][name] for side in ("left", "right") for name in names)
              for line in frames if line["frame"] == "wheel"]
    assert len(wheels) > 5
    assert [tuple(getattr(side, name) for side in (message.left, message.right) for name in names)
            for message in graph.messages("/teensy_wheel")][:len(wheels)] == wheels
    echoes = [(line["sensor"], line["distance"], line["when"]) for line in frames if line["frame"] == "sonar"]
    assert [(message.sensor, message.distance, message.when)
            for message in graph.messages("/teensy_distance")][:len(echoes)] == echoes


def check_link(player, graph):
    """Pings are answered, and no frame is corrupt but one that a reboot cuts."""
    link = graph.newest("/teensy_sensor_hub/link")
    assert player.pongs > player.end_us / 1e6 / 3
    assert link.pongs >= player.pongs - 2
    assert link.bad_frames <= len(player.reboots_us)


def check_place(player, graph):
    """The car is where it is."""
    odoms = graph.messages("/odom")
    start, end = (player.capture.truth_at(player.stamp_us(odoms[index].header.stamp)) for index in (0, -1))
    cos, sin = math.cos(start.yaw_rad), math.sin(start.yaw_rad)
    dx, dy = end.x_m - start.x_m, end.y_m - start.y_m
    position, orientation = odoms[-1].pose.pose.position, odoms[-1].pose.pose.orientation
    off_m = math.hypot(position.x - (cos * dx + sin * dy), position.y - (cos * dy - sin * dx))
    assert off_m <= max(0.04, 0.005 * player.capture.distance_m())
    yaw_rad = 2 * math.atan2(orientation.z, orientation.w) - (end.yaw_rad - start.yaw_rad)
    assert abs(math.degrees(math.remainder(yaw_rad, 2 * math.pi))) <= 3.0


@pytest.mark.parametrize("name, line", [(name, LINES[(index + 1) % 2]) for index, name in enumerate(NAMES)])
def test_capture_becomes_what_was_true(car, name, line):
    graph = car.graph
    car.cable.delay_s, car.cable.frame_s, car.cable.read_sizes = line
    player = Player(car, name)
    graph.record("/odom", "/teensy_wheel", "/teensy_distance", "/teensy_sensor_hub/link")
    car.hub(odom_rate=0, sonar_restart=0)
    graph.run(BEGIN_S + player.end_us / 1e6 + 0.001)
    for check in (check_frames, check_link, check_place):
        check(player, graph)
