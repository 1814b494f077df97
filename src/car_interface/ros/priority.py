"""Lets a process run before the other programs of a busy computer, where its user may: docs/safety.md."""
from __future__ import annotations

import os

TASKS = "/proc/self/task"


def raise_priority() -> bool:
    """Give all threads of this process the lowest real-time priority; whether its user may.

    SCHED_RR, since a nice value counts only among the programs of one session, and roslaunch gives each node a session
    of its own (sched(7), "The autogroup feature"). Threads and processes that are started later inherit it. Linux
    leaves a twentieth of each core to the others, even if a node never rested.
    """
    try:
        for task in os.listdir(TASKS):
            os.sched_setscheduler(int(task), os.SCHED_RR, os.sched_param(os.sched_get_priority_min(os.SCHED_RR)))
    except ProcessLookupError:
        return raise_priority()  # a thread has ended meanwhile
    except OSError:
        return False
    return True
