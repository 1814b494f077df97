"""The benchmark's command line: what to measure, the table, the file."""
from __future__ import annotations

import argparse
import json
import os
import platform
import sys
import time
import traceback
from typing import Iterator, NamedTuple

from .bus import measure_bus
from .core import measure_decode, measure_encode, measure_lookup
from .effort import FULL, QUICK, Effort
from .nodes import measure_memory, measure_start
from .one_process import measure_one_process
from .reaction import measure_chip, measure_heartbeat, measure_reaction
from .rows import Row, head, table, verdict
from .serial_line import measure_line, measure_serial
from .stage import OthersMeter, Stage
from .whole_car import measure_car

GROUPS = {"reaction": measure_reaction, "chip": measure_chip, "heartbeat": measure_heartbeat,
          "decode": measure_decode, "encode": measure_encode, "serial": measure_serial, "line": measure_line,
          "lookup": measure_lookup, "bus": measure_bus, "start": measure_start, "memory": measure_memory,
          "car": measure_car}
ON_REQUEST = {"one_process": measure_one_process}  # of an option, not of a target
WITHOUT_ROS = {"decode", "encode", "lookup"}
PACE_STEPS = 200_000
DISTURBED_PERCENT = 10  # of a core, by others, from which on delays and their p99 are theirs as well


class Course(NamedTuple):
    """How a group went."""

    group: str
    took_s: float
    others_percent: float  # of a core, used by other programs
    pace: float  # of the machine before and after it, see pace()


def read_arguments() -> argparse.Namespace:
    """What was asked for."""
    parser = argparse.ArgumentParser(
        prog="./dev bench", description="Measure everything that this package exists for, on this machine. Exit code "
        "0 = everything was measured, whether or not each target was met.")
    parser.add_argument("--quick", action="store_true",
                        help="fewer trials, one car: within a minute; too few to judge a p99")
    parser.add_argument("--only", action="append", choices=(*GROUPS, *ON_REQUEST), metavar="NAME",
                        help=f"measure this only; may be given again. One of {', '.join(GROUPS)}, or "
                        f"{', '.join(ON_REQUEST)}, which isn't measured otherwise")
    parser.add_argument("--json", metavar="FILE", default=os.environ.get("CAR_INTERFACE_BENCH_JSON"),
                        help="where to write the figures as JSON")
    return parser.parse_args()


def machine() -> dict:
    """What it was measured on."""
    with open("/proc/cpuinfo", encoding="utf-8", errors="replace") as file:
        lines = [line.partition(":") for line in file]
    models = [value.strip() for key, _, value in lines if key.strip() in ("model name", "Model")]
    return {"cpu": models[0] if models else platform.machine(), "cores": os.cpu_count(),
            "python": platform.python_version(), "kernel": platform.release(), "load_before": os.getloadavg()[0]}


def measure(names, effort: Effort) -> Iterator[tuple[list[Row], str, Course]]:
    """Each group's rows, what went wrong with it, and how it went."""
    before = pace()
    with Stage() as stage:
        for name in names:
            rows: list[Row] = []
            trouble = ""
            begun_s, others = time.monotonic(), OthersMeter()
            try:
                if name not in WITHOUT_ROS:
                    stage.open()
                rows.extend({**GROUPS, **ON_REQUEST}[name](effort, stage))
            except (Exception, SystemExit) as error:  # the other groups can still be measured
                trouble = f"{name}: {type(error).__name__}: {error}"
                traceback.print_exc()
            took_s, others_percent = time.monotonic() - begun_s, others.percent()
            after = pace()
            yield rows, trouble, Course(name, took_s, others_percent, (before + after) / 2)
            before = after


def pace() -> float:
    """How fast a fixed piece of Python runs now, in steps per second of CPU time.

    A virtual machine's neighbours take caches and clock from it, and a small computer that is hot slows down: no count
    of used time shows either.
    """
    begun_s, total = time.process_time(), 0
    for step in range(PACE_STEPS):
        total += step * step % 7
    return PACE_STEPS / (time.process_time() - begun_s)


def main() -> int:
    """Measure, print, write."""
    arguments = read_arguments()
    begun_s = time.monotonic()
    about = machine()
    print(f"{about['cpu']}, {about['cores']} cores, Python {about['python']}, Linux {about['kernel']}; "
          f"load before: {about['load_before']:.2f}\n\n{head()}", flush=True)
    rows, troubles, courses = [], [], []
    for new, trouble, course in measure(arguments.only or GROUPS, QUICK if arguments.quick else FULL):
        rows.extend(new)
        courses.append(course)
        if trouble:
            troubles.append(trouble)
        if new:
            print(table([line for row in new for line in row.lines()]), flush=True)
    print()
    for note in dict.fromkeys(f"{row.what}: {row.note}" for row in rows if row.note):
        print(f"  {note}")
    for row in rows:
        if row.void:
            print(f"  {row.what}: counts for nothing, for {row.void}")
    if any(row.summary and 1 < row.summary.samples < 100 for row in rows):
        print("  where n is below 100, p99 is the maximum")
    print(f"\n{verdict(rows)}; took {time.monotonic() - begun_s:.0f} s")
    disturbed = [f"{course.group} {course.others_percent:.0f}" for course in courses
                 if course.others_percent > DISTURBED_PERCENT]
    if disturbed:
        print(f"Other programs disturbed it, with so many % of a core: {', '.join(disturbed)}")
    print("The machine's own pace, in million steps a second of a loop that is always the same: "
          + ", ".join(f"{course.group} {course.pace / 1e6:.1f}" for course in courses))
    if arguments.json:
        write(arguments.json, about, rows, courses, arguments.quick)
        print(f"JSON: {arguments.json}")
    for trouble in troubles:
        print(f"not measured: {trouble}", file=sys.stderr)
    return 1 if troubles else 0


def write(path: str, about: dict, rows: list[Row], courses: list[Course], quick: bool) -> None:
    """The figures for a program."""
    record = {"machine": about, "date": time.strftime("%Y-%m-%dT%H:%M:%S%z"), "quick": quick,
              "groups": [course._asdict() for course in courses], "rows": [row.as_json() for row in rows]}
    with open(path, "w", encoding="utf-8") as file:
        json.dump(record, file, ensure_ascii=False, indent=1)
        file.write("\n")
