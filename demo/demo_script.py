"""A scripted drive: nobody there, a human drives, the planner drives a figure-eight, the human lets go.

Plays both the person with the gamepad and the planner. Pure: pose, speed and ``now_ns`` in, orders out. The planner
asks for its figure-eight all the time, which shows who is obeyed.
"""
from __future__ import annotations

import math
from typing import NamedTuple

from car_interface.common.units import NS_PER_S

NOBODY, TELEOP, LEFT_CIRCLE, RIGHT_CIRCLE, LET_GO, DONE = range(6)
STAGE_NAMES = ("nobody there", "human drives", "planner: left circle", "planner: right circle", "human let go", "done")
TURN_RAD = 2 * math.pi


class DriveConfig(NamedTuple):
    """The dimensions of the drive. The defaults fit the default room and take about 40 s."""

    nobody_s: float = 5.0
    picked_up_s: float = 2.0  # before its first use the gamepad is there for this long, with no deadman held
    let_go_s: float = 6.0
    max_turn_s: float = 20.0  # a circle that takes longer is given up
    speed_mps: float = 1.2
    throttle_at_speed: float = 0.35  # of the stick: holds about this speed with the scale of throttle.yaml
    throttle_per_mps: float = 0.5  # of the stick, for missing speed
    teleop_steering: float = 0.98  # of the stick, left positive
    radius_m: float = 1.6
    gain_per_s: float = 1.5  # from missing speed to acceleration
    max_acceleration_mps2: float = 2.0


class Orders(NamedTuple):
    """The present actions of the person and the planner."""

    stage: int
    manual: bool  # the manual deadman is held
    autonomous: bool  # the autonomous one
    steering: float  # the gamepad's stick, −1 right .. +1 left
    throttle: float  # the gamepad's other stick, 0 .. 1: the script lets the car roll where it is too fast
    radius_m: float  # the planner's request, right negative
    acceleration_mps2: float  # the planner's request
    gamepad_on: bool  # there is a gamepad at all


class Drive:
    """The script's present stage. A stage ends by time, or with a full turn of the car."""

    def __init__(self, config: DriveConfig, now_ns: int):
        self._config = config
        self.stage = NOBODY
        self._since_ns = now_ns
        self._turned_rad = 0.0
        self._last_yaw_rad: float | None = None

    @property
    def turned_rad(self) -> float:
        """The turn of the car in this stage, left positive."""
        return self._turned_rad

    def orders(self, now_ns: int, yaw_rad: float, speed_mps: float) -> Orders:
        """Return what to do now, at this heading (modulo a turn) and speed."""
        if self._last_yaw_rad is not None:
            self._turned_rad += math.remainder(yaw_rad - self._last_yaw_rad, TURN_RAD)
        self._last_yaw_rad = yaw_rad
        elapsed_s = (now_ns - self._since_ns) / NS_PER_S
        if self._is_over(elapsed_s):
            self.stage += 1
            self._since_ns = now_ns
            self._turned_rad = 0.0
        config = self._config
        missing_mps = config.speed_mps - speed_mps
        wanted = config.gain_per_s * missing_mps
        throttle = max(0.0, min(1.0, config.throttle_at_speed + config.throttle_per_mps * missing_mps))
        return Orders(
            stage=self.stage,
            manual=self.stage == TELEOP,
            autonomous=self.stage in (LEFT_CIRCLE, RIGHT_CIRCLE),
            steering=config.teleop_steering if self.stage == TELEOP else 0.0,
            throttle=throttle if self.stage == TELEOP else 0.0,
            radius_m=-config.radius_m if self.stage == RIGHT_CIRCLE else config.radius_m,
            acceleration_mps2=max(-config.max_acceleration_mps2, min(config.max_acceleration_mps2, wanted)),
            gamepad_on=(elapsed_s >= config.nobody_s - config.picked_up_s if self.stage == NOBODY
                        else self.stage != DONE))

    def _is_over(self, elapsed_s):
        config = self._config
        if self.stage == NOBODY:
            return elapsed_s >= config.nobody_s
        if self.stage == LET_GO:
            return elapsed_s >= config.let_go_s
        if self.stage == DONE:
            return False
        turn = -self._turned_rad if self.stage == RIGHT_CIRCLE else self._turned_rad
        return turn >= TURN_RAD or elapsed_s >= config.max_turn_s
