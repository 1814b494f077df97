"""Garbage is collected while all nodes of a process are idle, and at no other time."""
from __future__ import annotations

import subprocess
import sys

# In an interpreter of its own: a test run has its own garbage collection. Prints what each case collected.
SCRIPT = """
import gc
from car_interface.ros.garbage import (
    MAX_NEW_OBJECTS, MAX_POSTPONED_NS, MIN_IDLE_NS, PERIOD_NS, RETRY_NS, SETTLED_NS, IdleCollector, node_activity)

runs = []
gc.callbacks.append(lambda phase, info: runs.append(info["generation"]) if phase == "start" else None)

def cycles(count):
    for _ in range(count):
        cycle = []
        cycle.append(cycle)

def collected(case, *arguments):
    runs.clear()
    again_ns = collector.end_step(*arguments)
    print(case, runs, *[again_ns - arguments[0]] * (again_ns < float("inf")))

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

now, never = now + 10 * PERIOD_NS, float("inf")
with node_activity() as one, node_activity() as other:
    one.end_step(now, now + PERIOD_NS)
    other.begin_step()
    collected("other_in_a_step", now, never)
    other.end_step(now, now + PERIOD_NS)
    collected("what_it_sent_is_on_its_way", now + SETTLED_NS - 1, never)
    other.end_step(now, now + SETTLED_NS + MIN_IDLE_NS - 1)
    collected("other_is_due_soon", now + SETTLED_NS, never)
    other.end_step(now, now + SETTLED_NS + MIN_IDLE_NS)
    collected("both_idle", now + SETTLED_NS, never)
    now += 10 * PERIOD_NS
    other.end_step(now, now)
    collected("never_idle", now, never)
    collected("never_idle", now + MAX_POSTPONED_NS - 1, never)
    one.begin_step()
    collected("postponed_and_in_a_step", now + MAX_POSTPONED_NS, never)
    one.end_step(now + MAX_POSTPONED_NS, never)
    collected("postponed", now + MAX_POSTPONED_NS, never)
    now += 10 * PERIOD_NS
    other.begin_step()
    cycles(MAX_NEW_OBJECTS)
    collected("too_many", now, never)
now += 10 * PERIOD_NS
collected("others_have_ended", now, never)
print("retry", RETRY_NS)
"""


def test_only_idle_time_is_used_and_nothing_is_left():
    done = subprocess.run([sys.executable, "-B", "-c", SCRIPT], capture_output=True, text=True, check=True, timeout=60,
                          env={"PYTHONPATH": ":".join(sys.path)})
    assert done.stdout.splitlines() == [
        "allocations []", "busy []", "idle [2]", "too_soon []", "again [2]", "never_idle [2]", "left True",
        "set aside True",
        "other_in_a_step [] 2000000", "what_it_sent_is_on_its_way [] 2000000", "other_is_due_soon [] 2000000",
        "both_idle [2]", "never_idle [] 2000000", "never_idle [] 2000000", "postponed_and_in_a_step [] 2000000",
        "postponed [2]", "too_many [2]", "others_have_ended [2]", "retry 2000000"]
