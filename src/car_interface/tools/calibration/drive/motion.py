"""The car's pose, speed and curvature by its newest odometry."""
from __future__ import annotations

import math
from collections import deque

from car_interface.common.units import NS_PER_S
from car_interface.tools.calibration.drive.area import Pose

WINDOW_S = 0.25
MIN_WINDOW_M = 0.08  # a shorter way shows no curvature
MAX_STEP_S = 0.3  # between two odometries that belong together


class Motion:
    """The newest motion.

    Attributes:
        pose: the newest, its yaw unwrapped.
        speed_mps: the newest, forward positive.
    """

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
        """Of the path in the last quarter of a second, left positive; ``None``: it hardly moved."""
        distance_m = sum(entry[1] for entry in self._window)
        if distance_m < MIN_WINDOW_M:
            return None
        return sum(entry[2] for entry in self._window) / distance_m
