"""Whether an IMU is mounted upright: by the axis along which it feels gravity."""
from __future__ import annotations

import math
from typing import Any

MIN_GRAVITY_MPS2 = 5.0  # less on the average: something has taken it off already
UPRIGHT = 0.8  # the cosine of the largest tilt of an upright IMU


class Gravity:
    """The mean of an IMU's accelerations: on a drive all but gravity cancels out."""

    def __init__(self):
        self._count = 0
        self._sum_mps2 = [0.0, 0.0, 0.0]

    def add(self, acceleration: Any) -> None:
        """Add the linear_acceleration of a sensor_msgs/Imu."""
        axes = (acceleration.x, acceleration.y, acceleration.z)
        if all(map(math.isfinite, axes)):
            self._count += 1
            self._sum_mps2 = [before + now for before, now in zip(self._sum_mps2, axes)]

    def note(self, topic: str) -> str:
        """What is wrong with the mounting of the IMU on a topic; empty: nothing, or that can't be told."""
        mean_mps2 = [total / max(self._count, 1) for total in self._sum_mps2]
        size_mps2 = math.sqrt(sum(mean**2 for mean in mean_mps2))
        if size_mps2 < MIN_GRAVITY_MPS2 or abs(mean_mps2[2]) >= UPRIGHT * size_mps2:
            return ""
        axis = max(range(3), key=lambda index: abs(mean_mps2[index]))
        return (f"{topic}: gravity lies along its {'xyz'[axis]} axis, not along z: it is mounted on its side, and its "
                "turn rate about z isn't the car's")
