"""The samples of a drive while it goes on: what a fit takes, as an array at any moment."""
from __future__ import annotations

import math
from array import array

import numpy as np

from car_interface.calibration.steering.drive import Drive
from car_interface.common.units import NS_PER_S


class Samples:
    """Odometry and duties of a drive.

    Times are on one scale, in nanoseconds: of odometry when it was measured, of duties when they arrived. Memory: 40
    bytes for each odometry and 16 for each change of the duty, 0.7 MB for five minutes.
    """

    def __init__(self):
        self._odom = [array("d") for _ in range(5)]  # t_s, x_m, y_m, yaw_rad (unwrapped), speed_mps
        self._duty = [array("d") for _ in range(2)]  # t_s, duty
        self._freeze = False

    def update_odometry(self, x_m: float, y_m: float, yaw_rad: float, speed_mps: float, at_ns: int) -> None:
        """One odometry; the yaw may be wrapped. One that isn't later than the last, or isn't finite, is left out."""
        raise NotImplementedError

    def update_duty(self, duty: float, at_ns: int) -> None:
        """What the board holds on the steering's channel; no servo's pulse (0, off) = unknown."""
        raise NotImplementedError

    def drive(self) -> Drive:
        """All samples so far as arrays of their own: (N,) of odometry, (M,) of duties; safe to hand to a thread."""
        raise NotImplementedError
