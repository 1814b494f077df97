"""Keeps what a calibration drive has measured so far: motion, samples for a fit, positions, fits, progress, time.

It is the same for a car that drives itself and for a person with the stick, and so is what both of them ask for.
"""
from __future__ import annotations

import math
from array import array
from collections import deque
from typing import NamedTuple

import numpy as np

from car_interface.common.staleness import TimedInput
from car_interface.common.units import NS_PER_S
from car_interface.steering.calibration import SteeringCalibration
from car_interface.tools.calibration.drive.area import Pose
from car_interface.tools.calibration.drive.config import CalibrationDriveConfig
from car_interface.tools.calibration.drive.knowledge import Knowledge
from car_interface.tools.calibration.drive.positions import Positions
from car_interface.tools.calibration.shared import is_pulse
from car_interface.tools.calibration.steering.drive import CurveFitConfig, Delay, SteeringDrive, distance_m
from car_interface.tools.recordings.columns import Odom

WINDOW_S = 0.25
MIN_WINDOW_M = 0.08  # a shorter way shows no curvature
MAX_STEP_S = 0.3  # between two odometries that belong together
ODOM_TIMEOUT_S, OUTPUT_TIMEOUT_S = 0.5, 2.5  # the board's output comes on change and once a second
MAX_STEP_NS = NS_PER_S // 5  # the longest time from step to step that counts as driven
FULL_FIT_NS = 40 * NS_PER_S  # so often delay and backlash are estimated anew
MIN_POSITIONS = 5  # before the first fit
ENOUGH = 0.1  # of what the tool allows: an error below this anywhere ends the drive
EARLY_S = 240.0  # of the whole drive, a guess while nothing is known
MIN_LEFT_S = 5.0  # as long as it isn't over
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


class Progress(NamedTuple):
    """How far the drive is; the defaults: it hasn't begun."""

    fraction: float = 0.0  # 0 to 1, for a progress bar
    known: Knowledge = Knowledge()
    driven_s: float = 0.0  # with the button held
    left_s: float = math.inf  # an estimate of what is still to be driven, at most what max_time leaves
    positions: int = 0  # how many positions were measured so far


def steering_text(steering: float, middle: str = "the middle") -> str:
    """Return ``40% left`` for 0.4, and ``?`` where the steering isn't known."""
    if not math.isfinite(steering):
        return "?"
    percent = round(100 * abs(steering))
    return f"{percent}% {'left' if steering > 0 else 'right'}" if percent else middle


class Motion:
    """The car's pose (its yaw unwrapped), speed (forward positive) and curvature by its newest odometry."""

    def __init__(self):
        self.pose = Pose(0.0, 0.0, 0.0)
        self.speed_mps = 0.0
        self._at_ns = -math.inf
        self._window: deque = deque()  # (time, distance, change of yaw)

    def update(self, pose: Pose, speed_mps: float, at_ns: int) -> tuple[float, float]:
        """Take an odometry: (the distance since the last one, backward negative; the change of yaw)."""
        since_s = (at_ns - self._at_ns) / NS_PER_S
        turned_rad = math.remainder(pose.yaw_rad - self.pose.yaw_rad, 2 * math.pi)
        moved_m = math.copysign(math.hypot(pose.x_m - self.pose.x_m, pose.y_m - self.pose.y_m), speed_mps)
        if not 0 < since_s <= MAX_STEP_S:
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
        return sum(entry[2] for entry in self._window) / distance_m if distance_m >= MIN_WINDOW_M else None


class Samples:
    """Odometry and duties of a drive.

    Times are on one scale, in nanoseconds: of odometry when it was measured, of duties when they arrived. Memory: 40
    bytes for each odometry and 16 for each duty, 0.7 MB for five minutes.
    """

    def __init__(self):
        self._odom = array("d")  # t_s, x_m, y_m, yaw_rad, speed_mps, and again
        self._duty = array("d")  # t_s, duty, and again

    def update_odometry(self, pose: Pose, speed_mps: float, at_ns: int) -> None:
        """Add one odometry, its yaw unwrapped. One that isn't later than the last is left out."""
        if not self._odom or at_ns / NS_PER_S > self._odom[-5]:
            self._odom.extend((at_ns / NS_PER_S, *pose, speed_mps))

    def update_duty(self, duty: float, at_ns: int) -> None:
        """Add what the board holds on the steering's channel; what is no servo's pulse (0, off) is unknown."""
        self._duty.extend((at_ns / NS_PER_S, duty if is_pulse(duty) else math.nan))

    def drive(self) -> SteeringDrive:
        """Return all samples so far as new arrays: (N,) of odometry, (M,) of duties; safe to hand to a thread."""
        odom = Odom(*np.array(self._odom).reshape(-1, 5).T.copy())
        along_m = distance_m(odom) if len(odom.t_s) else np.zeros(0)
        return SteeringDrive(odom.t_s, along_m, odom.yaw_rad, *np.array(self._duty).reshape(-1, 2).T.copy())


class Survey:
    """What both kinds of calibration drive have: evidence, the time that counts, and an end.

    Args:
        base: turn_arb's calibration.

    Attributes:
        ends: the duties of its ends to the left and to the right.
        is_slowed: more than its drag and its ESC in neutral slows it now, hands or throttle_arb's brake; it is to be
            set. That brakes only while it is sure that no reverse comes of it: the next time it may not.
    """

    OF_DRIVING = ""  # what the time that counts is, behind its number

    def __init__(self, base: SteeringCalibration, config: CalibrationDriveConfig):
        self.base, self.config, self.ends = base, config, (base.servo_left, base.servo_right)
        self.samples, self.motion, self.positions = Samples(), Motion(), Positions(base)
        self._odom, self._duty = TimedInput("odom", ODOM_TIMEOUT_S), TimedInput("/servo/output", OUTPUT_TIMEOUT_S)
        self.is_slowed = False
        self._drives = True  # what odometry says now shows something about the steering
        self._is_fitting = self._is_newest = False  # now; the knowledge is of the last fit, which has ended
        self._fitted = 0  # how many positions had been held when the newest fit was begun
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
        moved = self.motion.update(Pose(x_m, y_m, yaw_rad), speed_mps, measured_ns)
        if self._drives:
            self.samples.update_odometry(self.motion.pose, speed_mps, measured_ns)
        self._update_motion(*moved, measured_ns, now_ns)

    def update_duty(self, duty: float, now_ns: int) -> None:
        """Take what the servo board holds on the steering's channel, by /servo/output."""
        self._duty.update(duty, now_ns)
        self.samples.update_duty(duty, now_ns)

    def take_fit_task(self) -> tuple[SteeringDrive, CurveFitConfig] | None:
        """Return what ``assess`` is to fit now, once; ``None`` while it does, or when nothing new was measured."""
        held, known = len(self.positions.held), self.positions.knowledge
        if self._is_fitting or held == self._fitted or held < MIN_POSITIONS:
            return None
        self._is_fitting, self._is_newest, self._fitted = True, False, held
        if not known.reason and self._stepped_ns - self._full_ns < FULL_FIT_NS:
            return self.samples.drive(), known.given
        self._full_ns = self._stepped_ns
        return self.samples.drive(), CurveFitConfig(understeer=self.base.understeer, limits=self.ends)

    def update_knowledge(self, knowledge: Knowledge, now_ns: int) -> None:
        """Take the answer to a task; the drive goes on with what it knew until it comes."""
        self._is_fitting, self._is_newest = False, not knowledge.reason
        if self._is_newest:
            self.positions.update_knowledge(knowledge, self._fitted)

    def finish(self) -> None:
        """End now, with what there is (the person asks for it): the next step is DONE."""
        self._end = self._end or f"ended by hand after {self.driven_s:.0f} s{self.OF_DRIVING}"

    @property
    def is_enough(self) -> bool:
        """Whether all is known by far."""
        known = self.positions.knowledge
        return (self._is_newest and not known.missing and not self.positions.first
                and known.errors.max() <= ENOUGH and not self.positions.has_gaps)

    @property
    def servo_delay(self) -> Delay:
        """The servo's by the newest fit; a guess before."""
        delay = self.positions.knowledge.given.delay
        return delay._replace(lag_s=max(0.02, delay.lag_s))

    def picture(self) -> tuple[tuple[float, float] | None, list[tuple[float, float]]]:
        """Return for rviz the area's center, ``None`` = there is none, and the path of the next seconds as far as it is
        known: (x, y) in m in odometry's frame.
        """
        return None, []

    def progress(self) -> Progress:
        """Return how far it is."""
        driven_s, left_s = self.driven_s, min(max(0.0, self.config.max_time_s - self.driven_s), self._left_s())
        fraction = driven_s / (driven_s + left_s) if driven_s > 0 else 0.0
        return Progress(fraction, self.positions.knowledge, driven_s, left_s, len(self.positions.held))

    def _left_s(self):
        """Return an estimate: an error shrinks with the root of the time that is spent on it, and none has to be
        smaller than ENOUGH.
        """
        known = self.positions.knowledge
        if self.is_enough:
            return 0.0
        if known.reason:
            return max(MIN_LEFT_S, EARLY_S - self.driven_s)
        ratio = float(np.mean(np.maximum(1.0, known.errors / ENOUGH) ** 2))
        return max(MIN_LEFT_S, max(1.0, self.driven_s) * (ratio - 1))

    def _silence(self, now_ns):
        """Return why it doesn't know what the car does; empty: it does."""
        return next((timed.stale_reason(now_ns) for timed in (self._odom, self._duty) if timed.is_stale(now_ns)), "")

    def _tick(self, now_ns):
        """Return the time since the last step in ns, as much as counts of it."""
        since_ns = 0 if self._stepped_ns is None else min(now_ns - self._stepped_ns, MAX_STEP_NS)
        self._stepped_ns = now_ns
        return since_ns

    def _is_over(self, counts_ns):
        """Count so much more time; return whether that is over, enough is known, or it was ended."""
        self._driven_ns += counts_ns
        if self.is_enough:
            self._end = self._end or f"enough is known after {self.driven_s:.0f} s{self.OF_DRIVING}"
        elif self.driven_s >= self.config.max_time_s:
            self._end = self._end or f"the time of {self.config.max_time_s:g} s is over"
        return bool(self._end)
