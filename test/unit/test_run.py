"""test/run.py: which tests run, how many at a time, and what becomes of one that hangs."""
import configparser
import signal
import subprocess
import sys
import time
from pathlib import Path

TEST = Path(__file__).resolve().parents[1]
# A process of a session of its own, as roslaunch's nodes are.
HANGS = ("sh", "-c", "setsid sleep 600 & echo $! > hangs.pid; echo its last line; wait")
PASSES = ("sh", "-c", "echo '<testsuite><testcase name=\"a\"/></testsuite>' > results/passes.test/a.xml")
RUN = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
import run
run.adopt_descendants()
STEPS = {steps}
sys.exit(run.run(Path(), [run.Step(name, name, *step) for name, step in STEPS.items()], True, 0))
"""


def run_steps(folder, commands, limit_s=600.0):
    """Start a run of steps: names and commands; the limit is of those that hang."""
    steps = {name: (command, {}, limit_s if command is HANGS else 600.0, False) for name, command in commands.items()}
    return subprocess.Popen([sys.executable, "-c", RUN.format(steps=steps), str(TEST)],
                            cwd=str(folder), stdout=subprocess.PIPE, text=True)


def lines_of(process):
    """Return what a run printed until its end."""
    return process.communicate(timeout=120)[0].splitlines()


def hanging_pid(folder):
    path, deadline_s = folder / "hangs.pid", time.monotonic() + 60
    while not (path.exists() and path.read_text(encoding="ascii").endswith("\n")):
        assert time.monotonic() < deadline_s, "the step did not start"
        time.sleep(0.01)
    return int(path.read_text(encoding="ascii"))


def has_ended(pid):
    """Say whether a process ends: one that was killed may still be there for a moment."""
    path, deadline_s = Path(f"/proc/{pid}/stat"), time.monotonic() + 60
    while path.exists() and path.read_text(encoding="utf-8").rpartition(")")[2].split()[0] not in "ZX":
        if time.monotonic() > deadline_s:
            return False
        time.sleep(0.01)
    return True


def test_step_that_hangs_is_ended_and_named_with_the_end_of_its_log_and_the_others_run(tmp_path):
    process = run_steps(tmp_path, {"hangs.test": HANGS, "passes.test": PASSES}, limit_s=5.0)
    lines = lines_of(process)
    assert "FAILED hangs.test: hung: ended after 5 s" in lines and "  | its last line" in lines
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


# A ./dev whose tests hang as told.
DEV = """#!/usr/bin/env bash
[[ $1 == test ]] || exit 0
trap '{trap}' TERM
sleep 600 & echo $! > hangs.pid
wait $!
"""


def start_ci(folder, trap, end_s):
    """Start .ci/run with limits of some seconds."""
    (folder / ".ci").mkdir(parents=True)
    text = (TEST.parent / ".ci" / "run").read_text(encoding="utf-8")
    for name, seconds in (("LINT_S=480", "LINT_S=5"), ("TEST_S=3000", "TEST_S=5"), ("END_S=60", f"END_S={end_s}")):
        assert name in text
        text = text.replace(name, seconds)
    for name, content in ((".ci/run", text), ("dev", DEV.format(trap=trap))):
        (folder / name).write_text(content, encoding="utf-8")
        (folder / name).chmod(0o755)
    return subprocess.Popen([str(folder / ".ci" / "run")], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def test_ci_run_ends_tests_that_hang_whether_or_not_they_end_when_asked_to(tmp_path):
    ends = start_ci(tmp_path / "ends", "echo 3 passed, 1 failed, 0 skipped; exit 1", 60)
    does_not = start_ci(tmp_path / "does_not", "", 1)
    # Before its last lines, bash reports what was killed.
    assert (lines_of(ends)[-1:], ends.returncode) == (["3 passed, 1 failed, 0 skipped"], 124)
    assert (lines_of(does_not)[-2:], does_not.returncode) == (
        [".ci/run: ./dev test was killed", "0 passed, 1 failed, 0 skipped"], 137)
    for folder in ("ends", "does_not"):
        assert has_ended(hanging_pid(tmp_path / folder))


def test_each_module_that_its_tests_must_run_whole_exists():
    ini = configparser.ConfigParser()
    ini.read(str(TEST / "coverage.ini"))
    for pattern in ini["run"]["include"].split():
        assert list((TEST.parent / "src").glob(pattern[len("*/src/"):])), f"there is no {pattern}"
