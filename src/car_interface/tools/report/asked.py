"""What a planner asked for by AckermannDrive, and how closely the car did it."""
from __future__ import annotations

import math
from typing import Any, Mapping

from car_interface.tools.recordings.columns import ackermann_drive
from car_interface.tools.report.downsample import Trace
from car_interface.tools.report.following import MIN_SPEED_MPS, RATIOS, STEADY_S, Bins

SAME_RAD, SAME_MPS = 0.02, 0.1  # planners change what they ask for by less all the time
TRACES = ("requested angle", "requested speed")


class AskedWatch:
    """Follows ackermann_msgs/AckermannDriveStamped or AckermannDrive.

    Args:
        traces: those of TRACES, and ``requested curvature`` where the wheelbase is known, are written to.
        wheelbase_m: of the car; ``None`` = unknown: which curvature an angle asks for can't be told.

    Attributes:
        wheelbase_m: as above.
        curvature_per_m: asked for now, left positive; ``None`` = unknown.
        unchanged_since_s: when the angle last changed by more than SAME_RAD.
    """

    def __init__(self, traces: Mapping[str, Trace], wheelbase_m: float | None):
        self._traces, self.wheelbase_m = traces, wheelbase_m
        self.curvature_per_m: float | None = None
        self.unchanged_since_s = 0.0
        self._angle_rad = self._speed_mps = math.nan  # from which changes count
        self._speed_since_s = 0.0
        self._speed_ratios = Bins(*RATIOS)

    def on_drive(self, time_s: float, message: Any) -> None:
        """One request."""
        asked = ackermann_drive(message)
        angle_rad, speed_mps = asked.steering_angle, asked.speed
        if not (math.isfinite(angle_rad) and math.isfinite(speed_mps)):
            return
        self._traces["requested angle"].add(time_s, math.degrees(angle_rad))
        self._traces["requested speed"].add(time_s, speed_mps)
        if not abs(angle_rad - self._angle_rad) <= SAME_RAD:
            self._angle_rad, self.unchanged_since_s = angle_rad, time_s
        if not abs(speed_mps - self._speed_mps) <= SAME_MPS:
            self._speed_mps, self._speed_since_s = speed_mps, time_s
        if self.wheelbase_m is not None:
            self.curvature_per_m = math.tan(angle_rad) / self.wheelbase_m
            self._traces["requested curvature"].add(time_s, self.curvature_per_m)

    def compare_speed(self, time_s: float, speed_mps: float) -> None:
        """Compare what the car drives now."""
        if abs(self._speed_mps) > MIN_SPEED_MPS and time_s - self._speed_since_s > STEADY_S:
            self._speed_ratios.add(speed_mps / self._speed_mps)

    def speed_ratio(self):
        """The driven speed as a ratio of the one that was asked for, where that was steady."""
        return self._speed_ratios.median()
