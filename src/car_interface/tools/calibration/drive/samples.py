"""Keeps what odometry and the servo board showed on a drive: the newest motion, and all samples for a fit."""
from __future__ import annotations

import math
from array import array
from collections import deque

import numpy as np

from car_interface.common.units import NS_PER_S
from car_interface.tools.calibration.drive.area import Pose
from car_interface.tools.calibration.shared import MAX_PULSE, MIN_PULSE
from car_interface.tools.calibration.steering.drive import SteeringDrive, distance_m
from car_interface.tools.recordings.columns import Odom

WINDOW_S = 0.25
MIN_WINDOW_M = 0.08  # a shorter way shows no curvature
MAX_STEP_S = 0.3  # between two odometries that belong together


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
        """Add one odometry; the yaw may be wrapped. One that isn't later than the last, or isn't finite, is left out.
        """
        t_s = self._seconds(at_ns)
        if not all(map(math.isfinite, (x_m, y_m, yaw_rad, speed_mps))) or len(self) and t_s <= self._odom[0][-1]:
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
        self._duty[1].append(duty if MIN_PULSE <= duty <= MAX_PULSE else math.nan)

    def drive(self) -> SteeringDrive:
        """Return all samples so far as new arrays: (N,) of odometry, (M,) of duties; safe to hand to a thread."""
        t_s, x_m, y_m, yaw_rad, speed_mps = (np.array(column) for column in self._odom)
        duty_t_s, duty = (np.array(column) for column in self._duty)
        along_m = np.zeros(0)
        if len(t_s):
            along_m = distance_m(Odom(t_s, x_m, y_m, yaw_rad, speed_mps))
        return SteeringDrive(t_s, along_m, yaw_rad, duty_t_s, duty)

    def _seconds(self, at_ns):
        """Since the first sample: small numbers keep their microseconds."""
        if self._first_ns is None:
            self._first_ns = at_ns
        return (at_ns - self._first_ns) / NS_PER_S
