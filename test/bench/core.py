"""Speed of decode, encode, lookup and decisions, each in a fresh interpreter by speed.py."""
from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Iterator

from set_up import find_pythons

from .effort import Effort
from .rows import MEDIAN, P99, Row, Summary, Target
from .stage import Stage

ROOT = Path(__file__).resolve().parents[2]
LOOKUPS = {11: (0.55, "0.68"), 100: (0.85, "15.9"), 1000: (2.2, "1054")}  # µs: to reach, and Autoware's C++
PYTHON38 = find_pythons([(3, 8)]).get((3, 8))


def samples(python: str, *arguments) -> dict:
    run = subprocess.run([python, str(ROOT / "test/bench/speed.py"), *map(str, arguments)], check=True,
                         stdout=subprocess.PIPE, env={**os.environ, "PYTHONPATH": str(ROOT / "src")})
    return json.loads(run.stdout)


def measure_decode(effort: Effort, stage: Stage) -> Iterator[Row]:
    """Measure on this Python, and on 3.8 beside it, if there is one; each read of 4 KB is a sample."""
    for python in (sys.executable, *([PYTHON38] if PYTHON38 and sys.version_info[:2] != (3, 8) else [])):
        result = samples(python, "decode", effort.decode_passes)
        name, is_judged = f"decode, Python {result['python']}", python == sys.executable
        yield Row("decode", f"{name}: 20 MB in 4 KB reads", "MB/s", Summary.of(result["mb_per_s"], True),
                  (Target(MEDIAN, low=25, original="3.1"),) if is_judged else (Target(),))
        yield Row("decode", f"{name}: a frame", "µs", Summary.of(result["us_per_frame"]),
                  (Target(MEDIAN, high=1.15, original="9.3"), Target(P99)) if is_judged else (Target(),))


def measure_encode(effort: Effort, stage: Stage) -> Iterator[Row]:
    result = samples(sys.executable, "encode", effort.calls)
    yield Row("encode", "encode: a ping's frame", "µs", Summary.of(result["us"]), (Target(high=4), Target(P99)),
              note="a sample is the mean of 500 calls")


def measure_lookup(effort: Effort, stage: Stage) -> Iterator[Row]:
    for size, (bound_us, original) in LOOKUPS.items():
        result = samples(sys.executable, "lookup", effort.calls, size)
        yield Row("lookup", f"lookup: {size}×{size}", "µs", Summary.of(result["us"]),
                  (Target(high=bound_us, original=original), Target(P99)), note="a sample is the mean of 500 calls")


def measure_decide(effort: Effort, stage: Stage) -> Iterator[Row]:
    """Measure what limits cost that are not reached: a decision with them and without, in turns."""
    for node, kind in (("turn_arb", "decide_steering"), ("throttle_arb", "decide_throttle")):
        result = samples(sys.executable, kind, effort.calls // 500)
        yield Row("decide", f"decide: {node} without limits", "µs", Summary.of(result["off"]),
                  note="the planner drives; a sample is one decision after other programs used the CPU's caches")
        yield Row("decide", f"decide: {node} below its limits, more", "µs", Summary.of(result["more"]),
                  (Target(high=50),))
