"""Findings: how bad, about what, what it is, and what to do about it; how they look in a terminal; and how a look at
something becomes one that hangs, fails, or is made on a busy computer.
"""
from __future__ import annotations

import textwrap
import threading
import time
from concurrent.futures import Future
from typing import Any, Callable, NamedTuple, Sequence

from car_interface.ros.clocks import SYSTEM

OK, WARN, BAD = range(3)  # also the exit codes, and the levels of diagnostic_msgs/DiagnosticStatus
BY_SILENCE = True  # of a finding

_NAMES = ("ok", "warn", "bad")
_MEANINGS = ("nothing to do", "nothing that is bad; read the warnings", "begin with the first that is bad")
_COLOURS = ("\033[32m", "\033[1;33m", "\033[1;31m")
_PLAIN = "\033[0m"
SUBJECT_WIDTH = 10
NARROWEST = 60  # below it a line would be all indentation
TICK_S = 0.02


class Finding(NamedTuple):
    """What one check found."""

    level: int  # OK, WARN (the car may drive) or BAD (it can't, or shouldn't)
    subject: str  # what was examined, one word
    what: str  # what was found
    remedy: str = ""  # what to do or type next; empty only when it's OK
    by_silence: bool = False  # whether it follows from an answer that didn't come in time


def all_of(subject: str, *cases: tuple) -> list[Finding]:
    """Return the findings of all cases that hold.

    A case is whether it does, the level, what, and, where that is needed, the remedy and BY_SILENCE.
    """
    return [Finding(level, subject, *texts) for holds, level, *texts in cases if holds]


def first(subject: str, *cases: tuple) -> list[Finding]:
    """Return the finding of the first case that holds, if one does, likewise."""
    return all_of(subject, *cases)[:1]


def worst(findings: Sequence[Finding]) -> int:
    """Return the highest level: the exit code."""
    return max(finding.level for finding in findings)


def render(finding: Finding, width: int | None = None, colour: bool = False) -> str:
    """Return a finding as text, wrapped for a terminal's ``width`` in columns; ``None`` = one long line, for a pipe."""
    name = f"{_NAMES[finding.level]:4}"
    head = f"{name}  {finding.subject:{SUBJECT_WIDTH}}  "
    parts = [" ".join(part.split()) for part in (finding.what, finding.remedy and f"remedy: {finding.remedy}") if part]
    if width is None:
        text = head + " | ".join(parts)
    else:
        blank = " " * len(head)
        indents = ((head, blank), (blank, blank + " " * len("remedy: ")))
        text = "\n".join(textwrap.fill(part, max(NARROWEST, width), initial_indent=first, subsequent_indent=later,
                                       break_long_words=False, break_on_hyphens=False)
                         for part, (first, later) in zip(parts, indents))
    return _COLOURS[finding.level] + name + _PLAIN + text[len(name):] if colour else text


def summarise(findings: Sequence[Finding], colour: bool = False) -> str:
    """Return the last line: how many of each kind, and what that means."""
    levels = [finding.level for finding in findings]
    counts = ", ".join(f"{levels.count(level)} {_NAMES[level]}" for level in (BAD, WARN, OK) if level in levels)
    text = f"{counts}: {_MEANINGS[worst(findings)]}"
    return f"{_COLOURS[worst(findings)]}{text}{_PLAIN}" if colour else text


class Task:
    """Runs ``probe(*arguments)`` in a thread, so that it may hang; a finding about ``subject`` says that it does."""

    def __init__(self, subject: str, probe: Callable[..., Any], *arguments: Any):
        self._subject = subject
        self._outcome: Future = Future()
        # Not one of an executor's: Python waits for those when it ends, also after Ctrl-C.
        threading.Thread(target=self._run, args=(probe, arguments), name=subject, daemon=True).start()

    def _run(self, probe, arguments):
        try:
            self._outcome.set_result(probe(*arguments))
        except Exception as error:  # no fault of one probe may end the others
            self._outcome.set_exception(error)

    def wait(self, deadline_s: float) -> tuple[Any, list[Finding]]:
        """Return the result, or ``None`` and what went wrong, by a deadline of the monotonic clock."""
        if not SYSTEM.wait_for(self._outcome.done, deadline_s - time.monotonic(), TICK_S):
            return None, [Finding(BAD, self._subject, "no answer in time: given up",
                                  "See whether a device hangs: dmesg", by_silence=True)]
        error = self._outcome.exception()
        if error is not None:
            what = f"the doctor couldn't look at it: {type(error).__name__}: {error}"
            return None, [Finding(BAD, self._subject, what, "See the line of the versions first")]
        return self._outcome.result(), []

    def findings(self, deadline_s: float) -> list[Finding]:
        """Return the result of a probe that returns findings, or what went wrong."""
        result, trouble = self.wait(deadline_s)
        return trouble or result


class PaceWatch:
    """Notices whether this computer is too busy for the doctor's time limits to mean anything."""

    def __init__(self):
        self._start_s = time.monotonic()
        self._ticks = 0
        threading.Thread(target=self._count, name="pace", daemon=True).start()

    def _count(self):
        while True:
            time.sleep(TICK_S)
            self._ticks += 1

    def is_busy(self) -> bool:
        """Return whether a thread that sleeps got less than half of its turns."""
        return 2 * TICK_S * self._ticks < time.monotonic() - self._start_s - TICK_S
