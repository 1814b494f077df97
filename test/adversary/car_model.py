"""A car on a line: no mass, but a motor that lags, a brake, drag, a slope, tyres that slide, and walls."""
from __future__ import annotations

import math
from typing import NamedTuple

from adversary.esc_model import BACKWARD, BRAKE, FORWARD

G = 9.81


class CarSpec(NamedTuple):
    """One car.

    Attributes:
        lag_s: of the motor, for push and brake.
        push_mps2, top_mps: full throttle's acceleration from standstill, and its speed.
        brake_mps2: of the full brake.
        grip_mps2: beyond it the braked wheels lock and stand.
        drag_mps2: rolls out so.
        slope: rise over distance, uphill positive.
        wall_m, wall_behind_m: distance to what blocks the car; inf = nothing.
    """

    lag_s: float = 0.05
    push_mps2: float = 7.0
    top_mps: float = 10.0
    brake_mps2: float = 6.0
    grip_mps2: float = 20.0
    drag_mps2: float = 0.35
    slope: float = 0.0
    wall_m: float = math.inf
    wall_behind_m: float = math.inf


class CarModel:
    """Speed and place.

    Attributes:
        speed_mps, wheel_mps: of the car, and of its wheels' tread; x_m: where it is.
        is_locked: the wheels are braked harder than the tyres hold.
        hit_mps: at which a wall ahead stopped it in this step; 0 = none did.
    """

    def __init__(self, spec: CarSpec):
        self.spec = spec
        self.x_m = self.speed_mps = self.wheel_mps = 0.0
        self.is_locked, self.hit_mps = False, 0.0
        self._push = self._brake = 0.0
        self.ahead_m, self.behind_m = spec.wall_m, -spec.wall_behind_m

    def step(self, motor: str, level: float, drag_brake: float, dt_s: float) -> None:
        """Go on by ``dt_s`` with what the motor does."""
        spec, speed = self.spec, self.speed_mps
        push = brake = 0.0
        if motor == FORWARD:
            push = max(0.0, spec.push_mps2 * (level - max(0.0, speed) / spec.top_mps))
        elif motor == BACKWARD:
            push = min(0.0, -spec.push_mps2 * (level + min(0.0, speed) / spec.top_mps))
        elif motor == BRAKE:
            brake = level * spec.brake_mps2
        else:
            brake = drag_brake * spec.brake_mps2
        share = dt_s / (spec.lag_s + dt_s)
        self._push += (push - self._push) * share
        self._brake += (brake - self._brake) * share
        slope = -G * spec.slope
        pushes = max(-spec.grip_mps2, min(spec.grip_mps2, self._push)) + slope
        holds = self._brake + spec.drag_mps2
        self.is_locked = self._brake > spec.grip_mps2 and abs(speed) > 0.05
        if self.is_locked:
            holds = spec.grip_mps2
        if speed == 0.0:
            if abs(pushes) <= holds:
                self.wheel_mps = 0.0
                return
            speed = math.copysign((abs(pushes) - holds) * dt_s, pushes)
        else:
            after = speed + (pushes - math.copysign(holds, speed)) * dt_s
            speed = 0.0 if after * speed <= 0 else after
        self.x_m += speed * dt_s
        self.hit_mps = 0.0
        if self.x_m >= self.ahead_m and speed > 0:
            self.x_m, self.hit_mps, speed = self.ahead_m, speed, 0.0
        elif self.x_m <= self.behind_m and speed < 0:
            self.x_m, speed = self.behind_m, 0.0
        self.speed_mps = speed
        self.wheel_mps = 0.0 if self.is_locked else speed
