"""test/run.py, ./dev and .ci/run: which tests run, and what becomes of one that fails or hangs."""
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
run, Tally = importlib.import_module("run"), importlib.import_module("tally").Tally
NODE_TESTS = {path.stem for path in (TEST / "process").glob("*.test")}


def test_without_names_every_test_runs_once_and_a_name_selects_the_files_that_contain_it():
    every = run.select([])
    assert every.unit == sorted(set((TEST / "unit").rglob("test_*.py")))
    assert every.graph == sorted((TEST / "graph").glob("test_*.py"))
    assert sorted(path.stem for path in (*every.shared, *every.timed)) == sorted(NODE_TESTS)
    assert {*run.TIMED, *run.LONG} <= NODE_TESTS
    some = run.select(["test_layering", "test_messages", "turn_arb.test"])
    assert [[path.name for path in paths] for paths in some] == [
        ["test_layering.py"], ["test_messages.py"], [], ["turn_arb.test"]]
    limits_s = [run.node_limit_s(path, everything=False) for path in (TEST / "process").glob("*.test")]
    assert max(limits_s) <= 900, "twenty minutes for the others, of the 50 of .ci/run"
    with pytest.raises(ValueError, match="no test file has nosuch in its name"):
        run.select(["turn_arb", "nosuch"])


def test_second_python_leaves_out_what_cannot_differ_unless_everything_is_asked_for(tmp_path):
    steps = [run.unit_step(tmp_path, sys.executable, [TEST / "unit"], is_second, everything)
             for is_second, everything in ((False, False), (True, False), (True, True))]
    assert ["not once and not browser" in step.command for step in steps] == [False, True, False]
    assert len({steps[0].name, steps[1].name}) == 2


@pytest.mark.parametrize("failing, code, unsteady, total, starts", [
    ({"b.test"}, 1, ["b.test: too late"], Tally(3), 2),
    ({"b.test", "b-again.test"}, 1, [], Tally(2, ("b.test: too late",)), 2),
    ({"b.test"}, 124, [], Tally(2, ("b.test: too late",)), 1),
    (set("abcd"), 1, [], Tally(0, tuple(f"{name}.test: too late" for name in "abc")), 1),
], ids=["passes_alone", "fails_alone_as_well", "hung", "all_fail"])
def test_failed_node_test_runs_once_more_alone_and_is_named(monkeypatch, tmp_path, failing, code, unsteady, total,
                                                            starts):
    started: list[str] = []

    class Process:
        pid = 0

        def __init__(self, *command, **_):
            started.append(command[-1])
            self.returncode = code if Path(command[-1]).name in failing else 0

        def poll(self):
            return self.returncode
    failing = {name if "." in name else f"{name}.test" for name in failing}
    for name, value in (("start", Process), ("MAX_REPEATED", 2), ("print_line", print),
                        ("cpus_have_time", lambda: True), ("can_leave_idle_policy", lambda: False),
                        ("node_limit_s", lambda *_: 60.0),
                        ("tally", lambda folder: Tally(0, (f"{folder.name}: too late",)) if folder.name in failing
                         else Tally(1))):
        monkeypatch.setattr(run, name, value)
    runner, paths = run.Runner(tmp_path, []), [Path(f"{name}.test") for name in "abc"]
    run.run_node_tests(runner, tmp_path, run.Selection([], [], paths, []), everything=False)
    assert run.repeat_failed(runner, tmp_path, paths) == unsteady
    assert Tally.sum(runner.tallies.values()) == total
    assert len([name for name in started if Path(name).stem == "b"]) == starts
    if code == 124:
        assert (tmp_path / "results/b.test/why_ended").read_text(encoding="utf-8") == "hung: ended after 60 s"


@pytest.mark.parametrize("tests, everything, limit_s", [
    ('<test time-limit="200"/><group><test time-limit="40"/></group>', False, 300.0),
    ("<test/>", False, 120.0),
    ('<test time-limit="3600"/>', False, 900.0),
    ('<test time-limit="3600"/>', True, 3660.0),
], ids=["several_are_added", "without_one_rostest_s", "long_with_all", "long_of_all"])
def test_limit_of_a_node_test_is_that_of_its_tests(tmp_path, tests, everything, limit_s):
    path = tmp_path / "x.test"
    path.write_text(f"<launch>{tests}</launch>", encoding="utf-8")
    assert run.node_step(tmp_path, path, "x.test", everything).limit_s == limit_s


# A process of a session of its own, as roslaunch's nodes are.
HANGS = ("sh", "-c", "setsid sleep 600 & echo $! > hangs.pid; echo its last line; wait")
PASSES = ("sh", "-c", "echo '<testsuite><testcase name=\"a\"/></testsuite>' > results/passes.test/a.xml")
# A run of steps as those of the node tests, one after the other.
RUN = f"""
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
import run
COMMANDS = {dict(zip(("passes.test", "hangs.test", "waits.test"), (PASSES, HANGS, PASSES)))}
run.node_step = lambda _, path, name, __: run.Step(name, name, COMMANDS[name], {{}}, 600.0)
run.cpu_count, run.cpus_have_time = lambda: 0, lambda: True
run.os.chdir = lambda _: None
run.adopt_descendants()
sys.exit(run.run(Path(), [], run.Selection([], [], [Path(name) for name in COMMANDS], []), False, True))
"""


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


def test_run_that_is_ended_names_what_ran_and_what_had_not_begun_and_its_last_line_is_the_sum(tmp_path):
    process = subprocess.Popen([sys.executable, "-c", RUN, str(TEST)], cwd=str(tmp_path), stdout=subprocess.PIPE,
                               text=True)
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
    environment = {**run.os.environ, "CAR_INTERFACE_UNIT_LIMIT_S": "2"}
    command = run.pytest_command(sys.executable, tmp_path, "-n", "1", "--dist", "loadfile", str(tmp_path))
    subprocess.run(command, cwd=str(tmp_path), env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                   timeout=120, check=False)
    tally = importlib.import_module("tally").tally(tmp_path)
    assert (tally.passed, len(tally.failures)) == (1, 1)
    assert (tmp_path / "hung").read_text(encoding="ascii") == "once", "hypothesis ran what hung again"
    assert "test_some.test_hangs: " in tally.failures[0] and "hung: ended after 2 s" in tally.failures[0]


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
    for name, seconds in (("LINT_S=480", "LINT_S=2"), ("TEST_S=3000", "TEST_S=2"), ("END_S=60", f"END_S={end_s}")):
        assert name in text
        text = text.replace(name, seconds)
    for name, content in ((".ci/run", text), ("dev", DEV.format(hanging=hanging, trap=trap))):
        (folder / name).write_text(content, encoding="utf-8")
        (folder / name).chmod(0o755)
    done = subprocess.run([str(folder / ".ci" / "run")], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
                          timeout=120, check=False)
    return done.stdout.splitlines(), done.returncode


@pytest.mark.parametrize("hanging, trap, end_s, expected", [
    ("lint", "echo lint hung; exit 1", 60, (["lint hung"], 124)),
    ("test", "echo 3 passed, 1 failed, 0 skipped; exit 1", 60, (["3 passed, 1 failed, 0 skipped"], 124)),
    ("test", "", 1, ([".ci/run: ./dev test was killed", "0 passed, 1 failed, 0 skipped"], 137)),
], ids=["lint", "test", "test_that_does_not_end_when_asked_to"])
def test_ci_run_ends_what_hangs(tmp_path, hanging, trap, end_s, expected):
    lines, code = run_ci(tmp_path, hanging, trap, end_s)
    # Before its last lines, bash reports what was killed.
    assert (lines[-len(expected[0]):], code) == expected
    assert has_ended(hanging_pid(tmp_path))


def test_limits_of_ci_run_are_an_hour_together():
    text = (TEST.parent / ".ci" / "run").read_text(encoding="utf-8")
    lint_s, test_s, end_s = (int(text.partition(f"{name}=")[2].split()[0]) for name in ("LINT_S", "TEST_S", "END_S"))
    assert lint_s + test_s + 2 * end_s <= 3600


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
