"""The simulated Teensy against captures of the original firmware: same wheels, echoes and commands in, same frames out.

Fed to it are the captures' pins at power-up, wheels' pulses, echoes, commands and losses of power, each at its time,
with their uptime and a clock that is 25 ppm fast. Out come the captures' frames in their order, all of them, but:

- A pulse's time is interpolated between positions 20 or 50 ms apart, to some 0.1 ms: ``when`` may be 1 ms off, and the
  speed by that share. Where both wheels' pulses are that close to each other, or to the 5 ms that a report waits, it
  isn't determined in which report one comes: ``undetermined``.
- Echoes begin at times known to 1 µs: ±2 µs in an echo, 1 ms in its tick. Its filler byte isn't compared.
- ``line_busy``: which of several waiting reports is next hangs on all the bytes since the line was last idle. Numbers
  are held instead of the order.
"""

import math
import struct
from collections import Counter, deque
from dataclasses import dataclass
from functools import lru_cache

import pytest

import teensy_bench
from captures import load
from car_interface.sim.teensy_firmware import FirmwareConfig, TeensyFirmware
from car_interface.sim.teensy_sensors import BACKWARD, FORWARD, LEFT, RIGHT, SONAR_MISSING, SONAR_STUCK
from teensy_bench import framed_for_the_receiver, ones_complement_sum, parse_counter, parse_sonar, parse_wheels

pytestmark = pytest.mark.once
MS, US = 1_000_000, 1_000
BYTE_NS = 10 * 1_000_000_000 / 115200
UINT32 = 0xFFFFFFFF
PULSE_M = math.pi * 0.095 / 20
COMMANDS = {"ping": 1, "sonar_start": 5, "get_counters": 10, "sonar_wait": 12}
FRAMES = ("wheel", "sonar", "pong", "counter")
WHEEL_FIELDS = ("speed", "direction", "when", "dist", "dist_abs")


@dataclass(frozen=True)
class Capture:
    """How a capture began, and how much of it is not determined."""

    name: str
    pass_us: float  # when the loop passed first, modulo 250 µs
    undetermined: int = 0  # frames that may differ
    # When the Teensy is switched on: of a capture that begins in a stream one repeat of standing wheels before it,
    first_us: float = 0.0
    lead_us: float = 0.0  # and its first sonar hears such an echo, for the next one to ping when the captured one did.
    config: tuple = ()
    missing: tuple = ()  # the sensors that are not connected
    odometer_start: int = 0  # what its wheels have counted forward before

    @property
    def captured(self):
        return load(self.name)

    @property
    def frames(self):
        return [fields_of(line) for line in self.captured.frames if not line.get("cut")]

    def at_ns(self, t_us):
        """A captured time, moved so that the loop passes at whole multiples of its period."""
        return round((t_us - self.pass_us) * US)


POWERED_UP = [
    Capture("stop_go", 15, undetermined=2),
    Capture("reboot_rolling", 221),
    Capture("missing_sonars", 145.6, missing=(0,)),
    Capture("stuck_sonar", 54),
    Capture("sonar_start", 191),
    Capture("drive_reverse", 196.4, undetermined=60),
]
STREAMS = [
    Capture("far", 0, 2, first_us=-96476.174, lead_us=75834.1,
            config=(("clock_start_ms", 206407), ("sonar_sequence", (3, 4, 5, 0, 1, 2)))),
    Capture("far_young", 0, first_us=-97349.174, lead_us=75834.1,
            config=(("clock_start_ms", 4907), ("sonar_sequence", (3, 4, 5, 0, 1, 2)))),
    Capture("stuck_old", 0, first_us=-199839.099, lead_us=173831.6,
            config=(("clock_start_ms", 184804), ("sonar_sequence", (5, 0, 1, 2, 3, 4)))),
    Capture("wrap", 0, first_us=-97670.549, lead_us=83833.9, odometer_start=2**32 - 300,
            config=(("clock_start_ms", 4294956502), ("sonar_sequence", (4, 5, 0, 1, 2, 3)))),
]
BUSY = Capture("line_busy", 114)


def fields_of(line):
    kind = line["frame"]
    if kind == "wheel":
        return kind, *([line[side][name] for name in WHEEL_FIELDS] for side in ("left", "right"))
    if kind == "sonar":
        return kind, line["sensor"], line["distance"], line["when"]
    if kind == "pong":
        return kind, line["timestamp1"], line["timestamp2"]
    return "counter", line["name"], line["count"]


def pulses_of(truth):
    """(µs, side, direction) of each pulse: a whole number crossed, by the cubic through positions and speeds."""
    found = []
    for begin, end in zip(truth, truth[1:]):
        span_us = end.t_us - begin.t_us
        before, after = (begin.left_pulses, begin.right_pulses), (end.left_pulses, end.right_pulses)
        steps = [there - here for here, there in zip(before, after)]
        mean = sum(steps) / 2
        for side in (LEFT, RIGHT):
            start, step = before[side], steps[side]
            share = step / mean if mean else 1.0
            slopes = [mps / PULSE_M * span_us * 1e-6 * share for mps in (begin.speed_mps, end.speed_mps)]
            if abs(sum(slopes) / 2 - step) > 0.2 * abs(step) + 0.05:
                slopes = [step, step]  # it began or stopped in between

            def position(u, start=start, step=step, slopes=slopes):
                cubed, squared = u**3, u**2
                return (start + step * (3 * squared - 2 * cubed) + slopes[0] * (cubed - 2 * squared + u)
                        + slopes[1] * (cubed - squared))

            first, last = math.floor(start), math.floor(after[side])
            crossed = range(first + 1, last + 1) if last > first else range(first, last, -1)
            for whole in crossed:
                low, high = 0.0, 1.0
                for _ in range(30):
                    middle = (low + high) / 2
                    if (position(middle) < whole) == (step > 0):
                        low = middle
                    else:
                        high = middle
                found.append((begin.t_us + high * span_us, side, FORWARD if step > 0 else BACKWARD))
    return sorted(found)


def command(line):
    """A command as the captures' host framed it: with the receiver's own checksum."""
    payload = (struct.pack("<II", line["timestamp1"], 0) if "timestamp1" in line else
               struct.pack("<I", line["ms"]) if "ms" in line else b"")
    return framed_for_the_receiver(teensy_bench.message(COMMANDS[line["host"]], payload))


def parsed(frame):
    if frame[2] == teensy_bench.WHEELS:
        return ("wheel", *([wheel.speed, wheel.direction, wheel.when, wheel.dist, wheel.dist_abs]
                           for wheel in parse_wheels(frame)))
    if frame[2] == teensy_bench.SONAR:
        sonar = parse_sonar(frame)
        return "sonar", sonar.sensor, sonar.echo_us, sonar.when
    if frame[2] == teensy_bench.PONG:
        return ("pong", *struct.unpack_from("<II", frame, 4))
    return ("counter", *parse_counter(frame))


class Replay:
    """A capture's inputs, fed to a simulated Teensy until the last frame; and what that sent since the first."""

    def __init__(self, capture):
        self.capture, captured = capture, capture.captured
        config = FirmwareConfig(
            clock_drift_ppm=25, loop_us=250, sonar_pulse_end_us=1_000_000, **dict(capture.config),
            wheel_positions=(math.floor(captured.truth[0].left_pulses), math.floor(captured.truth[0].right_pulses)))
        self._echoes = deque((sensor, pulse_us) for _, sensor, pulse_us in captured.echoes if pulse_us is not None)
        if capture.lead_us:
            self._echoes.appendleft((config.sonar_sequence[0], capture.lead_us))
        self.wrong_sensors = []  # pings with another one than in the capture
        begin_ns = capture.at_ns(capture.first_us)
        self.teensy = TeensyFirmware(config, self._echo_us, begin_ns)
        for sensor in capture.missing:
            self.teensy.set_sonar(sensor, SONAR_MISSING, begin_ns - 1)
        for wheel in self.teensy._axle.wheels if capture.odometer_start else ():
            wheel._dist = wheel._dist_abs = capture.odometer_start
            wheel._direction = FORWARD
        self.teensy.transmit(capture.at_ns(0))
        self.sent = b""
        for at_ns, act in self._acts(captured):
            self.sent += self.teensy.transmit(at_ns)
            act(at_ns)
        end_us = captured.frames[-1]["t_us"]
        self.sent += self.teensy.transmit(capture.at_ns(end_us) + 4 * MS)
        self.frames = [parsed(frame[:-1]) for frame in map(teensy_bench.unstuffed, self.sent.split(b"\x7e"))
                       if len(frame) >= 5 and ones_complement_sum(frame) == 0xFF]

    def _echo_us(self, sensor, at_ns):
        if not self._echoes:
            return 1000
        wanted, pulse_us = self._echoes.popleft()
        if sensor != wanted:
            self.wrong_sensors.append((at_ns, sensor, wanted))
        return pulse_us

    def _acts(self, captured):
        teensy, at = self.teensy, self.capture.at_ns
        acts = []
        for at_us, side, direction in pulses_of(captured.truth):
            act = lambda at_ns, side=side, direction=direction: teensy.wheel_pulse(side, direction, at_ns)  # noqa: E731
            acts.append((at(at_us), act))
        filler = bytes(39) if self.capture in POWERED_UP or self.capture == BUSY else b""
        for line in captured.commands:
            # The capture says when the frame was accepted: its last byte had come since the pass before.
            wire, filler = filler + command(line), b""
            began_ns = at(line["t_us"]) - round(len(wire) * BYTE_NS) - 120 * US
            acts.append((began_ns, lambda at_ns, wire=wire: teensy.receive(wire, at_ns)))
        for off_us in times_of(captured, "reboot"):
            boot_us = min(up_us for up_us in times_of(captured, "power up") if up_us > off_us) - 300_000
            off_ns = round((boot_us - off_us) * US)
            acts.append((at(off_us), lambda at_ns, off_ns=off_ns: teensy.reboot(at_ns, off_ns)))
        for at_us, sensor, _ in [echo for echo in captured.echoes if echo[2] is None][:1]:
            acts.append((at(at_us) - MS, lambda at_ns, sensor=sensor: teensy.set_sonar(sensor, SONAR_STUCK, at_ns)))
        return sorted(acts, key=lambda act: act[0])


def times_of(captured, event):
    return [line["t_us"] for line in captured.events if line["event"] == event]


def key(frame):
    """What of a frame is determined exactly."""
    kind, *fields = frame
    if kind == "wheel":
        return kind, [(direction, dist, dist_abs) for _, direction, _, dist, dist_abs in fields]
    return kind, fields[0]


def aligned(expected, sent):
    """Pairs of frames with the same key, in order → (pairs of indices, how many frames have no partner)."""
    pairs, i, j = [], 0, 0
    while i < len(expected) and j < len(sent):
        skips = [(left, right) for left in range(4) for right in range(4)]
        for left, right in sorted(skips, key=sum):
            there = i + left < len(expected) and j + right < len(sent)
            if there and key(expected[i + left]) == key(sent[j + right]):
                i, j = i + left, j + right
                pairs.append((i, j))
                break
        i, j = i + 1, j + 1
    return pairs, len(expected) + len(sent) - 2 * len(pairs)


def ahead_ms(tick, of_tick):
    return (tick - of_tick + (1 << 31) & UINT32) - (1 << 31)


def assert_alike(expected, sent):
    """The fields that have a tolerance, where two frames have the same key."""
    kind, *wanted = expected
    _, *got = sent
    if kind == "wheel":
        for (speed, _, when, _, _), (sent_speed, _, sent_when, _, _) in zip(wanted, got):
            assert abs(ahead_ms(sent_when, when)) <= 1, (expected, sent)
            assert abs(sent_speed - speed) <= 2, (expected, sent)
    elif kind == "sonar":
        assert abs(got[1] - wanted[1]) <= 2 and abs(ahead_ms(got[2], wanted[2])) <= 1, (expected, sent)
    elif kind == "pong" or wanted[0] in ("rxErrorDropped", "rxBytes", "rxPackets"):
        assert got == wanted
    else:
        assert abs(got[1] - wanted[1]) <= max(3, 2e-4 * wanted[1]), (expected, sent)


@lru_cache(maxsize=None)
def replayed(capture):
    return Replay(capture)


every_capture = pytest.mark.parametrize("capture", POWERED_UP + STREAMS, ids=lambda capture: capture.name)


@every_capture
def test_same_inputs_give_the_captured_frames_in_their_order(capture):
    expected, replay = capture.frames, replayed(capture)
    pairs, alone = aligned(expected, replay.frames)
    assert replay.wrong_sensors == []
    assert alone <= capture.undetermined
    assert len(pairs) >= 90
    for i, j in pairs:
        assert_alike(expected[i], replay.frames[j])


def test_frame_that_a_restart_cuts_leaves_the_captured_part_of_it():
    capture = next(capture for capture in POWERED_UP if capture.name == "reboot_rolling")
    boots = replayed(capture).sent.split(bytes.fromhex("7ec13e7e"))[1:]
    sent = [capture.captured.sent_by(off_us + 1000) for off_us in times_of(capture.captured, "reboot")]
    parts = [each[each.rindex(b"\x7e"):] for each in sent]
    assert len(parts) == len(boots) - 1 == 3
    for part, before in zip(parts, boots):
        assert before.endswith(part)


def test_busiest_line_carries_as_many_reports_of_each_kind_and_drops_as_many():
    frames, sent_frames = BUSY.frames, Replay(BUSY).frames
    counts, sent_counts = (Counter(frame[0] for frame in each) for each in (frames, sent_frames))
    assert set(sent_counts) == set(counts) == set(FRAMES)
    for kind, count in counts.items():
        assert sent_counts[kind] == pytest.approx(count, rel=0.01), kind
    counters, sent_counters = ({fields[0]: fields[1] for kind, *fields in each if kind == "counter"}
                               for each in (frames, sent_frames))
    assert list(sent_counters) == list(counters)
    for name, count in counters.items():
        assert sent_counters[name] == pytest.approx(count, rel=0.33 if name == "txInfoSonarDrop" else 0.05), name
