"""Counts the results of a step of the tests (test/run.py) by what is in its folder.

- junit files, anywhere below it. Those that rostest writes beside a test's own (rostest-*.xml) report only whether the
  test ran: their failures count and their passes do not.
- skipped: a line for each skipped test that rosunit counts as passed.
- exit_code: of the step's command. Not 0 without a failed test is a failure: something crashed.
- why_ended: the reason, if the step did not end by itself. A failure too.
- left_behind: how many processes outlived the command, if any did. A failure too.
"""
from __future__ import annotations

from pathlib import Path
from typing import Iterable, Iterator, NamedTuple
from xml.etree import ElementTree


class Tally(NamedTuple):
    """How many tests passed and were skipped, and what failed: name and message of each."""

    passed: int = 0
    failures: tuple[str, ...] = ()
    skipped: int = 0

    @staticmethod
    def sum(tallies: Iterable[Tally]) -> Tally:
        passed, failures, skipped = zip(Tally(), *tallies)
        return Tally(sum(passed), sum(failures, ()), sum(skipped))

    def lines(self) -> list[str]:
        return [f"FAILED {failure}" for failure in self.failures]

    def __str__(self) -> str:
        return f"{self.passed} passed, {len(self.failures)} failed, {self.skipped} skipped"


def cases(path: Path) -> Iterator[tuple[str, str, str]]:
    """Yield name, outcome (passed, failed, skipped) and message of each test in a junit file.

    Raises:
        ElementTree.ParseError: the file is incomplete or no XML.
    """
    for case in ElementTree.parse(str(path)).iter("testcase"):
        name = "{}.{}".format(case.get("classname", ""), case.get("name", "")).lstrip(".")
        bad = [part for part in case if part.tag in ("failure", "error")]
        if bad:
            message = bad[0].get("message") or (bad[0].text or "").strip()
            yield name, "failed", message.splitlines()[0] if message else bad[0].tag
        else:
            yield name, "skipped" if case.find("skipped") is not None else "passed", ""


def crash(folder: Path) -> str | None:
    """Return how the step's command ended, or None when its exit code was 0."""
    path = folder / "exit_code"
    code = int(path.read_text()) if path.exists() else 0
    return f"ended with exit code {code} without a failed test" if code else None


def tally(folder: Path) -> Tally:
    outcomes = {"passed": 0, "failed": 0, "skipped": 0}
    failures, unreadable = [], []
    for path in sorted(folder.rglob("*.xml")):
        try:
            found = list(cases(path))
        except ElementTree.ParseError as error:
            unreadable.append(f"its result file {path.name} is no XML: {error}")
            continue
        for name, outcome, message in found:
            if path.name.startswith("rostest-") and outcome != "failed":
                continue
            outcomes[outcome] += 1
            if outcome == "failed":
                failures.append(f"{name}: {message}")
    skipped = folder / "skipped"
    if skipped.exists():
        count = len(skipped.read_text(encoding="utf-8").splitlines())
        outcomes["passed"] -= count
        outcomes["skipped"] += count
    why_ended = folder / "why_ended"
    if why_ended.exists():
        failures.append(why_ended.read_text(encoding="utf-8"))
    # A test that was ended leaves an empty file: one failure, not two.
    failures = failures or unreadable
    how = crash(folder)
    if how and not failures:
        failures.append(how)
    if not failures and not sum(outcomes.values()):
        failures.append("no test ran")
    left = folder / "left_behind"
    if left.exists():
        failures.append(f"left {left.read_text().strip()} processes behind")
    return Tally(outcomes["passed"], tuple(f"{folder.name}: {failure}" for failure in failures), outcomes["skipped"])
