"""What the calibration drive asks for, and how far it is: the records between its core and a node."""
from __future__ import annotations

import math
from typing import NamedTuple

# Phases of a drive, for programs; Step.text says the same to people, with numbers.
WAITING = "waiting"  # the button was never held, or an input is missing: the text says which
PAUSED = "paused"  # the button was let go; it goes on when it is held again, wherever the car stands by then
SETTLING = "settling"  # it steers to the next position: past it and back, so that the backlash lies to a known side
MEASURING = "measuring"  # it holds a position
TURNING = "turning"  # a tight turn back into the area
AVOIDING = "avoiding"  # a sonar sees something: it slows, stops, and turns to the other side
BLOCKED = "blocked"  # it can't go on from here; the text says how to reposition the car
DONE = "done"  # enough is known, or the time is over; ask for nothing any more, and conclude


class Step(NamedTuple):
    """What to ask for now."""

    # for av_steer_req, −1 right to 1 left; ``None`` = ask for nothing (the button isn't held, it is over); by hand
    # where to hold the stick
    steering: float | None
    speed_mps: float  # for av_speed_req; 0 = stop
    # one of the constants above; by hand PAUSED (it stands or isn't driven slowly enough), SETTLING (steer there, past
    # it first), MEASURING (hold it) or DONE
    phase: str
    text: str  # the same in words, one line
    target_duty: int = 0  # the position that is measured or next; 0 = none
    held: float | None = None  # by hand where the stick is held, by the duty on the board; NaN = unknown


class RadiusRow(NamedTuple):
    """How well one radius is known, as a row of the tool's own report."""

    side: str  # ``left`` or ``right``
    radius_m: float  # of the turn
    duty: float  # for it; NaN = unknown
    radius_error: float  # two standard errors of the radius, as a ratio of it; inf = unknown
    is_known: bool  # the tool would write this one

    @property
    def is_measured(self) -> bool:
        """Whether anything is known; with an error as large as the radius it may be any."""
        return self.radius_error < 1.0


class Progress(NamedTuple):
    """How far the drive is."""

    fraction: float  # 0 to 1, for a progress bar
    rows: tuple[RadiusRow, ...]  # per side and radius, tight first; before the first fit none
    missing: tuple[str, ...]  # what the tool would refuse the drive for by now, sentences; empty: it would write
    driven_s: float  # with the button held
    left_s: float  # an estimate of what is still to be driven, at most what max_time leaves
    positions: int  # how many positions were measured so far
    center_duty: float  # where it goes straight; NaN: unknown
    center_error: float  # two standard errors of that


def steering_text(steering: float, middle: str = "the middle") -> str:
    """Return ``40% left`` for 0.4, and ``?`` where the steering isn't known."""
    if not math.isfinite(steering):
        return "?"
    percent = round(100 * abs(steering))
    return f"{percent}% {'left' if steering > 0 else 'right'}" if percent else middle
