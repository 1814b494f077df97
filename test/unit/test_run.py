"""test/run.py: which tests run, how many at a time, and what becomes of one that hangs."""
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


def names(paths):
    return [path.name for path in paths]


def test_without_names_every_test_runs_once_and_the_longest_process_tests_begin_first():
    selected = run.select([])
    for paths, pattern in zip(selected, ("unit/**/test_*.py", "graph/test_*.py", "process/*.test")):
        assert sorted(paths) == sorted(TEST.glob(pattern)) != []
    limits_s = [run.time_limit_s(path) for path in selected.process]
    assert limits_s == sorted(limits_s, reverse=True)


def test_name_selects_files_that_contain_it_and_one_that_no_test_has_is_refused():
    assert tuple(map(names, run.select(["test_layering"]))) == (["test_layering.py"], [], [])
    assert tuple(map(names, run.select(["test_story", "test_tally"]))) == (["test_tally.py"], ["test_story.py"], [])
    with pytest.raises(ValueError, match="no test file has nosuch in its name"):
        run.select(["test_story", "nosuch"])


def test_second_python_leaves_out_what_cannot_differ_unless_everything_is_asked_for(tmp_path):
    steps = [run.pytest_step(tmp_path, "unit tests", run.Python(sys.executable, "", is_second), [TEST], "", is_all)
             for is_second, is_all in ((False, False), (True, False), (True, True))]
    assert ["not once and not browser" in step.command for step in steps] == [False, True, False]
    assert len({steps[0].name, steps[1].name}) == 2


def test_python_without_ros_runs_no_nodes(tmp_path):
    pythons = [run.Python(sys.executable, "ros", False), run.Python(sys.executable, "", True)]
    steps = run.all_steps(tmp_path, pythons, run.Selection([TEST], [TEST], [TEST / "process/demo.test"]), False)
    assert [step.name.split("-")[0] for step in steps] == ["unit", "graph", "unit", "demo.test"]


@pytest.mark.parametrize("tests, is_all, limit_s", [
    ('<test time-limit="240"/>', False, 300.0),
    ('<test time-limit="200"/><group><test time-limit="40"/></group>', False, 300.0),
    ("<test/>", False, 120.0),
    ('<test time-limit="3600"/>', False, 900.0),
    ('<test time-limit="3600"/>', True, 3660.0),
], ids=["own_and_a_minute", "several_are_added", "without_one_rostest_s", "long_with_all", "long_of_all"])
def test_limit_of_a_process_test_is_that_of_its_tests(tmp_path, tests, is_all, limit_s):
    path = tmp_path / "x.test"
    path.write_text(f"<launch>{tests}</launch>", encoding="utf-8")
    assert run.process_step(tmp_path, path, is_all).limit_s == limit_s


# A process of a session of its own, as roslaunch's nodes are.
HANGS = ("sh", "-c", "setsid sleep 600 & echo $! > hangs.pid; echo its last line; wait")
PASSES = ("sh", "-c", "echo '<testsuite><testcase name=\"a\"/></testsuite>' > results/passes.test/a.xml")
# Ends when as many have begun as its argument says, and none is at work beside one that is to be alone.
MEETS = """
[ ! -e alone ] || exit 1; [ {count} != 1 ] || touch alone; echo x >> begun; i=0
until [ "$(wc -l < begun)" -ge {count} ]; do i=$((i+1)); [ $i -lt 600 ] || exit 1; sleep 0.05; done
sleep 0.5; rm -f alone; echo '<testsuite><testcase name="a"/></testsuite>' > results/{name}/a.xml
"""
RUN = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
import run
run.adopt_descendants()
STEPS = {steps}
sys.exit(run.run(Path(), [run.Step(name, name, *step) for name, step in STEPS.items()], {at_work}, 0))
"""


def run_steps(folder, commands, limit_s=600.0, at_work=1):
    """Start a run of steps: names and commands; the limit is of those that hang."""
    steps = {name: (command, {}, limit_s if command is HANGS else 600.0, name.startswith("py"))
             for name, command in commands.items()}
    return subprocess.Popen([sys.executable, "-c", RUN.format(steps=steps, at_work=at_work), str(TEST)],
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


def test_steps_of_pytest_are_at_work_alone_and_two_others_together(tmp_path):
    meets = {name: ("sh", "-c", MEETS.format(count=count, name=name))
             for name, count in (("py1", 1), ("py2", 1), ("a.test", 4), ("b.test", 4))}
    assert lines_of(run_steps(tmp_path, meets, at_work=2))[-1] == "4 passed, 0 failed, 0 skipped"


@pytest.mark.once
def test_step_that_hangs_is_ended_and_named_with_the_end_of_its_log_and_the_others_run(tmp_path):
    process = run_steps(tmp_path, {"hangs.test": HANGS, "passes.test": PASSES}, limit_s=8.0)
    lines = lines_of(process)
    assert "FAILED hangs.test: hung: ended after 8 s" in lines and "  | its last line" in lines
    assert (lines[-1], process.returncode) == ("1 passed, 1 failed, 0 skipped", 1)
    assert has_ended(hanging_pid(tmp_path))


def test_run_that_is_ended_names_what_ran_and_what_had_not_begun_and_its_last_line_is_the_sum(tmp_path):
    process = run_steps(tmp_path, {"passes.test": PASSES, "hangs.test": HANGS, "waits.test": PASSES})
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
    (tmp_path / "conftest.py").write_text((TEST / "conftest.py").read_text(encoding="utf-8"))
    (tmp_path / "test_some.py").write_text(HANGING_TEST)
    environment = {**run.os.environ, "CAR_INTERFACE_UNIT_LIMIT_S": "5"}
    python = run.Python(sys.executable, "", False)
    command = run.pytest_step(tmp_path, "unit tests", python, [tmp_path], "", False).command
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
