"""Runs the linters: ``./dev lint``. Exit code 1 when they find something.

    python3 test/lint.py FOLDER_OF_THE_LINTERS
"""
from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def main(linters: str) -> int:
    """Run each of them, whatever the one before it found."""
    os.chdir(str(ROOT))
    modules = sorted(path.as_posix() for folder in ("src", "demo", "test") for path in Path(folder).rglob("*.py"))
    files = [*modules, "setup.py", "demo/demo_drive", *sorted(path.as_posix() for path in Path("scripts").iterdir())]
    commands = [
        [f"{linters}/ruff", "check", "--no-cache", "--quiet", "--output-format=concise", "."],
        [sys.executable, "-B", "test/node_reference.py", "--check"],
        [sys.executable, "-B", "test/safety_case.py", "--check"],
        # Floats have had is_integer() for ever; vermin takes every call of it for the one of integers.
        [f"{linters}/vermin", "--quiet", "--target=3.8-", "--violations", "--exclude", "int.is_integer", *files],
    ]
    failed = [command for command in commands if subprocess.run(command, check=False).returncode]
    if failed:
        print("./dev: lint found something to change", file=sys.stderr)
        return 1
    print(f"lint: nothing to change in {len(files)} Python files")
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
