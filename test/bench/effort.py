"""How long to measure."""
from __future__ import annotations

from typing import NamedTuple


class Effort(NamedTuple):
    reactions: int
    chip_reactions: int
    releases: int
    heartbeat_s: float
    frames: int  # one by one
    line_s: float
    line_rounds: int
    starts: int
    memory_s: float
    drive_s: float
    cars: tuple[int, ...]
    busy_reactions: int
    busy_s: float


FULL = Effort(reactions=600, chip_reactions=300, releases=100_000, heartbeat_s=60, frames=1000, line_s=20,
              line_rounds=4, starts=10, memory_s=15, drive_s=25, cars=(1, 2, 4), busy_reactions=300, busy_s=600)
QUICK = Effort(reactions=10, chip_reactions=10, releases=1000, heartbeat_s=1, frames=20, line_s=0.3,
               line_rounds=1, starts=1, memory_s=0.5, drive_s=1, cars=(1,), busy_reactions=30, busy_s=15)
