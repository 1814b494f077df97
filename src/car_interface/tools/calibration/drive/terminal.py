"""The calibration drive's lines for a terminal: what to do, how far it is, what is known how well.

Pure: records in, lines of text out; ``nodes.calibration_drive`` prints them.
"""
from __future__ import annotations

import math
import textwrap
from typing import Iterable, Sequence

from car_interface.tools.calibration.drive.knowledge import Knowledge
from car_interface.tools.calibration.drive.survey import (
    AVOIDING,
    BLOCKED,
    DONE,
    MEASURING,
    PAUSED,
    SETTLING,
    TURNING,
    WAITING,
    Progress,
    Step,
    steering_text,
)
from car_interface.tools.calibration.steering.calibrate import SIGNS, Breakpoint

BAR = 24
STICK_BAR = 37  # odd: it has a middle
# What comes before the text, and a word for the phase.
BEFORE = {WAITING: "waits: ", PAUSED: "paused: ", SETTLING: "it steers ", BLOCKED: "blocked: "}
HEADLINES = {WAITING: "waits", PAUSED: "paused", SETTLING: "steers", MEASURING: "measures", TURNING: "turns back",
             AVOIDING: "avoids", BLOCKED: "blocked", DONE: "over"}
KNOWN, PARTLY, UNKNOWN = "#", "+", "."  # of a radius
LEGEND = f"{KNOWN} known   {PARTLY} not well enough   {UNKNOWN} not yet"
MAX_MISSING = 3
ENOUGH, GOES_ON = "nothing is missing", "; it goes on to know it better: F finishes now"
ADVICE = ": drive "  # to a person who drives without this guidance
REFUSED = ("what is missing stands above: drive again, longer or with more room. calibrate_steering makes one table of "
           "both recordings, too")


def introduction(by_stick: bool, radius_m: float) -> str:
    """Return what is about to happen."""
    if by_stick:
        return ("You drive, holding the manual deadman: slowly, about 1 m/s, and away from walls. It says where to "
                "hold the stick.")
    return (f"The car drives by itself while you hold the autonomous deadman, within {radius_m:g} m of where it stands "
            f"when you first hold it: {2 * radius_m:g} x {2 * radius_m:g} m have to be free. Let go, and it stops.")


def drive_lines(step: Step, progress: Progress) -> list[str]:
    """Return all of a drive's picture, for a terminal that is drawn anew; by hand with a bar of where to hold the
    stick.
    """
    is_over, points, missing = step.phase == DONE, progress.known.points, missing_lines(progress.known.missing)
    headline = [BEFORE.get(step.phase, "") + step.text] if step.held is None else [step.text, *stick_bar(step)]
    if len(missing) > MAX_MISSING:
        missing[MAX_MISSING:] = [f"missing: … and {len(missing) - MAX_MISSING} more"]
    elif points and not missing:
        missing = [ENOUGH if is_over else ENOUGH + GOES_ON]
    bar, positions = progress_bar(progress.fraction), f"{progress.positions} position{'s' * (progress.positions != 1)}"
    return [*([] if is_over else headline),  # what comes then is printed below
            f"{bar} {percent(progress.fraction)}   {_times(progress)}, {positions}",
            *known_lines(progress.known), *missing, *([LEGEND] if points else [])]


def plain_line(phase: str, text: str, progress: Progress) -> str:
    """Return one line for where nothing can be drawn anew: a log, a pipe."""
    return f"{percent(progress.fraction)}, {_times(progress)}; {phase}: {text}"


def missing_lines(missing: Iterable[str]) -> list[str]:
    """Return what is missing, without the tool's advice for a drive without step."""
    return [f"missing: {text.partition(ADVICE)[0]}" for text in missing]


def known_lines(known: Knowledge) -> list[str]:
    """Return what is known of each side, and of straight on."""
    lines = [f"{side:<6} {radius_marks(known.points.get(side, ()))}" for side in SIGNS]
    if math.isfinite(known.center_duty):
        lines.append(f"straight on: duty {known.center_duty:.0f} ± {known.center_error:.0f}")
    return lines


def progress_bar(fraction: float, length: int = BAR) -> str:
    """``[####....]``; full only when all is done."""
    full = math.floor(length * fraction)
    return f"[{'#' * full}{'.' * (length - full)}]"


def percent(fraction: float) -> str:
    """`` 24%``; 100% only when all is done."""
    return f"{math.floor(100 * fraction):3d}%"


def clock_text(seconds: float) -> str:
    """``2:05`` for 125 s."""
    return f"{round(seconds) // 60}:{round(seconds) % 60:02d}"


def stick_bar(step: Step, length: int = STICK_BAR) -> list[str]:
    """Two lines: a bar from left to right with the place to hold and where the stick is, and both in words."""
    cells = ["-"] * length
    cells[length // 2] = "+"
    if math.isfinite(step.held):
        cells[_cell(step.held, length)] = "o"
    target = _cell(step.steering, length)
    cells[target] = "X" if cells[target] == "o" else "V"
    return [f"left |{''.join(cells)}| right  V hold here, o the stick",
            f"     hold at {steering_text(step.steering)}; it is at {steering_text(step.held)}"]


def mark(point: Breakpoint) -> str:
    """Return how well a radius is known; with an error as large as the radius it may be any."""
    return KNOWN if point.is_known else PARTLY if point.radius_error < 1.0 else UNKNOWN


def radius_marks(points: Sequence[Breakpoint]) -> str:
    """Return a mark for each radius of a side, tight first: ``0.9 m ##+... 300 m: 2 of 6, 1.4 m to ±12%``."""
    if not points:
        return "nothing known yet"
    marks = "".join(map(mark, points))
    text = f"{points[0].radius_m:g} m {marks} {points[-1].radius_m:g} m: {marks.count(KNOWN)} of {len(points)}"
    worst = max((point for point in points if not point.is_known), key=lambda point: point.radius_error, default=None)
    if worst is None:
        return text
    error = f"to ±{worst.radius_error:.0%}" if mark(worst) == PARTLY else "isn't known"
    return f"{text}, {worst.radius_m:g} m {error}"


def _times(progress):
    return f"{clock_text(progress.driven_s)} driven, about {clock_text(progress.left_s)} left"


def _cell(steering, length):
    """Return which of an odd number of cells a steering falls into: left is at the left."""
    return length // 2 - round(max(-1.0, min(1.0, steering)) * (length // 2))


def wrapped(lines: Sequence[str], width: int) -> list[str]:
    """Lines that fit: a terminal that wraps them by itself can't be drawn over."""
    return [part for line in lines for part in textwrap.wrap(
        line, max(20, width - 1), subsequent_indent=" " * (2 + len(line) - len(line.lstrip())))]
