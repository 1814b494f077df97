"""Prints which of the given files Python 3.8 cannot compile. Exit code 1 when there are any.

Under another interpreter than 3.8 its parser is told to accept 3.8 only, which is nearly as strict.
"""
from __future__ import annotations

import ast
import sys


def problem(path: str) -> str | None:
    """Return in one line why Python 3.8 refuses the file, or None."""
    with open(path, encoding="utf-8") as file:
        source = file.read()
    try:
        ast.parse(source, path, feature_version=(3, 8))
        compile(source, path, "exec", dont_inherit=True)
    except SyntaxError as error:
        return f"{path}:{error.lineno}: not Python 3.8: {error.msg}"
    return None


def main() -> int:
    problems = [line for line in map(problem, sys.argv[1:]) if line]
    for line in problems:
        print(line)
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
