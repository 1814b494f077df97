"""Switches off the mechanisms of the safety case, one at a time, and sees that the tests that their rows name fail.

``./dev mutate --mechanisms [MODULE...]``. ``switched off`` in ``test/safety_case.yaml`` has the changes. A test of
test/process runs as it is started by ``./dev test``, with its whole file. One that hangs has noticed, too.
"""
from __future__ import annotations

import os
import signal
import subprocess
from collections import defaultdict
from pathlib import Path

from mutate import PACKAGE, Job, Key, Place, Slot, is_named, run
from safety_case import DATA, Case, load

LIMIT_S = 150.0  # that one test with a change may compute; the longest takes 60 s


def jobs_of(root: Path, case: Case, names: list[str]) -> list[Job]:
    """Return a job for each change in the named modules and each test that must notice it."""
    tests, jobs = case.data["tests"], []
    for module, before, after, aliases in case.data["switched off"]:
        path = f"{module}.py"
        if is_named(path, names):
            source = (root / PACKAGE / path).read_bytes()
            start = source.index(before.encode())
            place = Place(source.count(b"\n", 0, start) + 1, start, start + len(before.encode()), after.encode())
            jobs += [Job(Key(path, alias, before, after, 1), place, [f"test/{tests[alias]}"], LIMIT_S)
                     for alias in aliases]
    return jobs


class ProcessSlot(Slot):
    """A slot that also runs the files of test/process."""

    def _pytest(self, tests):
        if not tests[0].startswith("test/process/"):
            return super()._pytest(tests)
        file = Path(tests[0].partition("::")[0]).resolve()
        return subprocess.call(["rostest", f"--pkgdir={self._copy}", "--package=car_interface",
                                f"--results-base-dir={self._folder}", str(file).replace("_test.py", ".test")])

    def end(self) -> None:
        """End the job, and what a test of test/process has left behind in sessions of its own."""
        super().end()
        mark = f"TMPDIR={self._folder}/tmp".encode()
        for path in Path("/proc").glob("[0-9]*/environ"):
            try:
                if mark in path.read_bytes().split(b"\0"):
                    os.kill(int(path.parent.name), signal.SIGKILL)
            except OSError:
                pass  # it has ended, or is another user's


def report(root: Path, slots: list[Slot], names: list[str]) -> int:
    """Run and print; return 1 if a test passed without the mechanism that it is named for."""
    count, passed = 0, defaultdict(list)
    for result in run(slots, jobs_of(root, load(DATA.read_text(encoding="utf-8")), names)):
        key = result.job.key  # its function is the test's name
        count += 1
        print(f"{'PASSED ' if result.passed else 'noticed'} {key.module} {key.line!r} → {key.change!r}: {key.function}",
              flush=True)
        if result.passed:
            passed[key.module].append(key.function)
    print(f"{count} tests without their mechanisms: {count - sum(map(len, passed.values()))} failed, as they should",
          *(f"  {module}: {', '.join(aliases)} passed" for module, aliases in passed.items()), sep="\n")
    return 1 if passed else 0
