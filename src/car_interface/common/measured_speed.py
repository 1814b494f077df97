"""Follows the measured speed, and bounds the speed that the car has when a command given now takes effect."""
from __future__ import annotations

import math

from car_interface.common.staleness import TimedInput
from car_interface.common.units import NS_PER_S

MAX_SPEED_MPS = 100.0  # 360 km/h: a plausibility bound, no such car is faster
WINDOW_NS = 100_000_000  # over which an acceleration is measured: five reports at 50 Hz, whose noise it evens out
MAX_ACCELERATION_MPS2 = 10.0  # 1 g: no tyre on a floor does more
ACTUATION_S = 0.06  # from a decision until the servo has turned by a tenth: a pulse of 20 ms, and 0.04 s
MAX_AHEAD_S = 0.2  # of extrapolation: the largest acceleration then adds 2 m/s
# Between two reports a car may gain speed unseen: the simulated Slash's full throttle is 5.6 m/s². Reports that are
# late by more than LATE_S are missing, and nobody should push the car on until the next one.
UNSEEN_MPS2 = 6.0
LATE_S, LATE_PERIODS = 0.1, 2.0
UNSEEN_AFTER_S = 0.02  # the intervals between reports vary by as much: a period of 50 Hz
MAX_PERIOD_S = 0.2  # the hub's odometry of a car that stands comes five times a second
# Locked wheels read 0 while the car slides. No tyre slows a car by more than 1 g; a reading that falls faster, and by
# more than noise, comes from sliding wheels. A slide on dust still slows the car by 3 m/s².
MAX_DECELERATION_MPS2, SLIDE_MPS2 = 10.0, 3.0
NOISE_MPS, NOISE_RATIO = 0.1, 0.06


class MeasuredSpeed(TimedInput):
    """The speed by odometry, forward positive. A value that isn't finite or is beyond MAX_SPEED_MPS is no measurement.

    Args:
        timeout_s: a speed older than this is lost; 0 = never.
        name: odometry's in a reason.
    """

    def __init__(self, timeout_s: float, name: str = "odom"):
        super().__init__(name, timeout_s)
        self._anchor_ns, self._anchor_mps = None, 0.0  # where the acceleration is measured from
        self._gain_mps2 = 0.0  # by which its magnitude rises
        self._period_s, self._periods = MAX_PERIOD_S, 0  # of the reports: the mean of about eight, and how many
        self._updated_ns: int | None = None  # when the newest was measured
        # The car's newest speed without its sign, also while its wheels are locked; 0: none was ever received.
        self.magnitude_mps = 0.0

    def update(self, speed_mps: float, now_ns: int, age_ns: int = 0) -> None:
        """Take a speed that has arrived, and how old it was then."""
        if not abs(speed_mps) <= MAX_SPEED_MPS:  # also for NaN
            self.mark_stale(f"it was {speed_mps}")
            return
        measured_ns = now_ns - max(0, age_ns)
        if self._updated_ns is not None:
            measured_ns = max(measured_ns, self._updated_ns)
        if self._anchor_ns is None or self.is_stale(now_ns):
            self._anchor_ns, self._anchor_mps, self._gain_mps2 = measured_ns, speed_mps, 0.0
        elif measured_ns - self._anchor_ns >= WINDOW_NS:
            gain_mps2 = (abs(speed_mps) - abs(self._anchor_mps)) * NS_PER_S / (measured_ns - self._anchor_ns)
            self._gain_mps2 = max(0.0, min(MAX_ACCELERATION_MPS2, gain_mps2))
            self._anchor_ns, self._anchor_mps = measured_ns, speed_mps
        super().update(speed_mps, now_ns, age_ns)
        elapsed_s = MAX_PERIOD_S if self._updated_ns is None else (measured_ns - self._updated_ns) / NS_PER_S
        self.magnitude_mps = self._believed_mps(abs(speed_mps), elapsed_s)
        if self._updated_ns is not None:
            self._periods = min(8, self._periods + 1)
            self._period_s += (min(elapsed_s, MAX_PERIOD_S) - self._period_s) / self._periods
        self._updated_ns = measured_ns

    def _believed_mps(self, measured_mps, elapsed_s):
        """Return the car's speed, judged by the speed of its wheels."""
        before_mps = self.magnitude_mps
        fallen_mps = before_mps - measured_mps - NOISE_MPS - NOISE_RATIO * before_mps
        if fallen_mps <= MAX_DECELERATION_MPS2 * elapsed_s:
            return measured_mps
        return max(measured_mps, before_mps - SLIDE_MPS2 * elapsed_s)

    @property
    def _late_s(self):
        return LATE_S + LATE_PERIODS * self._period_s

    def is_late(self, now_ns: int) -> bool:
        """Return whether reports are missing that should have come; this is before the speed is lost."""
        return self.silence_s(now_ns) > self._late_s

    @property
    def last_mps(self) -> float:
        """The newest speed; NaN: none was ever received."""
        return self.value if self.was_received else math.nan

    def highest_mps(self, now_ns: int) -> float:
        """Return the magnitude that the speed may have when a command given now takes effect.

        It extrapolates the measured acceleration, and adds full throttle for the time of which nothing is known: while
        reports are missing, and by as much as their stamps are late. A lost speed keeps its bound. Call it only once a
        speed was received.
        """
        unseen_s = min(self.silence_s(now_ns), self._late_s) + self.was_late_s - self._period_s - UNSEEN_AFTER_S
        return (self.magnitude_mps + self._gain_mps2 * min(MAX_AHEAD_S, self.age_s(now_ns) + ACTUATION_S)
                + UNSEEN_MPS2 * max(0.0, unseen_s))
