"""Runs the doctor as a user does, and what it showed."""
from __future__ import annotations

import os
import re
import subprocess
import time
from typing import NamedTuple

from waiting import executable

OK, WARN, BAD = "ok", "warn", "bad"
CODES = {OK: 0, WARN: 1, BAD: 2}
ATTEMPTS = 3
GIVEN_UP = "no answer in time: given up"
MOST_S = 20.0  # less than 10 s on a machine that has nothing else to do


class Examination(NamedTuple):
    """What one run of the doctor showed."""

    code: int
    lines: list
    errors: str
    took_s: float

    @property
    def findings(self) -> list:
        """Level, subject and text of each finding."""
        found = [re.match(r"(ok|warn|bad) +(\S+) +(.*)", line) for line in self.lines[:-1]]
        return [match.groups() for match in found]

    def of(self, subject: str) -> list:
        """Level and text of each finding about a subject."""
        return [(level, text) for level, about, text in self.findings if about == subject]

    def __str__(self):
        return "\n".join([*self.lines, self.errors])


def run(*command, env=None, cwd=None) -> subprocess.CompletedProcess:
    """Run a program to its end, in pipes."""
    return subprocess.run(command, env=env, cwd=cwd, stdin=subprocess.DEVNULL, capture_output=True, text=True,
                          timeout=60, check=False)


def examine(*options, cwd=None, **environment) -> Examination:
    """Run the doctor as a user does, in a pipe; again when this computer was too busy for it."""
    for _ in range(ATTEMPTS):
        examination = _examine_once(options, cwd, environment)
        if GIVEN_UP not in str(examination):
            break
    return examination


def _examine_once(options, cwd, environment):
    began_s = time.monotonic()
    done = run(executable("doctor"), *options, env={**os.environ, **environment}, cwd=cwd)
    return Examination(done.returncode, done.stdout.splitlines(), done.stderr, time.monotonic() - began_s)


def check_order(test, examination: Examination) -> None:
    """Every line has its level, its remedy where one is due; the last one sums up; the exit code is the worst."""
    shown = str(examination)
    test.assertNotIn("Traceback", shown)
    test.assertEqual(examination.errors, "")
    levels = []
    for line in examination.lines[:-1]:
        test.assertRegex(line, r"^(ok  |warn|bad )  \S+ +\S", shown)
        levels.append(line[:4].strip())
        test.assertEqual(" | remedy: " in line, levels[-1] != OK, line)
    counts = ", ".join(f"{levels.count(level)} {level}" for level in (BAD, WARN, OK) if level in levels)
    test.assertTrue(examination.lines[-1].startswith(f"{counts}: "), shown)
    test.assertEqual(examination.code, max(CODES[level] for level in levels), shown)
    test.assertLess(examination.took_s, MOST_S)
