"""Models the virtual car's drive train and tyres: from a duty to an acceleration, from the steering to a path.

Pure. The numbers of the ESC, motor, brakes and drag are the truth that a value map only approximates.

Tyres limit how hard it can brake, and make its path differ from its steering. The front wheels slip sideways by an
angle that grows with the square of the lateral acceleration a: the path is less curved than the steering points, by
``understeer`` · a². Measured circles of a 3.5 kg F1TENTH car (motion capture, 0.5 to 2.5 m/s, 3 steering angles;
recordings of Tinker-Twins/F1TENTH-Mocap-Data-Recording-Pipeline) follow that within 2.5 % in radius, up to 5 m/s²
sideways. Beyond, the friction circle holds: √(along² + across²) ≤ grip. Weight doesn't move and slip takes no time: no
skid, no oversteer, no rocking before it tips.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from car_interface.common import declared
from car_interface.sim.esc import BACKWARD, BRAKE, FORWARD, MotorState, is_pulse, throttle_of

TRUE = "of the full duty, before drag; forward and backward at standstill"  # the meaning of three parameters
UPRIGHT_RATIO = 0.9  # below this part of the acceleration at which it tips, the car stands on its wheels again


@dataclass(frozen=True)
class DriveTrainConfig:
    """The drive train, from the ESC's duty to the car's acceleration."""

    full_reverse_duty: float = 3277.0  # 1.0, 1.5 and 2.0 ms at 50 Hz
    neutral_duty: float = 4915.0
    full_forward_duty: float = 6554.0
    neutral_band_duty: float = 25.0  # within this distance of neutral the ESC does nothing
    forward_mps2: float = declared.number("forward_acceleration", 5.6, TRUE, "m/s²", above=0.0, high=100)
    reverse_mps2: float = declared.number("reverse_acceleration", 3.6, TRUE, "m/s²", above=0.0, high=100)
    brake_mps2: float = declared.number("brake_deceleration", 7.0, TRUE, "m/s²", above=0.0, high=100)
    thrust_halves_mps: float = 9.4  # at this speed the motor has half its thrust
    # Resistance at speed v is the sum of these, the second times v, the third times v². With the defaults full throttle
    # ends at 14 m/s.
    drag_mps2: float = 0.35
    drag_per_s: float = 0.08
    drag_per_m: float = 0.004
    # Ratio of the thrust that is lost while the battery empties, from half of it above the stated thrust to half of it
    # below. Brakes don't need the battery.
    sag: float = 0.0
    sag_over_s: float = 300.0  # how long that takes; the thrust stays as it is after that
    lag_s: float = 0.0  # time constant with which the motor's thrust and brake follow the ESC

    def thrust(self, elapsed_s: float) -> float:
        """Return the ratio of the stated thrust that the battery gives at a time after the start."""
        return 1.0 + self.sag * (0.5 - min(1.0, elapsed_s / self.sag_over_s))


def throttle(duty: int, drive: DriveTrainConfig) -> float | None:
    """Return the throttle of a duty: -1 (full reverse) to 1 (full forward), 0 in the neutral band; None: no pulse."""
    if not is_pulse(duty):
        return None
    return throttle_of(duty, drive.full_reverse_duty, drive.neutral_duty, drive.full_forward_duty,
                       drive.neutral_band_duty, drive.neutral_band_duty)


class Motor:
    def __init__(self, lag_s: float):
        self._lag_s = lag_s
        self._push = self._brake = 0.0

    def step(self, motor: MotorState, dt_s: float) -> tuple[float, float]:
        """Return thrust, −1 backward to 1 forward, and brake, 0 to 1, after ``dt_s``."""
        push = {FORWARD: motor.level, BACKWARD: -motor.level}.get(motor.mode, 0.0)
        brake = motor.level if motor.mode == BRAKE else 0.0
        share = -math.expm1(-dt_s / self._lag_s) if self._lag_s else 1.0
        self._push += (push - self._push) * share
        self._brake += (brake - self._brake) * share
        return self._push, self._brake


def motor_acceleration_mps2(push: float, brake: float, speed_mps: float, drive: DriveTrainConfig, thrust: float = 1.0,
                            downhill_mps2: float = 0.0) -> float:
    """Return the car's acceleration by its motor; the other arguments as of ``true_acceleration_mps2``."""
    speed = abs(speed_mps)
    resistance_mps2 = drive.drag_mps2 + speed * (drive.drag_per_s + speed * drive.drag_per_m) + brake * drive.brake_mps2
    push_mps2 = downhill_mps2
    if push:
        way = math.copysign(1.0, push)
        full_mps2 = abs(push) * thrust * (drive.forward_mps2 if way > 0 else drive.reverse_mps2)
        # A motor's own voltage opposes the ESC's, and adds to it where the motor turns against its drive.
        own_voltage = 1.0 + speed / drive.thrust_halves_mps
        push_mps2 += way * full_mps2 * (own_voltage if way * speed_mps < 0.0 else 1.0 / own_voltage)
    if not speed_mps and abs(push_mps2) <= resistance_mps2:
        return 0.0
    return push_mps2 - math.copysign(resistance_mps2, speed_mps or push_mps2)


def true_acceleration_mps2(esc_duty: int, speed_mps: float, drive: DriveTrainConfig = DriveTrainConfig(),
                           thrust: float = 1.0, downhill_mps2: float = 0.0) -> float:
    """Return the car's acceleration without an ESC's memory, which a value map for this car approximates.

    A duty against the car's motion brakes. At standstill reverse drives backward (no double tap), and a push below the
    static drag moves nothing.

    Args:
        speed_mps: backward negative.
        thrust: the ratio of its thrust that the battery gives.
        downhill_mps2: the part of the slope, forward positive; 0 on level ground.
    """
    command = throttle(esc_duty, drive) or 0.0
    push, brake = (0.0, abs(command)) if command * speed_mps < 0.0 else (command, 0.0)
    return motor_acceleration_mps2(push, brake, speed_mps, drive, thrust, downhill_mps2)


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
    """Counts how often a car would have tipped over. The car drives on."""

    def __init__(self, rollover_mps2: float):
        self._rollover_mps2 = rollover_mps2
        self._tips = False
        self.count = 0  # how often; once until it stands on its wheels again
        self.lateral_mps2 = 0.0  # of the newest, the largest so far; left turns positive
        self.max_lateral_mps2 = 0.0  # the largest magnitude since the start

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
