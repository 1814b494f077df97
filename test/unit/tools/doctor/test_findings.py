"""A look in a thread of its own: its result, its fault, or that it hangs."""
import subprocess
import sys
import threading
import time

import pytest

from car_interface.tools.doctor import cli, findings
from car_interface.tools.doctor.findings import BAD, OK, WARN, Finding, PaceWatch, Task

FINE = [Finding(OK, "bus", "/dev/i2c-1")]


def soon():
    return time.monotonic() + 30.0


def test_task_gives_the_result_of_its_look_or_its_fault_as_a_finding():
    assert Task("bus", lambda *arguments: arguments, 1, 2).wait(soon()) == ((1, 2), [])
    assert Task("bus", lambda: FINE).findings(soon()) == FINE
    def look():
        raise KeyError("what")
    found, = Task("bus", look).findings(soon())
    assert (found.level, found.subject) == (BAD, "bus") and "KeyError: 'what'" in found.what


def test_look_that_hangs_is_a_finding_at_its_deadline():
    released = threading.Event()
    task = Task("bus", released.wait)
    found, = task.findings(time.monotonic() + 0.1)
    assert (found.level, found.what) == (BAD, "no answer in time: given up")
    released.set()


def test_look_that_hangs_does_not_keep_a_program_from_ending_that_is_interrupted():
    program = ("import threading; from car_interface.tools.doctor.findings import Task; "
               "Task('bus', threading.Event().wait); raise KeyboardInterrupt")
    ended = subprocess.run([sys.executable, "-c", program], stderr=subprocess.PIPE, timeout=60, check=False)
    assert ended.stderr.endswith(b"KeyboardInterrupt\n")


@pytest.mark.parametrize("ticks, elapsed_s, is_busy", [(0, 0.01, False), (49, 1.0, False), (20, 1.0, True)])
def test_computer_is_busy_where_a_thread_that_sleeps_gets_less_than_half_of_its_turns(monkeypatch, ticks, elapsed_s,
                                                                                      is_busy):
    monkeypatch.setattr(PaceWatch, "_count", lambda self: None)
    now_s = [100.0]
    monkeypatch.setattr(findings.time, "monotonic", lambda: now_s[0])
    pace = PaceWatch()
    pace._ticks = ticks
    now_s[0] += elapsed_s
    assert pace.is_busy() == is_busy


@pytest.mark.parametrize("is_busy", [False, True])
def test_answer_that_did_not_come_is_bad_unless_the_computer_is_busy(monkeypatch, capsys, is_busy):
    monkeypatch.setattr(PaceWatch, "is_busy", lambda self: is_busy)
    worst = cli.show([Finding(BAD, "nodes", "/turn_arb is registered, but doesn't answer", "End it", by_silence=True),
                      Finding(WARN, "bus", "there is no such bus", "Switch it on")])
    silent, absent, _ = capsys.readouterr().out.splitlines()
    assert absent == "warn  bus         there is no such bus | remedy: Switch it on"
    assert worst == (WARN if is_busy else BAD)
    assert silent == (
        "warn  nodes       couldn't check, as this computer is busy: /turn_arb is registered, but doesn't answer | "
        "remedy: See what keeps it busy (top), and run the doctor again" if is_busy else
        "bad   nodes       /turn_arb is registered, but doesn't answer | remedy: End it")
