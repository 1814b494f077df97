"""Writes docs/safety_case.md from test/safety_case.yaml, and finds what that table of faults lacks.

    safety_case.py [--check]

``--check`` changes nothing. It ends with code 1 where the page is stale; where a row names a test, module or risk that
doesn't exist; where a goal has no test, or a row no change in ``switched off`` that switches its mechanism off for one
of its tests; and where a cause, a topic, a node or a device has no row. These are taken from where they are declared:
common/causes.py, the inputs of the command path's nodes in docs/nodes.md, its headings, and the parts in
docs/wiring.md.
"""
from __future__ import annotations

import ast
import re
import sys
import textwrap
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import yaml

TEST = Path(__file__).resolve().parent
ROOT = TEST.parent
DATA, PAGE = TEST / "safety_case.yaml", ROOT / "docs" / "safety_case.md"
COMMAND_PATH = ("turn_arb", "throttle_arb", "pca9685", "generic_value_converter", "planner_interface", "teleop_logi")
TITLES = {"topic": "Messages", "wire": "Other links", "node": "Nodes", "device": "Devices", "cause": "Common causes"}
INTRODUCTION = (
    "Made by `python3 test/safety_case.py` from `test/safety_case.yaml`; `./dev lint` checks it. No standard is "
    "claimed. The item: steering, throttle and servo board of a car that a person drives, or a planner does under a "
    "person's deadman. How it stops: [Failsafe](safety.md).")
LEGEND = (
    "*Dead* is whatever sends no more; bounds count from the last message, without delays of the network and of a busy "
    "computer. *Unanswered* is what would happen. Causes are `so`; tests have their names of "
    "[safety_case.yaml](../test/safety_case.yaml), R1 is a risk of the table above.")
HEAD = ("fault", "unanswered", "answer, and its bound", "by: tests", "risk")


class Row(NamedTuple):
    """One fault of a part; ``answer`` names causes between backticks."""

    modes: list[str]
    effect: str
    answer: str
    module: str
    tests: list[str]
    risks: list[str]


class Part(NamedTuple):
    """A link, a node, a device; ``is_any``: its rows are those of every part of its kind."""

    name: str
    kind: str
    is_any: bool
    of: list[str]  # its topics, nodes or devices
    rows: list[Row]


class Case(NamedTuple):
    data: dict[str, Any]
    parts: list[Part]

    @property
    def rows(self) -> list[Row]:
        return [row for part in self.parts for row in part.rows]


def load(text: str) -> Case:
    data = yaml.load(text, getattr(yaml, "CSafeLoader", yaml.SafeLoader))
    parts = [Part(part["name"], part["kind"], part.get("any", False),
                  [name for key in ("topics", "nodes", "devices") for name in part.get(key, [])],
                  [Row(*row) for row in part["rows"]]) for part in data["parts"]]
    return Case(data, parts)


# --- what the table lacks ---

def faults(case: Case) -> list[str]:
    """Return what is wrong with the table, a line each."""
    return [*_tests(case), *_references(case), *_modes(case), *_declared(case), *_off(case)]


def _tests(case):
    tests = case.data["tests"]
    for alias, name in tests.items():
        path, _, function = name.partition("::")
        if not (TEST / path).exists():
            yield f"{alias}: there is no test/{path}"
        elif function not in _functions(TEST / path):
            yield f"{alias}: test/{path} has no {function}"
    used = {name for row in case.rows for name in row.tests}
    for goal, fields in case.data["goals"].items():
        used.update(fields["tests"])
        if not fields["tests"]:
            yield f"{goal} has no test"
    yield from (f"{alias}: tests lacks this name" for alias in sorted(used - set(tests)))
    yield from (f"{alias}: no row names this test" for alias in sorted(set(tests) - used))


@lru_cache(maxsize=None)
def _functions(path):
    return {node.name for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
            if isinstance(node, ast.FunctionDef)}


def _references(case):
    risks, used = case.data["risks"], set()
    for part in case.parts:
        for row in part.rows:
            where = f"{part.name}, {', '.join(row.modes)}"
            used.update(row.risks)
            yield from (f"{where}: there is no risk {name}" for name in row.risks if name not in risks)
            module = ROOT / "src/car_interface" / row.module
            if row.module and not (module.is_dir() or module.with_suffix(".py").exists()):
                yield f"{where}: there is no module {row.module}"
            if not row.risks and not (row.tests and row.module):
                yield f"{where}: it has neither mechanism and test nor a residual risk"
    yield from (f"{name}: no row has this risk" for name in risks if name not in used)


def _modes(case):
    for kind, modes in case.data["modes"].items():
        parts = [part for part in case.parts if part.kind == kind]
        common = {mode for part in parts if part.is_any for row in part.rows for mode in row.modes}
        for part in parts:
            found = common | {mode for row in part.rows for mode in row.modes}
            if not part.is_any:
                yield from (f"{part.name}: no row for {mode}" for mode in modes if mode not in found)
            if modes:
                yield from (f"{part.name}: {mode} is no mode of a {kind}" for mode in sorted(found - set(modes)))


def _declared(case):
    has_row = {name for part in case.parts for name in part.of}
    answers = {name for row in case.rows for name in re.findall("`([^`]+)`", row.answer)}
    yield from (f"cause {cause!r} has no row" for cause in causes() if cause not in answers | set(case.data["normal"]))
    yield from (f"topic {topic} has no row" for topic in sorted(topics() - has_row))
    yield from (f"node {node} has no row" for node in nodes() if node not in has_row | set(case.data["outside"]))
    yield from (f"device {device!r} has no row" for device in devices() if device not in has_row)


def _off(case):
    off = case.data["switched off"]
    for module, before, _, aliases in off:
        path = ROOT / "src/car_interface" / f"{module}.py"
        count = path.read_text(encoding="utf-8").count(before) if path.exists() else 0
        if count != 1:
            yield f"switched off: {before!r} stands {count} times in {module}"
        yield from (f"switched off: tests lacks {alias}" for alias in aliases if alias not in case.data["tests"])
    noticed = {(f"{module}/", alias) for module, *_, aliases in off for alias in aliases}
    for part in case.parts:
        yield from (f"{part.name}, {', '.join(row.modes)}: nothing switches {row.module} off for one of its tests"
                    for row in part.rows if row.module and not any(
                        name in row.tests and module.startswith(f"{row.module}/") for module, name in noticed))


def causes() -> list[str]:
    """Return the texts of common/causes.py."""
    tree = ast.parse((ROOT / "src/car_interface/common/causes.py").read_text(encoding="utf-8"))
    return [node.value.value for node in tree.body if isinstance(node, ast.Assign)
            and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)]


def topics() -> set[str]:
    """Return what the command path's nodes subscribe to, by the tables of docs/nodes.md."""
    found: set[str] = set()
    for section in _text("nodes.md").split("\n## ")[1:]:
        if section.partition(":")[0] in COMMAND_PATH:
            for names in re.findall(r"^in \|([^|]*)\|", section, re.M):
                found.update(re.findall("`([^`]+)`", names.partition("→")[0]))
    return found


def nodes() -> list[str]:
    """Return the nodes of docs/nodes.md, which are the headings with a colon."""
    return re.findall(r"^## (\w+): ", _text("nodes.md"), re.M)


def devices() -> list[str]:
    """Return the parts that docs/wiring.md lists."""
    table = _text("wiring.md").partition("---|---|---\n")[2].partition("\n\n")[0]
    return [line.partition(" |")[0] for line in table.splitlines()]


def _text(page):
    return (ROOT / "docs" / page).read_text(encoding="utf-8")


# --- the page ---

def page(case: Case) -> str:
    """Return the page of a table without faults."""
    data = case.data
    goals = [f"{name}|{each['text']}|{each['time']}|{', '.join(each['tests'])}" for name, each in data["goals"].items()]
    risks = [f"{name}|{what}|{remedy}" for name, (what, remedy) in data["risks"].items()]
    figures = [f"{what}|`{command}`|{found}" for what, command, found in data["figures"]]
    blocks = [
        "# Safety case: what can fail, and what answers it",
        INTRODUCTION,
        "## What it assumes",
        "\n".join(textwrap.fill(f"- {each}", 120, subsequent_indent="  ") for each in data["assumes"]),
        "## Goals", _table(("goal", "what must hold", "within", "tests"), goals),
        "## Figures", _table(("what", "command", "found"), figures),
        "## What remains, and what you can do", _table(("risk", "what remains", "what you can do"), risks),
        "## Faults", LEGEND]
    for kind, title in TITLES.items():
        lines = [line for part in case.parts if part.kind == kind for line in _lines(part)]
        blocks += [f"### {title}", _table(HEAD, lines)]
    return "\n\n".join(each if "\n" in each else textwrap.fill(each, 120) for each in blocks) + "\n"


def _lines(part):
    names = ", ".join(f"`{name}`" if part.kind in ("topic", "node") else name for name in part.of)
    if part.of != [part.name.lower()]:
        yield f"**{part.name}**{': ' if names else ''}{names}||||"
    else:
        yield f"**{part.name}**||||"
    for row in part.rows:
        by = f"`{row.module}`: {', '.join(row.tests)}" if row.module else ", ".join(row.tests)
        yield "|".join([", ".join(row.modes), row.effect, row.answer, by, ", ".join(row.risks)])


def _table(head, lines):
    return "\n".join(["|".join(head), "|".join(["---"] * len(head)), *lines])


def main() -> int:
    case = load(DATA.read_text(encoding="utf-8"))
    found = faults(case)
    text = page(case)
    if "--check" not in sys.argv:
        PAGE.write_text(text, encoding="utf-8")
    elif not PAGE.exists() or PAGE.read_text(encoding="utf-8") != text:
        found.append("docs/safety_case.md is stale: python3 test/safety_case.py")
    print(*(f"test/safety_case.yaml: {line}" for line in found), sep="\n", end="\n" if found else "")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
