"""Estimate a car's deceleration in neutral, for any heading, from its speed while it rolls in neutral.

In neutral only drag and gravity act. On a plane the deceleration at a heading with the unit vector u is

    c(u) = drag − pull · u,

where pull is the slope as a vector: gravity's acceleration down the slope, in the frame in which the car started.
Right after a push the motor's force F still acts, which was the acceleration plus c: with a share e of it left, the
speed falls by c − e F. How much is left depends on the motor's lag, and the same lag falsifies each short roll in the
same way: so it isn't noise, but an unknown like drag and the pull's two components. ``Slope`` estimates these four by
an extended Kalman filter (Simon, Optimal State Estimation, 13.2). ``Slope.coasting`` returns the likely deceleration,
and the one that is certain within the error's bound: tight at a heading where it was measured, wider the farther the
car turns from there, and wide everywhere before the first roll. A climb one way is expected to be a descent the other
way, and rolls at several headings of an arc show the whole plane.

Pure. All bounds are two standard deviations.
"""
from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

from car_interface.common.measured_speed import MAX_SPEED_MPS
from car_interface.common.units import NS_PER_S
from car_interface.throttle.esc_config import EscConfig
from car_interface.throttle.esc_motion import MOTOR_LAG_NS

# Before the first roll the slope's pull has this bound: a floor of 5 % pulls by 0.49 m/s². And the drag exceeds
# esc/drag_deceleration by SURPLUS_MPS2, give or take as much: a Slash has 0.3 to 0.4 m/s², and its ESC's drag brake
# adds to that. Of a force, nothing and all that the longest lag leaves are both within the bound.
PULL_MPS2, SURPLUS_MPS2, SHARE_BOUND = 0.5, 0.2, 0.7
# A shorter lag leaves a share that shrinks: so much of the force is uncertain even if the mean share is known.
SHAPE = 0.25
CHANGES_MPS2 = 0.015  # the pull's change within a metre; an abrupt change starts over
ACTUATION_S = 0.03  # from the decision to the ESC's pulse
LAG_S = MOTOR_LAG_NS / NS_PER_S
WINDOW_S, MIN_WINDOW_S, MIN_REPORTS = 0.5, 0.1, 4  # of one measured deceleration
NOISE_MPS, NOISE_RATIO = 0.02, 0.02  # of one report of the speed: a constant part, and a part of the speed
RECENT_S = 0.12  # the present acceleration is measured over this time: six reports at 50 Hz
ROLLS_MPS = 0.05  # a car that is slower may stand
STOOD_NS = 3 * NS_PER_S  # a car that stood for longer may have been carried somewhere else


class Coasting(NamedTuple):
    """A deceleration in neutral; negative: the car gets faster."""

    certain_mps2: float  # it is at least this; not more than esc/drag_deceleration
    likely_mps2: float


class Slope:
    """Estimate drag and slope under one car.

    Attributes:
        acceleration_mps2: the rate at which the speed rises now, forward or backward; negative: it falls.
        brake_lacks_mps2: by how much the last brake that was measured fell short of esc/brake_deceleration.
    """

    def __init__(self, esc: EscConfig):
        self._drag_mps2, self._brake_mps2 = esc.drag_deceleration_mps2, esc.brake_deceleration_mps2
        self.acceleration_mps2 = 0.0
        self.brake_lacks_mps2 = 0.0
        self._fraction = 0.0
        self._held_ns = 0  # when the ESC got this fraction
        self._accelerated_mps2 = self._braked_mps2 = 0.0  # until then, and of this the brake's part
        self._recent: deque = deque()
        self._yaw_rad = 0.0
        self._stood_ns: int | None = None
        self._fit = Fit()
        # Without and with the present window.
        self._before = self._estimate = Estimate.unknown(self._drag_mps2)

    def update_esc(self, fraction: float, now_ns: int) -> None:
        """Take the fraction that the ESC gets from now on."""
        if fraction == self._fraction:
            return
        self._close_window()
        self._accelerated_mps2, self._braked_mps2 = self.acceleration_mps2, 0.0
        if self._recent and self._fraction < 0.0 < self._recent[-1][1]:
            self._braked_mps2 = min(self._accelerated_mps2 + self._drag_mps2, self._fraction * self._brake_mps2)
        self._fraction, self._held_ns = fraction, now_ns

    def update_speed(self, speed_mps: float, measured_ns: int, curvature_per_m: float) -> None:
        """Take a speed (forward positive), the time of its measurement, and the curvature (1/m) of the arc.

        One that is NaN or beyond MAX_SPEED_MPS is none.
        """
        recent = self._recent
        if not abs(speed_mps) <= MAX_SPEED_MPS or recent and measured_ns <= recent[-1][0]:
            return
        way_m = speed_mps * min(1.0, (measured_ns - recent[-1][0]) / NS_PER_S) if recent else 0.0
        self._yaw_rad += way_m * curvature_per_m
        self._before = self._before.after(abs(way_m))
        if not self._fit.count:
            self._estimate = self._before
        recent.append((measured_ns, speed_mps))
        while recent[0][0] < measured_ns - round(RECENT_S * NS_PER_S):
            recent.popleft()
        self.acceleration_mps2 = self._acceleration_mps2()
        if len(recent) == 1 or abs(speed_mps) < ROLLS_MPS:  # reports were missing, or it may stand
            self._close_window()
        if abs(speed_mps) < ROLLS_MPS:
            self._stand(measured_ns)
            return
        self._stood_ns = None
        self._measure(speed_mps, measured_ns)

    def _measure(self, speed_mps, measured_ns):
        """Measure a deceleration, if the ESC has had neutral or a brake for long enough."""
        since_s = (measured_ns - self._held_ns) / NS_PER_S
        if self._fraction == 0.0 and since_s >= ACTUATION_S:
            self._coast(speed_mps, since_s - ACTUATION_S)
        elif self._fraction < 0.0 < speed_mps and since_s >= ACTUATION_S + 4.0 * LAG_S:
            self._brake(speed_mps, since_s)

    def coasting(self, is_backward: bool, turn_rad: float = 0.0) -> Coasting:
        """Return the deceleration in neutral, forward or backward, after the heading has turned by ``turn_rad``."""
        yaw_rad = self._yaw_rad + turn_rad + (math.pi if is_backward else 0.0)
        likely_mps2, bound_mps2 = self._estimate.coasting(yaw_rad)
        return Coasting(min(self._drag_mps2, likely_mps2 - bound_mps2), likely_mps2)

    def _acceleration_mps2(self):
        fit = Fit()
        for at_ns, speed_mps in self._recent:
            fit.add(at_ns / NS_PER_S, abs(speed_mps))
        return fit.slope() if fit.count >= 3 else 0.0

    def _coast(self, speed_mps, since_s):
        """Measure in neutral. Of a brake, between nothing and what the longest lag leaves may still act."""
        fit = self._fit
        fit.add(since_s, abs(speed_mps))
        if fit.count < MIN_REPORTS or fit.span_s < MIN_WINDOW_S:
            return
        slows_mps2, left = -fit.slope(), math.exp(-fit.mean_s / LAG_S)
        bound_mps2 = (NOISE_MPS + NOISE_RATIO * abs(speed_mps)) * math.sqrt(12.0 / fit.count) / fit.span_s
        if self._braked_mps2:
            half_mps2 = left * self._braked_mps2 / 2.0
            slows_mps2, bound_mps2, left = slows_mps2 + half_mps2, math.hypot(half_mps2, bound_mps2), 0.0
        yaw_rad = self._yaw_rad + (math.pi if speed_mps < 0.0 else 0.0)
        roll = Roll(yaw_rad, slows_mps2, bound_mps2, self._accelerated_mps2, left)
        self._estimate = self._before.measured(roll, self._drag_mps2)
        if fit.span_s >= WINDOW_S:
            self._close_window()

    def _brake(self, speed_mps, since_s):
        """Measure under a brake that has built up."""
        fit = self._fit
        fit.add(since_s, speed_mps)
        if fit.count >= MIN_REPORTS and fit.span_s >= WINDOW_S:
            self.brake_lacks_mps2 = max(0.0, fit.slope() - self._fraction * self._brake_mps2)
            self._close_window()

    def _close_window(self):
        self._before = self._estimate
        self._fit = Fit()

    def _stand(self, measured_ns):
        if self._stood_ns is None:
            self._stood_ns = measured_ns
        elif measured_ns - self._stood_ns > STOOD_NS:
            self._before = self._estimate = self._estimate.elsewhere(self._drag_mps2)


class Fit:
    """Fit a straight line through speeds, by least squares."""

    def __init__(self):
        self.count = 0
        self._first_s = self.span_s = self._t = self._v = self._tt = self._tv = 0.0

    def add(self, at_s: float, speed_mps: float) -> None:
        if not self.count:
            self._first_s = at_s
        time_s = self.span_s = at_s - self._first_s
        self.count += 1
        self._t += time_s
        self._v += speed_mps
        self._tt += time_s * time_s
        self._tv += time_s * speed_mps

    @property
    def mean_s(self) -> float:
        return self._first_s + self._t / self.count

    def slope(self) -> float:
        """Return the acceleration in m/s²; 0 with fewer than two times."""
        spread = self.count * self._tt - self._t * self._t
        return (self.count * self._tv - self._t * self._v) / spread if spread else 0.0


class Roll(NamedTuple):
    """One measurement in neutral.

    Attributes:
        slows_mps2: the deceleration that was seen, with its error's bound ``bound_mps2``.
        accelerated_mps2: the acceleration before, of which a motor with the lag LAG_S still has a share ``left``.
    """

    yaw_rad: float
    slows_mps2: float
    bound_mps2: float
    accelerated_mps2: float = 0.0
    left: float = 0.0


class Estimate(NamedTuple):
    """What slows a car in neutral, and how long its motor's force lasts.

    Attributes:
        state: drag and the pull's two components (m/s²), and the share of what LAG_S leaves that is truly left, 0 to 1.
        errors: the rows of the symmetric matrix of their squared error bounds.
    """

    state: tuple[float, ...]
    errors: tuple[tuple[float, ...], ...]

    @classmethod
    def unknown(cls, drag_mps2: float, share: float = 0.5, share_square: float = SHARE_BOUND ** 2) -> Estimate:
        """Return level ground and half of the longest lag, with the bounds before any measurement."""
        pull = PULL_MPS2 ** 2
        return cls((drag_mps2 + SURPLUS_MPS2, 0.0, 0.0, share),
                   ((SURPLUS_MPS2 ** 2, 0.0, 0.0, 0.0), (0.0, pull, 0.0, 0.0), (0.0, 0.0, pull, 0.0),
                    (0.0, 0.0, 0.0, share_square)))

    def elsewhere(self, drag_mps2: float) -> Estimate:
        """Return the same motor on unknown ground."""
        return Estimate.unknown(drag_mps2, self.state[3], self.errors[3][3])

    def after(self, way_m: float) -> Estimate:
        """Return the same after a distance on which the slope may have changed."""
        if not way_m:
            return self
        drag, (xd, xx, xy, xs), (yd, yx, yy, ys), share = self.errors
        changed = CHANGES_MPS2 ** 2 * way_m
        return self._replace(errors=(drag, (xd, xx + changed, xy, xs), (yd, yx, yy + changed, ys), share))

    def coasting(self, yaw_rad: float) -> tuple[float, float]:
        """Return the deceleration at a heading, and the bound of its error."""
        looks = _looks(yaw_rad)
        return _dot(looks, self.state), math.sqrt(max(0.0, _dot(looks, self._times(looks))))

    def measured(self, roll: Roll, drag_mps2: float) -> Estimate:
        """Return the estimate with a roll. One that is off by more than twice the bound belongs to other ground."""
        taken, is_other_ground = self._taken(roll)
        return self.elsewhere(drag_mps2)._taken(roll)[0] if is_other_ground else taken

    def _taken(self, roll):
        looks, left = _looks(roll.yaw_rad), roll.left * self.state[3]
        coasts_mps2 = _dot(looks, self.state)
        force_mps2 = max(0.0, roll.accelerated_mps2 + coasts_mps2)
        wrong_mps2 = roll.slows_mps2 - (coasts_mps2 - left * force_mps2)
        by_ground = 1.0 - left if force_mps2 else 1.0
        looks = (*(by_ground * part for part in looks[:3]), -roll.left * force_mps2)
        blurred = self._times(looks)
        square = _dot(looks, blurred) + roll.bound_mps2 ** 2 + (SHAPE * looks[3]) ** 2
        drag, x, y, share = (value + wrong_mps2 / square * part for value, part in zip(self.state, blurred))
        errors = tuple(tuple(value - row * column / square for value, column in zip(values, blurred))
                       for values, row in zip(self.errors, blurred))
        return Estimate((drag, x, y, min(1.0, max(0.0, share))), errors), wrong_mps2 ** 2 > 4.0 * square

    def _times(self, vector):
        return tuple(_dot(row, vector) for row in self.errors)


def _looks(yaw_rad):
    """Return how the deceleration at a heading depends on the state."""
    return 1.0, -math.cos(yaw_rad), -math.sin(yaw_rad), 0.0


def _dot(one, other):
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2] + one[3] * other[3]
