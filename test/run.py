"""Runs the tests, as ``./dev test`` does once the workspace is built and sourced.

A *step* is one command with results of its own: the unit tests on one Python (test/unit), the tests of nodes in one
process on one Python (test/graph), or one .test file with its own ROS master (test/process). Those of pytest come one
after the other, each on every CPU. The .test files mostly wait: two of them are at work beside pytest, then four.
"""
from __future__ import annotations

import argparse
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Iterable, NamedTuple
from xml.etree import ElementTree

from processes import (
    TIMEOUT_EXIT_CODE,
    adopt_descendants,
    end_descendants,
    end_of_log,
    free_port,
    interrupt,
    start,
    wait_until,
)
from tally import Tally, tally

TEST = Path(__file__).resolve().parent
ROOT = TEST.parent
# .test files at a time; with --all, whose bounds are those of a machine that does nothing else, one step.
AT_WORK, BESIDE_PYTEST = 4, 2
# Limits after which a step has hung. On two busy cores the longest .test file took 135 s, all unit tests 185 s.
PROCESS_LIMIT_S, PYTEST_LIMIT_S = 900.0, 1800.0
LONG_PYTEST_LIMIT_S = 3 * 3600.0  # with --all: 20,000 single faults and pairs alone take 45 min of a CPU
# One unit test fails after 600 s (test/conftest.py); of one that nothing interrupts the log shows where it is.
PYTEST_TRACEBACK_S = 660
ROSTEST_LIMIT_S = 60.0  # of a test without a time-limit: wiki.ros.org/roslaunch/XML/test
START_AND_END_S = 60.0  # for rostest to start its master and nodes, and to end them: 5 s on an idle machine
END_S = 15.0  # for an interrupted step to end its processes
POLL_S = 0.2
PYTEST_RAN_NOTHING = 5  # its exit code
# What drives the car is measured by its own tests: in test/unit, and in test/graph. See coverage.ini.
MEASURED_UNIT = ("interlock", "common", "steering", "throttle", "planner", "teleop", "pca9685", "teensy/link",
                 *(f"teensy/sensing/test_plausibility{part}.py" for part in ("", "_pulse_counts", "_ticks", "_wheels")))
MEASURED_GRAPH = ("brakes", "config", "gamepad_joy", "generic_value_converter", "human_first", "inbox", "live_tuning",
                  "phone_drive", "planner_interface", "teleop_logi", "throttle_arb", "turn_arb")
# On another Python only those that could differ there, without --all a sample. test/conftest.py explains the marks.
SECOND_PYTHON = ("-m", "not once and not browser")
SAMPLE = ("-m", "not once and not browser and not more", "--hypothesis-profile", "few")
# Threads of numerical libraries only compete with each other here.
PYTEST_ENVIRONMENT = {"OPENBLAS_NUM_THREADS": "1"}
# Older ones write byte code beside the tests, whatever PYTHONPYCACHEPREFIX says.
OLDEST_PYTEST_WITH_PREFIX = 6
VERSIONS = "import importlib.metadata, platform; print(platform.python_version(), importlib.metadata.version('pytest'))"


class Selection(NamedTuple):
    """The test files to run, by their folders; those of ``process`` are .test files."""

    unit: list[Path]
    graph: list[Path]
    process: list[Path]


class Step(NamedTuple):
    """One command of the tests; its name is also that of its folder of results."""

    name: str
    title: str
    command: tuple[str, ...]
    environment: dict[str, str]
    limit_s: float
    is_pytest: bool = False
    may_be_empty: bool = False  # on a second Python each of the selected tests may run once only


class Python(NamedTuple):
    """An interpreter that the tests run on.

    Attributes:
        path: of its program.
        ros_path: PYTHONPATH with ROS and the generated messages for it; empty = it has none, and runs no nodes.
        is_second: it runs only what could differ there.
    """

    path: str
    ros_path: str
    is_second: bool


def select(names: Iterable[str]) -> Selection:
    """Return the test files whose name contains one of the names, all of them without names.

    Raises:
        ValueError: no test file's name contains one of the names.
    """
    everything = Selection(sorted((TEST / "unit").rglob("test_*.py")), sorted((TEST / "graph").glob("test_*.py")),
                           sorted((TEST / "process").glob("*.test"), key=lambda path: (-time_limit_s(path), path.name)))
    for name in names:
        if not any(name in path.name for paths in everything for path in paths):
            raise ValueError(f"no test file has {name} in its name: see test/unit, test/graph and test/process/*.test")
    return Selection(*([path for path in paths if not names or any(name in path.name for name in names)]
                       for paths in everything))


def time_limit_s(path: Path) -> float:
    """Return the limit of a .test file: the sum of its tests' own."""
    tests = ElementTree.parse(str(path)).iter("test")
    return START_AND_END_S + sum(float(test.get("time-limit", ROSTEST_LIMIT_S)) for test in tests)


def pytest_step(results: Path, title: str, python: Python, files: list[Path], python_path: str, is_all: bool) -> Step:
    """Return the step of some tests by pytest on one Python, on every CPU."""
    version, pytest_version = subprocess.check_output([python.path, "-c", VERSIONS], text=True).split()
    name = title.split()[0] + (f"-{version}" if python.is_second else "")
    marks = () if not python.is_second else SECOND_PYTHON if is_all else SAMPLE
    title = f"{title}, Python {version}"
    if is_all:  # property tests take other cases each time; with the seed, the same again
        seed = random.randrange(2 ** 32)
        marks, title = (*marks, f"--hypothesis-seed={seed}"), f"{title}, seed {seed}"
    command = (python.path, "-m", "pytest", "-q", "--tb=short", "-p", "no:cacheprovider",
               "-o", f"faulthandler_timeout={PYTEST_TRACEBACK_S}", f"--junitxml={results / name / 'junit.xml'}",
               "-n", str(len(os.sched_getaffinity(0))), "--dist", "loadfile", *marks, *map(str, files))
    environment = {**PYTEST_ENVIRONMENT, "PYTHONPATH": python_path}
    if int(pytest_version.split(".")[0]) < OLDEST_PYTEST_WITH_PREFIX:
        environment["PYTHONDONTWRITEBYTECODE"] = "1"
    return Step(name, title, command, environment,
                LONG_PYTEST_LIMIT_S if is_all else PYTEST_LIMIT_S, is_pytest=True, may_be_empty=python.is_second)


def coverage_step(results: Path, python: Python) -> Step:
    """Return the step that fails unless its own tests run each line and branch of what drives the car."""
    files = [*(TEST / "unit" / name for name in MEASURED_UNIT),
             *(TEST / "graph" / f"test_{name}.py" for name in MEASURED_GRAPH)]
    command = ("sh", "-c", '"$0" -m coverage run -m pytest "$@" && "$0" -m coverage report', python.path, "-q",
               "--tb=short", "-p", "no:cacheprovider", *SECOND_PYTHON,
               f"--junitxml={results / 'coverage' / 'junit.xml'}", *map(str, files))
    environment = {"PYTHONPATH": python.ros_path, "CAR_INTERFACE_ALL": "",
                   "COVERAGE_RCFILE": str(TEST / "coverage.ini"), "COVERAGE_FILE": str(results / "coverage" / "data")}
    return Step("coverage", "coverage", command, {**PYTEST_ENVIRONMENT, **environment}, PYTEST_LIMIT_S, is_pytest=True)


def process_step(results: Path, path: Path, is_all: bool) -> Step:
    folder = results / path.name
    command = ("rostest", f"--pkgdir={ROOT}", "--package=car_interface", f"--results-base-dir={folder}", str(path))
    limit_s = time_limit_s(path) if is_all else min(time_limit_s(path), PROCESS_LIMIT_S)
    return Step(path.name, path.name, command, {"CAR_INTERFACE_TABLE": str(folder / "table")}, limit_s)


def all_steps(results: Path, pythons: list[Python], selected: Selection, is_all: bool) -> list[Step]:
    """Return the steps of a run, in the order in which they begin where there is room."""
    steps = []
    for python in pythons:
        if selected.unit:
            steps.append(pytest_step(results, "unit tests", python, selected.unit, str(ROOT / "src"), is_all))
        if selected.graph and python.ros_path:
            steps.append(pytest_step(results, "graph tests", python, selected.graph, python.ros_path, is_all))
    return steps + [process_step(results, path, is_all) for path in selected.process]


class Running(NamedTuple):
    step: Step
    process: subprocess.Popen
    begun_s: float


class Runner:
    """Runs steps side by side, and prints a line for each that ends.

    Args:
        output: folder; the results are in ``results/STEP``, the nodes' logs in ``log/test/STEP``.
        is_alone: one step at a time.
    """

    def __init__(self, output: Path, is_alone: bool):
        self.tallies: dict[str, Tally] = {}  # by step
        self._results, self._logs = output / "results", output / "log" / "test"
        self._is_alone = is_alone
        self._running: list[Running] = []

    def run(self, steps: list[Step]) -> None:
        waiting = list(steps)
        while waiting or self._running:
            for each in [each for each in self._running if each.process.poll() is not None]:
                self._running.remove(each)
                self._report(each.step, each.process.returncode, time.monotonic() - each.begun_s)
            next_step = next((step for step in waiting if self._has_room_for(step)), None)
            if next_step is not None:
                waiting.remove(next_step)
                self._begin(next_step)
            else:
                time.sleep(POLL_S)

    def _has_room_for(self, step):
        if self._is_alone:
            return not self._running
        by_pytest = sum(each.step.is_pytest for each in self._running)
        if step.is_pytest:
            return not by_pytest
        return len(self._running) - by_pytest < (BESIDE_PYTEST if by_pytest else AT_WORK)

    def _begin(self, step):
        folder = self._results / step.name
        folder.mkdir(parents=True, exist_ok=True)
        environment = {**os.environ, "ROS_LOG_DIR": str(self._logs / step.name),
                       "CAR_INTERFACE_SKIPPED": str(folder / "skipped"), **step.environment}
        with open(str(folder / "log"), "wb") as log:
            process = start(sys.executable, str(TEST / "processes.py"), "--limit", str(step.limit_s), "--left-behind",
                            str(folder / "left_behind"), *step.command, env=environment, stdin=subprocess.DEVNULL,
                            stdout=log, stderr=log)
        self._running.append(Running(step, process, time.monotonic()))

    def _report(self, step, code, took_s, why_ended=""):
        folder, logs = self._results / step.name, self._logs / step.name
        (folder / "exit_code").write_text(str(code), encoding="ascii")
        if code == TIMEOUT_EXIT_CODE:
            why_ended = f"hung: ended after {step.limit_s:.0f} s"
        if why_ended:
            (folder / "why_ended").write_text(why_ended, encoding="utf-8")
        is_empty = step.may_be_empty and code == PYTEST_RAN_NOTHING
        result = self.tallies[step.name] = Tally() if is_empty else tally(folder)
        print_line(step.title, took_s, str(result))
        if result.failures:
            print(*result.lines(), end_of_log(folder / "log", 60), sep="\n", flush=True)
            if logs.exists():
                print(f"  (the nodes' logs: {logs})", flush=True)

    def end(self) -> None:
        """End the steps that are still at work, all at once."""
        for each in self._running:
            interrupt(each.process, 0)
        wait_until(lambda: all(each.process.poll() is not None for each in self._running), END_S)
        end_descendants()

    def give_up(self, steps: Iterable[Step]) -> None:
        """End the run: what is at work, and each of the steps that has not begun, counts as failed."""
        ended = [(each, time.monotonic() - each.begun_s) for each in self._running]
        self.end()
        for each, took_s in ended:
            self._report(each.step, each.process.returncode, took_s,
                         f"ended after {took_s:.0f} s, since the whole run was ended")
        for step in steps:
            self.tallies.setdefault(step.name,
                                    Tally(failures=(f"{step.name}: not run, since the whole run was ended",)))


def print_line(title: str, took_s: float, result: str = "") -> None:
    print(f"{title:<44} {took_s:7.1f} s   {result}", flush=True)


def run(output: Path, steps: list[Step], is_alone: bool, skipped: int) -> int:
    """Run steps, print the results and their sum; return the exit code.

    SIGTERM ends the run early, as timeout(1) does in .ci/run when the run has taken too long: its results are printed,
    and what had not ended by itself counts as failed.

    Args:
        is_alone: one step at a time.
        skipped: how many Pythons could not be prepared: each counts as a skipped test.
    """
    begun_s = time.monotonic()
    runner = Runner(output, is_alone)
    try:
        runner.run(steps)
    except SystemExit as end:
        if end.code != 128 + signal.SIGTERM:
            raise
        print(f"./dev test: ended by SIGTERM after {time.monotonic() - begun_s:.0f} s", flush=True)
        runner.give_up(steps)
    finally:
        runner.end()
    print_line("all", time.monotonic() - begun_s)
    tables = "".join(path.read_text(encoding="utf-8") for path in sorted((output / "results").glob("*/table")))
    if tables:
        print(f"\nfault | at | trials | median ms | worst ms\n{tables}", end="")
    total = Tally.sum([*runner.tallies.values(), Tally(skipped=skipped)])
    print("", *total.lines(), total, sep="\n")
    return 1 if total.failures else 0


def main() -> int:
    parser = argparse.ArgumentParser(prog="./dev test", usage="%(prog)s [--all] [NAME...]", add_help=False)
    parser.add_argument("--all", action="store_true")
    parser.add_argument("--check", action="store_true")
    parser.add_argument("--output", type=Path)
    parser.add_argument("--python", action="append", default=[])
    parser.add_argument("--coverage")
    parser.add_argument("names", nargs="*")
    arguments = parser.parse_args()
    try:
        selected = select(arguments.names)
    except ValueError as error:
        parser.exit(1, f"./dev test: {error}\n")
    if arguments.check:
        return 0
    if arguments.all:
        os.environ["CAR_INTERFACE_ALL"] = "1"
        os.environ.setdefault("CAR_INTERFACE_TRIALS", "50")
    os.environ["ROS_MASTER_URI"] = f"http://127.0.0.1:{free_port()}"
    adopt_descendants()
    results = arguments.output / "results"
    os.chdir(str(results))
    first, other = (os.environ.get(name, "") for name in ("PYTHONPATH", "CAR_INTERFACE_OTHER_PYTHONPATH"))
    pythons = [Python(path, other if number else first, number > 0)
               for number, path in enumerate(arguments.python) if os.access(path, os.X_OK)]
    steps, skipped = all_steps(results, pythons, selected, arguments.all), len(arguments.python) - len(pythons)
    if arguments.coverage and not arguments.names:
        if os.access(arguments.coverage, os.X_OK):
            steps.insert(0, coverage_step(results, Python(arguments.coverage, first, False)))
        else:
            skipped += 1
    return run(arguments.output, steps, arguments.all, skipped)


if __name__ == "__main__":
    sys.exit(main())
