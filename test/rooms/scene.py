"""One random draw: room, car, its files, its sonars and odometry, and who drives it blindly."""
from __future__ import annotations

import math
import random
from dataclasses import dataclass

from car_interface.throttle.esc_config import EscConfig

from .car import CarConfig
from .room import Outline, Pose, Room, random_room, random_start

OUTLINE = Outline()  # the Slash's
MOUNTS = {  # config/sonars.yaml
    "front_right": Pose(0.40, -0.10, -0.5236), "front_middle": Pose(0.42, 0.0, 0.0),
    "front_left": Pose(0.40, 0.10, 0.5236), "rear_right": Pose(-0.12, -0.10, -2.6180),
    "rear_middle": Pose(-0.14, 0.0, 3.1416), "rear_left": Pose(-0.12, 0.10, 2.6180)}
SONARS = tuple(MOUNTS)
FIELD_OF_VIEW_RAD = 0.5236
MIN_RANGE_M = 0.02
ALL_IN_TURN, MOSTLY_AHEAD = (0, 1, 2, 3, 4, 5), (1, 0, 1, 2, 1, 0, 1, 2, 1, 4)  # docs/limits.md
ESCS = {  # what the files say
    "measured": EscConfig(profile="brake_then_reverse", profile_measured=True),
    "not measured": EscConfig(profile="brake_then_reverse"),
    "unverified": EscConfig(),
    "crawler": EscConfig(profile="brake_becomes_reverse")}


@dataclass(frozen=True)
class Driver:
    """Who pushes, in which direction, and on which arcs; without a look at the room.

    Attributes:
        hand: ``planner`` or ``stick``.
        push: the planner's value, or the stick's deflection, always positive.
        is_fitful: it lets go and pushes again, every second or so.
        path: ``straight``, ``arc``, ``slalom`` (steps from one side to the other) or ``waves`` (a sine).
        curvature_per_m: of the arc, or the tightest of a slalom; left positive.
    """

    hand: str
    push: float
    is_backward: bool
    is_fitful: bool
    path: str
    curvature_per_m: float
    period_s: float

    def curvature(self, at_s: float) -> float:
        turn = math.sin(2 * math.pi * at_s / self.period_s)
        if self.path == "slalom":
            return math.copysign(self.curvature_per_m, turn)
        return self.curvature_per_m * (turn if self.path == "waves" else 1.0)

    def pushes(self, at_s: float) -> bool:
        return not self.is_fitful or math.sin(2.4 * at_s) + math.sin(4.1 * at_s) > -0.5


@dataclass(frozen=True)
class Scene:
    """A draw; from ``gone_s`` on its room is empty."""

    seed: int
    room: Room
    start: Pose
    car: CarConfig
    kind: str
    driver: Driver
    max_range_m: float
    is_mostly_ahead: bool
    firing_s: float
    dropouts: float
    noise_m: float
    odometry_late_s: float
    gone_s: float = math.inf

    def room_at(self, at_s: float) -> Room:
        return self.room if at_s < self.gone_s else Room(())

    @property
    def esc(self) -> EscConfig:
        return ESCS[self.kind]

    @property
    def brief(self) -> str:
        driver = self.driver
        return (f"{self.kind}, {driver.hand}{' backward' if driver.is_backward else ''}, {driver.path} "
                f"{driver.curvature_per_m:+.2f}, {self.max_range_m:g} m, slope {self.car.slope:+.0%}")


def random_car(rng, kind: str, uphill_rad: float) -> CarConfig:
    """A car whose files promise no more than it does; its slope is 0, or 5 % up or down its first way."""
    slope, drag_mps2 = rng.choice((0.0, 0.05, -0.05)), rng.uniform(0.3, 0.6)
    return CarConfig(
        becomes_reverse=kind == "crawler" or kind == "unverified" and rng.random() < 0.4,
        hold_s=rng.uniform(0.0, 0.3), dwell_s=rng.uniform(0.1, 0.4), dead_band=rng.uniform(0.03, 0.08),
        drag_brake=rng.choice((0.0, rng.uniform(0.0, 0.1))), motor_lag_s=rng.uniform(0.02, 0.15),
        push_mps2=rng.uniform(2.5, 6.0), top_mps=rng.uniform(5.0, 12.0), brake_mps2=rng.uniform(3.0, 5.0),
        drag_mps2=drag_mps2, breakaway_mps2=drag_mps2 + rng.uniform(0.0, 0.3), slope=slope, uphill_rad=uphill_rad,
        steering_lag_s=rng.uniform(0.03, 0.1), grip_mps2=rng.uniform(5.0, 8.0))


def random_driver(rng) -> Driver:
    hand = rng.choice(("planner", "planner", "stick"))
    path = rng.choice(("straight", "straight", "arc", "arc", "slalom", "waves"))
    curvature = 0.0 if path == "straight" else rng.choice((-1, 1)) * rng.uniform(0.05, 1.0)
    return Driver(hand=hand, push=rng.uniform(0.6, 3.0) if hand == "planner" else rng.uniform(0.3, 1.0),
                  is_backward=rng.random() < 0.15, is_fitful=rng.random() < 0.2, path=path, curvature_per_m=curvature,
                  period_s=rng.uniform(2.0, 7.0))


def random_scene(seed: int) -> Scene:
    rng = random.Random(seed)
    room, kind, driver = random_room(rng), rng.choice(tuple(ESCS)), random_driver(rng)
    start = random_start(room, rng)
    first_way = start.yaw_rad + (math.pi if driver.is_backward else 0.0)
    return Scene(seed, room, start, random_car(rng, kind, first_way), kind, driver, max_range_m=rng.choice((2.0, 4.0)),
                 is_mostly_ahead=rng.random() < 0.5, firing_s=rng.uniform(0.058, 0.072), dropouts=0.05,
                 noise_m=rng.uniform(0.0, 0.01), odometry_late_s=rng.choice((0.0, rng.uniform(0.0, 0.15))))
