"""How late this machine wakes whoever asks to be woken: what a test that measures time must know of it.

A machine with other work, too, may keep a node or the test from running for longer than the time that is measured.
Wider bounds would make a test blind on every machine; so a measurement that fails is repeated, but only if the machine
is known to have been late meanwhile, and only a few times: a fault of the code fails each of them.
"""
from __future__ import annotations

import collections
import os
import threading
import time
from typing import Any, Callable

PERIOD_S = 0.01
LATE_S = 0.015  # an idle machine's worst is a few ms
TIMES = 5
KEPT = 100_000  # wake-ups: a quarter of an hour on each CPU


class Witness:
    """A thread on each CPU that wants to be woken every 10 ms, and how late it was. A context manager."""

    def __init__(self):
        cpus = sorted(os.sched_getaffinity(0))
        self._woken: collections.deque = collections.deque(maxlen=KEPT)  # when, and how late: s
        self._due_s = dict.fromkeys(cpus, time.monotonic() + PERIOD_S)
        self._ending = threading.Event()
        self._threads = [threading.Thread(target=self._watch, args=(cpu,), daemon=True) for cpu in cpus]

    def __enter__(self) -> Witness:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_):
        self._ending.set()
        for thread in self._threads:
            thread.join()

    def _watch(self, cpu):
        os.sched_setaffinity(0, {cpu})  # of this thread alone
        while not self._ending.is_set():
            self._due_s[cpu] = time.monotonic() + PERIOD_S
            time.sleep(PERIOD_S)
            now_s = time.monotonic()
            self._woken.append((now_s, now_s - self._due_s[cpu]))

    def late_s(self, since_s: float) -> float:
        """How late the latest wake-up since then was, one that is still awaited included."""
        now_s = time.monotonic()
        return max([0.0, *(late_s for woken_s, late_s in list(self._woken) if woken_s >= since_s),
                    *(now_s - due_s for due_s in list(self._due_s.values()))])


def measured(attempt: Callable[[], Any], restore: Callable[[], Any] = lambda: None, times: int = TIMES) -> Any:
    """What ``attempt`` returns; one that fails is made again if the machine was late meanwhile.

    Args:
        attempt: makes a measurement from its beginning and asserts what must be true of it.
        restore: is called before an attempt is made again.
        times: the last of so many counts, however late the machine was.

    Raises:
        AssertionError: of an attempt that counts.
    """
    with Witness() as witness:
        for left in reversed(range(times)):
            began_s = time.monotonic()
            try:
                return attempt()
            except AssertionError as error:
                late_s = witness.late_s(began_s)
                if not left or late_s < LATE_S:
                    raise
                print(f"measured again, as this machine woke others up to {1e3 * late_s:.0f} ms late: {error}",
                      flush=True)
                restore()
    return None
