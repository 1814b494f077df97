"""The measured speed, and what it will be when a command that is given now takes effect."""
from __future__ import annotations

import math

from car_interface.common.staleness import TimedInput
from car_interface.common.units import NS_PER_S

MAX_SPEED_MPS = 100.0  # no such car is faster
WINDOW_NS = 100_000_000  # over which an acceleration is measured: five reports at 50 Hz, whose noise it evens out
MAX_ACCELERATION_MPS2 = 10.0  # no tyre does more
ACTUATION_S = 0.06  # from a decision to the servo's turn: a pulse of 20 ms, and a servo that turns by a tenth
MAX_AHEAD_S = 0.2


class MeasuredSpeed:
    """The speed by odometry, forward positive. One that isn't finite, or no car's, is no measurement.

    Args:
        timeout_s: a speed older than this is lost; 0 = never.
    """

    def __init__(self, timeout_s: float):
        self._speed = TimedInput("odom", timeout_s)
        self._anchor_ns, self._anchor_mps = None, 0.0  # where the acceleration is measured from
        self._gain_mps2 = 0.0  # by which its magnitude rises

    @property
    def was_received(self) -> bool:
        """Whether there ever was one."""
        return self._speed.was_received

    def update(self, speed_mps: float, now_ns: int) -> None:
        """A speed that has arrived."""
        if not abs(speed_mps) <= MAX_SPEED_MPS:  # also for NaN
            self._speed.mark_stale()
            return
        if self._anchor_ns is None or self._speed.is_stale(now_ns):
            self._anchor_ns, self._anchor_mps, self._gain_mps2 = now_ns, speed_mps, 0.0
        elif now_ns - self._anchor_ns >= WINDOW_NS:
            gain_mps2 = (abs(speed_mps) - abs(self._anchor_mps)) * NS_PER_S / (now_ns - self._anchor_ns)
            self._gain_mps2 = max(0.0, min(MAX_ACCELERATION_MPS2, gain_mps2))
            self._anchor_ns, self._anchor_mps = now_ns, speed_mps
        self._speed.update(speed_mps, now_ns)

    def mark_stale(self) -> None:
        """Messages were dropped before they got here."""
        self._speed.mark_stale()

    def is_lost(self, now_ns: int) -> bool:
        """Whether there was one and it is stale; also if there never was."""
        return self._speed.is_stale(now_ns)

    def lost_reason(self, now_ns: int) -> str:
        """Why it is lost, in words."""
        return self._speed.stale_reason(now_ns)

    def age_s(self, now_ns: int) -> float:
        """Seconds since the newest; inf = never received."""
        return self._speed.age_s(now_ns)

    @property
    def last_mps(self) -> float:
        """The newest speed; NaN: none was ever received."""
        return self._speed.value if self._speed.was_received else math.nan

    def highest_mps(self, now_ns: int) -> float:
        """The magnitude that it may have when a command of now takes effect: it rises as it did. The last one if lost.

        Only to be asked for once there was one.
        """
        ahead_s = min(MAX_AHEAD_S, self._speed.age_s(now_ns) + ACTUATION_S)
        return abs(self._speed.value) + self._gain_mps2 * ahead_s
