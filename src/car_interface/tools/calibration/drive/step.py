"""What the calibration drive asks for, and how far it is: the records between its core and a node."""
from __future__ import annotations

import math
from typing import NamedTuple

# Phases of a drive, for programs; Step.text says the same to people, with numbers.
WAITING, PAUSED, SETTLING, MEASURING, TURNING, AVOIDING, BLOCKED, DONE = (
    "waiting", "paused", "settling", "measuring", "turning", "avoiding", "blocked", "done")


class Step(NamedTuple):
    """What to ask for now.

    Attributes:
        steering: for av_steer_req, −1 right to 1 left; ``None`` = ask for nothing (the button isn't held, it is over).
        speed_mps: for av_speed_req; 0 = stop.
        phase: one of the constants above:
            WAITING: the button was never held, or an input is missing: the text says which.
            PAUSED: the button was let go; it goes on when it is held again, wherever the car stands by then.
            SETTLING: it steers to the next position: past it and back, so that the backlash lies to a known side.
            MEASURING: it holds a position.
            TURNING: a tight turn back into the area.
            AVOIDING: a sonar sees something: it slows, stops, and turns to the other side.
            BLOCKED: it can't go on from here; the text says how to reposition the car.
            DONE: enough is known, or the time is over; ask for nothing any more, and conclude.
        text: the same in words, one line.
        target_duty: the position that is measured or next; 0 = none.
    """

    steering: float | None
    speed_mps: float
    phase: str
    text: str
    target_duty: int = 0


class Guidance(NamedTuple):
    """What a person who steers with the stick has to do now.

    Attributes:
        steering: where to hold the stick: tele_steer_req, −1 right to 1 left.
        held: where it is held, by the duty on the board; NaN = unknown.
        seconds_left: how long still, at this speed; 0 = the next position comes.
        phase: SETTLING (steer there, past it first), MEASURING (hold it), PAUSED (it stands or isn't driven slowly
            enough), DONE.
        text: one line for the person, such as ``push past 43 % left, then come back to 40 % left``.
        target_duty: the position.
    """

    steering: float
    held: float
    seconds_left: float
    phase: str
    text: str
    target_duty: int = 0


class RadiusRow(NamedTuple):
    """How well one radius is known, as a row of the tool's own report.

    Attributes:
        side: ``left`` or ``right``.
        radius_m: of the turn.
        duty: for it; NaN = unknown.
        radius_error: two standard errors of the radius, as a ratio of it; inf = unknown.
        is_known: the tool would write this one.
    """

    side: str
    radius_m: float
    duty: float
    radius_error: float
    is_known: bool

    @property
    def is_measured(self) -> bool:
        """Whether anything is known; with an error as large as the radius it may be any."""
        return self.radius_error < 1.0


class Progress(NamedTuple):
    """How far the drive is.

    Attributes:
        fraction: 0 to 1, for a progress bar.
        rows: per side and radius, tight first; before the first fit none.
        missing: what the tool would refuse the drive for by now, sentences; empty: it would write.
        driven_s: with the button held.
        left_s: an estimate of what is still to be driven, at most what max_time leaves.
        positions: how many positions were measured so far.
        center_duty, center_error: where it goes straight, and two standard errors; NaN: unknown.
    """

    fraction: float
    rows: tuple[RadiusRow, ...]
    missing: tuple[str, ...]
    driven_s: float
    left_s: float
    positions: int
    center_duty: float
    center_error: float


def steering_text(steering: float, middle: str = "the middle") -> str:
    """Return ``40% left`` for 0.4, and ``?`` where the steering isn't known."""
    if not math.isfinite(steering):
        return "?"
    percent = round(100 * abs(steering))
    return f"{percent}% {'left' if steering > 0 else 'right'}" if percent else middle
