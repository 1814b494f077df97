"""Sums up test runs: prints each failure by name and, as the last line, `N passed, N failed, N skipped`.

Each argument is the directory of one run, which holds

- junit files, anywhere below it. Those that rostest writes beside a test's own (rostest-*.xml) say only whether the
  test ran, so that of them the failures count and the passes do not;
- skipped, when tests were that rosunit counts as passed: a line each;
- exit_code, what the run's command ended with. Not 0 without a failed test is a failure: something crashed;
- left_behind, when processes outlived the run: how many. A failure too;
- not_run, instead of all these, when the run could not be made: the reason. It counts as one skipped test.

Exit code 1 when anything failed.
"""
from __future__ import annotations

import sys
from pathlib import Path
from typing import Iterator, NamedTuple
from xml.etree import ElementTree

TIMEOUT_EXIT_CODE = 124


class Tally(NamedTuple):
    """How many tests of a run passed and were skipped, and what failed, a line each."""

    passed: int
    failures: list[str]
    skipped: int


def cases(path: Path) -> Iterator[tuple[str, str, str]]:
    """Yields name, outcome (passed, failed, skipped) and message of each test in a junit file.

    Raises:
        ElementTree.ParseError: the file is cut or no XML.
    """
    for case in ElementTree.parse(str(path)).iter("testcase"):
        name = "{}.{}".format(case.get("classname", ""), case.get("name", "")).lstrip(".")
        bad = [part for part in case if part.tag in ("failure", "error")]
        if bad:
            message = bad[0].get("message") or (bad[0].text or "").strip()
            yield name, "failed", message.splitlines()[0] if message else bad[0].tag
        else:
            yield name, "skipped" if case.find("skipped") is not None else "passed", ""


def crash(directory: Path) -> str | None:
    """Says how the run's command ended when that was not well, or returns None."""
    path = directory / "exit_code"
    code = int(path.read_text()) if path.exists() else 0
    if code == TIMEOUT_EXIT_CODE:
        return "took too long and was ended"
    return f"ended with exit code {code} without a failed test" if code else None


def tally(directory: Path) -> Tally:
    """Sums up one run."""
    if (directory / "not_run").exists():
        return Tally(0, [], 1)
    outcomes = {"passed": 0, "failed": 0, "skipped": 0}
    failures, unreadable = [], []
    for path in sorted(directory.rglob("*.xml")):
        try:
            found = list(cases(path))
        except ElementTree.ParseError as error:
            unreadable.append(f"{directory.name}: its result file {path.name} is no XML: {error}")
            continue
        for name, outcome, message in found:
            if path.name.startswith("rostest-") and outcome != "failed":
                continue
            outcomes[outcome] += 1
            if outcome == "failed":
                failures.append(f"{directory.name}: {name}: {message}")
    skipped = directory / "skipped"
    if skipped.exists():
        count = len(skipped.read_text(encoding="utf-8").splitlines())
        outcomes["passed"] -= count
        outcomes["skipped"] += count
    # A test that was ended leaves an empty file behind: one failure, not two.
    failures = failures or unreadable
    how = crash(directory)
    if how and not failures:
        failures.append(f"{directory.name}: {how}")
    if not failures and not sum(outcomes.values()):
        failures.append(f"{directory.name}: no test ran")
    left = directory / "left_behind"
    if left.exists():
        failures.append(f"{directory.name}: left {left.read_text().strip()} processes behind")
    return Tally(outcomes["passed"], failures, outcomes["skipped"])


def main() -> int:
    runs = [tally(Path(argument)) for argument in sys.argv[1:]]
    failures = [line for run in runs for line in run.failures]
    for line in failures:
        print(f"FAILED {line}")
    passed, skipped = sum(run.passed for run in runs), sum(run.skipped for run in runs)
    print(f"{passed} passed, {len(failures)} failed, {skipped} skipped")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
