"""Keeps what a calibration drive has measured so far: samples, positions, fits, progress, time.

It is the same for a car that drives itself and for a person with the stick.
"""
from __future__ import annotations

import math

from car_interface.common.staleness import TimedInput
from car_interface.common.units import NS_PER_S
from car_interface.steering.calibration import SteeringCalibration
from car_interface.tools.calibration.drive.config import CalibrationDriveConfig
from car_interface.tools.calibration.drive.knowledge import FitTask, Knowledge
from car_interface.tools.calibration.drive.positions import Measured, Positions
from car_interface.tools.calibration.drive.samples import Motion, Samples
from car_interface.tools.calibration.drive.step import Progress

INPUT_TIMEOUT_S = 0.5  # of odometry and of the board's output
MAX_STEP_NS = NS_PER_S // 5  # the longest time from step to step that counts as driven
FULL_FIT_NS = 40 * NS_PER_S  # so often delay and backlash are estimated anew
MIN_POSITIONS = 5  # before the first fit
ENOUGH = 0.1  # of what the tool allows: an error below this anywhere ends the drive
EARLY_S = 240.0  # of the whole drive, a guess while nothing is known
MIN_LEFT_S = 5.0  # as long as it isn't over


class Survey:
    """One drive's evidence: of at most ``max_time_s`` of driving, by the calibration before."""

    def __init__(self, base: SteeringCalibration, max_time_s: float):
        self.samples = Samples()
        self.positions = Positions(base)
        self.knowledge: Knowledge | None = None  # the newest with a curve
        self.ends = (base.servo_left, base.servo_right)
        self._base = base
        self._max_time_s = max_time_s
        self._number = 0
        self._is_out = False  # a task is under way
        self._since_task = 0  # positions that were held since the newest task
        self._full_ns = -FULL_FIT_NS

    def add(self, measured: Measured) -> None:
        """Take what was measured of a position that was held for long enough."""
        self.positions.add(measured)
        self._since_task += 1

    def take_task(self, now_ns: int) -> FitTask | None:
        """Return what is to be fitted now, once."""
        if self._is_out or not self._since_task or self.positions.count < MIN_POSITIONS:
            return None
        self._is_out, self._since_task = True, 0
        self._number += 1
        known = self.knowledge
        is_full = known is None or now_ns - self._full_ns >= FULL_FIT_NS
        if is_full:
            self._full_ns = now_ns
        return FitTask(self.samples.drive(), self._base, None if is_full else known.delay,
                       None if is_full else known.backlash_duty, self._number,
                       0.0 if is_full else known.backlash_sigma)

    def update_knowledge(self, knowledge: Knowledge) -> None:
        """Take the answer to a task."""
        if knowledge.number != self._number:
            return
        self._is_out = False
        if knowledge.reason:
            return
        self.knowledge = knowledge
        self.positions.update_knowledge(knowledge, self._since_task)

    @property
    def is_enough(self) -> bool:
        """Whether all is known by far."""
        known = self.knowledge
        return (known is not None and not known.missing and not self.positions.first_left
                and max(known.errors) <= ENOUGH and not self.positions.has_gaps
                and known.number == self._number and not self._is_out)

    @property
    def servo_lag_s(self) -> float:
        """The servo's lag by the newest fit; a guess before."""
        return 0.15 if self.knowledge is None else max(0.02, self.knowledge.delay.lag_s)

    @property
    def servo_delay_s(self) -> float:
        """The servo's delay by the newest fit; a guess before."""
        return 0.05 if self.knowledge is None else self.knowledge.delay.delay_s

    def progress(self, driven_s: float) -> Progress:
        """Return how far it is after so long a drive."""
        left_s = min(max(0.0, self._max_time_s - driven_s), self._left_s(driven_s))
        fraction = driven_s / (driven_s + left_s) if driven_s > 0 else 0.0
        known = self.knowledge
        if known is None:
            missing = ("everything; the ends and straight on come first",)
            return Progress(fraction, (), missing, driven_s, left_s, self.positions.count, math.nan, math.nan)
        return Progress(fraction, known.rows, known.missing, driven_s, left_s, self.positions.count, known.center_duty,
                        known.center_error)

    def _left_s(self, driven_s):
        """Return an estimate: an error shrinks with the root of the time that is spent on it, and none has to be
        smaller than ENOUGH.
        """
        if self.is_enough:
            return 0.0
        if self.knowledge is None:
            return max(MIN_LEFT_S, EARLY_S - driven_s)
        errors = self.knowledge.errors
        ratio = sum(max(1.0, error / ENOUGH) ** 2 for error in errors) / len(errors)
        return max(MIN_LEFT_S, max(1.0, driven_s) * (ratio - 1))


class MeasuredDrive:
    """What both kinds of calibration drive have: evidence, the time that counts, and an end.

    Args:
        base: turn_arb's calibration.
    """

    OF_DRIVING = ""  # what the time that counts is, behind its number

    def __init__(self, base: SteeringCalibration, config: CalibrationDriveConfig):
        self._base, self._config = base, config
        self._survey, self._motion = Survey(base, config.max_time_s), Motion()
        self._odom, self._duty = TimedInput("odom", INPUT_TIMEOUT_S), TimedInput("/servo/output", INPUT_TIMEOUT_S)
        self._driven_ns, self._stepped_ns = 0, None
        self._now_ns = 0
        self._end = ""  # why it is over

    @property
    def samples(self) -> Samples:
        """All that was measured so far, for ``conclude``."""
        return self._survey.samples

    @property
    def driven_s(self) -> float:
        """The time that counts: that of the held button, or by hand that in which the car moved."""
        return self._driven_ns / NS_PER_S

    def take_fit_task(self) -> FitTask | None:
        """Return what is to be fitted now, once; ``None`` while one is under way, or when nothing new was measured."""
        return self._survey.take_task(self._now_ns)

    def update_knowledge(self, knowledge: Knowledge, now_ns: int) -> None:
        """Take the answer to a task; the drive goes on with what it knew until it comes."""
        self._survey.update_knowledge(knowledge)

    def progress(self, now_ns: int) -> Progress:
        """Return how far it is."""
        return self._survey.progress(self.driven_s)

    def finish(self) -> None:
        """End now, with what there is (the person asks for it): the next step is DONE."""
        self._end = self._end or f"ended by hand after {self.driven_s:.0f} s{self.OF_DRIVING}"

    def _tick(self, now_ns):
        """Return the time since the last step in ns, as much as counts of it."""
        since_ns = 0 if self._stepped_ns is None else min(now_ns - self._stepped_ns, MAX_STEP_NS)
        self._stepped_ns = self._now_ns = now_ns
        return since_ns

    def _end_if_over(self):
        """End where enough is known, or the time is over."""
        if self._survey.is_enough:
            self._end = self._end or f"enough is known after {self.driven_s:.0f} s{self.OF_DRIVING}"
        elif self.driven_s >= self._config.max_time_s:
            self._end = self._end or f"the time of {self._config.max_time_s:g} s is over"
