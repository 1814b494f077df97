"""Runs the rooms: ``python3 test/rooms``."""
import importlib
import sys
from pathlib import Path

TEST = Path(__file__).resolve().parents[1]
# In place of this folder: its modules are imported as rooms.…
sys.path[:1] = [str(TEST), str(TEST.parent / "src")]
if __name__ == "__main__":
    sys.exit(importlib.import_module("rooms.command_line").main())
