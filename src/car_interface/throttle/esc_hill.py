"""Whether a hill drives the car: in neutral it gets no slower."""
from __future__ import annotations

from car_interface.throttle.esc_motion import STANDSTILL_MPS, MeasuredMotion

# What was measured so long after a push was its motor's; an earlier gain isn't the hill's.
AFTER_NS = 100_000_000
# More than odometry's noise: at a crawl, and in each m/s.
GAINS_MPS, NOISE = 0.02, 0.03
SLOWS_MPS = 0.05


class HillWatch:
    """Follows the speed while the ESC has neutral.

    Attributes:
        drives_the_car: a hill does, the way it rolls; it counts until the car has stood or slowed in neutral.
    """

    def __init__(self):
        self.drives_the_car = False
        self._neutral_ns: int | None = None
        self._least_mps = self._most_mps = 0.0

    def step(self, fraction: float, motion: MeasuredMotion, now_ns: int) -> None:
        """What the ESC gets from now on."""
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
