"""Holding one position of the steering: going there past it or as it comes, settling, and what was measured since."""
from __future__ import annotations

import math

from car_interface.tools.calibration.drive.positions import Measured

PAST_DUTY = 90.0  # so far it is passed by, which is more than any usual backlash
CROSSED_DUTY = 50.0  # of these; from there on it comes back
SETTLED_DUTY = 5.0
MARGIN_S = 0.06


class Hold:
    """One position, from the moment at which it is asked for.

    Args:
        from_side: the side from which to come to it, in duty: 1 = higher, −1 = lower; 0 = as it comes.
        servo_duty: where the servo is about now.
        limits: the lowest and the highest duty that may be asked for.
        lag_s, delay_s: of the servo.
    """

    def __init__(self, duty: int, from_side: int, servo_duty: float, limits: tuple[float, float], lag_s: float,
                 delay_s: float, now_ns: int):
        self.duty = duty
        natural = 1 if servo_duty > duty else -1
        self.from_side = from_side or natural
        self._past_duty = float(duty)
        self._past_ns = now_ns
        at_duty = servo_duty
        if abs(servo_duty - duty) < PAST_DUTY or self.from_side != natural:
            self._past_duty = min(max(duty + self.from_side * PAST_DUTY, limits[0]), limits[1])
            crossed = duty + self.from_side * min(CROSSED_DUTY, abs(self._past_duty - duty) * 0.8)
            past_s = delay_s + _time_s(abs(self._past_duty - servo_duty), abs(self._past_duty - crossed), lag_s)
            self._past_ns = now_ns + round(past_s * 1e9)
            at_duty = self._past_duty
        settle_s = delay_s + MARGIN_S + _time_s(abs(at_duty - duty), SETTLED_DUTY, lag_s)
        self.settled_ns = self._past_ns + round(settle_s * 1e9)
        self.length_m = self.turned_rad = 0.0

    def asked_duty(self, now_ns: int) -> float:
        """Return what to ask for now."""
        return self._past_duty if now_ns < self._past_ns else float(self.duty)

    def is_settled(self, now_ns: int) -> bool:
        """Return whether the wheels are where they are to be."""
        return now_ns >= self.settled_ns

    def update_motion(self, distance_m: float, turned_rad: float, at_ns: int) -> None:
        """Take what odometry saw since the last call."""
        if at_ns >= self.settled_ns:
            self.length_m += distance_m
            self.turned_rad += turned_rad

    def seconds_to_settle(self, now_ns: int) -> float:
        """Until it is settled; 0 = it is."""
        return max(0.0, (self.settled_ns - now_ns) / 1e9)

    def measured(self) -> Measured:
        """Return the result so far."""
        return Measured(self.duty, self.from_side, self.length_m, self.turned_rad / max(self.length_m, 1e-6))


def _time_s(from_duty, to_duty, lag_s):
    """Return how long a first-order lag takes from one distance to its target to a smaller one."""
    return lag_s * math.log(from_duty / to_duty) if from_duty > to_duty > 0 else 0.0
