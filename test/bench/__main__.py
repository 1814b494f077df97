"""Runs the benchmark: ``python3 test/bench``, as ``./dev bench`` does once the workspace is sourced."""
import importlib
import sys
from pathlib import Path

TEST = Path(__file__).resolve().parents[1]
# In place of this folder: what is in it is found as bench.…, and the nodes that it starts don't see it.
sys.path[:1] = [str(TEST), str(TEST / "node")]
sys.exit(importlib.import_module("bench.command_line").main())
