"""The result of a calibration drive, as one message in its recording: JSON, from which bag_report makes the page."""
from __future__ import annotations

import json
from typing import Any, NamedTuple, Sequence

TOPIC = "calibration_drive/result"
MAX_NUMBER = 1e9  # no duty, curvature or radius in m is larger; as for odometry in ``columns``


class SideRow(NamedTuple):
    """What a table has for one radius to one side, and what it rests on; ± are two standard errors."""

    old_duty: float
    old_per_m: float  # the curvature that the car drives with that duty, positive
    duty: float
    duty_error: float
    radius_error: float  # as a ratio of the radius
    segments: int  # that were driven about as tight
    distance_m: float  # in these
    source: str  # driven, end or old: nothing was driven there


class CalibrationResult(NamedTuple):
    """The new table beside the old one, what it rests on, and what to do next. Curvatures are left positive."""

    refusal: str  # why no table is written; empty = it is
    lines: Sequence[str]  # on servo, center and ends, for a person
    next_steps: Sequence[str]
    radii_m: Sequence[float]
    left: Sequence[SideRow]
    right: Sequence[SideRow]
    centers: Sequence[float]  # duty: old, new
    driven: Sequence[Sequence[float]]  # duty and curvature of each position that was held
    curve: Sequence[Sequence[float]]  # duty, curvature and its ±
    old_curve: Sequence[Sequence[float]]  # duty, and its curvature by the old table

    def text(self) -> str:
        """Return it as the text of a message."""
        return json.dumps(self)


def parsed(text: str) -> CalibrationResult:
    """Return the result in a message's text.

    Raises:
        ValueError: it is no such text. Recordings come from other people.
    """
    try:
        refusal, lines, steps, radii_m, left, right, centers, driven, curve, old_curve = json.loads(text)
        sides = [[SideRow(*map(float, row[:5]), int(row[5]), float(row[6]), str(row[7])) for row in side]
                 for side in (left, right)]
        (radii_m,), (centers,) = _numbers([radii_m], len(radii_m)), _numbers([centers], 2)
        result = CalibrationResult(str(refusal), list(map(str, lines)), list(map(str, steps)), radii_m, *sides, centers,
                                   _numbers(driven, 2), _numbers(curve, 3), _numbers(old_curve, 2))
    except (TypeError, ValueError, IndexError, OverflowError, RecursionError) as error:
        raise ValueError("the calibration drive's result can't be read") from error
    if not len(result.radii_m) == len(result.left) == len(result.right):
        raise ValueError("the calibration drive's result has no table")
    return result


def _numbers(rows: Any, width: int) -> list[list[float]]:
    found = [[float(value) for value in row] for row in rows]
    if not all(len(row) == width and all(abs(value) <= MAX_NUMBER for value in row) for row in found):  # nor of NaN
        raise ValueError("these are no numbers of a car's")
    return found
