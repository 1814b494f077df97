"""Damages the bytes on a serial line: silence, noise, another baud rate, cuts, a flood.

Random numbers come from a seed.
"""
from __future__ import annotations

import math
import random

from car_interface.common.errors import require
from car_interface.common.units import NS_PER_S

MAX_S = 3600
MAX_LOST = 1_000_000
FLOOD_PER_S = 1_000_000  # bytes
MAX_FLOOD = 8192  # at once, after a pause of the simulator's
TO_HOST, TO_TEENSY = 0, 1
# Faults that last: nothing reaches the host; each side receives at half the baud rate of the other; random bytes follow
# the Teensy's.
LASTING = SILENCE, SCRAMBLE, FLOOD = "silence", "scramble", "flood"


class BadLine:
    """The line between the Teensy and the host, with faults that can be switched on."""

    def __init__(self, seed: int):
        self._random = random.Random(seed)
        self._noise = (BitErrors(seed), BitErrors(seed + 1))
        self._receivers = (SlowReceiver(), SlowReceiver())
        self._until_ns = dict.fromkeys(LASTING, 0)
        self._flooded_ns = 0  # until when the flood has been sent
        self._to_lose = 0

    def begin(self, fault: str, duration_s: float, now_ns: int) -> None:
        """Begin one of ``LASTING``; a duration of 0 ends it."""
        require(0 <= duration_s <= MAX_S, fault, duration_s, f"0 to {MAX_S} s")
        self._until_ns[fault] = now_ns + round(duration_s * NS_PER_S)
        if fault == SCRAMBLE:
            self._receivers = (SlowReceiver(), SlowReceiver())
        elif fault == FLOOD:
            self._flooded_ns = now_ns

    def cut(self, count: float) -> None:
        """Lose the next ``count`` bytes to the host."""
        require(0 <= count <= MAX_LOST and count % 1 == 0, "cut", count, f"a whole number from 0 to {MAX_LOST}")
        self._to_lose = int(count)

    def bit_errors(self, rate: float) -> None:
        """Set the ratio of wrong bits in both directions."""
        for noise in self._noise:
            noise.set_rate(rate)

    def to_host(self, data: bytes, now_ns: int) -> bytes:
        """Return what arrives at the host of the bytes that the Teensy sent since the last call."""
        if now_ns < self._until_ns[SILENCE]:
            data = b""
        data, self._to_lose = data[self._to_lose:], max(0, self._to_lose - len(data))
        return self._carry(TO_HOST, data, now_ns) + self._flood(now_ns)

    def to_teensy(self, data: bytes, now_ns: int) -> bytes:
        """Return what arrives at the Teensy of the host's bytes."""
        return self._carry(TO_TEENSY, data, now_ns)

    def _carry(self, direction, data, now_ns):
        if now_ns < self._until_ns[SCRAMBLE]:
            data = self._receivers[direction].receive(data)
        return self._noise[direction].flip(data)

    def _flood(self, now_ns):
        until_ns = min(now_ns, self._until_ns[FLOOD])
        count = (until_ns - self._flooded_ns) * FLOOD_PER_S // NS_PER_S
        if count <= 0:
            return b""
        self._flooded_ns = until_ns
        count = min(count, MAX_FLOOD)
        return self._random.getrandbits(8 * count).to_bytes(count, "little")


class BitErrors:
    """Flips bits at random, independently of each other."""

    def __init__(self, seed: int):
        self._random = random.Random(seed)
        self._rate = 0.0
        self._next = 0  # bits until the next wrong one

    def set_rate(self, rate: float) -> None:
        """Set the ratio of flipped bits; 0 = none.

        Raises:
            ConfigError: it isn't a ratio up to a half, which leaves no information.
        """
        require(0 <= rate <= 0.5, "bit_errors", rate, "0 to 0.5")
        self._rate = rate
        if rate:
            self._next = self._gap()

    def flip(self, data: bytes) -> bytes:
        """Return the bytes as they arrive."""
        if not self._rate:
            return data
        noisy = bytearray(data)
        while self._next < 8 * len(data):
            noisy[self._next // 8] ^= 1 << self._next % 8
            self._next += 1 + self._gap()
        self._next -= 8 * len(data)
        return bytes(noisy)

    def _gap(self):
        """Return the number of right bits before the next wrong one: geometric, by the exponential distribution."""
        return int(self._random.expovariate(-math.log1p(-self._rate)))


class SlowReceiver:
    """A UART with a wrong baud rate, half of the sender's.

    It takes a falling edge for a start bit and samples the line once in two of the sender's bits. A byte without its
    stop bit is a framing error; Linux returns a 0 for it.
    """

    def __init__(self):
        self._line = ""  # the bits that haven't been sampled, a 1 = idle

    def receive(self, data: bytes) -> bytes:
        """Return what it receives of bytes that follow each other without a pause."""
        # On the line a byte is a start bit 0, the byte from its least bit on, and a stop bit 1.
        self._line += "".join(f"0{f'{byte:08b}'[::-1]}1" for byte in data)
        received = bytearray()
        start = self._line.find("0")
        while 0 <= start <= len(self._line) - 20:
            bits = self._line[start + 1: start + 20: 2]  # start bit, eight bits, stop bit, each sampled in its middle
            is_start = bits[0] == "0"
            if is_start:
                received.append(int(bits[8:0:-1], 2) if bits[9] == "1" else 0)
            start = self._line.find("0", start + (20 if is_start else 1))
        self._line = self._line[start:] if start >= 0 else ""
        return bytes(received)
