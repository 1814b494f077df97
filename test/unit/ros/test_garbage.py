"""Garbage is collected while a node is idle, and at no other time."""
from __future__ import annotations

import subprocess
import sys

# In an interpreter of its own: a test run has its own garbage collection. Prints what each case collected.
SCRIPT = """
import gc
from car_interface.ros.garbage import MAX_NEW_OBJECTS, MIN_IDLE_NS, PERIOD_NS, IdleCollector

runs = []
gc.callbacks.append(lambda phase, info: runs.append(info["generation"]) if phase == "start" else None)

def cycles(count):
    for _ in range(count):
        cycle = []
        cycle.append(cycle)

def collected(case, *arguments):
    runs.clear()
    collector.step(*arguments)
    print(case, runs)

collector = IdleCollector()
before = len(gc.get_objects())
runs.clear()
cycles(MAX_NEW_OBJECTS // 2)
print("allocations", runs)
now = 10 * PERIOD_NS
collected("busy", now, now + MIN_IDLE_NS - 1)
collected("idle", now, now + MIN_IDLE_NS)
collected("too_soon", now + PERIOD_NS - 1, now + 10 * PERIOD_NS)
collected("again", now + PERIOD_NS, float("inf"))
cycles(MAX_NEW_OBJECTS)
collected("never_idle", now + 2 * PERIOD_NS, now + 2 * PERIOD_NS)
print("left", len(gc.get_objects()) - before < 100)
print("set aside", gc.get_freeze_count() > 10 * before)
"""


def test_only_idle_time_is_used_and_nothing_is_left():
    done = subprocess.run([sys.executable, "-B", "-c", SCRIPT], capture_output=True, text=True, check=True, timeout=60,
                          env={"PYTHONPATH": ":".join(sys.path)})
    assert done.stdout.splitlines() == [
        "allocations []", "busy []", "idle [2]", "too_soon []", "again [2]", "never_idle [2]", "left True",
        "set aside True"]
