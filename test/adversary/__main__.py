"""Command line: see the package's docstring."""
import sys
from pathlib import Path

TEST = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(TEST), str(TEST.parent / "src")]

from adversary.runs import main  # noqa: E402

if __name__ == "__main__":
    sys.exit(main())
