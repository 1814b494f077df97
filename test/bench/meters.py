"""CPU time and memory of processes, and of the whole machine, by /proc (proc(5))."""
from __future__ import annotations

import os
import time

from processes import descendants

GUARD = "car_interface.nodes.pca9685.pca9685_guard"  # an argument of its command line
TICKS_PER_S = os.sysconf("SC_CLK_TCK")


class CpuMeter:
    def __init__(self, *pids: int):
        self._pids = pids
        self._begun_s, self._used_s = time.monotonic(), sum(map(cpu_s, pids))

    def percent(self) -> float:
        return 100 * (sum(map(cpu_s, self._pids)) - self._used_s) / (time.monotonic() - self._begun_s)


def with_guard(pid: int) -> list[int]:
    """Return a node's process and, if it has the servo board, the guard's. The virtual chip's is no part of a car."""
    return [pid, *(child for child in descendants(pid) if GUARD in _command_line(child))]


def _command_line(pid):
    try:
        with open(f"/proc/{pid}/cmdline", encoding="utf-8", errors="replace") as file:
            return file.read().split("\0")
    except OSError:
        return []  # it has just ended


def cpu_s(pid: int, with_children: bool = False) -> float:
    """Return user and system time of a process, s, in steps of 10 ms; also that of its ended children, if asked for."""
    with open(f"/proc/{pid}/stat", encoding="utf-8", errors="replace") as file:
        fields = file.read().rpartition(")")[2].split()  # after the name, which may hold anything
    return sum(map(int, fields[11:15 if with_children else 13])) / TICKS_PER_S


def rss_mb(pid: int) -> float:
    return _kb(f"/proc/{pid}/status", "VmRSS:") / 1000


def pss_mb(pid: int) -> float:
    """Return the same, with its ratio of the pages that it shares with other processes, MB."""
    return _kb(f"/proc/{pid}/smaps_rollup", "Pss:") / 1000


def _kb(path, key):
    with open(path, encoding="utf-8", errors="replace") as file:
        return next(int(line.split()[1]) for line in file if line.startswith(key))


class OthersMeter:
    """The CPU time that programs outside this run have used since this was made: they disturb it."""

    def __init__(self):
        self._begun_s, self._before_s = time.monotonic(), self._others_s()

    @staticmethod
    def _others_s():
        with open("/proc/stat", encoding="ascii") as file:
            ticks = [int(field) for field in file.readline().split()[1:9]]
        idle, ours_s = ticks[3] + ticks[4], 0.0
        for pid in (os.getpid(), *descendants()):
            try:
                ours_s += cpu_s(pid, with_children=True)
            except OSError:
                pass  # it has just ended
        return (sum(ticks) - idle) / TICKS_PER_S - ours_s

    def percent(self) -> float:
        return max(0.0, 100 * (self._others_s() - self._before_s) / (time.monotonic() - self._begun_s))
