"""What is known of a steering by now, by the calibration's own fit, and where least is known.

The only heavy part of the drive, a pure function of what it is given: a node calls it in a second thread.
"""
from __future__ import annotations

from typing import NamedTuple

from car_interface.calibration.delay import Delay
from car_interface.calibration.drive.step import Row
from car_interface.calibration.steering.drive import Drive
from car_interface.steering.calibration import SteeringCalibration


class FitTask(NamedTuple):
    """What to fit.

    Attributes:
        drive: the samples by now.
        base: the calibration before.
        delay, backlash_duty: by the newest full fit; ``None`` = estimate them, which takes most of the time.
        number: tasks rise; the answer to an older one is left out.
    """

    drive: Drive
    base: SteeringCalibration
    delay: Delay | None
    backlash_duty: float | None
    number: int


class Knowledge(NamedTuple):
    """What a fit found.

    Attributes:
        number: of the task.
        reason: why there is no curve yet, the end of a sentence; empty = there is one.
        duties, curvatures: the curve at the board's counts, rising, and its curvatures in 1/m, left positive.
        errors: at each, what isn't known of the curvature as a ratio of what the tool allows: above 1 it refuses.
        rows: as in Progress.
        missing: as in Progress.
        delay, backlash_duty, center_duty, center_error: of the fit; ``None`` and NaN where unknown.
    """

    number: int
    reason: str
    duties: tuple[float, ...] = ()
    curvatures: tuple[float, ...] = ()
    errors: tuple[float, ...] = ()
    rows: tuple[Row, ...] = ()
    missing: tuple[str, ...] = ()
    delay: Delay | None = None
    backlash_duty: float | None = None
    center_duty: float = float("nan")
    center_error: float = float("nan")


def assess(task: FitTask) -> Knowledge:
    """Fit what there is. Never raises: a drive without a curve is a Knowledge with a reason."""
    raise NotImplementedError
