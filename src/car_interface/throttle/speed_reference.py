"""Lead a reference speed to the requested one, within limits of acceleration, braking and jerk."""
from __future__ import annotations

import math


class SpeedReference:
    """A speed that follows a target.

    Attributes:
        speed_mps: the present speed, 0 or more.
        acceleration_mps2: the present acceleration; negative = it slows down.
    """

    def __init__(self):
        self.speed_mps = self.acceleration_mps2 = 0.0

    def reset(self, speed_mps: float) -> None:
        """Start over at a speed, without acceleration."""
        self.speed_mps, self.acceleration_mps2 = max(0.0, speed_mps), 0.0

    def step(self, target_mps: float, max_acceleration_mps2: float, max_braking_mps2: float, max_jerk_mps3: float,
             dt_s: float) -> None:
        """Move on by ``dt_s`` towards a target of 0 or more, without overshooting it.

        Near the target the acceleration falls early enough to keep the limit of the jerk j: while an acceleration a
        falls to 0 in steps of j·dt, the speed still changes by a² / 2j + a·dt / 2.
        """
        if dt_s <= 0:
            return
        gap_mps = target_mps - self.speed_mps
        limit_mps2 = max_acceleration_mps2 if gap_mps > 0 else max_braking_mps2
        step_mps2 = max_jerk_mps3 * dt_s
        falling_mps2 = math.sqrt((step_mps2 / 2) ** 2 + 2 * max_jerk_mps3 * abs(gap_mps)) - step_mps2 / 2
        wanted_mps2 = math.copysign(min(limit_mps2, falling_mps2), gap_mps)
        self.acceleration_mps2 += max(-step_mps2, min(step_mps2, wanted_mps2 - self.acceleration_mps2))
        speed_mps = self.speed_mps + self.acceleration_mps2 * dt_s
        if (target_mps - speed_mps) * gap_mps <= 0 or speed_mps < 0:
            self.speed_mps, self.acceleration_mps2 = target_mps, 0.0
        else:
            self.speed_mps = speed_mps
