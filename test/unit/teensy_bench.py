"""A simulated Teensy on a bench, for the tests of its parts; parser and encoders for its line.

Those are written from the protocol's description alone and are shared with nothing.
"""
import json
import struct
from collections import namedtuple
from pathlib import Path

from car_interface.sim.teensy_firmware import FirmwareConfig, TeensyFirmware
from car_interface.sim.teensy_sensors import LEFT
from car_interface.sim.teensy_uart import COUNTER_NAMES, PacketPool, Receiver

MS, S = 1_000_000, 1_000_000_000
PING, PONG, SET_SEQ, START, SONAR, WHEELS, GET_COUNTERS, WAIT = 1, 2, 3, 5, 6, 7, 10, 12

DATA = Path(__file__).resolve().parents[1] / "data"
CAPTURE = (DATA / "capture_mixed.bin").read_bytes()
CAPTURED = [json.loads(line) for line in (DATA / "capture_mixed.jsonl").read_text().splitlines()]

Wheel = namedtuple("Wheel", "speed direction reserved when dist dist_abs")
Sonar = namedtuple("Sonar", "sensor filler echo_us when")


def unstuffed(data):
    plain, escaped = bytearray(), False
    for byte in data:
        if byte == 0x7D:
            escaped = True
        else:
            plain.append(byte ^ 0x20 if escaped else byte)
            escaped = False
    return bytes(plain)


def ones_complement_sum(data):
    total = sum(data)
    while total > 0xFF:
        total = (total & 0xFF) + (total >> 8)
    return total


def split_frames(data):
    """Bytes → unescaped frames without their checksums; empty ones and the boot frame left out."""
    found = [frame for frame in map(unstuffed, data.split(b"\x7e")[1:-1]) if len(frame) >= 5]
    assert all(ones_complement_sum(frame) == 0xFF for frame in found)
    return [frame[:-1] for frame in found]


def parse_wheels(frame):
    return Wheel(*struct.unpack_from("<HBBIII", frame, 4)), Wheel(*struct.unpack_from("<HBBIII", frame, 20))


def parse_sonar(frame):
    return Sonar(*struct.unpack_from("<BBHI", frame, 4))


def parse_counter(frame):
    assert frame[-1] == 0 and 0 not in frame[8:-1]
    return frame[8:-1].decode("ascii"), struct.unpack_from("<I", frame, 4)[0]


def stuffed(data):
    return b"".join(bytes([0x7D, byte ^ 0x20]) if byte in (0x7D, 0x7E) else bytes([byte]) for byte in data)


def framed_for_the_receiver(message):
    """The receiver's own checksum: 7e, stuffed message, checksum, 7e."""
    for reserved in (stuffed(message[3:4]), b"\x7d\x20"):
        wire = stuffed(message[:3]) + reserved + stuffed(message[4:])
        checksum = 0xFF - sum(byte for byte in wire if byte != 0x7D) % 256
        if checksum not in (0x7D, 0x7E):
            break
    return b"\x7e" + wire + bytes([checksum]) + b"\x7e"


def framed_by_the_textbook(message):
    return b"\x7e" + stuffed(message + bytes([0xFF - ones_complement_sum(message)])) + b"\x7e"


def message(command, payload=b"", dst=2):
    return bytes([dst, 1, command, 0]) + payload


def ping(timestamp1):
    return message(PING, struct.pack("<II", timestamp1, 0))


def received(wire, corrected=False):
    """What a receiver alone makes of ``wire``: the packets that it accepts, and its counters."""
    counters = dict.fromkeys(COUNTER_NAMES, 0)
    pool = PacketPool(None)
    receiver = Receiver(pool.acquire, counters, corrected)
    accepted = []
    for byte in wire:
        packet = receiver.byte(byte)
        if packet is not None:
            accepted.append(bytes(packet))
            pool.release(packet)
    return accepted, counters


GOOD = framed_for_the_receiver(message(GET_COUNTERS))


class Bench:
    """A Teensy on a table: pass time, write to it, read what it sends."""

    def __init__(self, echo_us=None, **config):
        self.teensy = TeensyFirmware(FirmwareConfig(**config), echo_us)
        self.now_ns = 0
        self.sent = b""

    def until(self, at_ns):
        self.now_ns = max(at_ns, self.now_ns)
        self.sent += self.teensy.transmit(self.now_ns)
        return self

    def after(self, span_ns):
        return self.until(self.now_ns + span_ns)

    def write(self, wire):
        self.teensy.receive(wire, self.now_ns)
        return self

    def command(self, command, payload=b""):
        return self.write(framed_for_the_receiver(message(command, payload)))

    def roll(self, side, direction, pulses, every_ns):
        for _ in range(pulses):
            self.until(self.now_ns + every_ns)
            self.teensy.wheel_pulse(side, direction, self.now_ns)
        return self

    def frames(self, command):
        return [frame for frame in split_frames(self.sent) if frame[2] == command]


def wheel_reports(bench, side=LEFT):
    return [parse_wheels(frame)[side] for frame in bench.frames(WHEELS)]
