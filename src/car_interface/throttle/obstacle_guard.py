"""Whether the car has to stop for what its sonars see, with what its ESC guarantees now.

Pure. A stop that is certain to brake now may not be when it is needed. An ESC that takes a pull for a brake after
driving forward takes it for reverse after neutral, so a stop trusts that for half a second of coasting only
(``throttle.esc.STOP_MEMORY_NS``). So here it counts while the car is driven or braked. A car that coasts too long, or
whose brake is about to be released, is counted with drag alone, which is what is left then. So it is backward, too.
"""
from __future__ import annotations

import math
from typing import NamedTuple

from car_interface.common.measured_speed import MeasuredSpeed
from car_interface.common.units import NS_PER_S
from car_interface.throttle.arbiter import PLANNER, TELEOP, Arbitration
from car_interface.throttle.esc import BRAKING, FORWARD, NEUTRAL, REVERSE, STOP_MEMORY_NS, EscDecision
from car_interface.throttle.esc_config import EscConfig
from car_interface.throttle.limits import SpeedBound
from car_interface.throttle.obstacle_stop import Guarantee, ObstacleStop

ROLLS_MPS = 0.1
# Before the stop's memory of driving forward ends a stop must have begun, and reached the ESC.
TRUSTED_COASTING_NS = STOP_MEMORY_NS - round(0.2 * NS_PER_S)


class Obstacle(NamedTuple):
    """What the sonars allow."""

    bounds: tuple[SpeedBound, ...] = ()
    stop: SpeedBound | None = None  # one that the car exceeds


NONE = Obstacle()


class ObstacleGuard:
    """Follows one car's ESC, and bounds its speed by its sonars."""

    def __init__(self, sonars: ObstacleStop, esc: EscConfig):
        self.sonars = sonars
        self._drag = Guarantee(esc.drag_deceleration_mps2, 0.0, esc.drag_deceleration_mps2)
        self._answer: EscDecision | None = None
        self._pushed_ns = -math.inf

    def update_esc(self, answer: EscDecision, now_ns: int) -> None:
        """What the ESC was given."""
        self._answer = answer
        if answer.state == FORWARD and answer.fraction > 0:
            self._pushed_ns = now_ns

    def check(self, arbitration: Arbitration, speed: MeasuredSpeed, curvature_per_m: float, now_ns: int) -> Obstacle:
        """What the sonars allow whoever drives, in the direction in which the car drives."""
        if arbitration.is_stop or arbitration.source not in (TELEOP, PLANNER) or not speed.was_received:
            return NONE
        is_reverse = self._answer is not None and self._answer.state == REVERSE
        is_backward = speed.last_mps <= -ROLLS_MPS or speed.last_mps < ROLLS_MPS and (
            is_reverse or arbitration.asked < 0)
        guarantee = self._drag if is_backward or is_reverse else self._guarantee(arbitration, now_ns)
        bound = self.sonars.bound(curvature_per_m, is_backward, guarantee, now_ns)
        if bound is None:
            return NONE
        if speed.magnitude_mps > bound.speed_mps and speed.magnitude_mps >= ROLLS_MPS:
            return Obstacle(stop=bound)
        return Obstacle(bounds=(bound,))

    def _guarantee(self, arbitration, now_ns):
        answer = self._answer
        if answer is None:
            return self._drag
        told = Guarantee(answer.stop_mps2, answer.coasts_below_mps, self._drag.drag_mps2)
        if answer.state == FORWARD or answer.state == BRAKING and arbitration.asked < 0:
            return told
        if answer.state == NEUTRAL and (now_ns - self._pushed_ns <= TRUSTED_COASTING_NS or told.coasts_below_mps):
            return told
        return self._drag
