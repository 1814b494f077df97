#!/usr/bin/env python3
"""Measures the core's speed in an interpreter of its own and prints the samples as JSON.

    PYTHONPATH=src python3 test/bench/speed.py decode PASSES    (or encode CALLS, lookup CALLS SIZE, decide_… CALLS)
"""
from __future__ import annotations

import json
import platform
import random
import sys
from pathlib import Path
from time import perf_counter_ns

from car_interface.common.units import NS_PER_S
from car_interface.steering.arbiter import PLANNER, SteeringArbiter, SteeringArbiterConfig
from car_interface.steering.config import load_steering
from car_interface.steering.limits import SourceLimits, SteeringLimits
from car_interface.teensy.link import framing, protocol
from car_interface.teensy.link.framing import FrameDecoder
from car_interface.throttle.arbiter import ThrottleArbiterConfig
from car_interface.throttle.calibration import ThrottleCalibration
from car_interface.throttle.control import ThrottleControl
from car_interface.throttle.esc_config import EscConfig
from car_interface.throttle.limits import DriveLimits, ThrottleLimits
from car_interface.throttle.value_map import ValueMap, load_value_map

CAPTURE = Path(__file__).resolve().parents[1] / "data" / "capture_mixed.bin"
CONFIG = Path(__file__).resolve().parents[2] / "config"
FRAMES = 795  # in the capture
TOTAL_BYTES, READ_BYTES = 20_000_000, 4096
BATCH = 500  # calls between two readings of the clock
NOW_NS = NS_PER_S // 2
FILL_BYTES = 24_000_000


def decode(passes: int) -> dict:
    """Decode every frame to a typed record; return MB/s and µs per frame of each read of 4 KB."""
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
    costs = []
    for start in range(0, len(arguments), BATCH):
        batch = arguments[start:start + BATCH]
        begun_ns = perf_counter_ns()
        for argument in batch:
            call(*argument)
        costs.append((perf_counter_ns() - begun_ns) / 1e3 / len(batch))
    return costs


def encode(calls: int) -> dict:
    numbers = random.Random(1)
    stamps = [(numbers.randrange(protocol.UINT32),) for _ in range(calls)]
    return {"us": per_call(lambda stamp: framing.encode(protocol.ping(stamp)), stamps)}


def value_map(size: int) -> ValueMap:
    """Return a map with values −5 to 3 and velocities 0 to 20 m/s, whose slope differs everywhere."""
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
    numbers = random.Random(1)
    wanted = [(numbers.uniform(-9, 4), numbers.uniform(0, 20)) for _ in range(calls)]
    return {"us": per_call(value_map(size).value_at, wanted)}


def steering(limits: SteeringLimits) -> SteeringArbiter:
    arbiter = SteeringArbiter(load_steering(str(CONFIG / "turn_arb.yaml")), SteeringArbiterConfig(limits=limits))
    arbiter.update_human(True, NOW_NS)
    arbiter.update_teleop(0.0, NOW_NS)
    arbiter.update_planner(2.0, NOW_NS)
    arbiter.update_odometry(1.0, NOW_NS)
    return arbiter


def throttle(limits: ThrottleLimits) -> ThrottleControl:
    control = ThrottleControl(ThrottleCalibration(1, [-5.0, 0.0, 3.0], [3277, 4915, 6554], 4915),
                              ThrottleArbiterConfig(), EscConfig(arming_time_s=0.1), limits)
    for at_ns in (0, NOW_NS // 2, NOW_NS):  # neutral for the arming time, then the deadman is held
        control.arbiter.update_human(at_ns == NOW_NS, at_ns)
        control.arbiter.update_steering(PLANNER, "", at_ns)
        control.arbiter.update_teleop(0.0, at_ns)
        control.update_planner(0.5, at_ns)
        control.update_odometry(1.0, at_ns)
        control.update_turn(2.0, 2.83)
        control.decide(at_ns)
    return control


def decide(calls: int, off, on) -> dict:
    """Time single decisions of two arbiters in turns, which differ by their limits, both with the same answer.

    Before each the CPU's caches are filled with something else, as they are in a car, where other programs ran since
    the last one: it takes ten times as long as one of many in a row.
    """
    duties = [arbiter.decide(NOW_NS).duty for arbiter in (off, on)]
    if duties[0] != duties[1]:
        raise SystemExit(f"the limits are reached: {duties}")
    fill, costs_us = bytearray(FILL_BYTES), ([], [])
    for index in range(calls):
        for arbiter, costs in zip((off, on), costs_us):
            bytes(fill)
            costs.extend(per_call(arbiter.decide, [(NOW_NS + index,)]))  # a nanosecond apart: every input stays fresh
    return {"off": costs_us[0], "more": [on_us - off_us for off_us, on_us in zip(*costs_us)]}


def decide_steering(calls: int) -> dict:
    none = SourceLimits()
    return decide(calls, steering(SteeringLimits(human=none, planner=none)), steering(SteeringLimits()))


def decide_throttle(calls: int) -> dict:
    limits = DriveLimits(max_speed_mps=3.0, max_acceleration_mps2=3.0, max_braking_mps2=5.0)
    value_map = load_value_map(str(CONFIG / "value_map.csv"))
    return decide(calls, throttle(ThrottleLimits(slow_down=False)),
                  throttle(ThrottleLimits(planner=limits, value_map=value_map)))


if __name__ == "__main__":
    kinds = {kind.__name__: kind for kind in (decode, encode, lookup, decide_steering, decide_throttle)}
    samples = kinds[sys.argv[1]](*map(int, sys.argv[2:]))
    print(json.dumps({"python": platform.python_version(), **samples}))
