"""The samples of a drive while it goes on: what a fit takes, as arrays at any moment."""
from __future__ import annotations

import math
from array import array

import numpy as np

from car_interface.common.units import NS_PER_S
from car_interface.tools.calibration.steering.distance import distance_m
from car_interface.tools.calibration.steering.drive import MAX_PULSE, MIN_PULSE, Drive
from car_interface.tools.recordings.series import Odom


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
        """How many odometries there are."""
        return len(self._odom[0])

    @property
    def duration_s(self) -> float:
        """From the first odometry to the last."""
        return self._odom[0][-1] - self._odom[0][0] if len(self) else 0.0

    def update_odometry(self, x_m: float, y_m: float, yaw_rad: float, speed_mps: float, at_ns: int) -> None:
        """One odometry; the yaw may be wrapped. One that isn't later than the last, or isn't finite, is left out."""
        t_s = self._seconds(at_ns)
        if not all(map(math.isfinite, (x_m, y_m, yaw_rad, speed_mps))) or len(self) and t_s <= self._odom[0][-1]:
            return
        if len(self):
            before_rad = self._odom[3][-1]
            yaw_rad = before_rad + math.remainder(yaw_rad - before_rad, 2 * math.pi)
        for column, value in zip(self._odom, (t_s, x_m, y_m, yaw_rad, speed_mps)):
            column.append(value)

    def update_duty(self, duty: float, at_ns: int) -> None:
        """What the board holds on the steering's channel; what is no servo's pulse (0, off) is unknown."""
        t_s = self._seconds(at_ns)
        if self._duty[0] and t_s < self._duty[0][-1]:
            return
        self._duty[0].append(t_s)
        self._duty[1].append(duty if MIN_PULSE <= duty <= MAX_PULSE else math.nan)

    def drive(self) -> Drive:
        """All samples so far as arrays of their own: (N,) of odometry, (M,) of duties; safe to hand to a thread."""
        t_s, x_m, y_m, yaw_rad, speed_mps = (np.array(column) for column in self._odom)
        duty_t_s, duty = (np.array(column) for column in self._duty)
        along_m = np.zeros(0)
        if len(t_s):
            along_m = distance_m(Odom(t_s, x_m, y_m, yaw_rad, speed_mps, np.zeros(len(t_s))))
        return Drive(t_s, along_m, yaw_rad, duty_t_s, duty)

    def _seconds(self, at_ns):
        """Since the first sample: small numbers keep their microseconds."""
        if self._first_ns is None:
            self._first_ns = at_ns
        return (at_ns - self._first_ns) / NS_PER_S
