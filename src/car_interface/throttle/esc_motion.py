"""Read the measured speed for the ESC's rules.

``MeasuredMotion`` takes each speed with its arrival and age, and returns whether the car stands or rolls, how fast it
is at least, and whether a pull that is decided on now ends before the car stands. ``MotionCheck`` returns why the
motion contradicts the ESC's state. ``HillWatch`` detects a hill: in neutral the car gains speed. With an unknown speed
nothing is certain. Pure: ``now_ns`` is passed in.
"""
from __future__ import annotations

import math
from collections import deque

from car_interface.common.measured_speed import MAX_SPEED_MPS, SLIDE_MPS2
from car_interface.common.staleness import TimedInput
from car_interface.common.units import NS_PER_S
from car_interface.throttle.esc_config import EscConfig

STANDSTILL_MPS = 0.1  # a wheel's pulse (1.5 cm) every 0.15 s
# Rubber on dry asphalt, 0.8 g. With 4 m/s² `python3 test/adversary 400 --seed 700000` finds 2 reversals.
MAX_DECELERATION_MPS2 = 8.0
ACTUATION_NS = 40_000_000  # from a decision to the end of the pulse before it: a tick and a period, 20 ms each
# If no decision follows, the board holds a pull that may become reverse for 80 ms (``pca9685.channels``), and then
# ends the pulse that it has begun: another 20 ms. With 20 ms `python3 test/adversary --sweep` finds reversals.
PULL_NS = 100_000_000
# A brake_then_reverse's pull it holds as long as any command: neutral between two pulls would let it reverse.
HELD_PULL_NS = 270_000_000
# After a silence of FRESH_NS a rolling speed that claims a larger standard deviation is unknown, until one claims a
# smaller one: m/s, and as a part of the speed. The hub's first ones after a reboot were off by 1 m/s.
UNCERTAIN_MPS, UNCERTAIN_RATIO = 0.3, 0.1
FRESH_NS = 150_000_000  # an older speed misses reports: the hub's odometry comes at 50 Hz
# A brake that is held decelerates by no more than SEEN_RATIO times what was measured over WINDOW_NS, and SEEN_MPS2:
# the brake's own change, and odometry's noise. Chosen; test_esc_motion.py fails with 1 and 0. SPEEDS reports are kept.
SEEN_RATIO, SEEN_MPS2, WINDOW_NS, SPEEDS = 1.25, 1.0, 80_000_000, 16
SEEN_FOR_NS = 100_000_000  # later the car may have hit something; chosen, test_esc_motion.py fails with 0.5 s
ROLLS_OUT_NS = 3_000_000_000  # after reverse a car without any odometry has rolled to a stop
# A motor pushes on for this long: the longest lag of the cars in test/rooms and test/adversary.
MOTOR_LAG_NS = 150_000_000
HILL_AFTER_NS = 100_000_000  # a gain within this time of the last push is the motor's
HILL_GAIN_MPS, HILL_GAIN_RATIO = 0.02, 0.03  # a gain beyond odometry's noise: a constant part, and a part of the speed
HILL_LOSS_MPS = 0.05  # a car that loses this much in neutral is no longer driven by a hill


class MeasuredMotion:
    """Keep the measured speed, forward positive, and judge it.

    Attributes:
        measured_ns: when the newest speed was measured.
        is_stamped: the newest speed came with an age.
    """

    def __init__(self, config: EscConfig):
        self._speed = TimedInput("odom", config.speed_timeout_s)
        self.measured_ns, self.is_stamped = -math.inf, False
        self._arrival_ns, self._is_in_doubt = -math.inf, False
        self._slides_until_ns = -math.inf
        # When the newest speed's first brake began; None: it wasn't braked. A brake changes it, and a filter that
        # has lost its sensor predicts on with one: so a speed that repeats is no newer than this.
        self._braked_ns: int | None = None
        self._speeds: deque = deque(maxlen=SPEEDS)  # (measured_ns, speed without its sign)
        self._backward_ns: int | None = None  # when it last drove or rolled backward; None: it has stopped

    def update(self, speed_mps: float, now_ns: int, age_ns: int = 0, sigma_mps: float = 0.0) -> None:
        """Take a speed, its age at arrival, and its standard deviation.

        One that isn't finite or is beyond MAX_SPEED_MPS is unknown, and so is an uncertain one after a silence.
        """
        was_silent, self._arrival_ns = now_ns - self._arrival_ns > FRESH_NS, now_ns
        if not abs(speed_mps) <= MAX_SPEED_MPS:  # also for NaN
            self._speed.mark_stale(f"it was {speed_mps}")
            return
        rolls = abs(speed_mps) >= STANDSTILL_MPS
        is_uncertain = rolls and sigma_mps > max(UNCERTAIN_MPS, UNCERTAIN_RATIO * abs(speed_mps))
        self._is_in_doubt = is_uncertain and (was_silent or self._is_in_doubt)
        if self._is_in_doubt:
            self._speed.mark_stale(f"it was uncertain by {sigma_mps:.1f} m/s")
            return
        if speed_mps != self._speed.value:
            self._braked_ns = None
        self._speed.update(speed_mps, now_ns, age_ns)
        self.measured_ns, self.is_stamped = now_ns - max(0, age_ns), age_ns > 0
        self._speeds.append((self.measured_ns, abs(speed_mps)))
        if rolls:  # wheels that a brake locks read 0 while the car slides on
            slides_until_ns = self.measured_ns + round(abs(speed_mps) / SLIDE_MPS2 * NS_PER_S)
            self._slides_until_ns = max(self._slides_until_ns, slides_until_ns)

    def update_brake(self, now_ns: int) -> None:
        """Record that the ESC brakes a car that rolls."""
        if self._braked_ns is None:
            self._braked_ns = now_ns

    def update_reverse(self, now_ns: int) -> None:
        """Record that the ESC drives backward: its motor may push for MOTOR_LAG_NS more."""
        self._backward_ns = now_ns + MOTOR_LAG_NS

    def may_roll_backward(self, now_ns: int) -> bool:
        """Return whether the car drove or rolled backward, and no later speed shows that this is over.

        Without any odometry it is over after ROLLS_OUT_NS.
        """
        if self.rolls_backward(now_ns):
            self._backward_ns = max(self._backward_ns or 0, self.measured_ns)
        elif self._backward_ns is not None:
            is_seen = self.speed_mps(now_ns) is not None and self.measured_ns > self._backward_ns
            if is_seen or not self._speed.was_received and now_ns - self._backward_ns > ROLLS_OUT_NS:
                self._backward_ns = None
        return self._backward_ns is not None

    def mark_stale(self) -> None:
        """Treat the speed as unknown until the next one, since messages were dropped."""
        self._speed.mark_stale()

    def speed_mps(self, now_ns: int) -> float | None:
        """Return the speed; ``None`` = unknown."""
        return None if self._speed.is_stale(now_ns) else self._speed.value

    def unknown_reason(self, now_ns: int) -> str:
        """Return the reason for which the speed is unknown."""
        return self._speed.stale_reason(now_ns)

    def is_fresh(self, now_ns: int) -> bool:
        """Return whether the speed is known and at most FRESH_NS old."""
        return self.speed_mps(now_ns) is not None and now_ns - self.measured_ns <= FRESH_NS

    def rolled_forward_since(self, since_ns: int) -> bool:
        """Return whether the newest speed, stale or not, was measured since then, and the car rolled forward."""
        return self.measured_ns >= since_ns and self._speed.value >= STANDSTILL_MPS

    def stands(self, now_ns: int) -> bool:
        """Return whether the car is known to stand, and can't be sliding on locked wheels."""
        speed_mps = self.speed_mps(now_ns)
        return speed_mps is not None and abs(speed_mps) < STANDSTILL_MPS and now_ns >= self._slides_until_ns

    def rolls_forward(self, now_ns: int) -> bool:
        """Return whether the car is known to roll forward, or may slide forward on locked wheels."""
        speed_mps = self.speed_mps(now_ns)
        return speed_mps is not None and speed_mps > -STANDSTILL_MPS and not self.stands(now_ns)

    def rolls_backward(self, now_ns: int) -> bool:
        """Return whether the car is known to roll backward."""
        speed_mps = self.speed_mps(now_ns)
        return speed_mps is not None and speed_mps <= -STANDSTILL_MPS

    def least_speed_mps(self, now_ns: int) -> float:
        """Return the least speed, forward or backward, that the car can have when a decision takes effect."""
        return self._least_mps(now_ns, ACTUATION_NS)

    def outlasts_a_pull(self, now_ns: int, above_mps: float = 0.0, braked_since_ns: int | None = None) -> bool:
        """Return whether the car certainly rolls until the board has ended a pull that is given now.

        The board ends it by itself if no decision follows.

        Args:
            above_mps: it must be faster than this now, too.
            braked_since_ns: when the present brake began; ``None`` = it isn't braked.
        """
        slows_mps2 = self._slows_mps2(braked_since_ns, now_ns)
        return (self._least_mps(now_ns, PULL_NS, slows_mps2) > 0.0
                and self._least_mps(now_ns, 0, slows_mps2) > above_mps)

    def mps2_to_outlast_a_pull(self, now_ns: int, pull_ns: int = PULL_NS) -> float:
        """Return the deceleration that stops the car just when the board has ended a pull that is given now."""
        speed_mps = self.speed_mps(now_ns)
        return 0.0 if speed_mps is None else abs(speed_mps) * NS_PER_S / (self._age_ns(now_ns) + pull_ns)

    def _age_ns(self, now_ns):
        return now_ns - min(self.measured_ns, math.inf if self._braked_ns is None else self._braked_ns)

    def _slows_mps2(self, braked_since_ns, now_ns):
        """Return a bound of the present deceleration: the tyres', or by what the same brake was seen to do."""
        if braked_since_ns is None or self._age_ns(now_ns) > SEEN_FOR_NS:
            return MAX_DECELERATION_MPS2
        since = [each for each in self._speeds if each[0] >= braked_since_ns + MOTOR_LAG_NS]
        if not since or since[-1][0] - since[0][0] < WINDOW_NS:
            return MAX_DECELERATION_MPS2
        (first_ns, first_mps), (last_ns, last_mps) = since[0], since[-1]
        seen_mps2 = max(0.0, (first_mps - last_mps) * NS_PER_S / (last_ns - first_ns))
        return min(MAX_DECELERATION_MPS2, SEEN_RATIO * seen_mps2 + SEEN_MPS2)

    def _least_mps(self, now_ns, ahead_ns, slows_mps2=MAX_DECELERATION_MPS2):
        speed_mps = self.speed_mps(now_ns)
        if speed_mps is None:
            return 0.0
        age_s = (self._age_ns(now_ns) + ahead_ns) / NS_PER_S
        return max(0.0, abs(speed_mps) - slows_mps2 * age_s)


class MotionCheck:
    """Compare the measured speed with what the ESC's state allows.

    The car may roll backward in reverse. After that, and at the start, when it may have been in reverse before, it may
    roll backward until it has come to a standstill, but not faster than it already does.
    """

    def __init__(self, config: EscConfig):
        self._config = config
        self._since_ns: int | None = None
        self._max_backward_mps = math.inf
        self._reverse_until_ns = -math.inf

    def check(self, motion: MeasuredMotion, is_reverse: bool, now_ns: int, wants_backward: bool = False) -> str:
        """Return why the motion has contradicted the state for esc/motion_time; empty = it doesn't.

        With ``wants_backward`` the car is meant to roll backward, even by a hill alone.
        """
        speed_mps = motion.speed_mps(now_ns)
        if is_reverse:
            self._reverse_until_ns, self._max_backward_mps = now_ns + MOTOR_LAG_NS, math.inf
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
            self._neutral_ns, self._least_mps, self._most_mps = now_ns, math.inf, 0.0
        elif motion.measured_ns - self._neutral_ns >= HILL_AFTER_NS:
            self._least_mps, self._most_mps = min(self._least_mps, speed_mps), max(self._most_mps, speed_mps)
            if speed_mps >= self._least_mps * (1 + HILL_GAIN_RATIO) + HILL_GAIN_MPS:
                self.drives_the_car, self._most_mps = True, speed_mps
            elif speed_mps <= self._most_mps - HILL_LOSS_MPS:
                self.drives_the_car, self._least_mps = False, speed_mps
