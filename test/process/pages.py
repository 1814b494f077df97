"""Programs that stand in docs/, for the tests that run them."""
from __future__ import annotations

from pathlib import Path

DOCS = Path(__file__).resolve().parents[2] / "docs"


def first_planner(topic: str) -> str:
    """Return the program of planners.md that publishes on a topic, as a person would copy it."""
    blocks, lines = [], []
    for line in (DOCS / "planners.md").read_text(encoding="utf-8").splitlines():
        if line.startswith("    ") or not line and lines:
            lines.append(line[4:])
        elif lines:
            blocks.append("\n".join(lines))
            lines = []
    (program,) = (block for block in blocks if f'Publisher("{topic}"' in block)
    return program
