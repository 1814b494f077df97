"""What the measured speed says to an ESC's rules: whether the car stands, how fast it is at least, and whether it moves
against the ESC's state.
"""
from __future__ import annotations

import math
from collections import deque

from car_interface.common.measured_speed import MAX_SPEED_MPS
from car_interface.common.staleness import TimedInput
from car_interface.common.units import NS_PER_S
from car_interface.throttle.esc_config import EscConfig

STANDSTILL_MPS = 0.1
# Locked wheels read 0 while the car slides, under a brake or a strong drag brake. A slide on dust still slows it by
# 3 m/s²: after any measured speed the car may slide for no longer than that speed divided by this.
SLIDE_MPS2 = 3.0
MAX_DECELERATION_MPS2 = 8.0  # rubber on dry asphalt, 0.8 g
ACTUATION_NS = 40_000_000  # from a decision to the end of the last pulse before it: a period of 20 ms, and a timer tick
# The board holds a pull that may become reverse for 80 ms (``pca9685.channels``), should no other decision follow; and
# the pulse that it has begun by then takes another 20.
PULL_NS = 100_000_000
FRESH_NS = 150_000_000
# How much more a brake that is held may brake than it did over so long a time, by its own change and odometry's noise.
SEEN_RATIO, SEEN_MPS2, WINDOW_NS, SPEEDS = 1.25, 1.0, 80_000_000, 16
SEEN_FOR_NS = 100_000_000  # later the car may have hit something
ROLLS_OUT_NS = 3_000_000_000
MOTOR_LAG_NS = 150_000_000  # for so long a motor goes on pushing


class MeasuredMotion:
    """The measured speed, forward positive, and how it may be read.

    Attributes:
        measured_ns: when the newest was measured.
        is_stamped: whether it came with an age.
    """

    def __init__(self, config: EscConfig):
        self._speed = TimedInput("odom", config.speed_timeout_s)
        self.measured_ns, self.is_stamped = -math.inf, False
        self._slides_until_ns = -math.inf
        self._speeds: deque = deque(maxlen=SPEEDS)  # (measured_ns, speed without its sign)
        self._backward_ns: int | None = None  # when it was last driven or seen to roll backward, unless it has stopped

    def update(self, speed_mps: float, now_ns: int, age_ns: int = 0) -> None:
        """A speed that has arrived, and how old it was then; one that is not finite, or no car's, is unknown."""
        if not abs(speed_mps) <= MAX_SPEED_MPS:  # also for NaN
            self._speed.mark_stale(f"it was {speed_mps}")
            return
        self._speed.update(speed_mps, now_ns, age_ns)
        self.measured_ns, self.is_stamped = now_ns - max(0, age_ns), age_ns > 0
        self._speeds.append((self.measured_ns, abs(speed_mps)))
        if abs(speed_mps) >= STANDSTILL_MPS:
            slides_until_ns = self.measured_ns + round(abs(speed_mps) / SLIDE_MPS2 * NS_PER_S)
            self._slides_until_ns = max(self._slides_until_ns, slides_until_ns)

    def update_reverse(self, now_ns: int) -> None:
        """The ESC is in reverse."""
        self._backward_ns = now_ns + MOTOR_LAG_NS

    def may_roll_backward(self, now_ns: int) -> bool:
        """Whether it was driven or seen to roll backward, and no speed that was measured since shows that this is over.

        A car that has no odometry at all has rolled out after some seconds.
        """
        if self.rolls_backward(now_ns):
            self._backward_ns = max(self._backward_ns or 0, self.measured_ns)
        elif self._backward_ns is not None:
            is_seen = self.speed_mps(now_ns) is not None and self.measured_ns > self._backward_ns
            if is_seen or not self._speed.was_received and now_ns - self._backward_ns > ROLLS_OUT_NS:
                self._backward_ns = None
        return self._backward_ns is not None

    def mark_stale(self) -> None:
        """Messages were dropped: the speed is unknown until the next."""
        self._speed.mark_stale()

    def speed_mps(self, now_ns: int) -> float | None:
        """The speed; ``None`` = unknown."""
        return None if self._speed.is_stale(now_ns) else self._speed.value

    def unknown_reason(self, now_ns: int) -> str:
        """Why the speed is unknown."""
        return self._speed.stale_reason(now_ns)

    def is_fresh(self, now_ns: int) -> bool:
        """Whether the speed is known and hardly older than between two reports."""
        return self.speed_mps(now_ns) is not None and now_ns - self.measured_ns <= FRESH_NS

    def rolled_forward_since(self, since_ns: int) -> bool:
        """Whether the newest speed, known or lost by now, was measured since then, and the car rolled forward."""
        return self.measured_ns >= since_ns and self._speed.value >= STANDSTILL_MPS

    def stands(self, now_ns: int) -> bool:
        """Whether the car is known to stand."""
        speed_mps = self.speed_mps(now_ns)
        return speed_mps is not None and abs(speed_mps) < STANDSTILL_MPS and now_ns >= self._slides_until_ns

    def rolls_forward(self, now_ns: int) -> bool:
        """Whether it is known not to stand, and does not roll backward: it may slide on locked wheels."""
        speed_mps = self.speed_mps(now_ns)
        return speed_mps is not None and speed_mps > -STANDSTILL_MPS and not self.stands(now_ns)

    def rolls_backward(self, now_ns: int) -> bool:
        """Whether it is known to roll backward."""
        speed_mps = self.speed_mps(now_ns)
        return speed_mps is not None and speed_mps <= -STANDSTILL_MPS

    def least_speed_mps(self, now_ns: int) -> float:
        """The least that its speed, forward or backward, can be until a pulse that is decided on now has ended."""
        return self._least_mps(now_ns, ACTUATION_NS)

    def outlasts_a_pull(self, now_ns: int, above_mps: float = 0.0, braked_since_ns: int | None = None) -> bool:
        """Whether it certainly rolls on until the board has ended a pull that is decided on now, if none follows.

        Args:
            now_ns: the time.
            above_mps: and is faster than this now.
            braked_since_ns: since when it is braked as now; ``None`` = it isn't.
        """
        slows_mps2 = self._slows_mps2(braked_since_ns, now_ns)
        return (self._least_mps(now_ns, PULL_NS, slows_mps2) > 0.0
                and self._least_mps(now_ns, 0, slows_mps2) > above_mps)

    def mps2_to_outlast_a_pull(self, now_ns: int) -> float:
        """Return the deceleration with which it just rolls on until the board has ended a pull that is decided on now.
        """
        speed_mps = self.speed_mps(now_ns)
        return 0.0 if speed_mps is None else abs(speed_mps) * NS_PER_S / (now_ns - self.measured_ns + PULL_NS)

    def _slows_mps2(self, braked_since_ns, now_ns):
        """The most that it slows by now: what the tyres hold, or a good deal more than what the same brake does."""
        if braked_since_ns is None or now_ns - self.measured_ns > SEEN_FOR_NS:
            return MAX_DECELERATION_MPS2
        (first_ns, first_mps), (last_ns, last_mps) = self._window(braked_since_ns + MOTOR_LAG_NS)
        if last_ns - first_ns < WINDOW_NS:
            return MAX_DECELERATION_MPS2
        seen_mps2 = max(0.0, (first_mps - last_mps) * NS_PER_S / (last_ns - first_ns))
        return min(MAX_DECELERATION_MPS2, SEEN_RATIO * seen_mps2 + SEEN_MPS2)

    def _window(self, since_ns):
        """The oldest and the newest of the speeds that were measured since then."""
        window = [each for each in self._speeds if each[0] >= since_ns]
        return (window[0], window[-1]) if window else ((0, 0.0), (0, 0.0))

    def _least_mps(self, now_ns, ahead_ns, slows_mps2=MAX_DECELERATION_MPS2):
        speed_mps = self.speed_mps(now_ns)
        if speed_mps is None:
            return 0.0
        age_s = (now_ns - self.measured_ns + ahead_ns) / NS_PER_S
        return max(0.0, abs(speed_mps) - slows_mps2 * age_s)


class MotionCheck:
    """Compares the measured speed with what the ESC's state allows.

    Backward is allowed in reverse, and after it until the car has come to a standstill, if it gets no faster than it
    was then. The same holds at the beginning: it may have been in reverse before.
    """

    def __init__(self, config: EscConfig):
        self._config = config
        self._since_ns: int | None = None
        self._max_backward_mps = math.inf
        self._reverse_until_ns = -math.inf

    def check(self, motion: MeasuredMotion, is_reverse: bool, now_ns: int, wants_backward: bool = False) -> str:
        """Why the motion contradicts the state for too long; empty = it does not.

        Args:
            motion: the measured speed.
            is_reverse: the ESC is in reverse.
            now_ns: the time.
            wants_backward: the car is to roll backward, if by a hill alone.
        """
        speed_mps = motion.speed_mps(now_ns)
        if is_reverse:
            self._reverse_until_ns = now_ns + MOTOR_LAG_NS
        if speed_mps is None:
            return ""
        was_reverse = wants_backward or motion.measured_ns <= self._reverse_until_ns
        against = self._against(speed_mps, is_reverse, was_reverse)
        if not against:
            self._since_ns = None
        elif self._since_ns is None:
            self._since_ns = now_ns
        elif now_ns - self._since_ns >= self._config.motion_time_s * NS_PER_S:
            self._since_ns = None
            return against
        return ""

    def _against(self, speed_mps, is_reverse, was_reverse):
        margin_mps = self._config.motion_speed_mps
        if is_reverse:
            self._max_backward_mps = math.inf
            return f"it rolled forward at {speed_mps:.1f} m/s in reverse" if speed_mps > margin_mps else ""
        if was_reverse:
            self._max_backward_mps = math.inf
            return ""
        self._max_backward_mps = min(self._max_backward_mps, max(0.0, -speed_mps))
        if -speed_mps < STANDSTILL_MPS:
            self._max_backward_mps = 0.0
        if -speed_mps > self._max_backward_mps + margin_mps:
            return f"it rolled backward at {-speed_mps:.1f} m/s without reverse"
        return ""
