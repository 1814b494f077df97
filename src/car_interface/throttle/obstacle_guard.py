"""Bound the speed by what the sonars see, with the deceleration that ESC and ground guarantee now.

``ObstacleGuard.check`` takes the arbitration, the measured speed and the arc, and returns a ``SpeedBound``: with the
most throttle on the way to that speed, or as one that the car exceeds and has to stop for.
``obstacle_stop`` knows the distances; this module decides on which deceleration a stop can rely:

* A brake counts while the car is driven or braked, and for TRUSTED_COASTING_NS after a push. An ESC that brakes after
  forward may reverse after neutral, so a brake that is certain now may not be by the time that it is needed. A brake
  that is certain only above some speed doesn't count at all.
* Otherwise, and always backward, the car's own deceleration in neutral counts (``slope``).
* If that isn't certain either, the car has to find out. A car whose ESC may never brake is pushed gently (PROBES), and
  rolls in neutral until its deceleration is known or it stands. It rolls again, near its bound, when a turn has made
  its deceleration uncertain. A car whose ESC will brake is pushed until that is certain (PRIMES), which begins only
  with enough room. A stop is never pushed.

A motor pushes on after its throttle was cut. So the throttle rises gradually, and is cut before the bound where the
car's present acceleration will carry it there. Pure: ``now_ns`` is passed in.
"""
from __future__ import annotations

import math

from car_interface.common import causes
from car_interface.common.measured_speed import UNSEEN_MPS2, MeasuredSpeed
from car_interface.common.units import NS_PER_S
from car_interface.throttle.arbiter import PLANNER, TELEOP, Arbitration
from car_interface.throttle.esc import BRAKING, FORWARD, HOLD, NEUTRAL, REVERSE, STOP_MEMORY_NS, EscDecision
from car_interface.throttle.esc_config import BRAKE_THEN_REVERSE, FORWARD_ONLY, EscConfig
from car_interface.throttle.esc_motion import MOTOR_LAG_NS
from car_interface.throttle.limits import BAND_MPS, SpeedBound
from car_interface.throttle.obstacle_stop import MIN_STOP_MPS2, ObstacleStop
from car_interface.throttle.slope import Slope

ROLLS_MPS, MOVES_MPS = 0.1, 0.05  # a faster car certainly rolls; a slower one may stand
STEEP_MPS2 = 0.1  # less stops no car for certain: a slope of 1 % pulls by as much
TURNS = 2  # in so many steps the heading at which an arc's roll ends halfway is found
# A stop must begin, and reach the ESC, before the stop's memory of driving forward ends.
TRUSTED_COASTING_NS = STOP_MEMORY_NS - round(0.2 * NS_PER_S)
MOTOR_LAG_S = MOTOR_LAG_NS / NS_PER_S
CUT_S = 0.05 + MOTOR_LAG_S  # from the throttle's cut until the car gets no faster: the way to the ESC, a pulse, the lag
# The throttle that holds a speed is estimated as a mean over CUT_S, and over LATE_STEADY times odometry's age: that
# damps the loop, which contains this age.
STEADY_S, LATE_STEADY = CUT_S, 4.0
FULL_MPS2 = 2.0 * 5.6  # the simulated Slash's 5.6 m/s², which half of the throttle may already reach
# Odometry may show this acceleration of a car that has none, and NOISE_PER_S more for each m/s. At 1 m/s it is three
# standard deviations of the slope of six reports in 0.12 s, with noise of 0.01 m/s and 1 %.
NOISE_MPS2, NOISE_PER_S = 0.5, 0.1
# Where nothing is certain to stop it, a car begins with PROBE_MPS at most. The throttle starts at the dead band and
# grows e-fold in RISES_S (by a third within the motor's lag and odometry's age), until the car accelerates by
# RISING_MPS2.
PROBE_MPS, RISES_S, RISING_MPS2 = 0.25, 0.8, 0.1
# If its deceleration is less certain than this, the car rolls in neutral until half of the doubt is left. With 0.06 to
# 0.1 it drives more slowly for the doubt, with 0.03 it rolls too often (`python3 test/rooms --empty`).
DOUBT_MPS2 = 0.04
NEAR_MPS = 0.15  # the car rolls only from this far below its bound on; up to there it may have the least throttle
# esc_history.DROVE_NS and the way to the ESC; in this time the least throttle adds PRIME_MPS at most.
PRIME_S, PRIME_MPS = 0.6, 0.35
# How the car begins to drive, as the reason names it.
PROBES, PRIMES = "before it is known how it slows down here it has", "before its brake is certain it has"
STEEP = "nothing is certain to stop it on this slope, which allows"


class ObstacleGuard:
    """Follow one car's ESC, and bound its speed by its sonars.

    Attributes:
        sonars: takes their ranges.
        slope: takes the measured speed.
    """

    def __init__(self, sonars: ObstacleStop, esc: EscConfig):
        self.sonars = sonars
        self.slope = Slope(esc)
        self._drag_mps2 = esc.drag_deceleration_mps2
        self._brake_mps2 = esc.stop_brake * esc.brake_deceleration_mps2
        # Its brake becomes certain once it has driven forward for a while.
        self._will_brake = bool(esc.profile in (BRAKE_THEN_REVERSE, FORWARD_ONLY) and esc.profile_measured
                                and esc.stop_brake)
        self._least = esc.dead_band_forward, esc.dead_band_reverse
        self._answer = EscDecision(0.0, NEUTRAL, "", "", 0.0)
        self._push_began_ns = self._pushed_ns = self._answered_ns = -math.inf
        self._throttle = 0.0  # the fraction that the ESC has now
        self._steady = 0.0  # the throttle that holds the speed
        self._late_s = 0.0  # odometry's age
        self._rolls = False  # whether it rolls in neutral, to measure its deceleration

    def update_esc(self, answer: EscDecision, now_ns: int) -> None:
        """Take the ESC's newest decision."""
        elapsed_s = (now_ns - self._answered_ns) / NS_PER_S
        self._answer, self._answered_ns = answer, now_ns
        if answer.state == FORWARD and answer.fraction > 0:
            self._push_began_ns = self._push_began_ns if self._throttle else now_ns
            self._pushed_ns = now_ns
        self._throttle = abs(answer.fraction) if answer.state in (FORWARD, REVERSE) else 0.0
        # The throttle that accelerates the car is more than the one that holds its speed. A roll that measures the
        # ground changes neither.
        surplus = max(0.0, self.slope.acceleration_mps2) / UNSEEN_MPS2
        holds = max(0.0, (self._steady if self._rolls else self._throttle) - surplus)
        self._steady += (holds - self._steady) * min(1.0, elapsed_s / (STEADY_S + LATE_STEADY * self._late_s))
        self.slope.update_esc(answer.fraction, now_ns)

    def check(self, arbitration: Arbitration, speed: MeasuredSpeed, curvature_per_m: float, now_ns: int
              ) -> SpeedBound | None:
        """Return what the sonars allow in the direction in which the car drives; ``None`` = nothing to bound."""
        if not speed.was_received:
            return None
        self.sonars.update_motion(speed.last_mps, curvature_per_m, now_ns)
        if arbitration.is_stop or arbitration.source not in (TELEOP, PLANNER):
            return None
        self._late_s = speed.age_s(now_ns)
        is_reverse = self._answer.state == REVERSE
        is_backward = _drives_backward(arbitration, speed.last_mps, is_reverse)
        gain_mps2 = self._gain_mps2(speed)
        highest_mps = self._highest_mps(speed, gain_mps2, now_ns)
        reaches_mps = highest_mps + gain_mps2 * CUT_S
        coasting = self._coasting(reaches_mps, curvature_per_m, is_backward)
        brake_mps2 = 0.0 if is_backward or is_reverse else self._certain_brake_mps2(arbitration, coasting, now_ns)
        stop_mps2 = max(coasting.certain_mps2, brake_mps2)
        begins = self._begins(arbitration, coasting, is_backward) if stop_mps2 < STEEP_MPS2 else ""
        bound = self._bound(begins, stop_mps2, coasting, reaches_mps, curvature_per_m, is_backward, now_ns)
        self._rolls = highest_mps >= MOVES_MPS and self._is_in_doubt(coasting, stop_mps2, bound, highest_mps)
        rolls = speed.magnitude_mps >= ROLLS_MPS
        if rolls and highest_mps > bound.speed_mps:
            return bound._replace(is_stop=True)
        throttle = self._max_throttle(begins, bound, reaches_mps, highest_mps, is_backward, now_ns)
        # The brake of a stop is let go only for a push: on a hill the car would roll.
        is_pushed = min(throttle, abs(arbitration.asked)) >= self._least[is_backward]
        is_held = self._answer.cause == causes.STOPPING and self._answer.state in (BRAKING, HOLD)
        return bound._replace(max_throttle=throttle, is_stop=is_held and not rolls and not is_pushed)

    def _gain_mps2(self, speed):
        """Return the acceleration, or 0 if odometry's noise may look like it."""
        gain_mps2 = self.slope.acceleration_mps2
        return gain_mps2 if gain_mps2 > NOISE_MPS2 + NOISE_PER_S * speed.magnitude_mps else 0.0

    def _highest_mps(self, speed, gain_mps2, now_ns):
        """Return the highest speed that the car may have now, by the age of the measured one."""
        if speed.is_late(now_ns):
            return speed.highest_mps(now_ns)
        return speed.magnitude_mps + gain_mps2 * self._late_s

    def _coasting(self, speed_mps, curvature_per_m, is_backward):
        """Return the mean deceleration in neutral from a speed to standstill.

        Gravity's work on an arc is its work along the chord, and the chord points as the car does halfway. The less
        deceleration is certain there, the farther that is.
        """
        coasting = self.slope.coasting(is_backward)
        if curvature_per_m:
            for _ in range(TURNS):
                certain_mps2 = max(STEEP_MPS2, coasting.certain_mps2)
                halfway_m = speed_mps * speed_mps / (4.0 * certain_mps2)
                coasting = self.slope.coasting(is_backward, halfway_m * curvature_per_m * (-1 if is_backward else 1))
        return coasting

    def _certain_brake_mps2(self, arbitration, coasting, now_ns):
        """Return the deceleration of a brake that will be certain when it is needed; 0: there is none."""
        answer = self._answer
        if answer.stop_mps2 <= self._drag_mps2:
            return 0.0
        is_trusted = (answer.state == FORWARD or answer.state == BRAKING and arbitration.asked < 0
                      or answer.state == NEUTRAL and now_ns - self._pushed_ns <= TRUSTED_COASTING_NS)
        return answer.stop_mps2 - self._brake_lacks_mps2(coasting) if is_trusted else 0.0

    def _brake_lacks_mps2(self, coasting):
        """Return by how much slope and measured brakings fall short of the configured brake."""
        return max(0.0, self._drag_mps2 - coasting.likely_mps2, self.slope.brake_lacks_mps2)

    def _begins(self, arbitration, coasting, is_backward):
        """Return how a car begins to drive that nothing is certain to stop; empty: it isn't driven."""
        if self._will_brake and not is_backward:
            return PRIMES if arbitration.asked > 0 and self._answer.state in (FORWARD, HOLD, NEUTRAL) else ""
        return PROBES if coasting.likely_mps2 >= STEEP_MPS2 else ""

    def _bound(self, begins, stop_mps2, coasting, reaches_mps, curvature_per_m, is_backward, now_ns):
        """Return the bound of the speed, by the deceleration that a stop can rely on."""
        late_s = self._late_s + MOTOR_LAG_S
        if begins == PRIMES:
            stop_mps2 = self._brake_mps2 - self._brake_lacks_mps2(coasting)
            pushed_s = (now_ns - self._push_began_ns) / NS_PER_S if self._throttle else 0.0
            late_s += max(0.0, PRIME_S - pushed_s)
        elif begins == PROBES:
            stop_mps2 = MIN_STOP_MPS2
        elif stop_mps2 < STEEP_MPS2:
            return SpeedBound(0.0, causes.OBSTACLE_SLOWED, STEEP)
        bound = self.sonars.bound(curvature_per_m, is_backward, stop_mps2, now_ns, late_s)
        if begins == PRIMES:
            return bound._replace(words=PRIMES)
        if begins == PROBES:
            return bound._replace(speed_mps=PROBE_MPS, words=PROBES) if bound.speed_mps > PROBE_MPS else bound
        is_by_drag = stop_mps2 == coasting.certain_mps2
        return self._sustained(bound, stop_mps2, reaches_mps, curvature_per_m, is_backward) if is_by_drag else bound

    def _sustained(self, bound, stop_mps2, reaches_mps, curvature_per_m, is_backward):
        """Return the bound that still holds once the car is that fast.

        A faster car stops farther along its arc, at another heading, where less deceleration may be certain. The bound
        is taken to go with the root of that deceleration, and to fall evenly from the present speed to the present
        bound. The speed where the falling bound meets the speed itself can be kept.
        """
        left_mps = bound.speed_mps - reaches_mps
        if left_mps <= 0.0 or not curvature_per_m:
            return bound
        there_mps2 = max(0.0, self._coasting(bound.speed_mps, curvature_per_m, is_backward).certain_mps2)
        falls_mps = max(0.0, bound.speed_mps * (1.0 - math.sqrt(there_mps2 / stop_mps2)))
        return bound._replace(speed_mps=reaches_mps + left_mps * left_mps / (left_mps + falls_mps))

    def _is_in_doubt(self, coasting, stop_mps2, bound, highest_mps):
        """Return whether to roll in neutral: a better known deceleration would allow more than the present bound."""
        doubt_mps2 = min(self._drag_mps2, coasting.likely_mps2) - max(stop_mps2, coasting.certain_mps2)
        if self._rolls:
            return doubt_mps2 > DOUBT_MPS2 / 2.0
        return doubt_mps2 > DOUBT_MPS2 and highest_mps >= bound.speed_mps - NEAR_MPS

    def _max_throttle(self, begins, bound, reaches_mps, highest_mps, is_backward, now_ns):
        """Return the most throttle on the way to a bound, 0..1."""
        if begins == PRIMES:
            return self._primes(bound, highest_mps, now_ns)
        if self._rolls or reaches_mps >= bound.speed_mps:
            return 0.0
        throttle = self._approach(bound, is_backward, highest_mps)
        if begins == PROBES:
            throttle = min(throttle, self._rising(is_backward, highest_mps, now_ns))
        return throttle

    def _primes(self, bound, highest_mps, now_ns):
        """Return the throttle until the brake is certain. It begins only with room for all of it: less doesn't help."""
        if not self._throttle and bound.speed_mps < highest_mps + PRIME_MPS:
            return 0.0
        return self._rising(False, highest_mps, now_ns) if highest_mps < PROBE_MPS else self._least[False]

    def _rising(self, is_backward, highest_mps, now_ns):
        """Return the throttle on unknown ground: it rises while the car doesn't move or doesn't get faster."""
        rises = highest_mps < MOVES_MPS or self.slope.acceleration_mps2 < RISING_MPS2
        elapsed_s = min(0.1, (now_ns - self._answered_ns) / NS_PER_S) if rises else 0.0
        return max(self._least[is_backward], self._throttle * (1.0 + elapsed_s / RISES_S))

    def _approach(self, bound, is_backward, highest_mps):
        """Return the throttle with which the car approaches a bound gradually."""
        left_mps = bound.speed_mps - highest_mps
        gradual_mps = BAND_MPS + FULL_MPS2 * (CUT_S + self._late_s)
        least = self._least[is_backward] if left_mps > NEAR_MPS else 0.0
        return max(least, min(1.0, self._steady + left_mps / gradual_mps))


def _drives_backward(arbitration, speed_mps, is_reverse):
    """Return whether the car drives backward, or is about to from standstill."""
    return speed_mps <= -ROLLS_MPS or speed_mps < ROLLS_MPS and (is_reverse or arbitration.asked < 0)
