"""When a person has to place the car: positions to one side are missing, and it only ever turns to the other.

A car that turns widely goes from one turn to the next one to the same side, as no way across the area leads to one to
the other side that stays inside.
"""
from __future__ import annotations

import math
from typing import Sequence

LOST_RAD = 3 * 2 * math.pi  # turned to the other side meanwhile


class LostTurns:
    """The tight turns of one car: 0 = to the left, 1 = to the right.

    Attributes:
        asked: the one for which a person is asked to place the car; ``None`` = nobody is.
    """

    def __init__(self):
        self.asked: int | None = None
        self._since_rad = [0.0, 0.0]  # turned to the other side since each was driven last

    def update_motion(self, turned_rad: float) -> None:
        """By how much the heading changed, left positive."""
        self._since_rad[0] += max(0.0, -turned_rad)
        self._since_rad[1] += max(0.0, turned_rad)

    def drive(self, side: int) -> int | None:
        """A tight turn to that side is driven now: the other one, if it is lost."""
        self._since_rad[side] = 0.0
        return 1 - side if self._since_rad[1 - side] >= LOST_RAD else None

    def ask(self, side: int) -> None:
        """Ask a person for that one; again after three more turns to the other side."""
        self.asked, self._since_rad[side] = side, 0.0

    def text(self, turns_per_m: Sequence[float]) -> str:
        """What to do, for a person.

        Args:
            turns_per_m: the curvatures of the turns, (2,).
        """
        name, radius_m = ("left", "right")[self.asked], 1 / abs(turns_per_m[self.asked])
        return (f"{name} turns are missing, and no way leads to one: place the car so that the middle is about "
                f"{radius_m:.1f} m to its {name}, by hand or by the manual deadman, then hold the button again")
