#!/usr/bin/env python3
"""The core's speed in an interpreter of its own, so that nothing else is in its way: prints samples as JSON.

    PYTHONPATH=src python3 test/bench/speed.py decode PASSES
    PYTHONPATH=src python3 test/bench/speed.py encode CALLS
    PYTHONPATH=src python3 test/bench/speed.py lookup CALLS SIZE
"""
from __future__ import annotations

import json
import platform
import random
import sys
from pathlib import Path
from time import perf_counter_ns

from car_interface.teensy.link import framing, protocol
from car_interface.teensy.link.framing import FrameDecoder
from car_interface.throttle.value_map import ValueMap

CAPTURE = Path(__file__).resolve().parents[1] / "data" / "capture_mixed.bin"
FRAMES = 795  # in the capture
TOTAL_BYTES, READ_BYTES = 20_000_000, 4096
BATCH = 500  # calls between two looks at the clock


def decode(passes: int) -> dict:
    """For each read of 4 KB its MB/s and µs a frame; every frame becomes a typed record."""
    capture = CAPTURE.read_bytes()
    copies = -(-TOTAL_BYTES // len(capture))
    data = capture * copies
    reads = [data[start:start + READ_BYTES] for start in range(0, len(data), READ_BYTES)]
    rates, costs = [], []
    for _ in range(passes):
        decoder, frames = FrameDecoder(), 0
        for read in reads:
            begun_ns = perf_counter_ns()
            records = [protocol.decode(body) for body in decoder.feed(read)]
            took_ns = perf_counter_ns() - begun_ns
            frames += len(records)
            rates.append(1e3 * len(read) / took_ns)
            costs.append(took_ns / 1e3 / len(records))
        if frames != FRAMES * copies or decoder.tally.bad_frames:
            raise SystemExit(f"{frames} frames came out of {FRAMES * copies}")
    return {"mb_per_s": rates, "us_per_frame": costs}


def per_call(call, arguments) -> list[float]:
    """µs a call, for each batch of calls."""
    costs = []
    for start in range(0, len(arguments), BATCH):
        batch = arguments[start:start + BATCH]
        begun_ns = perf_counter_ns()
        for argument in batch:
            call(*argument)
        costs.append((perf_counter_ns() - begun_ns) / 1e3 / len(batch))
    return costs


def encode(calls: int) -> dict:
    """A ping's frame, whole: its body, checksum and escapes."""
    numbers = random.Random(1)
    stamps = [(numbers.randrange(protocol.UINT32),) for _ in range(calls)]
    return {"us": per_call(lambda stamp: framing.encode(protocol.ping(stamp)), stamps)}


def value_map(size: int) -> ValueMap:
    """Values −5 to 3, velocities 0 to 20 m/s; a rise that isn't the same anywhere."""
    numbers = random.Random(size)
    columns = []
    for _ in range(size):
        rises = [numbers.uniform(0.5, 1.5) for _ in range(size)]
        scale, level, column = 15 / sum(rises), numbers.uniform(-10.5, -9.5), []
        for rise in rises:
            level += scale * rise
            column.append(level)
        columns.append(column)
    return ValueMap([-5 + 8 * row / (size - 1) for row in range(size)],
                    [20 * column / (size - 1) for column in range(size)], list(zip(*columns)))


def lookup(calls: int, size: int) -> dict:
    """Random accelerations and velocities all over the map."""
    numbers = random.Random(1)
    wanted = [(numbers.uniform(-9, 4), numbers.uniform(0, 20)) for _ in range(calls)]
    return {"us": per_call(value_map(size).value_at, wanted)}


if __name__ == "__main__":
    kinds = {kind.__name__: kind for kind in (decode, encode, lookup)}
    samples = kinds[sys.argv[1]](*map(int, sys.argv[2:]))
    print(json.dumps({"python": platform.python_version(), **samples}))
