"""Writes the tables of parameters in docs/nodes.md, from where each parameter is declared.

    node_reference.py [--check]

``--check`` changes nothing, and ends with code 1 where a table is stale. A table stands between two comments:
``<!-- parameters of NODE -->`` and ``<!--end-->``.
"""
from __future__ import annotations

import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs/nodes.md"
TABLE = re.compile(r"(<!-- parameters of (\w+) -->\n).*?(<!--end-->)", re.S)
sys.path.insert(0, str(ROOT / "src"))


def table(config: type) -> str:
    """Return the table of a configuration's parameters; those with one meaning and one range share a row."""
    from car_interface.common.declared import rows
    merged: dict = {}
    for row in rows(config):
        merged.setdefault((row.range, row.text), []).append(row)
    lines = ["parameter|default|range|meaning", "---|---|---|---"]
    for (accepted, meaning), same in merged.items():
        names, defaults = ", ".join(row.name for row in same), [row.default for row in same]
        default = defaults[0] if len(set(defaults)) == 1 else "; ".join(defaults)
        lines.append(f"{names}|{default}|{accepted}|{meaning}")
    return "\n".join(lines) + "\n"


def written(text: str) -> str:
    """Return the page with its tables as they should be."""
    from car_interface.ros.start import config_class
    return TABLE.sub(lambda found: found[1] + table(config_class(found[2])) + found[3], text)


def main() -> int:
    """Write the tables, or check them; return the exit code."""
    text = PAGE.read_text(encoding="utf-8")
    new = written(text)
    if new == text:
        return 0
    if "--check" in sys.argv:
        print("docs/nodes.md: its tables of parameters are stale: python3 test/node_reference.py")
        return 1
    PAGE.write_text(new, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
