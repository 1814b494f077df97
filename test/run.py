"""Runs the tests, as ``./dev test`` does once the workspace is built and sourced.

A *step* is one command with results of its own: the unit tests on one Python, the tests of nodes in one process
(test/graph), or one node test with its own ROS master. Unit tests keep every CPU busy and node tests mostly wait, so
that both run side by side.
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
from typing import Callable, Iterable, NamedTuple
from xml.etree import ElementTree

from processes import (
    TIMEOUT_EXIT_CODE,
    adopt_descendants,
    descendants,
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
GRAPH_STEP = "graph"
# Node tests that measure times down to milliseconds: at most two of them run at a time, and no other node test.
TIMED = ("captures", "chain", "demo", "serial_faults", "teleop_logi", "turn_arb")
MAX_TIMED = 2
LONG = ("chain", "one_process", "fuzz", "doctor_situations")  # the longest begin first
MAX_REPEATED = 3  # more failed node tests than this have one cause: repeating them would only take time
# Limits after which a step has hung. On two busy cores the longest node test takes some 300 s, all unit tests 1500 s.
NODE_LIMIT_S, UNIT_LIMIT_S = 900.0, 2400.0
LONG_UNIT_LIMIT_S = 3600.0  # with --all
# One unit test fails after 600 s (test/unit/conftest.py); of one that nothing interrupts the log shows where it is.
PYTEST_TRACEBACK_S = 660
ROSTEST_LIMIT_S = 60.0  # of a test without a time-limit: wiki.ros.org/roslaunch/XML/test
START_AND_END_S = 60.0  # for rostest to start its master and nodes, and to end them: 5 s on an idle machine
END_S = 15.0  # for an interrupted step to end its processes
POLL_S = 0.2
# On a second Python only those that could differ there. test/unit/conftest.py explains the marks.
SECOND_PYTHON = ("-m", "not once and not browser")


class Selection(NamedTuple):
    """The test files to run; ``shared`` and ``timed`` start processes, of which the latter measure times."""

    unit: list[Path]
    graph: list[Path]
    shared: list[Path]
    timed: list[Path]


class Step(NamedTuple):
    """One command of the tests; its name is also that of its folder of results."""

    name: str
    title: str
    command: tuple[str, ...]
    environment: dict[str, str]
    limit_s: float
    is_unit: bool = False


def select(names: Iterable[str]) -> Selection:
    """Return the test files whose name contains one of the names, all of them without names.

    Raises:
        ValueError: no test file's name contains one of the names.
    """
    unit = sorted((TEST / "unit").rglob("test_*.py"))
    graph = sorted((TEST / "graph").glob("test_*.py"))
    node = sorted((TEST / "process").glob("*.test"), key=start_order)
    for name in names:
        if not any(name in path.name for path in (*unit, *graph, *node)):
            raise ValueError(f"no test file has {name} in its name: see test/unit, test/graph and test/process/*.test")

    def chosen(paths):
        return [path for path in paths if not names or any(name in path.name for name in names)]
    return Selection(chosen(unit), chosen(graph), chosen(path for path in node if path.stem not in TIMED),
                     chosen(path for path in node if path.stem in TIMED))


def start_order(path: Path) -> tuple[int, str]:
    """Return the key that sorts node tests: the longest first, then by name."""
    return LONG.index(path.stem) if path.stem in LONG else len(LONG), path.name


def free_share(before: list[int], after: list[int]) -> float:
    """Return the ratio of CPU time that was idle, or used at a low priority, between two readings of /proc/stat.

    The readings are user, nice, system, idle, iowait, irq, softirq and steal: proc(5). Unit tests run at a low
    priority, so that their time is free for node tests.
    """
    used = [now - then for now, then in zip(after, before)]
    return (used[1] + used[3] + used[4]) / max(1, sum(used))


def cpu_count() -> int:
    """Return how many CPUs this process may use."""
    return len(os.sched_getaffinity(0))


def cpu_times() -> list[int]:
    """Return the first eight figures of /proc/stat."""
    with open("/proc/stat", encoding="ascii") as file:
        return [int(field) for field in file.readline().split()[1:9]]


def cpus_have_time() -> bool:
    """Return whether a third of the CPUs' time is free during the next second."""
    before = cpu_times()
    time.sleep(1.0)
    return 3 * free_share(before, cpu_times()) > 1


def can_leave_idle_policy() -> bool:
    """Return whether a process may go back from SCHED_IDLE (sched(7)): else it would starve on a busy machine."""
    leave = "import os; os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))"
    return not subprocess.call(["chrt", "--idle", "0", sys.executable, "-c", leave], stderr=subprocess.DEVNULL)


class Running(NamedTuple):
    """A step at work."""

    step: Step
    process: subprocess.Popen
    begun_s: float


class Runner:
    """Runs steps side by side, and prints a line for each that ends.

    Args:
        output: folder; the results are in ``results/STEP``, the nodes' logs in ``log/test/STEP``.
        unit_steps: run one after the other, beside the node tests.
    """

    def __init__(self, output: Path, unit_steps: Iterable[Step]):
        self.tallies: dict[str, Tally] = {}  # by step
        self.hung: set[str] = set()  # names of steps
        self._results, self._logs = output / "results", output / "log" / "test"
        self._unit_steps = list(unit_steps)
        self._running: list[Running] = []
        self._unit_policy = os.SCHED_OTHER
        self.poll()

    def begin(self, step: Step) -> None:
        """Start a step in the background."""
        folder = self._results / step.name
        folder.mkdir(parents=True, exist_ok=True)
        environment = {**os.environ, "ROS_LOG_DIR": str(self._logs / step.name),
                       "CAR_INTERFACE_SKIPPED": str(folder / "skipped"), **step.environment}
        with open(str(folder / "log"), "wb") as log:
            process = start(sys.executable, str(TEST / "processes.py"), "--limit", str(step.limit_s), "--left-behind",
                            str(folder / "left_behind"), *step.command, env=environment, stdin=subprocess.DEVNULL,
                            stdout=log, stderr=log)
        self._running.append(Running(step, process, time.monotonic()))

    def poll(self) -> None:
        """Report the steps that have ended, and start the next unit tests when there is room for them."""
        for each in [each for each in self._running if each.process.poll() is not None]:
            self._running.remove(each)
            self._report(each.step, each.process.returncode, time.monotonic() - each.begun_s)
        if self._unit_steps and not self.unit_tests_run():
            self.begin(self._unit_steps.pop(0))
            self.set_unit_policy(self._unit_policy)

    def _report(self, step, code, took_s, why_ended=""):
        folder, logs = self._results / step.name, self._logs / step.name
        (folder / "exit_code").write_text(str(code), encoding="ascii")
        if code == TIMEOUT_EXIT_CODE:
            self.hung.add(step.name)
            why_ended = f"hung: ended after {step.limit_s:.0f} s"
        if why_ended:
            (folder / "why_ended").write_text(why_ended, encoding="utf-8")
        result = tally(folder)
        self.tallies[step.name] = result
        print_line(step.title, took_s, str(result))
        if result.failures:
            print(*result.lines(), end_of_log(folder / "log", 60), sep="\n", flush=True)
            if logs.exists():
                print(f"  (the nodes' logs: {logs})", flush=True)

    def unit_tests_run(self) -> bool:
        """Return whether unit tests are at work."""
        return any(each.step.is_unit for each in self._running)

    def node_tests(self) -> int:
        """Return how many node tests are at work."""
        return sum(not each.step.is_unit for each in self._running)

    def wait_until(self, condition: Callable[[], bool]) -> None:
        """Wait, and report what ends meanwhile."""
        self.poll()
        while not condition():
            time.sleep(POLL_S)
            self.poll()

    def wait_for_node_tests(self, count: int) -> None:
        """Wait until no more than so many node tests are at work."""
        self.wait_until(lambda: self.node_tests() <= count)

    def wait_for_unit_tests(self) -> None:
        """Wait until all unit tests have ended."""
        self.wait_until(lambda: not self.unit_tests_run() and not self._unit_steps)

    def wait_for_room(self) -> None:
        """Wait until another node test can begin: one on each CPU and one more, and one at a time on a busy machine."""
        self.wait_for_node_tests(cpu_count())
        while self.node_tests() and not cpus_have_time():
            self.wait_for_node_tests(cpu_count())

    def set_unit_policy(self, policy: int) -> None:
        """Have the unit tests run by SCHED_OTHER, or by SCHED_IDLE: then only while nothing else needs a CPU."""
        self._unit_policy = policy
        supervisors = [each.process.pid for each in self._running if each.step.is_unit]
        for pid in [*supervisors, *(pid for each in supervisors for pid in descendants(each))]:
            try:
                for thread in os.listdir(f"/proc/{pid}/task"):
                    os.sched_setscheduler(int(thread), policy, os.sched_param(0))
            except OSError:
                pass  # it has just ended

    def end(self) -> None:
        """End the steps that are still at work, all at once."""
        for each in self._running:
            interrupt(each.process, 0)
        wait_until(lambda: all(each.process.poll() is not None for each in self._running), END_S)
        end_descendants()

    def give_up(self, names: Iterable[str]) -> None:
        """End the run: what is at work, and each of the named steps that has not begun, counts as failed."""
        ended = [(each, time.monotonic() - each.begun_s) for each in self._running]
        self.end()
        for each, took_s in ended:
            self._report(each.step, each.process.returncode, took_s,
                         f"ended after {took_s:.0f} s, since the whole run was ended")
        for name in names:
            self.tallies.setdefault(name, Tally(failures=(f"{name}: not run, since the whole run was ended",)))


def print_line(title: str, took_s: float, result: str = "") -> None:
    """Print how long something took, and with which result."""
    print(f"{title:<44} {took_s:7.1f} s   {result}", flush=True)


def pytest_command(python: str, results: Path, *arguments: str) -> tuple[str, ...]:
    """Return a command that runs pytest at a lower priority than node tests have."""
    return ("nice", "-n", "5", python, "-m", "pytest", "-q", "--tb=short", "-p", "no:cacheprovider",
            "-o", f"faulthandler_timeout={PYTEST_TRACEBACK_S}", f"--junitxml={results / 'junit.xml'}", *arguments)


# pytest and old versions of Python write byte code beside the source, whatever PYTHONPYCACHEPREFIX says; threads of
# numerical libraries only compete with each other here.
PYTEST_ENVIRONMENT = {"PYTHONDONTWRITEBYTECODE": "1", "OPENBLAS_NUM_THREADS": "1"}


def unit_step(results: Path, python: str, files: list[Path], is_second: bool, everything: bool) -> Step:
    """Return the step of the unit tests on one Python."""
    version = subprocess.check_output([python, "-c", "import platform; print(platform.python_version())"], text=True)
    version = version.strip()
    name = "unit-" + version if is_second else "unit"
    marks = SECOND_PYTHON if is_second and not everything else ()
    title = f"unit tests, Python {version}"
    if everything:  # property tests take other cases each time; with the seed, the same again
        seed = random.randrange(2 ** 32)
        marks, title = (*marks, f"--hypothesis-seed={seed}"), f"{title}, seed {seed}"
    command = pytest_command(python, results / name, "-n", str(cpu_count()), "--dist", "loadfile", *marks,
                             *map(str, files))
    return Step(name, title, command, {**PYTEST_ENVIRONMENT, "PYTHONPATH": str(ROOT / "src")},
                LONG_UNIT_LIMIT_S if everything else UNIT_LIMIT_S, is_unit=True)


def graph_step(results: Path, files: list[Path]) -> Step:
    """Return the step of the tests of nodes in one process, on a clock of the test's."""
    command = pytest_command(sys.executable, results / GRAPH_STEP, "-n", str(cpu_count()), *map(str, files))
    return Step(GRAPH_STEP, "nodes in one process", command, PYTEST_ENVIRONMENT, NODE_LIMIT_S)


def node_limit_s(path: Path, everything: bool) -> float:
    """Return the limit of a node test: the sum of its tests' own, which are those of --all; else at most 15 minutes."""
    tests = ElementTree.parse(str(path)).iter("test")
    limit_s = START_AND_END_S + sum(float(test.get("time-limit", ROSTEST_LIMIT_S)) for test in tests)
    return limit_s if everything else min(limit_s, NODE_LIMIT_S)


def node_step(results: Path, path: Path, name: str, everything: bool) -> Step:
    """Return the step of one node test."""
    folder = results / name
    command = ("rostest", f"--pkgdir={ROOT}", "--package=car_interface", f"--results-base-dir={folder}", str(path))
    return Step(name, name, command, {"CAR_INTERFACE_TABLE": str(folder / "table")}, node_limit_s(path, everything))


def run_node_tests(runner: Runner, results: Path, selected: Selection, everything: bool) -> None:
    """Run the node tests beside the unit tests, those that measure times last."""
    if selected.graph:
        runner.begin(graph_step(results, selected.graph))
    for path in selected.shared:
        runner.wait_for_room()
        runner.begin(node_step(results, path, path.name, everything))
    runner.wait_for_node_tests(0)
    if not selected.timed:
        return
    # The bounds of --all are those of a machine that does nothing else.
    if everything or not can_leave_idle_policy():
        runner.wait_for_unit_tests()
    else:
        runner.set_unit_policy(os.SCHED_IDLE)
    for path in selected.timed:
        runner.wait_for_node_tests(0 if everything else MAX_TIMED - 1)
        runner.begin(node_step(results, path, path.name, everything))
    runner.wait_for_node_tests(0)
    runner.set_unit_policy(os.SCHED_OTHER)


def repeat_failed(runner: Runner, results: Path, paths: Iterable[Path]) -> list[str]:
    """Run the node tests that failed once more, each alone; return the failures of those that pass then.

    A program that was kept from running for seconds by others looks like one that is broken. What is broken fails
    again, and what passes is named: it depends on time where it shouldn't, in the test or in the code. What hung is not
    repeated: it has had many times the time that it needs.
    """
    failed = [path for path in paths if runner.tallies[path.name].failures and path.name not in runner.hung]
    if len(failed) > MAX_REPEATED:
        return []
    runner.wait_for_unit_tests()
    unsteady: list[str] = []
    for path in failed:
        again = node_step(results, path, f"{path.stem}-again.test", everything=False)
        runner.begin(again)
        runner.wait_for_node_tests(0)
        second = runner.tallies.pop(again.name)
        if not second.failures:
            unsteady += runner.tallies[path.name].failures
            runner.tallies[path.name] = second
    return unsteady


def run(output: Path, pythons: list[str], selected: Selection, everything: bool, repeats: bool) -> int:
    """Run the selected tests, print the results and their sum; return the exit code.

    SIGTERM ends the run early, as timeout(1) does in .ci/run when the run has taken too long: its results are printed,
    and what had not ended by itself counts as failed.
    """
    results, begun_s = output / "results", time.monotonic()
    runnable = [python for python in pythons if os.access(python, os.X_OK)]
    os.chdir(str(results))
    unit_steps = [unit_step(results, python, selected.unit, python != pythons[0], everything)
                  for python in runnable if selected.unit]
    runner, unsteady = Runner(output, unit_steps), []
    try:
        run_node_tests(runner, results, selected, everything)
        unsteady = repeat_failed(runner, results, [*selected.shared, *selected.timed]) if repeats else []
        runner.wait_for_unit_tests()
    except SystemExit as end:
        if end.code != 128 + signal.SIGTERM:
            raise
        print(f"./dev test: ended by SIGTERM after {time.monotonic() - begun_s:.0f} s", flush=True)
        nodes = (*selected.shared, *selected.timed)
        runner.give_up([*(step.name for step in unit_steps), *([GRAPH_STEP] if selected.graph else []),
                        *(path.name for path in nodes)])
    finally:
        runner.end()
    print_line("all", time.monotonic() - begun_s)
    tables = "".join(path.read_text(encoding="utf-8") for path in sorted(results.glob("*/table")))
    if tables:
        print(f"\nfault | at | trials | median ms | p99 ms | worst ms\n{tables}", end="")
    # A Python that could not be prepared counts as a skipped test.
    total = Tally.sum([*runner.tallies.values(), Tally(skipped=len(pythons) - len(runnable))])
    print("", *(f"UNSTEADY, passed alone: {failure}" for failure in unsteady), *total.lines(), total, sep="\n")
    return 1 if total.failures else 0


def main() -> int:
    parser = argparse.ArgumentParser(prog="./dev test", usage="%(prog)s [--all] [NAME...]", add_help=False)
    parser.add_argument("--all", action="store_true")
    parser.add_argument("--check", action="store_true")
    parser.add_argument("--output", type=Path)
    parser.add_argument("--python", action="append", default=[])
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
    # Who asks for one test, or for figures, wants to see it fail.
    repeats = not arguments.names and not arguments.all
    return run(arguments.output, arguments.python, selected, arguments.all, repeats)


if __name__ == "__main__":
    sys.exit(main())
