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
    def start(command, *options):
        return subprocess.Popen([sys.executable, str(TEST / "processes.py"), *options, "--left-behind", "left", "sh",
                                 "-c", command], cwd=str(tmp_path))
    return start


@pytest.mark.parametrize("command, code", [("exit 0", 0), ("exit 7", 7), ("kill -9 $$", 128 + 9)])
def test_exit_code_is_the_command_s(run, tmp_path, command, code):
    assert run(command).wait(60) == code
    assert not (tmp_path / "left").exists()


def test_daemon_that_the_command_leaves_is_counted_and_ended(run, tmp_path):
    assert run(DAEMON).wait(60) == 0
    assert (tmp_path / "left").read_text(encoding="ascii") == "1"
    assert not is_running(daemon(tmp_path))


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_signal_ends_command_and_daemon(run, tmp_path, number):
    process = run(DAEMON + "; sleep 60")
    pid = daemon(tmp_path)
    process.send_signal(number)
    assert process.wait(60) == 128 + number
    assert not is_running(pid)
    assert not (tmp_path / "left").exists(), "it is left behind by nobody: the run was interrupted"


def test_process_that_ignores_interrupts_is_ended_too(run, tmp_path):
    process = run("trap '' INT TERM; " + DAEMON + "; sleep 60; sleep 60")
    pid = daemon(tmp_path)
    process.send_signal(signal.SIGINT)
    assert process.wait(60) == 128 + signal.SIGINT
    assert not is_running(pid)


def test_time_limit_ends_command_and_daemon(run, tmp_path):
    assert run(DAEMON + "; sleep 60", "--limit", "1").wait(60) == 124
    assert not is_running(daemon(tmp_path))


def test_end_of_the_starting_process_ends_command_and_daemon(tmp_path):
    starter = subprocess.Popen(["sh", "-c", '"$@" & wait', "sh", sys.executable, str(TEST / "processes.py"), "sh", "-c",
                                DAEMON + "; sleep 60"], cwd=str(tmp_path))
    pid = daemon(tmp_path)
    starter.kill()
    starter.wait(60)
    deadline_s = time.monotonic() + 30
    while is_running(pid):
        assert time.monotonic() < deadline_s
        time.sleep(0.05)


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
