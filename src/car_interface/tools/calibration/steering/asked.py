"""The servo's duties of a drive on which only the steering angles that a planner asked for were recorded."""
from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from car_interface.pca9685.registers import counts_of_duty, duty_of_counts
from car_interface.steering.calibration import SteeringCalibration
from car_interface.tools.recordings.series import Ackermann

STRAIGHT_RAD = 1e-6


class AngleTable(NamedTuple):
    """By what a planner's angles became duties on the drive."""

    calibration: SteeringCalibration
    wheelbase_m: float

    def duty(self, angle_rad: float) -> int:
        """What the servo board outputs for an angle of the front wheels, left positive."""
        table = self.calibration
        duty = (table.servo_center if abs(angle_rad) < STRAIGHT_RAD else
                table.planner_duty(self.wheelbase_m / math.tan(angle_rad)))
        return duty_of_counts(counts_of_duty(duty))

    def duties(self, asked: Ackermann) -> np.ndarray:
        """The duty for each row, (N,)."""
        return np.array([self.duty(angle_rad) for angle_rad in asked.angle_rad.tolist()], float)

    def note(self, topic: str) -> str:
        """A line on what such a calibration rests on, and what it can't know."""
        return (f"no duties of the servo were recorded: the angles on {topic} count as the duties that --base has for "
                f"them with a wheelbase of {self.wheelbase_m:g} m. What this recording can't tell: whether --base was "
                "the table on this drive, and whether anything else steered (a gamepad, a trim, a limit)")
