"""test/run.py: which tests run, in which order, and when another one may begin."""
from __future__ import annotations

import importlib
import sys
from pathlib import Path

import pytest

TEST = Path(__file__).resolve().parents[1]
sys.path.append(str(TEST))
run = importlib.import_module("run")
NODE_TESTS = {path.stem for path in (TEST / "node").glob("*.test")}


def names(paths):
    return [path.name for path in paths]


def test_without_names_every_test_runs_once():
    selected = run.select([])
    assert len(selected.unit) == len(set(selected.unit)) == len(list((TEST / "unit").rglob("test_*.py")))
    assert names(selected.messages) == ["messages_test.py"]
    assert sorted(names([*selected.shared, *selected.timed])) == sorted(f"{name}.test" for name in NODE_TESTS)


def test_the_longest_node_tests_begin_first():
    assert names(run.select([]).shared)[:3] == ["one_process.test", "fuzz.test", "doctor_situations.test"]
    assert names(run.select([]).timed) == [f"{name}.test" for name in (
        "chain", "captures", "demo", "planner_interface", "planners", "serial_faults", "teleop_logi", "turn_arb")]


def test_tests_with_an_order_or_a_limit_of_their_own_exist():
    assert {*run.TIMED, *run.LONG} - NODE_TESTS == set()


@pytest.mark.parametrize("name, expected", [
    ("test_layering", (["test_layering.py"], [], [], [])),
    ("messages_test", ([], ["messages_test.py"], [], [])),
    ("turn_arb.test", ([], [], [], ["turn_arb.test"])),
    ("car_display.test", ([], [], ["car_display.test"], [])),
])
def test_name_selects_files_that_contain_it(name, expected):
    assert tuple(map(names, run.select([name]))) == expected


def test_several_names_select_what_contains_any_of_them():
    selected = run.select(["car_display.test", "turn_arb.test"])
    assert (names(selected.shared), names(selected.timed)) == (["car_display.test"], ["turn_arb.test"])
    assert selected.unit == []


def test_name_that_no_test_has_is_refused_even_beside_one_that_some_have():
    with pytest.raises(ValueError, match="no test file has nosuch in its name"):
        run.select(["turn_arb", "nosuch"])


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
        monkeypatch.setattr(run, "tally", self._tally)

    def _tally(self, folder):
        return run.Tally(0, (f"{folder.name}: too late",)) if folder.name in self.failing else run.Tally(1)

    def _start(self, *command, **_):
        name = Path(command[-1]).stem
        self.log.append(name)
        polls = self._polls.get(name, 3)
        clock, log = iter(range(polls)), self.log

        class Process:
            returncode, pid = 0, 0

            def poll(self):
                if next(clock, None) is not None:
                    return None
                log.append(f"{name} ended")
                return 0
        return Process()


def at_work(log):
    """The most steps at work at a time, by the log of their beginnings and ends."""
    count = most = 0
    for line in log:
        count += 0 if line.startswith("policy") else -1 if line.endswith(" ended") else 1
        most = max(most, count)
    return most


def unit(name):
    return run.Step(name, name, (name,), {}, is_unit=True)


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
