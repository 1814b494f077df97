"""Whether the car has to stop for what its sonars see, with what its ESC and the ground guarantee now.

Pure. A stop that is certain to brake now may not be when it is needed. An ESC that takes a pull for a brake after
driving forward takes it for reverse after neutral, so a stop trusts that for half a second of coasting only
(``throttle.esc.STOP_MEMORY_NS``). So here it counts while the car is driven or braked. A car that coasts too long, or
whose brake is about to be released, is counted with drag alone, which is what is left then. So it is backward, too,
and where a brake counts only as long as the car is fast: it may not be by the time that it is needed.

What the ground takes away (``throttle.slope``) counts, too. Before it is known the car begins slowly, and where its ESC
may never brake it rolls in neutral for a moment, which shows it. Where the ESC will brake the push lasts until that is
certain, also on a slope on which nothing else stops the car, and begins only with room for it. A stop is never pushed.

A motor goes on pushing after its throttle was cut. So the throttle is given back gradually, and taken away where the
car, getting faster as it does, will reach the bound anyway.
"""
from __future__ import annotations

import math
from typing import NamedTuple

from car_interface.common.measured_speed import UNSEEN_MPS2, MeasuredSpeed
from car_interface.common.units import NS_PER_S
from car_interface.throttle.arbiter import PLANNER, TELEOP, Arbitration
from car_interface.throttle.esc import BRAKING, FORWARD, NEUTRAL, REVERSE, STOP_MEMORY_NS, EscDecision
from car_interface.throttle.esc_config import BRAKE_THEN_REVERSE, FORWARD_ONLY, EscConfig
from car_interface.throttle.limits import BAND_MPS, SpeedBound
from car_interface.throttle.obstacle_stop import STEEP_MPS2, Guarantee, ObstacleStop
from car_interface.throttle.slope import Slope

ROLLS_MPS = 0.1
# Before the stop's memory of driving forward ends a stop must have begun, and reached the ESC.
TRUSTED_COASTING_NS = STOP_MEMORY_NS - round(0.2 * NS_PER_S)
MOTOR_LAG_S = 0.15
CUT_S = 0.05 + MOTOR_LAG_S  # from a throttle's cut until the car gets no faster: the way to the ESC, a pulse, the lag
# A throttle counts as what the car needs for its speed when it gets no faster by it, after this time (the second:
# towards an echo on a slope that isn't known); and no more after the last.
STEADY_S, CAREFUL_STEADY_S, LET_GO_S = 0.28, 1.0, 0.25
LATE_STEADY = 4.0  # longer by so many times odometry's age
FULL_MPS2 = 2.0 * UNSEEN_MPS2  # half of the throttle may be all that the motor can do
# An acceleration that odometry may show where there is none, and its share of the speed.
NOISE_MPS2, NOISE_PER_S = 0.5, 0.1
# What a slope on which a car stands in neutral may take from its drag, and what is left of that at least.
UNKNOWN_SLOPE_MPS2, LEFT_MPS2 = 0.25, 0.05
# As long as it isn't known how the car slows down here: what a car without a brake, on a slope that is steeper than its
# drag, is left rolling with. From the second on it rolls in neutral, until it is known or it hardly rolls.
UNKNOWN_SLOPE_MPS, SHOWS_SLOPE_MPS = 0.3, 0.18
# There its throttle begins with what the ESC takes at least, and rises by as much in so many seconds until the car
# moves, and while it gets no faster. So the motor's lag and odometry's age add little.
RISES_S, MOVES_MPS, RISING_MPS2 = 0.8, 0.05, 0.1
PRIME_S, PRIME_MPS = 0.6, 0.35  # a brake is certain after such a push, which makes the car faster by no more
LEAST_LEFT_MPS = 0.15  # so far below a bound the least throttle may always be given
UNKNOWN, UNCERTAIN = "before it is known how it slows down here it has", "before its brake is certain it has"
FREE_MPS = 0.6  # no echo allows so much on an unknown slope


class Obstacle(NamedTuple):
    """What the sonars allow."""

    bounds: tuple[SpeedBound, ...] = ()
    stop: SpeedBound | None = None  # one that the car exceeds


NONE = Obstacle()


class ObstacleGuard:
    """Follows one car's ESC, and bounds its speed by its sonars."""

    def __init__(self, sonars: ObstacleStop, esc: EscConfig):
        self.sonars = sonars
        self.slope = Slope(esc)
        self._drag_mps2 = esc.drag_deceleration_mps2
        # It brakes once it has driven for a while: neutral in between would only delay that.
        self._will_brake = bool(esc.profile in (BRAKE_THEN_REVERSE, FORWARD_ONLY) and esc.profile_measured
                                and esc.stop_brake)
        self._brake_mps2 = esc.stop_brake * esc.brake_deceleration_mps2
        self._answer: EscDecision | None = None
        self._pushed_ns = -math.inf
        self._answered_ns = -math.inf
        self._least = esc.dead_band_forward, esc.dead_band_reverse
        self._pushes = 0.0  # the throttle that it has
        self._steady = 0.0  # the throttle that the car needs for its speed
        self._late_s = 0.0  # odometry's age
        self._stops = False
        self._shows_slope = False
        self._is_careful = False  # towards an echo, where it isn't known how the car slows down

    def update_esc(self, answer: EscDecision, now_ns: int) -> None:
        """What the ESC was given."""
        self._answer = answer
        if answer.state == FORWARD and answer.fraction > 0:
            self._pushed_ns = now_ns
        elapsed_s = (now_ns - self._answered_ns) / NS_PER_S
        self._answered_ns = now_ns
        self._pushes = pushes = abs(answer.fraction) if answer.state in (FORWARD, REVERSE) else 0.0
        if pushes < self._steady:
            self._steady += (pushes - self._steady) * min(1.0, elapsed_s / LET_GO_S)
        elif self.slope.acceleration_mps2 < NOISE_MPS2:
            after_s = (CAREFUL_STEADY_S if self._is_careful else STEADY_S) + LATE_STEADY * self._late_s
            self._steady += (pushes - self._steady) * min(1.0, elapsed_s / after_s)
        self.slope.update_esc(answer.fraction, now_ns)

    def update_speed(self, speed_mps: float, now_ns: int, age_ns: int, curvature_per_m: float) -> None:
        """The measured speed, forward positive, how old it was at its arrival, and the arc on which the car drives."""
        self.slope.update_speed(speed_mps, now_ns - max(0, age_ns), curvature_per_m)

    def check(self, arbitration: Arbitration, speed: MeasuredSpeed, curvature_per_m: float, now_ns: int) -> Obstacle:
        """What the sonars allow whoever drives, in the direction in which the car drives."""
        if not speed.was_received:
            return NONE
        self.sonars.update_motion(speed.last_mps, curvature_per_m, now_ns)
        if arbitration.is_stop or arbitration.source not in (TELEOP, PLANNER):
            return NONE
        is_reverse = self._answer is not None and self._answer.state == REVERSE
        is_backward = speed.last_mps <= -ROLLS_MPS or speed.last_mps < ROLLS_MPS and (
            is_reverse or arbitration.asked < 0)
        guarantee = self._guarantee(arbitration, is_backward, is_backward or is_reverse, curvature_per_m, now_ns)
        is_certain = guarantee.stop_mps2 > guarantee.drag_mps2
        is_known = self.slope.is_known(is_backward) or is_certain
        self._late_s = speed.age_s(now_ns)
        late_s = self._late_s + MOTOR_LAG_S
        highest_mps = self._highest_mps(speed, now_ns)
        primed = None
        if not is_certain and (not is_known or guarantee.stop_mps2 < STEEP_MPS2):
            primed = self._primed(arbitration, is_backward, guarantee, curvature_per_m, highest_mps, now_ns)
        to_echo = None if is_known else self._on_unknown_slope(guarantee)
        bound = primed or self.sonars.bound(curvature_per_m, is_backward, guarantee, now_ns, late_s, to_echo=to_echo)
        self._is_careful = not is_known and bound.speed_mps < FREE_MPS
        if speed.magnitude_mps >= ROLLS_MPS and self._goes_on_stopping(is_backward):
            bound = bound._replace(speed_mps=min(ROLLS_MPS, bound.speed_mps), words=UNKNOWN)
        self._stops = highest_mps > bound.speed_mps and speed.magnitude_mps >= ROLLS_MPS
        if self._stops:
            return Obstacle(stop=bound)
        if not is_known or primed:
            bound = self._begun_slowly(bound, is_known, primed, is_backward, speed, highest_mps, now_ns)
        else:
            self._shows_slope = False
            bound = self._approached(bound, is_backward, highest_mps, speed, now_ns)
        return Obstacle(bounds=(bound,))

    def _primed(self, arbitration, is_backward, guarantee, curvature_per_m, highest_mps, now_ns):
        """The bound of a car whose brake a push will make certain; ``None``: there is no room for that."""
        brake_mps2 = self._brake_mps2 - self.slope.brake_lacks_mps2(False)
        if not (self._will_brake and not is_backward and arbitration.asked > 0 and brake_mps2 > STEEP_MPS2
                and (self._answer is None or self._answer.state in (FORWARD, NEUTRAL))):
            return None
        late_s = self._late_s + MOTOR_LAG_S + PRIME_S
        certain = Guarantee(brake_mps2, 0.0, guarantee.drag_mps2)
        bound = self.sonars.bound(curvature_per_m, False, certain, now_ns, late_s)
        return bound if self._pushes or bound.speed_mps >= highest_mps + PRIME_MPS else None

    def _goes_on_stopping(self, is_backward):
        """Whether a stop brakes where it isn't known how the car slows down without that: its brake isn't certain once
        it was released.
        """
        return (self._stops and self._answer is not None and self._answer.state == BRAKING
                and not self.slope.is_known(is_backward))

    def _guarantee(self, arbitration, is_backward, by_drag, curvature_per_m, now_ns):
        drag_mps2 = max(0.01, self._drag_mps2 - self.slope.lacks_mps2(is_backward, curvature_per_m))
        drag = Guarantee(drag_mps2, 0.0, drag_mps2)
        answer = self._answer
        if by_drag or answer is None or answer.coasts_below_mps or answer.stop_mps2 <= self._drag_mps2:
            return drag
        is_trusted = (answer.state == FORWARD or answer.state == BRAKING and arbitration.asked < 0
                      or answer.state == NEUTRAL and now_ns - self._pushed_ns <= TRUSTED_COASTING_NS)
        brake_mps2 = answer.stop_mps2 - self.slope.brake_lacks_mps2(is_backward)
        return Guarantee(brake_mps2, 0.0, drag_mps2) if is_trusted and brake_mps2 > drag_mps2 else drag

    def _highest_mps(self, speed, now_ns):
        """The speed that the car may have now, by the age of what was measured."""
        if speed.is_late(now_ns):
            return speed.highest_mps(now_ns)
        return speed.magnitude_mps + max(0.0, self._gain_mps2(speed)) * speed.age_s(now_ns)

    def _gain_mps2(self, speed):
        """The acceleration beyond what noise looks like."""
        return self.slope.acceleration_mps2 - NOISE_MPS2 - NOISE_PER_S * speed.magnitude_mps

    def _on_unknown_slope(self, guarantee):
        drag_mps2 = min(guarantee.drag_mps2, max(LEFT_MPS2, self._drag_mps2 - UNKNOWN_SLOPE_MPS2))
        return Guarantee(drag_mps2, 0.0, drag_mps2)

    def _begun_slowly(self, allowed, is_known, primed, is_backward, speed, highest_mps, now_ns):
        """A bound while it isn't known how the car slows down here, or while its brake isn't certain."""
        will_brake = self._will_brake and not is_backward
        self._shows_slope = (not will_brake and highest_mps >= MOVES_MPS
                             and (self._shows_slope or highest_mps >= SHOWS_SLOPE_MPS))
        most_mps = min(highest_mps, UNKNOWN_SLOPE_MPS) if self._shows_slope else UNKNOWN_SLOPE_MPS
        words = UNCERTAIN if is_known else UNKNOWN
        bound = allowed if most_mps >= allowed.speed_mps else allowed._replace(speed_mps=most_mps, words=words)
        bound = self._approached(bound, is_backward, highest_mps, speed, now_ns)
        bound = bound._replace(max_throttle=min(bound.max_throttle, self._rising(is_backward, highest_mps, now_ns)))
        if primed:
            return self._prolonged(bound, allowed, highest_mps)
        return bound._replace(max_throttle=0.0) if will_brake and not self._pushes else bound

    def _prolonged(self, bound, allowed, highest_mps):
        """The same for a car that is pushed: a push that ends too early makes no brake certain."""
        least = self._least[False]
        least_mps = min(allowed.speed_mps, highest_mps + BAND_MPS * (least + 0.01))
        return bound._replace(speed_mps=max(bound.speed_mps, least_mps), max_throttle=max(bound.max_throttle, least))

    def _rising(self, is_backward, highest_mps, now_ns):
        """The throttle that may be given there."""
        rises = highest_mps < MOVES_MPS or self.slope.acceleration_mps2 < RISING_MPS2
        elapsed_s = min(0.1, (now_ns - self._answered_ns) / NS_PER_S) if rises else 0.0
        return max(self._least[is_backward], self._pushes * (1.0 + elapsed_s / RISES_S))

    def _approached(self, bound, is_backward, highest_mps, speed, now_ns):
        """A bound with the throttle that may be given on the way to it."""
        left_mps, age_s = bound.speed_mps - highest_mps, speed.age_s(now_ns)
        gain_mps2 = self._gain_mps2(speed)
        if gain_mps2 > 0.0 and left_mps <= gain_mps2 * CUT_S:
            return bound._replace(max_throttle=0.0)
        gradual_mps = BAND_MPS + FULL_MPS2 * (CUT_S + age_s)
        least = self._least[is_backward] if left_mps > LEAST_LEFT_MPS else 0.0
        return bound._replace(max_throttle=max(least, min(1.0, self._steady + left_mps / gradual_mps)))
