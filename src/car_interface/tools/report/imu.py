"""How fast the car turned by an IMU, beside its odometry."""
from __future__ import annotations

import math
from typing import Any, Mapping

from car_interface.tools.recordings.gravity import Gravity
from car_interface.tools.report.downsample import Trace
from car_interface.tools.report.following import RATIOS, Bins, MedianOf
from car_interface.tools.report.motion import WINDOW_S, MotionWatch

TRACES = ("imu turn rate",)
MIN_RATE_RADPS = 0.2
LAG_S = WINDOW_S / 2  # as much as odometry's turn rate, which is that of a window


class ImuWatch:
    """Follows sensor_msgs/Imu.

    Args:
        traces: those of TRACES are written to.
        motion: how fast the car turns by odometry.
    """

    def __init__(self, traces: Mapping[str, Trace], motion: MotionWatch):
        self._traces, self._motion, self._gravity = traces, motion, Gravity()
        self._ratios = Bins(*RATIOS)
        self._rate_radps, self._last_s = 0.0, math.nan

    def on_imu(self, time_s: float, message: Any) -> None:
        """One measurement."""
        rate_radps = message.angular_velocity.z
        if not math.isfinite(rate_radps):
            return
        self._gravity.add(message.linear_acceleration)
        self._traces["imu turn rate"].add(time_s, rate_radps)
        step_s = time_s - self._last_s
        weight = 1 - math.exp(-step_s / LAG_S) if 0 <= step_s < 1 else 1.0
        self._last_s, self._rate_radps = time_s, self._rate_radps + weight * (rate_radps - self._rate_radps)
        by_odometry_radps = self._motion.turn_rate_radps
        if by_odometry_radps is not None and abs(self._rate_radps) > MIN_RATE_RADPS:
            self._ratios.add(by_odometry_radps / self._rate_radps)

    def note(self, topic: str) -> str:
        """What is wrong with its mounting; empty: nothing."""
        return self._gravity.note(topic)

    def odometry_ratio(self) -> MedianOf:
        """Odometry's turn rate as a ratio of the IMU's; no samples where that is mounted on its side."""
        return MedianOf(math.nan, 0) if self.note("") else self._ratios.median()
