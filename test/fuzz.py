#!/usr/bin/env python3
"""Fuzzing of what the serial line can bring: decoder, protocol and gates, seeded with the golden capture.

    PYTHONPATH=src python3 test/fuzz.py --cases 1000000

Each case is a piece of the capture, changed: bytes lost, doubled, inserted, changed, pieces swapped or cut; or bytes at
random; read in pieces of random sizes. After each the tally must add up, the decoder must hold no more than a frame,
and the next whole frame must come out. Prints how many cases, frames and records there were, and how memory grew; a
case that fails is printed with its number, which with the seed makes it again.
"""
from __future__ import annotations

import argparse
import gc
import random
import sys
import time
import tracemalloc
from collections import Counter
from pathlib import Path

from car_interface.teensy.link.framing import MAX_ON_LINE, FrameDecoder
from car_interface.teensy.link.protocol import Malformed, Pong, SonarStatus, WheelStatus, decode
from car_interface.teensy.sensing.plausibility import Gates

CAPTURE = (Path(__file__).resolve().parent / "data" / "capture_mixed.bin").read_bytes()
SPECIAL = (0x7E, 0x7D, 0x5E, 0x5D, 0x00, 0xFF, 0x20)
# From the capture: a sonar's report, and what its body says.
MARKER = bytes.fromhex("7e 01020600 006b11057b0000 f9 7e")
MARKER_BODY = MARKER[1:-2]
MAX_GROWTH = 50_000  # bytes over a run of any length; a leak of a byte per case shows in the long one


def piece(choose: random.Random) -> bytearray:
    """Some bytes of the capture."""
    start = choose.randrange(len(CAPTURE))
    return bytearray(CAPTURE[start:start + choose.choice((1, 5, 20, 40, 80, 200))])


def mutated(choose: random.Random) -> bytes:
    """One case."""
    kind = choose.random()
    if kind < 0.05:
        return bytes(choose.choices(SPECIAL, k=choose.randrange(300)))
    if kind < 0.1:
        return choose.getrandbits(8 * 120).to_bytes(120, "little")[:choose.randrange(121)]
    data = piece(choose)
    for _ in range(choose.choice((0, 1, 1, 2, 4, 8))):
        place = choose.randrange(len(data) + 1)
        change = choose.randrange(6)
        if change == 0:
            data[place:place + 1] = b""
        elif change == 1:
            data[place:place] = bytes((choose.choice(SPECIAL) if choose.random() < 0.5 else choose.randrange(256),))
        elif change == 2 and place < len(data):
            data[place] ^= 1 << choose.randrange(8)
        elif change == 3 and place < len(data):
            data[place] = choose.choice(SPECIAL)
        elif change == 4:
            data[place:place] = piece(choose)[:40]
        else:
            del data[place:place + choose.randrange(40)]
    return bytes(data)


class Fuzz:
    """One decoder, and gates behind it, that live through all cases."""

    def __init__(self, seed: int):
        self._seed = seed
        self._decoder = FrameDecoder()
        self._gates = Gates()
        self.records: Counter = Counter()
        self.cases = 0

    def case(self, number: int) -> None:
        """Run a case.

        Raises:
            AssertionError: when something is wrong.
        """
        choose = random.Random(self._seed * 1_000_003 + number)
        data, decoder = mutated(choose), self._decoder
        size = choose.choice((1, 3, 7, 64, 4096))
        for start in range(0, len(data), size):
            self._judge(decoder.feed(data[start:start + size]))
        assert decoder.pending <= MAX_ON_LINE
        tally = decoder.tally
        assert tally.bytes_in == tally.frame_bytes + tally.flags + tally.noise_bytes + decoder.pending
        if choose.random() < 0.02:
            decoder.reset()
        found = decoder.feed(MARKER)
        self._judge(found)
        assert found[-1] == MARKER_BODY
        self.cases += 1

    def _judge(self, bodies):
        gates = self._gates
        for body in bodies:
            record = decode(body)
            self.records[type(record).__name__] += 1
            if isinstance(record, Malformed):
                assert record.reason
            elif isinstance(record, WheelStatus):
                gates.wheels(record)
            elif isinstance(record, SonarStatus):
                gates.sonar(record)
            elif isinstance(record, Pong):
                gates.pong(record, is_ours=True)


def main() -> int:
    """Run the cases, and say what came of them."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--cases", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    fuzz = Fuzz(arguments.seed)
    begun_s = time.monotonic()
    warm = min(1000, arguments.cases)
    number = 0
    try:
        while number < warm:
            fuzz.case(number)
            number += 1
        gc.collect()
        tracemalloc.start()
        before, _ = tracemalloc.get_traced_memory()
        while number < arguments.cases:
            fuzz.case(number)
            number += 1
        gc.collect()
        growth = tracemalloc.get_traced_memory()[0] - before
    except Exception as error:
        print(f"case {number} of seed {arguments.seed}: {type(error).__name__}: {error}")
        print(mutated(random.Random(arguments.seed * 1_000_003 + number)).hex())
        return 1
    records = ", ".join(f"{count:,} {name}" for name, count in fuzz.records.most_common())
    print(f"{fuzz.cases:,} cases in {time.monotonic() - begun_s:.0f} s; {records}; memory grew by {growth:,} bytes")
    return growth > MAX_GROWTH


if __name__ == "__main__":
    sys.exit(main())
