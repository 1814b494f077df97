"""A process runs before others where its user may."""
from __future__ import annotations

import os
import subprocess
import sys

# In a process of its own, with a thread that was there before and one that comes later.
SCRIPT = """
import os, threading
from car_interface.ros import priority

if {refused}:
    def refuse(*_):
        raise PermissionError(1, "Operation not permitted")
    os.sched_setscheduler = refuse
policies, go = [], threading.Event()

def note():
    go.wait()
    policies.append(os.sched_getscheduler(0) == os.SCHED_RR)

threads = [threading.Thread(target=note)]
threads[0].start()
done = priority.raise_priority()
threads.append(threading.Thread(target=note))
threads[1].start()
go.set()
for thread in threads:
    thread.join()
print(done, os.sched_getscheduler(0) == os.SCHED_RR, *policies)
"""


def result(refused):
    done = subprocess.run([sys.executable, "-B", "-c", SCRIPT.format(refused=refused)], capture_output=True, text=True,
                          check=True, timeout=60, env={"PYTHONPATH": ":".join(sys.path)})
    assert done.stderr == ""
    return done.stdout.split()


def may_be_real_time():
    return subprocess.run(["chrt", "--rr", "1", "true"], capture_output=True, check=False).returncode == 0


def test_all_threads_of_a_process_that_may_are_raised():
    expected = str(may_be_real_time())
    assert result(False) == [expected] * 4


def test_process_that_may_not_goes_on_as_before():
    assert os.sched_getscheduler(0) == os.SCHED_OTHER
    assert result(True) == ["False"] * 4
