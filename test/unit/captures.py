"""Captures of the original Teensy firmware, as test/data/firmware/README.md describes them, and how to replay them.

A replay gives a consumer what the serial line gave the host: the bytes with the times at which they had left the UART,
and the pings that the host had sent. Nothing here knows what the result should be but the capture's own truth.
"""
from __future__ import annotations

import csv
import io
import json
import math
import tarfile
from bisect import bisect_left, bisect_right
from functools import lru_cache
from pathlib import Path
from typing import Iterator, NamedTuple

from car_interface.teensy.link.framing import FrameDecoder
from car_interface.teensy.link.pinging import Answer
from car_interface.teensy.link.protocol import Pong, SonarStatus, WheelStatus, decode
from car_interface.teensy.sensing.measurements import Measurements
from car_interface.teensy.sensing.sonar_monitor import SonarMonitor

FOLDER = Path(__file__).resolve().parents[1] / "data" / "firmware"
NAMES = tuple(sorted(path.name.split(".")[0] for path in FOLDER.glob("*.tar.xz")))
NS_PER_US = 1_000
PING_BYTES = 15  # without escapes; a filler had gone before
COMMAND_US = 2_000  # from the host's write to the receiver that accepts the command
READ_DELAY_US = 300  # a host reads a pong 0.1 to 3 ms after its last byte


class Truth(NamedTuple):
    """Where the car was at ``t_us``."""

    t_us: int
    x_m: float
    y_m: float
    yaw_rad: float
    speed_mps: float
    left_pulses: float
    right_pulses: float
    millis: float


class Ping(NamedTuple):
    sent_us: int
    timestamp1: int
    received_us: int | None  # None: no pong came


class Capture:
    """One capture.

    Attributes:
        data: all bytes that left the UART.
        times: (offset, t_us): the bytes before ``offset`` had left by then.
        pings: what the host sent.
        frames: as the firmware's own structures had them.
        events: reboots, drives, changes of a sonar.
        echoes: (t_us, sensor, pulse_us or None for ever).
    """

    def __init__(self, name: str):
        self.name = name
        with tarfile.open(FOLDER / f"{name}.tar.xz") as archive:
            files = {member.name: archive.extractfile(member).read() for member in archive.getmembers()}
        self.data = files[f"{name}.bin"]
        self.times = [(int(row["offset"]), int(row["t_us"])) for row in _rows(files[f"{name}.times.csv"])]
        self.pings = [Ping(int(row["sent_us"]), int(row["timestamp1"]), int(row["received_us"] or 0) or None)
                      for row in _rows(files[f"{name}.host.csv"])]
        lines = [json.loads(line) for line in files[f"{name}.truth.jsonl"].splitlines()]
        self.frames = [line for line in lines if "frame" in line]
        self.commands = [line for line in lines if "host" in line]
        self.events = [line for line in lines if "event" in line and line["event"] != "echo"]
        self.echoes = [(line["t_us"], line["sensor"], line["pulse_us"]) for line in lines
                       if line.get("event") == "echo"]
        self._echoes_of: dict[int, list] = {}  # by sensor
        for t_us, sensor, pulse_us in self.echoes:
            self._echoes_of.setdefault(sensor, []).append((t_us, pulse_us))
        self.truth = [Truth(line["t_us"], line["x"], line["y"], line["yaw"], line["speed_mps"], line["left_pulses"],
                            line["right_pulses"], line["millis"]) for line in lines if "truth" in line]
        self._truth_us = [row.t_us for row in self.truth]
        self.duration_us = max(self.times[-1][1], self.truth[-1].t_us)

    def sent_by(self, t_us: int) -> bytes:
        """The bytes that had left the UART by then."""
        return self.data[:max((offset for offset, at_us in self.times if at_us <= t_us), default=0)]

    def chunks(self) -> Iterator[tuple[int, bytes]]:
        """The bytes with the time at which the last of them had left the UART."""
        begin = 0
        for end, t_us in self.times:
            yield t_us, self.data[begin:end]
            begin = end

    def truth_at(self, t_us: float) -> Truth:
        """Interpolated; the ends are held."""
        index = bisect_right(self._truth_us, t_us)
        if index == 0 or index == len(self.truth):
            return self.truth[max(0, index - 1)]
        before, after = self.truth[index - 1], self.truth[index]
        ratio = (t_us - before.t_us) / (after.t_us - before.t_us)
        return Truth(*(a + ratio * (b - a) for a, b in zip(before, after)))

    def distance_m(self, until_us: float = math.inf) -> float:
        """Driven, forward and backward."""
        return sum(math.hypot(b.x_m - a.x_m, b.y_m - a.y_m) for a, b in zip(self.truth, self.truth[1:])
                   if b.t_us <= until_us)

    def pulse_us(self, sensor: int, t_us: int) -> float | None:
        """How long a sonar's newest echo before then took; ``None``: its pin stays high."""
        echoes = self._echoes_of[sensor]
        return next(reversed(echoes[:bisect_left(echoes, (t_us,))]))[1]


def _rows(data):
    return csv.DictReader(io.StringIO(data.decode("ascii")))


@lru_cache(maxsize=None)
def load(name: str) -> Capture:
    """A capture, read once."""
    return Capture(name)


class Moment(NamedTuple):
    """What became of one record."""

    received_us: int
    record: object
    result: object  # what Measurements made of it, or None


def replay(capture: Capture, skip_us: int = 0, until_us: float = math.inf,
           unplugged_us: tuple[float, float] = (0, 0)) -> tuple[list[Moment], Measurements]:
    """Feed a capture's bytes to the measurements at the pace at which they came, while the host listens.

    What comes from the first to the second time of ``unplugged_us`` is lost.
    """
    measurements = Measurements()
    monitor = SonarMonitor()
    decoder = FrameDecoder()
    starts_us = [line["t_us"] - COMMAND_US for line in capture.commands if line["host"] == "sonar_start"]
    sent = {}
    pings = [ping for ping in capture.pings if ping.sent_us >= skip_us]
    moments = []
    for t_us, data in capture.chunks():
        if t_us < skip_us or unplugged_us[0] <= t_us < unplugged_us[1]:
            continue
        if t_us > until_us:
            break
        received_us = t_us + READ_DELAY_US
        while pings and pings[0].sent_us < received_us:
            ping = pings.pop(0)
            sent[ping.timestamp1] = ping
        while starts_us and starts_us[0] < received_us:
            monitor.started(starts_us.pop(0) * NS_PER_US)
        for body in decoder.feed(data):
            record = decode(body)
            result = None
            if isinstance(record, Pong):
                ping = sent.pop(record.timestamp1, None)
                answer = None if ping is None else Answer(ping.sent_us * NS_PER_US,
                                                          (received_us - ping.sent_us) * NS_PER_US, PING_BYTES)
                result = measurements.pong(record, answer, received_us * NS_PER_US)
            elif isinstance(record, SonarStatus):
                is_trusted = monitor.report(record.sensor, record.echo_us, record.when, received_us * NS_PER_US)
                result = measurements.sonar(record, received_us * NS_PER_US, is_trusted)
            elif isinstance(record, WheelStatus):
                result = measurements.wheels(record, received_us * NS_PER_US)
            moments.append(Moment(received_us, record, result))
    return moments, measurements
