"""Estimate a car's deceleration in neutral, for any heading, from its speed while it rolls in neutral.

In neutral only drag and gravity act. On a plane the deceleration at a heading with the unit vector u is

    c(u) = drag − pull · u,

where pull is the slope as a vector: gravity's acceleration down the slope, in the frame in which the car started. Drag
and pull are three unknowns, and each roll in neutral measures one c(u). ``Slope`` estimates them by a Kalman filter of
three states (linear least squares). ``Slope.coasting`` returns the likely deceleration, and the one that is certain
within the error's bound: tight at a heading where it was measured, wider the farther the car turns from there, and wide
everywhere before the first roll. A climb one way is expected to be a descent the other way, and rolls at several
headings of an arc show the whole plane.

Pure. All bounds are two standard deviations.
"""
from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

from car_interface.common.units import NS_PER_S
from car_interface.throttle.esc_config import EscConfig
from car_interface.throttle.esc_motion import MOTOR_LAG_NS

# Bounds before the first measurement. The slope's pull: a floor of 5 % pulls by 0.49 m/s², which is three standard
# deviations; with a wider bound cars on level arcs roll so often that `python3 test/rooms --empty` finds them slow. And
# the drag beyond esc/drag_deceleration: a Slash has 0.3 to 0.4 m/s², and its ESC's drag brake adds to that.
PULL_MPS2, SURPLUS_MPS2 = 0.35, 0.3
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
        self._force_mps2 = 0.0  # of the motor or the brake at that time
        self._recent: deque = deque()
        self._yaw_rad = 0.0
        self._stood_ns: int | None = None
        self._fit = Fit()
        self._before = self._plane = Plane.unknown(self._drag_mps2)  # the estimate without and with the present window

    def update_esc(self, fraction: float, now_ns: int) -> None:
        """Take the fraction that the ESC gets from now on."""
        if fraction == self._fraction:
            return
        self._close_window()
        force_mps2 = self.acceleration_mps2 + self._drag_mps2
        if self._fraction < 0.0 < self._speed_mps:
            force_mps2 = min(force_mps2, self._fraction * self._brake_mps2)
        self._fraction, self._held_ns, self._force_mps2 = fraction, now_ns, force_mps2

    @property
    def _speed_mps(self):
        return self._recent[-1][1] if self._recent else 0.0

    def update_speed(self, speed_mps: float, measured_ns: int, curvature_per_m: float) -> None:
        """Take a speed (forward positive), the time of its measurement, and the curvature (1/m) of the arc."""
        recent = self._recent
        if not math.isfinite(speed_mps) or recent and measured_ns <= recent[-1][0]:
            return
        way_m = speed_mps * min(1.0, (measured_ns - recent[-1][0]) / NS_PER_S) if recent else 0.0
        self._yaw_rad += way_m * curvature_per_m
        self._before = self._before.after(abs(way_m))
        if not self._fit.count:
            self._plane = self._before
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
        likely_mps2, bound_mps2 = self._plane.coasting(yaw_rad)
        return Coasting(min(self._drag_mps2, likely_mps2 - bound_mps2), likely_mps2)

    def _acceleration_mps2(self):
        fit = Fit()
        for at_ns, speed_mps in self._recent:
            fit.add(at_ns / NS_PER_S, abs(speed_mps))
        return fit.slope() if fit.count >= 3 else 0.0

    def _coast(self, speed_mps, since_s):
        """Measure in neutral. Of the last force between nothing and what the longest lag leaves may still act."""
        fit = self._fit
        fit.add(since_s, abs(speed_mps))
        if fit.count < MIN_REPORTS or fit.span_s < MIN_WINDOW_S:
            return
        left_mps2 = self._force_mps2 * math.exp(-fit.mean_s / LAG_S)
        noise_mps2 = (NOISE_MPS + NOISE_RATIO * abs(speed_mps)) * math.sqrt(12.0 / fit.count) / fit.span_s
        yaw_rad = self._yaw_rad + (math.pi if speed_mps < 0.0 else 0.0)
        self._plane = self._before.measured(yaw_rad, left_mps2 / 2.0 - fit.slope(),
                                            math.hypot(left_mps2 / 2.0, noise_mps2), self._drag_mps2)
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
        self._before = self._plane
        self._fit = Fit()

    def _stand(self, measured_ns):
        if self._stood_ns is None:
            self._stood_ns = measured_ns
        elif measured_ns - self._stood_ns > STOOD_NS:
            self._before = self._plane = Plane.unknown(self._drag_mps2)


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


class Plane(NamedTuple):
    """Drag and the pull's two components, in m/s², and the symmetric matrix of their squared error bounds."""

    drag: float
    x: float
    y: float
    dd: float
    dx: float
    dy: float
    xx: float
    xy: float
    yy: float

    @classmethod
    def unknown(cls, drag_mps2: float) -> Plane:
        """Return level ground with the bounds before any measurement."""
        return cls(drag_mps2, 0.0, 0.0, SURPLUS_MPS2 ** 2, 0.0, 0.0, PULL_MPS2 ** 2, 0.0, PULL_MPS2 ** 2)

    def after(self, way_m: float) -> Plane:
        """Return the same after a distance on which the slope may have changed."""
        changed = CHANGES_MPS2 ** 2 * way_m
        return self._replace(xx=self.xx + changed, yy=self.yy + changed) if changed else self

    def coasting(self, yaw_rad: float) -> tuple[float, float]:
        """Return the deceleration at a heading, and the bound of its error."""
        cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
        square = (self.dd + self.xx * cos * cos + self.yy * sin * sin
                  + 2.0 * (self.xy * cos * sin - self.dx * cos - self.dy * sin))
        return self.drag - self.x * cos - self.y * sin, math.sqrt(max(0.0, square))

    def measured(self, yaw_rad: float, seen_mps2: float, bound_mps2: float, drag_mps2: float) -> Plane:
        """Return the estimate with a deceleration that was measured at a heading.

        One that is off by more than twice the bound belongs to other ground: then the estimate starts over.
        """
        cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
        d = self.dd - self.dx * cos - self.dy * sin
        x = self.dx - self.xx * cos - self.xy * sin
        y = self.dy - self.xy * cos - self.yy * sin
        square = d - x * cos - y * sin + bound_mps2 * bound_mps2
        wrong_mps2 = seen_mps2 - (self.drag - self.x * cos - self.y * sin)
        if wrong_mps2 * wrong_mps2 > 4.0 * square:
            unknown = Plane.unknown(drag_mps2)
            if self != unknown:
                return unknown.measured(yaw_rad, seen_mps2, bound_mps2, drag_mps2)
        gain = wrong_mps2 / square
        return Plane(self.drag + gain * d, self.x + gain * x, self.y + gain * y,
                     self.dd - d * d / square, self.dx - d * x / square, self.dy - d * y / square,
                     self.xx - x * x / square, self.xy - x * y / square, self.yy - y * y / square)
