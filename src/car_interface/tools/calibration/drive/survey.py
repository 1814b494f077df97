"""Keeps what a calibration drive has measured so far: motion, samples for a fit, positions, fits, progress, time.

It is the same for a car that drives itself and for a person with the stick.
"""
from __future__ import annotations

import math
from array import array
from collections import deque

import numpy as np

from car_interface.common.staleness import TimedInput
from car_interface.common.units import NS_PER_S
from car_interface.steering.calibration import SteeringCalibration
from car_interface.tools.calibration.drive.area import Pose
from car_interface.tools.calibration.drive.config import CalibrationDriveConfig
from car_interface.tools.calibration.drive.knowledge import Knowledge
from car_interface.tools.calibration.drive.positions import Measured, Positions
from car_interface.tools.calibration.drive.step import Progress
from car_interface.tools.calibration.shared import is_pulse
from car_interface.tools.calibration.steering.drive import CurveFitConfig, SteeringDrive, distance_m
from car_interface.tools.recordings.columns import Odom

WINDOW_S = 0.25
MIN_WINDOW_M = 0.08  # a shorter way shows no curvature
MAX_STEP_S = 0.3  # between two odometries that belong together

INPUT_TIMEOUT_S = 0.5  # of odometry and of the board's output
MAX_STEP_NS = NS_PER_S // 5  # the longest time from step to step that counts as driven
FULL_FIT_NS = 40 * NS_PER_S  # so often delay and backlash are estimated anew
MIN_POSITIONS = 5  # before the first fit
ENOUGH = 0.1  # of what the tool allows: an error below this anywhere ends the drive
EARLY_S = 240.0  # of the whole drive, a guess while nothing is known
MIN_LEFT_S = 5.0  # as long as it isn't over
NOTHING_KNOWN = Knowledge(missing=("everything; the ends and straight on come first",))


class Motion:
    """The car's pose (its yaw unwrapped), speed (forward positive) and curvature by its newest odometry."""

    def __init__(self):
        self.pose = Pose(0.0, 0.0, 0.0)
        self.speed_mps = 0.0
        self._at_ns: int | None = None
        self._window: deque = deque()  # (time, distance, change of yaw)

    def update(self, pose: Pose, speed_mps: float, at_ns: int) -> tuple[float, float]:
        """Take an odometry: (the distance since the last one, backward negative; the change of yaw)."""
        since_s = 0.0 if self._at_ns is None else (at_ns - self._at_ns) / NS_PER_S
        turned_rad = math.remainder(pose.yaw_rad - self.pose.yaw_rad, 2 * math.pi)
        moved_m = math.copysign(math.hypot(pose.x_m - self.pose.x_m, pose.y_m - self.pose.y_m), speed_mps)
        if self._at_ns is None or not 0 < since_s <= MAX_STEP_S:
            moved_m = 0.0
            self._window.clear()
        self.pose = pose._replace(yaw_rad=self.pose.yaw_rad + turned_rad)
        self.speed_mps, self._at_ns = speed_mps, at_ns
        self._window.append((at_ns, moved_m, turned_rad))
        while self._window[0][0] < at_ns - WINDOW_S * NS_PER_S:
            self._window.popleft()
        return (moved_m, turned_rad) if moved_m else (0.0, 0.0)

    def curvature_per_m(self) -> float | None:
        """Return the path's curvature in the last quarter of a second, left positive; ``None``: it hardly moved."""
        distance_m = sum(entry[1] for entry in self._window)
        if distance_m < MIN_WINDOW_M:
            return None
        return sum(entry[2] for entry in self._window) / distance_m


class Samples:
    """Odometry and duties of a drive.

    Times are on one scale, in nanoseconds: of odometry when it was measured, of duties when they arrived. Memory: 40
    bytes for each odometry and 16 for each duty, 0.7 MB for five minutes.
    """

    def __init__(self):
        self._odom = tuple(array("d") for _ in range(5))  # t_s, x_m, y_m, yaw_rad (unwrapped), speed_mps
        self._duty = tuple(array("d") for _ in range(2))  # t_s, duty
        self._first_ns = None

    def __len__(self) -> int:
        """Return how many odometries there are."""
        return len(self._odom[0])

    @property
    def duration_s(self) -> float:
        """From the first odometry to the last."""
        return self._odom[0][-1] - self._odom[0][0] if len(self) else 0.0

    def update_odometry(self, x_m: float, y_m: float, yaw_rad: float, speed_mps: float, at_ns: int) -> None:
        """Add one odometry; the yaw may be wrapped. One that isn't later than the last is left out."""
        t_s = self._seconds(at_ns)
        if len(self) and t_s <= self._odom[0][-1]:
            return
        if len(self):
            before_rad = self._odom[3][-1]
            yaw_rad = before_rad + math.remainder(yaw_rad - before_rad, 2 * math.pi)
        for column, value in zip(self._odom, (t_s, x_m, y_m, yaw_rad, speed_mps)):
            column.append(value)

    def update_duty(self, duty: float, at_ns: int) -> None:
        """Add what the board holds on the steering's channel; what is no servo's pulse (0, off) is unknown."""
        t_s = self._seconds(at_ns)
        if self._duty[0] and t_s < self._duty[0][-1]:
            return
        self._duty[0].append(t_s)
        self._duty[1].append(duty if is_pulse(duty) else math.nan)

    def drive(self) -> SteeringDrive:
        """Return all samples so far as new arrays: (N,) of odometry, (M,) of duties; safe to hand to a thread."""
        t_s, x_m, y_m, yaw_rad, speed_mps = (np.array(column) for column in self._odom)
        duty_t_s, duty = (np.array(column) for column in self._duty)
        along_m = distance_m(Odom(t_s, x_m, y_m, yaw_rad, speed_mps)) if len(t_s) else np.zeros(0)
        return SteeringDrive(t_s, along_m, yaw_rad, duty_t_s, duty)

    def _seconds(self, at_ns):
        """Since the first sample: small numbers keep their microseconds."""
        if self._first_ns is None:
            self._first_ns = at_ns
        return (at_ns - self._first_ns) / NS_PER_S


class Survey:
    """What both kinds of calibration drive have: evidence, the time that counts, and an end.

    Args:
        base: turn_arb's calibration.

    Attributes:
        ends: the duties of its ends to the left and to the right.
        knowledge: the newest with a curve.
    """

    OF_DRIVING = ""  # what the time that counts is, behind its number

    def __init__(self, base: SteeringCalibration, config: CalibrationDriveConfig):
        self.base, self.config, self.ends = base, config, (base.servo_left, base.servo_right)
        self.samples, self.motion, self.positions = Samples(), Motion(), Positions(base)
        self.knowledge: Knowledge | None = None
        self._odom, self._duty = TimedInput("odom", INPUT_TIMEOUT_S), TimedInput("/servo/output", INPUT_TIMEOUT_S)
        self._drives = True  # what odometry says now shows something about the steering
        self._is_fitting = self._is_newest = False  # now; the knowledge is of the last fit
        self._since_fit = 0  # positions that were held since the newest fit was begun
        self._full_ns = -FULL_FIT_NS
        self._driven_ns, self._stepped_ns = 0, None
        self._end = ""  # why it is over

    @property
    def driven_s(self) -> float:
        """The time that counts: that of the held button, or by hand that in which the car moved."""
        return self._driven_ns / NS_PER_S

    def update_odometry(self, x_m: float, y_m: float, yaw_rad: float, speed_mps: float, measured_ns: int,
                        now_ns: int) -> None:
        """Take the car's pose (middle of the rear axle, odometry's frame, yaw wrapped or not) and its speed, forward
        positive, that were measured at ``measured_ns`` and arrived at ``now_ns``. What isn't finite is left out.
        """
        if not all(map(math.isfinite, (x_m, y_m, yaw_rad, speed_mps))):
            return
        self._odom.update(None, now_ns)
        if self._drives:
            self.samples.update_odometry(x_m, y_m, yaw_rad, speed_mps, measured_ns)
        self._update_motion(*self.motion.update(Pose(x_m, y_m, yaw_rad), speed_mps, measured_ns), measured_ns, now_ns)

    def update_duty(self, duty: float, now_ns: int) -> None:
        """Take what the servo board holds on the steering's channel, by /servo/output."""
        self._duty.update(duty, now_ns)
        self.samples.update_duty(duty, now_ns)

    def add(self, measured: Measured) -> None:
        """Take what was measured of a position that was held for long enough."""
        self.positions.add(measured)
        self._since_fit += 1

    def take_fit_task(self) -> tuple[SteeringDrive, CurveFitConfig] | None:
        """Return what ``assess`` is to fit now, once; ``None`` while it does, or when nothing new was measured."""
        if self._is_fitting or not self._since_fit or self.positions.count < MIN_POSITIONS:
            return None
        self._is_fitting, self._since_fit = True, 0
        if self.knowledge is not None and self._stepped_ns - self._full_ns < FULL_FIT_NS:
            return self.samples.drive(), self.knowledge.given
        self._full_ns = self._stepped_ns
        return self.samples.drive(), CurveFitConfig(understeer=self.base.understeer, limits=self.ends)

    def update_knowledge(self, knowledge: Knowledge, now_ns: int) -> None:
        """Take the answer to a task; the drive goes on with what it knew until it comes."""
        self._is_fitting, self._is_newest = False, not knowledge.reason
        if self._is_newest:
            self.knowledge = knowledge
            self.positions.update_knowledge(knowledge, self._since_fit)

    def finish(self) -> None:
        """End now, with what there is (the person asks for it): the next step is DONE."""
        self._end = self._end or f"ended by hand after {self.driven_s:.0f} s{self.OF_DRIVING}"

    @property
    def is_enough(self) -> bool:
        """Whether all is known by far."""
        known = self.knowledge
        return (known is not None and not known.missing and not self.positions.first
                and max(known.errors) <= ENOUGH and not self.positions.has_gaps
                and self._is_newest and not self._is_fitting)

    @property
    def servo_lag_s(self) -> float:
        """The servo's lag by the newest fit; a guess before."""
        return 0.15 if self.knowledge is None else max(0.02, self.knowledge.given.delay.lag_s)

    @property
    def servo_delay_s(self) -> float:
        """The servo's delay by the newest fit; a guess before."""
        return 0.05 if self.knowledge is None else self.knowledge.given.delay.delay_s

    def progress(self) -> Progress:
        """Return how far it is."""
        driven_s, known = self.driven_s, self.knowledge or NOTHING_KNOWN
        left_s = min(max(0.0, self.config.max_time_s - driven_s), self._left_s(driven_s))
        fraction = driven_s / (driven_s + left_s) if driven_s > 0 else 0.0
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

    def _tick(self, now_ns):
        """Return the time since the last step in ns, as much as counts of it."""
        since_ns = 0 if self._stepped_ns is None else min(now_ns - self._stepped_ns, MAX_STEP_NS)
        self._stepped_ns = now_ns
        return since_ns

    def _end_if_over(self):
        """End where enough is known, or the time is over."""
        if self.is_enough:
            self._end = self._end or f"enough is known after {self.driven_s:.0f} s{self.OF_DRIVING}"
        elif self.driven_s >= self.config.max_time_s:
            self._end = self._end or f"the time of {self.config.max_time_s:g} s is over"
