"""test/run.py: which tests run, in which order, when another one may begin, and what becomes of one that hangs."""
from __future__ import annotations

import importlib
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

TEST = Path(__file__).resolve().parents[1]
sys.path.append(str(TEST))
run = importlib.import_module("run")
NODE_TESTS = {path.stem for path in (TEST / "process").glob("*.test")}


def names(paths):
    return [path.name for path in paths]


def test_without_names_every_test_runs_once():
    selected = run.select([])
    assert len(selected.unit) == len(set(selected.unit)) == len(list((TEST / "unit").rglob("test_*.py")))
    assert "test_messages.py" in names(selected.graph)
    assert sorted(names([*selected.shared, *selected.timed])) == sorted(f"{name}.test" for name in NODE_TESTS)


def test_the_longest_node_tests_begin_first():
    assert names(run.select([]).shared)[:3] == ["one_process.test", "fuzz.test", "doctor_situations.test"]
    assert names(run.select([]).timed) == [f"{name}.test" for name in (
        "chain", "captures", "demo", "serial_faults")]


def test_tests_with_an_order_or_a_limit_of_their_own_exist():
    assert {*run.TIMED, *run.LONG} - NODE_TESTS == set()


@pytest.mark.parametrize("name, expected", [
    ("test_layering", (["test_layering.py"], [], [], [])),
    ("test_messages", ([], ["test_messages.py"], [], [])),
    ("serial_faults.test", ([], [], [], ["serial_faults.test"])),
    ("demo_config.test", ([], [], ["demo_config.test"], [])),
])
def test_name_selects_files_that_contain_it(name, expected):
    assert tuple(map(names, run.select([name]))) == expected


def test_several_names_select_what_contains_any_of_them():
    selected = run.select(["demo_config.test", "serial_faults.test"])
    assert (names(selected.shared), names(selected.timed)) == (["demo_config.test"], ["serial_faults.test"])
    assert selected.unit == []


def test_name_that_no_test_has_is_refused_even_beside_one_that_some_have():
    with pytest.raises(ValueError, match="no test file has nosuch in its name"):
        run.select(["test_turn_arb", "nosuch"])


@pytest.mark.parametrize("used, share", [
    ([100, 0, 0, 0, 0, 0, 0, 0], 0.0),
    ([0, 0, 0, 100, 0, 0, 0, 0], 1.0),
    ([60, 30, 10, 0, 0, 0, 0, 0], 0.3),
    ([30, 0, 10, 30, 20, 5, 5, 0], 0.5),
    ([0, 0, 0, 0, 0, 0, 0, 0], 0.0),
], ids=["busy", "idle", "unit_tests_run_niced", "idle_and_waiting_for_disks", "no_time_has_passed"])
def test_free_share_is_idle_waiting_and_niced_time(used, share):
    before = [7, 11, 13, 17, 19, 23, 29, 31]
    assert run.free_share(before, [start + time for start, time in zip(before, used)]) == pytest.approx(share)


def test_second_python_leaves_out_what_cannot_differ_unless_everything_is_asked_for(tmp_path):
    steps = [run.unit_step(tmp_path, sys.executable, [TEST / "unit"], is_second, everything)
             for is_second, everything in ((False, False), (True, False), (True, True))]
    assert ["not once and not browser" in step.command for step in steps] == [False, True, False]
    assert len({steps[0].name, steps[1].name}) == 2


class Clock:
    """A runner's steps, without processes: each has ended after so many polls."""

    def __init__(self, monkeypatch, polls):
        self.log, self._polls = [], dict(polls)
        monkeypatch.setattr(run, "start", self._start)
        monkeypatch.setattr(run.time, "sleep", lambda _: None)
        monkeypatch.setattr(run, "cpu_count", lambda: 2)
        monkeypatch.setattr(run, "cpus_have_time", lambda: True)
        monkeypatch.setattr(run, "can_leave_idle_policy", lambda: True)
        monkeypatch.setattr(run, "descendants", lambda *_: [])
        monkeypatch.setattr(run, "print_line", lambda *_: None)
        monkeypatch.setattr(run.Runner, "set_unit_policy", lambda _, policy: self.log.append(f"policy {policy}"))
        self.failing: set[str] = set()
        self.codes: dict[str, int] = {}
        monkeypatch.setattr(run, "tally", self._tally)
        monkeypatch.setattr(run, "node_limit_s", lambda *_: 60.0)

    def _tally(self, folder):
        return run.Tally(0, (f"{folder.name}: too late",)) if folder.name in self.failing else run.Tally(1)

    def _start(self, *command, **_):
        name = Path(command[-1]).stem
        self.log.append(name)
        polls = self._polls.get(name, 3)
        clock, log, code = iter(range(polls)), self.log, self.codes.get(name, 0)

        class Process:
            returncode, pid = code, 0

            def poll(self):
                if next(clock, None) is not None:
                    return None
                log.append(f"{name} ended")
                return code
        return Process()


def at_work(log):
    """The most steps at work at a time, by the log of their beginnings and ends."""
    count = most = 0
    for line in log:
        count += 0 if line.startswith("policy") else -1 if line.endswith(" ended") else 1
        most = max(most, count)
    return most


def unit(name):
    return run.Step(name, name, (name,), {}, 60.0, is_unit=True)


@pytest.mark.parametrize("everything, most", [(False, 2), (True, 1)])
def test_timed_tests_run_at_most_two_at_a_time_and_one_with_all(monkeypatch, tmp_path, everything, most):
    clock = Clock(monkeypatch, {})
    timed = [Path(f"{name}.test") for name in "abcde"]
    run.run_node_tests(run.Runner(tmp_path, []), tmp_path, run.Selection([], [], [], timed), everything)
    assert at_work(clock.log) == most
    assert [line for line in clock.log if len(line) == 1] == list("abcde")


def test_unit_tests_run_one_python_after_the_other_and_idle_beside_timed_tests(monkeypatch, tmp_path):
    clock = Clock(monkeypatch, {"first": 5, "second": 50})
    runner = run.Runner(tmp_path, [unit("first"), unit("second")])
    run.run_node_tests(runner, tmp_path, run.Selection([], [], [], [Path("timed.test")]), everything=False)
    runner.wait_for_unit_tests()
    log = clock.log
    assert log.index("first ended") < log.index("second")
    assert log.index("policy 5") < log.index("timed") < log.index("timed ended") < log.index("second ended")


def test_all_lets_unit_tests_end_before_timed_tests_begin(monkeypatch, tmp_path):
    clock = Clock(monkeypatch, {"first": 20, "second": 20})
    runner = run.Runner(tmp_path, [unit("first"), unit("second")])
    run.run_node_tests(runner, tmp_path, run.Selection([], [], [], [Path("timed.test")]), everything=True)
    assert clock.log.index("second ended") < clock.log.index("timed")


def test_node_tests_that_share_the_machine_are_one_more_than_cpus(monkeypatch, tmp_path):
    clock = Clock(monkeypatch, dict.fromkeys("abcdefg", 20))
    shared = [Path(f"{name}.test") for name in "abcdefg"]
    run.run_node_tests(run.Runner(tmp_path, []), tmp_path, run.Selection([], [], shared, []), everything=False)
    assert at_work(clock.log) == 3


def test_on_a_busy_machine_node_tests_run_one_at_a_time(monkeypatch, tmp_path):
    clock = Clock(monkeypatch, dict.fromkeys("abc", 20))
    monkeypatch.setattr(run, "cpus_have_time", lambda: False)
    shared = [Path(f"{name}.test") for name in "abc"]
    runner = run.Runner(tmp_path, [])
    run.run_node_tests(runner, tmp_path, run.Selection([], [], shared, []), everything=False)
    assert at_work(clock.log) == 1


def run_and_repeat(clock, folder, names):
    """What is unsteady, and what failed in the end, of node tests that fail as the clock says."""
    for name in clock.failing:
        (folder / "results" / name).mkdir(parents=True)
        (folder / "results" / name / "log").write_text("")
    paths = [Path(f"{name}.test") for name in names]
    runner = run.Runner(folder, [])
    run.run_node_tests(runner, folder, run.Selection([], [], paths, []), everything=False)
    unsteady = run.repeat_failed(runner, folder, paths)
    return unsteady, run.Tally.sum(runner.tallies.values())


def test_failed_node_test_that_passes_alone_counts_as_passed_and_is_named(monkeypatch, tmp_path):
    clock = Clock(monkeypatch, {})
    clock.failing = {"b.test"}
    assert run_and_repeat(clock, tmp_path, "abc") == (["b.test: too late"], run.Tally(3))
    assert clock.log[-2:] == ["b", "b ended"]


def test_failed_node_test_that_fails_alone_as_well_stays_failed(monkeypatch, tmp_path):
    clock = Clock(monkeypatch, {})
    clock.failing = {"b.test", "b-again.test"}
    assert run_and_repeat(clock, tmp_path, "abc") == ([], run.Tally(2, ("b.test: too late",)))


def test_many_failed_node_tests_are_not_repeated(monkeypatch, tmp_path):
    clock = Clock(monkeypatch, {})
    clock.failing = {f"{name}.test" for name in "abcd"}
    unsteady, total = run_and_repeat(clock, tmp_path, "abcde")
    assert unsteady == [] and len(total.failures) == 4 and clock.log.count("a") == 1


def test_node_test_that_hung_is_not_repeated(monkeypatch, tmp_path):
    clock = Clock(monkeypatch, {})
    clock.failing, clock.codes = {"b.test"}, {"b": 124}
    assert run_and_repeat(clock, tmp_path, "abc") == ([], run.Tally(2, ("b.test: too late",)))
    assert clock.log.count("b") == 1


@pytest.mark.parametrize("tests, everything, limit_s", [
    ('<test time-limit="240"/>', False, 300.0),
    ('<test time-limit="200"/><group><test time-limit="40"/></group>', False, 300.0),
    ("<test/>", False, 120.0),
    ('<test time-limit="3600"/>', False, 900.0),
    ('<test time-limit="3600"/>', True, 3660.0),
], ids=["own_and_a_minute", "several_are_added", "without_one_rostest_s", "long_with_all", "long_of_all"])
def test_limit_of_a_node_test_is_that_of_its_tests(tmp_path, tests, everything, limit_s):
    path = tmp_path / "x.test"
    path.write_text(f"<launch>{tests}</launch>", encoding="utf-8")
    assert run.node_step(tmp_path, path, "x.test", everything).limit_s == limit_s


def test_usual_run_has_time_for_a_hanging_node_test_beside_all_that_passes():
    limits_s = [run.node_limit_s(path, everything=False) for path in (TEST / "process").glob("*.test")]
    assert max(limits_s) <= 900, "twenty minutes for the others, of the 50 of .ci/run"


# A process of a session of its own, as roslaunch's nodes are.
HANGS = ("sh", "-c", "setsid sleep 600 & echo $! > hangs.pid; echo its last line; wait")
PASSES = ("sh", "-c", "echo '<testsuite><testcase name=\"a\"/></testsuite>' > results/passes.test/a.xml")
# A run of steps as those of the node tests; argument: the limit in seconds of the one that hangs.
RUN = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
import run
COMMANDS = {commands}
limit_s = {{"hangs.test": float(sys.argv[2])}}
run.node_step = lambda _, path, name, __: run.Step(name, name, COMMANDS[name], {{}}, limit_s.get(name, 600.0))
run.cpu_count, run.cpus_have_time = lambda: 0, lambda: True
run.os.chdir = lambda _: None
run.adopt_descendants()
paths = [Path(name) for name in COMMANDS]
sys.exit(run.run(Path(), [], run.Selection([], [], paths, []), False, True))
"""


def run_steps(folder, commands, limit_s):
    """Start a run of these steps, one after the other."""
    return subprocess.Popen([sys.executable, "-c", RUN.format(commands=commands), str(TEST), str(limit_s)],
                            cwd=str(folder), stdout=subprocess.PIPE, text=True)


def lines_of(process):
    """Return what a run printed until its end."""
    try:
        return process.communicate(timeout=120)[0].splitlines()
    except subprocess.TimeoutExpired:
        process.terminate()
        raise


def hanging_pid(folder):
    path, deadline_s = folder / "hangs.pid", time.monotonic() + 60
    while not (path.exists() and path.read_text(encoding="ascii").endswith("\n")):
        assert time.monotonic() < deadline_s, "the step did not start"
        time.sleep(0.01)
    return int(path.read_text(encoding="ascii"))


def has_ended(pid):
    path = Path(f"/proc/{pid}/stat")
    return not path.exists() or path.read_text(encoding="utf-8").rpartition(")")[2].split()[0] in "ZX"


@pytest.mark.once
def test_step_that_hangs_is_ended_and_named_with_the_end_of_its_log_and_the_others_run(tmp_path):
    process = run_steps(tmp_path, {"hangs.test": HANGS, "passes.test": PASSES}, limit_s=8)
    lines = lines_of(process)
    assert "FAILED hangs.test: hung: ended after 8 s" in lines and "  | its last line" in lines
    assert (lines[-1], process.returncode) == ("1 passed, 1 failed, 0 skipped", 1)
    assert has_ended(hanging_pid(tmp_path))


def test_run_that_is_ended_names_what_ran_and_what_had_not_begun_and_its_last_line_is_the_sum(tmp_path):
    process = run_steps(tmp_path, {"passes.test": PASSES, "hangs.test": HANGS, "waits.test": PASSES}, limit_s=600)
    pid = hanging_pid(tmp_path)
    process.send_signal(signal.SIGTERM)
    lines = lines_of(process)
    assert any(line.startswith("FAILED hangs.test: ended after ") for line in lines) and "  | its last line" in lines
    assert "FAILED waits.test: not run, since the whole run was ended" in lines
    assert (lines[-1], process.returncode) == ("1 passed, 2 failed, 0 skipped", 1)
    assert has_ended(pid)


HANGING_TEST = """
import threading
from hypothesis import given, strategies

@given(strategies.integers())
def test_hangs(_):
    with open("hung", "a") as file:
        file.write("once")
    threading.Event().wait()

def test_passes():
    pass
"""


def test_unit_test_that_hangs_is_named_as_failed_and_the_others_run(tmp_path):
    (tmp_path / "conftest.py").write_text((TEST / "unit" / "conftest.py").read_text(encoding="utf-8"))
    (tmp_path / "test_some.py").write_text(HANGING_TEST)
    environment = {**run.os.environ, "CAR_INTERFACE_UNIT_LIMIT_S": "5"}
    command = run.pytest_command(sys.executable, tmp_path, "-n", "1", "--dist", "loadfile", str(tmp_path))
    subprocess.run(command, cwd=str(tmp_path), env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                   timeout=120, check=False)
    tally = importlib.import_module("tally").tally(tmp_path)
    assert (tally.passed, len(tally.failures)) == (1, 1)
    assert (tmp_path / "hung").read_text(encoding="ascii") == "once", "hypothesis ran what hung again"
    assert "test_some.test_hangs: " in tally.failures[0] and "hung: ended after 5 s" in tally.failures[0]


# A ./dev of which one command hangs as told; the other one ends with the sum, as it does.
DEV = """#!/usr/bin/env bash
hangs() {{ trap '{trap}' TERM; sleep 600 & echo $! > hangs.pid; wait $!; }}
[[ $1 != {hanging} ]] || hangs
[[ $1 == lint ]] || echo "3 passed, 0 failed, 0 skipped"
"""


def run_ci(folder, hanging, trap, end_s):
    """Return output and exit code of .ci/run with limits of some seconds."""
    (folder / ".ci").mkdir()
    text = (TEST.parent / ".ci" / "run").read_text(encoding="utf-8")
    for name, seconds in (("LINT_S=480", "LINT_S=8"), ("TEST_S=3000", "TEST_S=8"), ("END_S=60", f"END_S={end_s}")):
        assert name in text
        text = text.replace(name, seconds)
    for name, content in ((".ci/run", text), ("dev", DEV.format(hanging=hanging, trap=trap))):
        (folder / name).write_text(content, encoding="utf-8")
        (folder / name).chmod(0o755)
    done = subprocess.run([str(folder / ".ci" / "run")], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
                          timeout=120, check=False)
    return done.stdout.splitlines(), done.returncode


@pytest.mark.once
@pytest.mark.parametrize("hanging, trap, end_s, expected", [
    ("nothing", ":", 60, (["3 passed, 0 failed, 0 skipped"], 0)),
    ("lint", "echo lint hung; exit 1", 60, (["lint hung"], 124)),
    ("test", "echo 3 passed, 1 failed, 0 skipped; exit 1", 60, (["3 passed, 1 failed, 0 skipped"], 124)),
    ("test", "", 1, ([".ci/run: ./dev test was killed", "0 passed, 1 failed, 0 skipped"], 137)),
], ids=["nothing_hangs", "lint", "test", "test_that_does_not_end_when_asked_to"])
def test_ci_run_ends_what_hangs(tmp_path, hanging, trap, end_s, expected):
    lines, code = run_ci(tmp_path, hanging, trap, end_s)
    # Before its last lines, bash reports what was killed.
    assert (lines[-len(expected[0]):], code) == expected
    assert hanging == "nothing" or has_ended(hanging_pid(tmp_path))


def test_limits_of_ci_run_are_an_hour_together():
    text = (TEST.parent / ".ci" / "run").read_text(encoding="utf-8")
    lint_s, test_s, end_s = (int(text.partition(f"{name}=")[2].split()[0]) for name in ("LINT_S", "TEST_S", "END_S"))
    assert lint_s + test_s + 2 * end_s <= 3600


@pytest.mark.once
def test_set_up_that_is_ended_says_what_it_did_and_its_last_line_is_the_sum(tmp_path):
    text = (TEST.parent / "dev").read_text(encoding="utf-8")
    main = 'main "$@"\n'
    assert text.endswith(main)
    setup = 'setup() { say "Installing it"; logged pip supervised sh -c \'echo $$ > "$PID_FILE"; sleep 600\'; }\n'
    (tmp_path / "dev").write_text(text[:-len(main)] + setup + main, encoding="utf-8")
    (tmp_path / "test").symlink_to(TEST)
    environment = {**run.os.environ, "CAR_INTERFACE_WORKSPACE": str(tmp_path.with_name("workspace")),
                   "PID_FILE": str(tmp_path / "hangs.pid")}
    process = subprocess.Popen(["timeout", "600", "bash", str(tmp_path / "dev"), "test"], env=environment,
                               stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    pid = hanging_pid(tmp_path)
    process.terminate()  # which timeout hands on to all of its process group
    lines = lines_of(process)
    assert lines[-2:] == ["./dev: ended by SIGTERM; the last that it did: Installing it",
                          "0 passed, 1 failed, 0 skipped"]
    assert process.returncode != 0 and has_ended(pid)
