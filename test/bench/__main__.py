"""Runs the benchmark: ``python3 test/bench``, as ``./dev bench`` does once the workspace is sourced."""
import importlib
import sys
from pathlib import Path

TEST = Path(__file__).resolve().parents[1]
# In place of this folder: its modules are imported as bench.…, and do not shadow those of the nodes that it starts.
sys.path[:1] = [str(TEST), str(TEST / "process")]
processes = importlib.import_module("processes")
processes.adopt_descendants()
try:
    sys.exit(importlib.import_module("bench.command_line").main())
finally:
    processes.end_descendants()
