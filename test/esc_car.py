"""Simulates a car on a line under a virtual ESC: the simulator's drive train, and wheels that a strong brake locks.

Consumes the motor's state and time steps; produces the speeds of car and wheels. They differ while the brake has locked
the wheels: these stand, and the car slides on. Backward is negative. Pure.
"""
import math
from dataclasses import dataclass

from car_interface.sim.drive_train import COASTS, DriveTrainConfig, MotorState, following, motor_acceleration_mps2

GRAVITY_MPS2 = 9.81


@dataclass(frozen=True)
class EscCarConfig(DriveTrainConfig):
    """One car.

    Attributes:
        lock_mps2: a brake stronger than this locks the wheels.
        slide_mps2: the deceleration of a car with locked wheels.
        slope: metres up for each metre ahead.
    """

    lock_mps2: float = math.inf
    slide_mps2: float = 4.0
    slope: float = 0.0


class EscCar:
    """The car at one moment: its speed, its wheels' speed and its place in metres."""

    def __init__(self, config: EscCarConfig = EscCarConfig()):
        self.config, self._motor = config, COASTS
        self.speed_mps = self.wheel_mps = self.place_m = 0.0

    def step(self, dt_s: float, motor: MotorState) -> None:
        config, before_mps = self.config, self.speed_mps
        self._motor = following(self._motor, motor, dt_s, config.lag_s)
        downhill_mps2 = -GRAVITY_MPS2 * math.sin(math.atan(config.slope))
        locks = before_mps != 0 and self._motor.brake * config.brake_mps2 > config.lock_mps2
        after_mps = before_mps + dt_s * (
            downhill_mps2 - math.copysign(config.slide_mps2, before_mps) if locks else
            motor_acceleration_mps2(self._motor, before_mps, config, 1.0, downhill_mps2))
        if before_mps * after_mps < 0:
            after_mps = 0.0  # whether it goes on the other way is decided at standstill
        self.place_m += (before_mps + after_mps) / 2 * dt_s
        self.speed_mps, self.wheel_mps = after_mps, 0.0 if locks else after_mps
