"""A look in a thread of its own: its result, its fault, or that it hangs."""
from __future__ import annotations

import threading
import time

from car_interface.tools.doctor.examination import Task
from car_interface.tools.doctor.findings import BAD, OK, Finding

FINE = [Finding(OK, "bus", "/dev/i2c-1")]


def soon():
    return time.monotonic() + 5.0


def test_task_gives_the_result_of_its_look():
    assert Task("bus", lambda *arguments: arguments, 1, 2).wait(soon()) == ((1, 2), [])
    assert Task("bus", lambda: FINE).findings(soon()) == FINE


def test_look_that_fails_is_a_finding_and_ends_nothing_else():
    def look():
        raise KeyError("what")
    found, = Task("bus", look).findings(soon())
    assert (found.level, found.subject) == (BAD, "bus") and "KeyError: 'what'" in found.what


def test_look_that_hangs_is_a_finding_at_its_deadline():
    released = threading.Event()
    task = Task("bus", released.wait)
    begin_s = time.monotonic()
    found, = task.findings(begin_s + 0.1)
    assert (found.level, found.what) == (BAD, "no answer in time: given up")
    assert time.monotonic() - begin_s < 3.0
    released.set()
