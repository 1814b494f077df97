"""The Teensy's end of the cable in the hands of a test: it takes apart what the hub sends, and sends bytes.

Frames are made and read here from the protocol alone, not by the package's own encoder.
"""
from __future__ import annotations

import re
import struct

from car import Terminal
from graph import START_NS, Graph

PORT = "/dev/ttyAMA0"
FLAG = b"\x7e"
FILLER = bytes(39)
PING_HEADER = bytes.fromhex("02010100")
PING_SIZE = 4 + 8 + 1  # header, timestamp1, timestamp2, checksum
UPTIME_MS = 5000


def frame(body: bytes) -> bytes:
    """Frame a body as the firmware does: flags, one's-complement sum with carry, escapes."""
    total = sum(body)
    while total > 0xFF:
        total = (total & 0xFF) + (total >> 8)
    body += bytes((0xFF - total,))
    return FLAG + body.replace(b"\x7d", b"\x7d\x5d").replace(b"\x7e", b"\x7d\x5e") + FLAG


def sonar(sensor: int, echo_us: int, tick_ms: int) -> bytes:
    return frame(b"\x01\x02\x06\x00" + bytes((sensor, 0)) + echo_us.to_bytes(2, "little")
                 + tick_ms.to_bytes(4, "little"))


def wheels(pulses: tuple[int, int], ticks_ms: tuple[int, int], speed: int = 50, direction: int = 0) -> bytes:
    """A report of the wheels: their pulses so far, never backward, and when the last ones were."""
    return frame(b"\x01\x02\x07\x00" + b"".join(
        struct.pack("<HBBIII", speed, direction, 0, tick_ms, min(count, 1), count)
        for count, tick_ms in zip(pulses, ticks_ms)))


def unescaped(on_wire: bytes) -> bytes:
    return re.sub(b"\x7d(.)", lambda match: bytes((match.group(1)[0] ^ 0x20,)), on_wire, flags=re.DOTALL)


class Teensy(Terminal):
    """The Teensy's end of a car's cable, which sends a pong for each ping unless ``answers`` is false.

    Attributes:
        written: all that the hub has sent.
        pings: (time in ns, ping without flags) of each.
        commands: likewise of what is no ping, the command in hex.
    """

    def __init__(self, graph: Graph, cable, answers: bool = True):
        super().__init__(cable, PORT)
        self._graph, self.answers = graph, answers
        self.written = bytearray()
        self.pings: list[tuple[int, bytes]] = []
        self.commands: list[tuple[int, str]] = []
        self._rest = b""

    @property
    def tick_ms(self) -> int:
        return (self._graph.now_ns - START_NS) // 1_000_000 + UPTIME_MS

    def take(self, data: bytes) -> None:
        self.written += data
        *segments, self._rest = (self._rest + data).split(FLAG)
        for segment in segments:
            body = unescaped(segment)
            if body.startswith(PING_HEADER) and len(body) == PING_SIZE:
                self.pings.append((self._graph.now_ns, segment))
                self.pinged(body[4:8])
            elif segment.strip(b"\0"):
                self.commands.append((self._graph.now_ns, segment.hex()))

    def pinged(self, timestamp1: bytes) -> None:
        if self.answers:
            self.write(self.pong(timestamp1))

    def pong(self, timestamp1: bytes) -> bytes:
        return frame(b"\x01\x02\x02\x00" + timestamp1 + self.tick_ms.to_bytes(4, "little"))
