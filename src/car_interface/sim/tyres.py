"""Models the grip of tyres: how a car's path differs from its steering, how hard it can brake, and when it tips.

The front wheels slip sideways by an angle that grows with the square of the lateral acceleration a: the path is less
curved than the steering points, by ``understeer`` · a². Measured circles of a 3.5 kg F1TENTH car (motion capture, 0.5
to 2.5 m/s, 3 steering angles; recordings of Tinker-Twins/F1TENTH-Mocap-Data-Recording-Pipeline) follow that within
2.5 % in radius, up to 5 m/s² sideways. Beyond, the friction circle holds: √(along² + across²) ≤ grip.

Weight doesn't move and slip takes no time: no skid, no oversteer, no rocking before it tips.
"""
from __future__ import annotations

import math
from dataclasses import dataclass

from car_interface.common import declared

UPRIGHT_RATIO = 0.9  # below this part of the acceleration at which it tips, the car stands on its wheels again


@dataclass(frozen=True)
class TyreConfig:
    """One car's tyres and its balance: those of the measured car, and rubber on a dry floor, 0.8 g."""

    understeer: float = declared.number(
        "understeer", 0.0078, "curvature that it loses by its lateral acceleration", "1/m for each (m/s²)²", low=0,
        high=1)
    grip_mps2: float = declared.number(
        "grip", 7.8, "the most acceleration, along and across together", "m/s²", above=0.0, high=100)
    rollover_mps2: float = declared.number(
        "rollover", 7.0, "the lateral acceleration at which it tips", "m/s²", above=0.0, high=100)


def possible_acceleration_mps2(demanded_mps2: float, tyres: TyreConfig) -> float:
    """Return how much of an acceleration along the car the tyres transmit."""
    return max(-tyres.grip_mps2, min(tyres.grip_mps2, demanded_mps2))


def path_curvature_per_m(steered_per_m: float, speed_mps: float, along_mps2: float, tyres: TyreConfig) -> float:
    """Return the curvature of the path.

    Args:
        steered_per_m: the curvature of the steering at a crawl.
        speed_mps: its sign doesn't matter.
        along_mps2: transmitted by the tyres along the car; the rest of the friction circle is left for the turn.
    """
    speed2 = speed_mps * speed_mps
    loss = tyres.understeer * speed2 * speed2
    magnitude = abs(steered_per_m)
    if loss * magnitude > 1e-9:
        # steered = path + loss · path²: its positive root, in a form that takes a small loss.
        magnitude = 2 * magnitude / (1 + math.sqrt(1 + 4 * loss * magnitude))
    if speed2:
        across_mps2 = math.sqrt(max(0.0, tyres.grip_mps2 ** 2 - along_mps2 ** 2))
        magnitude = min(magnitude, across_mps2 / speed2)
    return math.copysign(magnitude, steered_per_m)


class Rollovers:
    """Counts how often a car would have tipped over. The car drives on.

    Attributes:
        count: how often; once until it stands on its wheels again.
        lateral_mps2: of the newest, the largest so far; left turns positive.
        max_lateral_mps2: the largest magnitude since the start.
    """

    def __init__(self, rollover_mps2: float):
        self._rollover_mps2 = rollover_mps2
        self._tips = False
        self.count = 0
        self.lateral_mps2 = 0.0
        self.max_lateral_mps2 = 0.0

    def update(self, lateral_mps2: float) -> None:
        magnitude = abs(lateral_mps2)
        self.max_lateral_mps2 = max(self.max_lateral_mps2, magnitude)
        if self._tips:
            self._tips = magnitude >= UPRIGHT_RATIO * self._rollover_mps2
            if magnitude > abs(self.lateral_mps2):
                self.lateral_mps2 = lateral_mps2
        elif magnitude >= self._rollover_mps2:
            self._tips = True
            self.count += 1
            self.lateral_mps2 = lateral_mps2
