"""Simulates a car on a line under a virtual ESC: enough to see in which direction it is driven, and where it stops.

Consumes the motor's state and time steps; produces the speeds of car and wheels. They differ while the brake has locked
the wheels: these stand, and the car slides on. Backward is negative. Pure.
"""
from __future__ import annotations

import math
from dataclasses import dataclass

from car_interface.common.errors import require
from car_interface.sim.esc import BACKWARD, BRAKE, FORWARD, MotorState

GRAVITY_MPS2 = 9.81


@dataclass(frozen=True)
class EscCarConfig:
    """One car.

    Attributes:
        forward_mps2, reverse_mps2, brake_mps2: at full level; the first two at standstill.
        thrust_halves_mps: at this speed the motor has half its thrust.
        drag_mps2, drag_per_s, drag_per_m: resistance at speed v is their sum, the second times v, the third times v².
        lock_mps2: a brake stronger than this locks the wheels.
        slide_mps2: the deceleration of a car with locked wheels.
        slope: metres up for each metre ahead.
    """

    forward_mps2: float = 5.6
    reverse_mps2: float = 3.6
    brake_mps2: float = 7.0
    thrust_halves_mps: float = 9.4
    drag_mps2: float = 0.35
    drag_per_s: float = 0.08
    drag_per_m: float = 0.004
    lock_mps2: float = math.inf
    slide_mps2: float = 4.0
    slope: float = 0.0

    def __post_init__(self):
        require(self.thrust_halves_mps > 0, "thrust_halves_mps", self.thrust_halves_mps, "more than 0")
        require(self.slide_mps2 > 0, "slide_mps2", self.slide_mps2, "more than 0")


class EscCar:
    """The car at one moment: its speed, its wheels' speed and its place in metres."""

    def __init__(self, config: EscCarConfig = EscCarConfig(), speed_mps: float = 0.0):
        self.config = config
        self.speed_mps = self.wheel_mps = speed_mps
        self.place_m = 0.0

    def step(self, dt_s: float, motor: MotorState) -> None:
        before_mps = self.speed_mps
        push_mps2, hold_mps2, locks = self._forces(motor)
        if before_mps:
            after_mps = before_mps + (push_mps2 - math.copysign(hold_mps2, before_mps)) * dt_s
            if before_mps * after_mps < 0:
                after_mps = 0.0  # whether it goes on the other way is decided at standstill
        elif abs(push_mps2) <= hold_mps2:
            after_mps = 0.0
        else:
            after_mps = (push_mps2 - math.copysign(hold_mps2, push_mps2)) * dt_s
        self.place_m += (before_mps + after_mps) / 2 * dt_s
        self.speed_mps = after_mps
        self.wheel_mps = 0.0 if locks else after_mps

    def _forces(self, motor):
        """Return (the push forward, the resistance to motion, whether the wheels are locked)."""
        config, speed = self.config, abs(self.speed_mps)
        push_mps2 = -GRAVITY_MPS2 * math.sin(math.atan(config.slope))
        drag_mps2 = config.drag_mps2 + speed * (config.drag_per_s + speed * config.drag_per_m)
        if motor.mode == BRAKE:
            brake_mps2 = motor.level * config.brake_mps2
            if brake_mps2 > config.lock_mps2 and speed:
                return push_mps2, config.slide_mps2, True
            return push_mps2, drag_mps2 + brake_mps2, False
        thrust = 1.0 / (1.0 + speed / config.thrust_halves_mps)
        if motor.mode == FORWARD:
            push_mps2 += motor.level * config.forward_mps2 * (thrust if self.speed_mps > 0 else 1.0)
        elif motor.mode == BACKWARD:
            push_mps2 -= motor.level * config.reverse_mps2 * (thrust if self.speed_mps < 0 else 1.0)
        return push_mps2, drag_mps2, False
