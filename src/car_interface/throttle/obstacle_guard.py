"""Whether the car has to stop for what its sonars see, with what its ESC and the ground guarantee now.

Pure. A stop that is certain to brake now may not be when it is needed. An ESC that takes a pull for a brake after
driving forward takes it for reverse after neutral, so a stop trusts that for half a second of coasting only
(``throttle.esc.STOP_MEMORY_NS``). So here it counts while the car is driven or braked. A car that coasts too long, or
whose brake is about to be released, is counted with what it loses by itself in neutral (``throttle.slope``). So it is
backward, too, and where a brake counts only as long as the car is fast: it may not be by the time that it is needed.

Where it isn't certain that the car slows down by itself it has to be found out. A car whose ESC may never brake is
pushed gently, and rolls in neutral until it is known, or it stands. It rolls again, near its bound, where a turn has
made its deceleration doubtful. Where the ESC will brake the push lasts until that is certain, and begins only with room
for it. A stop is never pushed.

A motor goes on pushing after its throttle was cut. So the throttle is given back gradually, and taken away where the
car, getting faster as it does, will reach the bound anyway.
"""
from __future__ import annotations

import math
from typing import NamedTuple

from car_interface.common import causes
from car_interface.common.measured_speed import UNSEEN_MPS2, MeasuredSpeed
from car_interface.common.units import NS_PER_S
from car_interface.throttle.arbiter import PLANNER, TELEOP, Arbitration
from car_interface.throttle.esc import BRAKING, FORWARD, NEUTRAL, REVERSE, STOP_MEMORY_NS, EscDecision
from car_interface.throttle.esc_config import BRAKE_THEN_REVERSE, FORWARD_ONLY, EscConfig
from car_interface.throttle.limits import BAND_MPS, SpeedBound
from car_interface.throttle.obstacle_stop import MIN_STOP_MPS2, Guarantee, ObstacleStop
from car_interface.throttle.slope import Slope

ROLLS_MPS, MOVES_MPS = 0.1, 0.05
STEEP_MPS2 = 0.1  # less than this stops no car for certain: 0.25 m/s would take 0.3 m, and 0.1 is a slope of 1 %
# Before the stop's memory of driving forward ends a stop must have begun, and reached the ESC.
TRUSTED_COASTING_NS = STOP_MEMORY_NS - round(0.2 * NS_PER_S)
MOTOR_LAG_S = 0.15  # the longest of the cars in test/rooms
CUT_S = 0.05 + MOTOR_LAG_S  # from a throttle's cut until the car gets no faster: the way to the ESC, a pulse, the lag
# The throttle that holds a speed is a mean over the motor's lag and a pulse, and over four times odometry's age, which
# damps the loop that the age is in.
STEADY_S, LATE_STEADY = CUT_S, 4.0
FULL_MPS2 = 2.0 * 5.6  # the simulated Slash's at full throttle; half of it may be all that the motor can do
# An acceleration that odometry may show where there is none, and more for each m/s: at 1 m/s three standard deviations
# of what noise of 0.01 m/s and 1 % makes of six reports in 0.12 s.
NOISE_MPS2, NOISE_PER_S = 0.5, 0.1
# Where nothing is certain to stop it a car begins with at most this speed. The throttle rises from the least by as much
# in so many seconds, until the car gets faster by so much: within the motor's lag and odometry's age by a third.
PROBE_MPS, RISES_S, RISING_MPS2 = 0.25, 0.8, 0.1
# With more doubt of its deceleration than this the car rolls in neutral, until half is left. With 0.06 to 0.1 it drives
# more slowly for the doubt, with 0.03 it rolls too often (test/rooms --empty).
DOUBT_MPS2 = 0.04
NEAR_MPS = 0.15  # it does so from this far below its bound on; the least throttle may be given up to there
# esc_history.DROVE_NS and a way to the ESC; in it the least throttle makes a car faster by no more than this.
PRIME_S, PRIME_MPS = 0.6, 0.35
# How it begins, in the words of the reason.
PROBES, PRIMES = "before it is known how it slows down here it has", "before its brake is certain it has"
STEEP = "nothing is certain to stop it on this slope, which allows"


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
        self._brake_mps2 = esc.stop_brake * esc.brake_deceleration_mps2
        # Its brake becomes certain once it has driven forward for a while.
        self._will_brake = bool(esc.profile in (BRAKE_THEN_REVERSE, FORWARD_ONLY) and esc.profile_measured
                                and esc.stop_brake)
        self._least = esc.dead_band_forward, esc.dead_band_reverse
        self._answer: EscDecision | None = None
        self._push_began_ns = self._pushed_ns = self._answered_ns = -math.inf
        self._throttle = 0.0  # that it has
        self._steady = 0.0  # that which holds its speed
        self._late_s = 0.0  # odometry's age
        self._rolls = False  # in neutral, to show how it slows down

    def update_esc(self, answer: EscDecision, now_ns: int) -> None:
        """Take what the ESC was given."""
        elapsed_s = (now_ns - self._answered_ns) / NS_PER_S
        self._answer, self._answered_ns = answer, now_ns
        if answer.state == FORWARD and answer.fraction > 0:
            self._push_began_ns = self._push_began_ns if self._throttle else now_ns
            self._pushed_ns = now_ns
        self._throttle = abs(answer.fraction) if answer.state in (FORWARD, REVERSE) else 0.0
        # What accelerates the car is more than what holds its speed. A roll to measure the ground changes neither.
        surplus = max(0.0, self.slope.acceleration_mps2) / UNSEEN_MPS2
        holds = max(0.0, (self._steady if self._rolls else self._throttle) - surplus)
        self._steady += (holds - self._steady) * min(1.0, elapsed_s / (STEADY_S + LATE_STEADY * self._late_s))
        self.slope.update_esc(answer.fraction, now_ns)

    def update_speed(self, speed_mps: float, now_ns: int, age_ns: int, curvature_per_m: float) -> None:
        """Take the measured speed, forward positive, how old it was at its arrival, and the arc that the car drives."""
        self.slope.update_speed(speed_mps, now_ns - max(0, age_ns), curvature_per_m)

    def check(self, arbitration: Arbitration, speed: MeasuredSpeed, curvature_per_m: float, now_ns: int) -> Obstacle:
        """Return what the sonars allow, whoever drives, in the direction in which the car drives."""
        if not speed.was_received:
            return NONE
        self.sonars.update_motion(speed.last_mps, curvature_per_m, now_ns)
        if arbitration.is_stop or arbitration.source not in (TELEOP, PLANNER):
            return NONE
        self._late_s = speed.age_s(now_ns)
        is_reverse = self._answer is not None and self._answer.state == REVERSE
        is_backward = speed.last_mps <= -ROLLS_MPS or speed.last_mps < ROLLS_MPS and (
            is_reverse or arbitration.asked < 0)
        gain_mps2 = self._gain_mps2(speed)
        highest_mps = self._highest_mps(speed, gain_mps2, now_ns)
        reaches_mps = highest_mps + gain_mps2 * CUT_S
        coasting = self.slope.coasting(is_backward, self._turn_rad(reaches_mps, curvature_per_m, is_backward))
        brake_mps2 = 0.0 if is_backward or is_reverse else self._certain_brake_mps2(arbitration, coasting, now_ns)
        stop_mps2 = max(coasting.certain_mps2, brake_mps2)
        begins = self._begins(arbitration, coasting, is_backward) if stop_mps2 < STEEP_MPS2 else ""
        bound = self._bound(begins, stop_mps2, coasting, reaches_mps, curvature_per_m, is_backward, now_ns)
        self._rolls = highest_mps >= MOVES_MPS and self._is_in_doubt(coasting, stop_mps2, bound, highest_mps)
        if highest_mps > bound.speed_mps and speed.magnitude_mps >= ROLLS_MPS:
            return Obstacle(stop=bound)
        if begins == PRIMES:
            throttle = self._primes(bound, highest_mps, now_ns)
        elif self._rolls or reaches_mps >= bound.speed_mps:
            throttle = 0.0
        else:
            throttle = self._approach(bound, is_backward, highest_mps)
            if begins == PROBES:
                throttle = min(throttle, self._rising(is_backward, highest_mps, now_ns))
        return Obstacle(bounds=(bound._replace(max_throttle=throttle),))

    def _gain_mps2(self, speed):
        """The acceleration, where it is more than noise may look like."""
        gain_mps2 = self.slope.acceleration_mps2
        return gain_mps2 if gain_mps2 > NOISE_MPS2 + NOISE_PER_S * speed.magnitude_mps else 0.0

    def _highest_mps(self, speed, gain_mps2, now_ns):
        """The speed that the car may have now, by the age of what was measured."""
        if speed.is_late(now_ns):
            return speed.highest_mps(now_ns)
        return speed.magnitude_mps + gain_mps2 * self._late_s

    def _turn_rad(self, speed_mps, curvature_per_m, is_backward):
        """By how much the heading will have changed halfway to where drag stops the car.

        Gravity's work on an arc is that along its chord, which points as the car does halfway.
        """
        halfway_m = speed_mps * speed_mps / (4.0 * self._drag_mps2)
        return halfway_m * curvature_per_m * (-1.0 if is_backward else 1.0)

    def _certain_brake_mps2(self, arbitration, coasting, now_ns):
        """The deceleration of a brake that is certain by the time that it is needed; 0: there is none."""
        answer = self._answer
        if answer is None or answer.coasts_below_mps or answer.stop_mps2 <= self._drag_mps2:
            return 0.0
        is_trusted = (answer.state == FORWARD or answer.state == BRAKING and arbitration.asked < 0
                      or answer.state == NEUTRAL and now_ns - self._pushed_ns <= TRUSTED_COASTING_NS)
        return answer.stop_mps2 - self._brake_lacks_mps2(coasting) if is_trusted else 0.0

    def _brake_lacks_mps2(self, coasting):
        return max(0.0, self._drag_mps2 - coasting.likely_mps2, self.slope.brake_lacks_mps2)

    def _begins(self, arbitration, coasting, is_backward):
        """How a car begins that nothing is certain to stop; empty: it doesn't."""
        if self._will_brake and not is_backward:
            may_prime = self._answer is None or self._answer.state in (FORWARD, NEUTRAL)
            return PRIMES if arbitration.asked > 0 and may_prime else ""
        return PROBES if coasting.likely_mps2 >= STEEP_MPS2 else ""

    def _bound(self, begins, stop_mps2, coasting, reaches_mps, curvature_per_m, is_backward, now_ns):
        late_s = self._late_s + MOTOR_LAG_S
        if begins == PRIMES:
            stop_mps2 = self._brake_mps2 - self._brake_lacks_mps2(coasting)
            pushed_s = (now_ns - self._push_began_ns) / NS_PER_S if self._throttle else 0.0
            late_s += max(0.0, PRIME_S - pushed_s)
        elif begins == PROBES:
            stop_mps2 = MIN_STOP_MPS2
        elif stop_mps2 < STEEP_MPS2:
            return SpeedBound(0.0, causes.OBSTACLE_SLOWED, STEEP)
        guarantee = Guarantee(stop_mps2, 0.0, stop_mps2)
        bound = self.sonars.bound(curvature_per_m, is_backward, guarantee, now_ns, late_s)
        if begins == PRIMES:
            return bound._replace(words=PRIMES)
        if begins == PROBES:
            return bound._replace(speed_mps=PROBE_MPS, words=PROBES) if bound.speed_mps > PROBE_MPS else bound
        is_by_drag = stop_mps2 == coasting.certain_mps2
        return self._sustained(bound, stop_mps2, reaches_mps, curvature_per_m, is_backward) if is_by_drag else bound

    def _sustained(self, bound, stop_mps2, reaches_mps, curvature_per_m, is_backward):
        """The bound that still holds once the car is as fast.

        A faster car stops farther along its arc, on another heading, where less may be certain to stop it. The bound
        goes with that deceleration's root; where a straight line through its values at the present speed and at the
        bound itself meets the speed lies what can be kept.
        """
        left_mps = bound.speed_mps - reaches_mps
        if left_mps <= 0.0 or not curvature_per_m:
            return bound
        turn_rad = self._turn_rad(bound.speed_mps, curvature_per_m, is_backward)
        there_mps2 = max(0.0, self.slope.coasting(is_backward, turn_rad).certain_mps2)
        falls_mps = max(0.0, bound.speed_mps * (1.0 - math.sqrt(there_mps2 / stop_mps2)))
        return bound._replace(speed_mps=reaches_mps + left_mps * left_mps / (left_mps + falls_mps))

    def _is_in_doubt(self, coasting, stop_mps2, bound, highest_mps):
        """Whether to roll in neutral: to know better how it slows down would allow more than its bound."""
        doubt_mps2 = min(self._drag_mps2, coasting.likely_mps2) - max(stop_mps2, coasting.certain_mps2)
        if self._rolls:
            return doubt_mps2 > DOUBT_MPS2 / 2.0
        return doubt_mps2 > DOUBT_MPS2 and highest_mps >= bound.speed_mps - NEAR_MPS

    def _primes(self, bound, highest_mps, now_ns):
        """The throttle until the brake is certain: a push that ends too early makes it no more so."""
        if not self._throttle and bound.speed_mps < highest_mps + PRIME_MPS:
            return 0.0
        return self._rising(False, highest_mps, now_ns) if highest_mps < PROBE_MPS else self._least[False]

    def _rising(self, is_backward, highest_mps, now_ns):
        """The throttle on ground that isn't known: it rises until the car moves, and while it gets no faster."""
        rises = highest_mps < MOVES_MPS or self.slope.acceleration_mps2 < RISING_MPS2
        elapsed_s = min(0.1, (now_ns - self._answered_ns) / NS_PER_S) if rises else 0.0
        return max(self._least[is_backward], self._throttle * (1.0 + elapsed_s / RISES_S))

    def _approach(self, bound, is_backward, highest_mps):
        """The throttle on the way to a bound."""
        left_mps = bound.speed_mps - highest_mps
        gradual_mps = BAND_MPS + FULL_MPS2 * (CUT_S + self._late_s)
        least = self._least[is_backward] if left_mps > NEAR_MPS else 0.0
        return max(least, min(1.0, self._steady + left_mps / gradual_mps))
