"""The benchmark's command line, its table and its JSON file."""
from __future__ import annotations

import argparse
import json
import os
import platform
import sys
import time
import traceback
from typing import Iterator, NamedTuple

from .busy import measure_busy
from .effort import FULL, QUICK, Effort
from .heartbeat import measure_heartbeat
from .meters import OthersMeter
from .nodes import measure_memory, measure_start
from .one_process import measure_one_process
from .reaction import measure_chip, measure_reaction, measure_tail
from .rows import COLUMNS, WIDTHS, Row, table, verdict
from .serial_line import measure_line, measure_serial
from .stage import Stage
from .throttle import measure_throttle
from .whole_car import measure_car

GROUPS = {"reaction": measure_reaction, "chip": measure_chip, "heartbeat": measure_heartbeat,
          "throttle": measure_throttle, "serial": measure_serial, "line": measure_line, "start": measure_start,
          "memory": measure_memory, "car": measure_car}
ON_REQUEST = {"one_process": measure_one_process, "busy": measure_busy, "tail": measure_tail}
LOOP_STEPS = 200_000


class Conditions(NamedTuple):
    group: str
    took_s: float
    others_percent: float  # of a core, used by other programs
    loop_hz: float  # mean of before and after it: loop_hz()


def machine() -> dict:
    with open("/proc/cpuinfo", encoding="utf-8", errors="replace") as file:
        lines = [line.partition(":") for line in file]
    models = [value.strip() for key, _, value in lines if key.strip() in ("model name", "Model")]
    return {"cpu": models[0] if models else platform.machine(), "cores": os.cpu_count(),
            "python": platform.python_version(), "kernel": platform.release(), "load_before": os.getloadavg()[0]}


def measure(names, effort: Effort) -> Iterator[tuple[list[Row], str, Conditions]]:
    """Measure groups; yield the rows of each, the error if there was one, and the conditions."""
    before = loop_hz()
    with Stage() as stage:
        for name in names:
            rows: list[Row] = []
            error_text = ""
            begun_s, others = time.monotonic(), OthersMeter()
            try:
                stage.open()
                rows.extend({**GROUPS, **ON_REQUEST}[name](effort, stage))
            except Exception as error:  # the other groups can still be measured
                error_text = f"{name}: {type(error).__name__}: {error}"
                traceback.print_exc()
            took_s, others_percent = time.monotonic() - begun_s, others.percent()
            after = loop_hz()
            yield rows, error_text, Conditions(name, took_s, others_percent, (before + after) / 2)
            before = after


def loop_hz() -> float:
    """Return how fast a fixed loop in Python runs now, in steps per second of CPU time.

    Other virtual machines on the same computer, or heat, slow a CPU down, which CPU time does not show.
    """
    begun_s, total = time.process_time(), 0
    for step in range(LOOP_STEPS):
        total += step * step % 7
    return LOOP_STEPS / (time.process_time() - begun_s)


def read_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="./dev bench", description="Measure latency, CPU and memory of this package on this machine. Exit code 0 "
        "= everything was measured, whether or not each target was met.")
    parser.add_argument("--quick", action="store_true",
                        help="fewer trials, one car: within two minutes, too little to judge by")
    parser.add_argument("--only", action="append", choices=(*GROUPS, *ON_REQUEST), metavar="NAME",
                        help=f"measure this only; may be given again. One of {', '.join(GROUPS)}, or "
                        f"{', '.join(ON_REQUEST)}, which are not measured otherwise")
    parser.add_argument("--json", metavar="FILE", default=os.environ.get("CAR_INTERFACE_BENCH_JSON"),
                        help="where to write the figures as JSON")
    return parser.parse_args()


def main() -> int:
    arguments = read_arguments()
    begun_s = time.monotonic()
    about = machine()
    print(f"{about['cpu']}, {about['cores']} cores, Python {about['python']}, Linux {about['kernel']}; "
          f"load before: {about['load_before']:.2f}\n", flush=True)
    print(table([COLUMNS, ["-" * width for width in WIDTHS]]), flush=True)
    rows, errors, conditions = [], [], []
    for new, error, condition in measure(arguments.only or GROUPS, QUICK if arguments.quick else FULL):
        rows.extend(new)
        conditions.append(condition)
        if error:
            errors.append(error)
        if new:
            print(table([row.cells(target) for row in new for target in row.targets]), flush=True)
    print()
    for note in dict.fromkeys(f"{row.what}: {row.note}" for row in rows if row.note):
        print(f"  {note}")
    for row in rows:
        if row.void:
            print(f"  {row.what}: meets no target, since {row.void}")
    print(f"\n{verdict(rows)}; took {time.monotonic() - begun_s:.0f} s")
    disturbed = [f"{each.group} {each.others_percent:.0f}" for each in conditions if each.others_percent > 10]
    if disturbed:
        print(f"Other programs used % of a core, which lengthens latencies: {', '.join(disturbed)}")
    print("The machine's own speed, in million steps a second of a fixed loop: "
          + ", ".join(f"{each.group} {each.loop_hz / 1e6:.1f}" for each in conditions))
    if arguments.json:
        record = {"machine": about, "date": time.strftime("%Y-%m-%dT%H:%M:%S%z"), "quick": arguments.quick,
                  "groups": [each._asdict() for each in conditions], "rows": [row.as_json() for row in rows]}
        with open(arguments.json, "w", encoding="utf-8") as file:
            json.dump(record, file, ensure_ascii=False, indent=1)
        print(f"JSON: {arguments.json}")
    for error in errors:
        print(f"not measured: {error}", file=sys.stderr)
    return 1 if errors else 0
