"""A car from the page: an ESC of one kind, a motor that follows late, drag, brake and slope, and steering that follows
late. Its figures are at least as good as what its files promise of it: it brakes no weaker and rolls no freer.
"""
from __future__ import annotations

import math
from typing import NamedTuple

from .room import Pose

GRAVITY_MPS2 = 9.81
STANDS_MPS = 0.02


class CarConfig(NamedTuple):
    """One car.

    Attributes:
        becomes_reverse: the ESC is a crawler's: a pulse behind neutral that is held drives backward at standstill.
        hold_s: for how long it holds the car before that.
        dwell_s: how long the other kind wants neutral between a brake and reverse.
        drag_brake: share of the full brake in neutral.
        brake_mps2: deceleration by the full brake.
        breakaway_mps2: what sets a standing car in motion; drag holds less than that.
        slope: of the floor, rising towards ``uphill_rad``.
        motor_lag_s: time constant with which motor and brake follow the ESC.
    """

    becomes_reverse: bool
    hold_s: float
    dwell_s: float
    dead_band: float
    drag_brake: float
    motor_lag_s: float
    push_mps2: float
    top_mps: float
    brake_mps2: float
    drag_mps2: float
    breakaway_mps2: float
    slope: float
    uphill_rad: float
    steering_lag_s: float
    grip_mps2: float


class Esc:
    """What an ESC makes of its pulses: a share of the motor's push, and one of its brake."""

    def __init__(self, config: CarConfig):
        self._config = config
        self._neutral_s = self._stood_s = 0.0
        self._has_braked = self._is_unlocked = False

    def step(self, request: float, speed_mps: float, step_s: float) -> tuple[float, float]:
        """Push, −1..1, and brake, 0..1, for a pulse, as a fraction of the way from neutral to each end."""
        band = self._config.dead_band
        level = max(0.0, min(1.0, (abs(request) - band) / (1 - band)))
        if request > band:
            self._neutral_s = self._stood_s = 0.0
            self._has_braked = self._is_unlocked = False
            return level, 0.0
        if request >= -band:
            self._stood_s = 0.0
            self._neutral_s += step_s
            self._is_unlocked |= self._has_braked and self._neutral_s >= self._config.dwell_s
            return 0.0, self._config.drag_brake
        self._neutral_s, self._has_braked = 0.0, True
        if self._config.becomes_reverse:
            self._stood_s = 0.0 if speed_mps > STANDS_MPS else self._stood_s + step_s
            is_reverse = self._stood_s > self._config.hold_s
        else:
            is_reverse = self._is_unlocked
        return (-level, 0.0) if is_reverse else (0.0, abs(request))


class Car:
    """Where a car is, how fast, and on which arc."""

    def __init__(self, config: CarConfig, pose: Pose):
        self.config = config
        self.pose = pose
        self.speed_mps = self.curvature_per_m = self.distance_m = 0.0
        self._esc = Esc(config)
        self._push_mps2 = self._brake_mps2 = 0.0

    @property
    def gravity_mps2(self) -> float:
        """How strongly the slope pushes it forward."""
        uphill = math.cos(self.pose.yaw_rad - self.config.uphill_rad)
        return -GRAVITY_MPS2 * self.config.slope * uphill

    def step(self, request: float, curvature_per_m: float, step_s: float) -> None:
        """Drive on for so long with this pulse and this wanted curvature."""
        self._follow(request, step_s)
        pull_mps2 = self._push_mps2 + self.gravity_mps2
        drag_mps2 = self.config.drag_mps2 if self.speed_mps else self.config.breakaway_mps2
        resist_mps = (drag_mps2 + self._brake_mps2) * step_s
        free_mps = self.speed_mps + pull_mps2 * step_s
        was_mps = self.speed_mps
        self.speed_mps = math.copysign(max(0.0, abs(free_mps) - resist_mps), free_mps)
        self._steer(curvature_per_m, step_s)
        moved_m = (was_mps + self.speed_mps) / 2 * step_s
        middle_rad = self.pose.yaw_rad + moved_m * self.curvature_per_m / 2
        self.distance_m += abs(moved_m)
        self.pose = Pose(self.pose.x_m + moved_m * math.cos(middle_rad), self.pose.y_m + moved_m * math.sin(middle_rad),
                         self.pose.yaw_rad + moved_m * self.curvature_per_m)

    def _follow(self, request, step_s):
        level, brake = self._esc.step(request, self.speed_mps, step_s)
        lacking_mps = level * self.config.top_mps - self.speed_mps
        wanted_mps2 = 0.0
        if level and lacking_mps * level > 0:  # a motor that turns faster than its pulse freewheels
            wanted_mps2 = max(-1.0, min(1.0, 2.0 * lacking_mps / self.config.top_mps)) * self.config.push_mps2
        share = min(1.0, step_s / self.config.motor_lag_s)
        self._push_mps2 += share * (wanted_mps2 - self._push_mps2)
        self._brake_mps2 += share * (brake * self.config.brake_mps2 - self._brake_mps2)

    def _steer(self, curvature_per_m, step_s):
        tightest = self.config.grip_mps2 / max(self.speed_mps ** 2, 0.01)
        wanted = max(-tightest, min(tightest, curvature_per_m))
        self.curvature_per_m += min(1.0, step_s / self.config.steering_lag_s) * (wanted - self.curvature_per_m)
