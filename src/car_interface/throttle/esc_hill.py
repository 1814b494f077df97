"""Detect a hill that drives the car: in neutral the car gains speed."""
from __future__ import annotations

from car_interface.throttle.esc_motion import STANDSTILL_MPS, MeasuredMotion

# A gain within this time of the last push is the motor's.
AFTER_NS = 100_000_000
# A gain beyond odometry's noise: a constant part in m/s, and a part of the speed.
GAINS_MPS, NOISE = 0.02, 0.03
SLOWS_MPS = 0.05  # a car that loses this much in neutral is no longer driven by the hill


class HillWatch:
    """Follow the speed while the ESC has neutral.

    Attributes:
        drives_the_car: the car gained speed in neutral, and hasn't stood or slowed in neutral since then.
    """

    def __init__(self):
        self.drives_the_car = False
        self._neutral_ns: int | None = None
        self._least_mps = self._most_mps = 0.0

    def step(self, fraction: float, motion: MeasuredMotion, now_ns: int) -> None:
        """Take what the ESC gets from now on, and the measured motion."""
        speed_mps = motion.speed_mps(now_ns)
        if speed_mps is None or abs(speed_mps) < STANDSTILL_MPS:
            self._neutral_ns = None
            if speed_mps is not None and not fraction:
                self.drives_the_car = False
            return
        speed_mps = abs(speed_mps)
        if fraction:
            self._neutral_ns = None
        elif self._neutral_ns is None:
            self._neutral_ns, self._least_mps, self._most_mps = now_ns, 1e9, 0.0
        elif motion.measured_ns - self._neutral_ns >= AFTER_NS:
            self._least_mps, self._most_mps = min(self._least_mps, speed_mps), max(self._most_mps, speed_mps)
            if speed_mps >= self._least_mps * (1 + NOISE) + GAINS_MPS:
                self.drives_the_car, self._most_mps = True, speed_mps
            elif speed_mps <= self._most_mps - SLOWS_MPS:
                self.drives_the_car, self._least_mps = False, speed_mps
