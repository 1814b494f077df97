"""test/processes.py: a run ends all that it has started, and reports what was left."""
from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

TEST = Path(__file__).resolve().parents[1]
SUPERVISED = (sys.executable, str(TEST / "processes.py"), "--grace", "0.5", "--left-behind", "left")
# A daemon: of a session of its own, and its parent has ended.
DAEMON = "setsid sleep 60 & echo $! > pid"


def is_running(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False


def daemon(folder: Path, within_s: float = 30.0) -> int:
    path, deadline_s = folder / "pid", time.monotonic() + within_s
    while not (path.exists() and path.read_text(encoding="ascii").endswith("\n")):
        assert time.monotonic() < deadline_s, "the daemon did not start"
        time.sleep(0.01)
    return int(path.read_text(encoding="ascii"))


@pytest.fixture
def run(tmp_path):
    return lambda command: subprocess.Popen([*SUPERVISED, "sh", "-c", command], cwd=str(tmp_path))


@pytest.mark.parametrize("command, code", [("exit 0", 0), ("exit 7", 7), ("kill -9 $$", 128 + 9)])
def test_exit_code_is_the_command_s(run, tmp_path, command, code):
    assert run(command).wait(60) == code
    assert not (tmp_path / "left").exists()


def test_daemon_that_the_command_leaves_is_counted_and_ended(run, tmp_path):
    assert run(DAEMON).wait(60) == 0
    assert (tmp_path / "left").read_text(encoding="ascii") == "1"
    assert not is_running(daemon(tmp_path))


def test_signal_time_limit_or_the_end_of_the_starting_process_ends_command_and_daemon(tmp_path):
    cases = {signal.SIGINT: DAEMON + "; sleep 60", signal.SIGTERM: DAEMON + "; sleep 60",
             "ignored": "trap '' INT TERM; " + DAEMON + "; sleep 60; sleep 60", "limit": DAEMON + "; sleep 60",
             "starter": DAEMON + "; sleep 60"}
    started = {}
    for case, command in cases.items():
        folder = tmp_path / str(case)
        folder.mkdir()
        options = ("--limit", "5") if case == "limit" else ()
        wrapped = ("sh", "-c", '"$@" & wait', "sh") if case == "starter" else ()
        started[case] = subprocess.Popen([*wrapped, *SUPERVISED, *options, "sh", "-c", command], cwd=str(folder))
    daemons = {case: daemon(tmp_path / str(case)) for case in cases}
    for case, number in ((signal.SIGINT, signal.SIGINT), (signal.SIGTERM, signal.SIGTERM), ("ignored", signal.SIGINT),
                         ("starter", signal.SIGKILL)):
        started[case].send_signal(number)
    codes = {case: process.wait(60) for case, process in started.items()}
    assert codes == {signal.SIGINT: 130, signal.SIGTERM: 143, "ignored": 130, "limit": 124, "starter": -9}
    deadline_s = time.monotonic() + 30
    while any(map(is_running, daemons.values())):  # the one whose starter was killed takes a moment
        assert time.monotonic() < deadline_s
        time.sleep(0.05)
    assert list(tmp_path.glob("*/left")) == [], "it is left behind by nobody: the runs were interrupted"


def test_descendants_have_no_process_of_others():
    sleeper = subprocess.Popen(["sleep", "60"])
    try:
        code = "import os, processes; print(processes.descendants(), sorted(processes.descendants(os.getppid())))"
        found = subprocess.check_output([sys.executable, "-c", code], text=True, env={**os.environ,
                                                                                     "PYTHONPATH": str(TEST)})
        assert found.startswith("[] [") and str(sleeper.pid) in found
    finally:
        sleeper.kill()
        sleeper.wait()
