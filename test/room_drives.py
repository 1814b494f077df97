"""Cars that drive blindly in random rooms, with obstacle_stop: how fast do they run into something?

``python3 test/room_drives.py 1000`` runs so many on all cores; test_virtual_drives.py runs a sample. Each depends on
its seed alone.

A planner pushes with no idea of the room, on arcs that it changes now and then; ranges are late and noisy. Judged by
the vehicle and the room alone: a collision counts as one with something *seen* when what the car touches was on the arc
that it drove and in the cone of a sonar for as long as the arithmetic needs to stop. All others are counted beside.
"""
from __future__ import annotations

import math
import random
import sys
from collections import deque
from typing import NamedTuple

from many_drives import MS, NEUTRAL, THROTTLE, Chip, S, asked_for, run_on_all_cores

from car_interface.interlock.motion_interlock import InterlockConfig
from car_interface.sim.collision import Collisions, Outline
from car_interface.sim.esc import VirtualEscConfig
from car_interface.sim.vehicle import Pose, SteeringConfig, Vehicle, VehicleConfig
from car_interface.sim.world import Box, Post, World, WorldConfig
from car_interface.steering.arbiter import PLANNER
from car_interface.throttle.arbiter import ArbiterConfig
from car_interface.throttle.control import ThrottleControl
from car_interface.throttle.esc_config import EscConfig
from car_interface.throttle.obstacle_stop import NAMES, Mount, ObstacleConfig

STEP_NS = 5 * MS
DRIVE_S = 12
MAX_RANGE_M = 2.0
CONE_RAD = math.radians(30)
FAST_MPS = 0.3
ALL_ALIKE, MOSTLY_AHEAD = (0, 1, 2, 3, 4, 5), (1, 0, 1, 2, 1, 0, 1, 2, 1, 4)
CAR = Outline()
# The brake that a stop is certain of, by half of the full one, and drag.
BRAKE_MPS2, DRAG_MPS2 = 1.5, 0.3
REACTION_S = 0.65  # the range's age, a cycle and the actuation


class Result(NamedTuple):
    seed: int
    speed_mps: float  # of the collision; 0 = none
    was_seen: bool
    distance_m: float


def random_room(rng) -> WorldConfig:
    half_x, half_y = rng.uniform(2.5, 6.0), rng.uniform(2.5, 6.0)
    boxes = tuple(Box(rng.uniform(-half_x, half_x), rng.uniform(-half_y, half_y), rng.uniform(0.3, 1.2),
                      rng.uniform(0.3, 1.2), rng.uniform(-3, 3)) for _ in range(rng.randrange(5)))
    posts = tuple(Post(rng.uniform(-half_x, half_x), rng.uniform(-half_y, half_y), rng.uniform(0.08, 0.3))
                  for _ in range(rng.randrange(6)))
    return WorldConfig(walls=(-half_x, half_x, -half_y, half_y), boxes=boxes, posts=posts, cone_rad=CONE_RAD, rays=13)


def free_start(rng, world) -> Pose:
    """A pose with a metre around it."""
    obstacles = world.obstacles
    x_from, x_to, y_from, y_to = world.config.walls
    while True:
        pose = Pose(rng.uniform(x_from, x_to), rng.uniform(y_from, y_to), rng.uniform(-math.pi, math.pi))
        if obstacles.clearance_m(pose) > 0.3:
            return pose


class Sonars:
    """Six sonars that fire one after another: the next when this one's echo came, or after 38 ms, and 30 ms later."""

    def __init__(self, rng, world, sequence):
        self._rng, self._world, self._sequence = rng, world, sequence
        self._index, self._next_ns = rng.randrange(len(sequence)), 0
        self._reports = deque()

    def step(self, pose, now_ns):
        """The ranges that arrive now, by name."""
        if now_ns >= self._next_ns:
            sensor = self._sequence[self._index]
            self._index = (self._index + 1) % len(self._sequence)
            distance_m = self._world.distance_m(pose, sensor)
            flight_ns = 38 * MS if distance_m is None else round(2e9 * distance_m / 343)
            range_m = math.inf if distance_m is None or distance_m > MAX_RANGE_M else max(
                0.0, distance_m + self._rng.gauss(0, 0.005))
            self._next_ns = now_ns + flight_ns + 30 * MS
            self._reports.append((now_ns + flight_ns + round(self._rng.uniform(2, 12)) * MS, NAMES[sensor], range_m))
        arrived = []
        while self._reports and self._reports[0][0] <= now_ns:
            arrived.append(self._reports.popleft()[1:])
        return arrived


def run(seed: int, stops: bool = True) -> Result:
    rng = random.Random(f"room {seed}")
    world = World(random_room(rng))
    profile = rng.choice(("brake_then_reverse", "unverified"))
    sequence = rng.choice((ALL_ALIKE, MOSTLY_AHEAD))
    config = VehicleConfig(
        steering=SteeringConfig(curve=((4000, 1.0), (6000, -1.0)), center_duty=5000),
        start=free_start(rng, world), esc=VirtualEscConfig())
    collisions = Collisions(world.obstacles)
    vehicle = Vehicle(config, 0, collisions)
    mounts = {name: Mount(mount.x_m, mount.y_m, mount.yaw_rad) for name, mount in zip(NAMES, world.config.mounts)}
    throttle = ThrottleControl(
        THROTTLE, ArbiterConfig(interlock=InterlockConfig(grant_at_start=True)),
        EscConfig(profile=profile, profile_measured=profile != "unverified", drag_deceleration_mps2=DRAG_MPS2),
        obstacles=ObstacleConfig(mounts, CONE_RAD, MAX_RANGE_M) if stops else None)
    sonars, history = Sonars(rng, world, sequence), []
    duty, steering_duty, value, change_ns, chip, odometry = NEUTRAL, 5000, 0.0, 0, Chip(rng, 5000), deque()
    for now_ns in range(STEP_NS, DRIVE_S * S, STEP_NS):
        for name, range_m in sonars.step(vehicle.pose, now_ns):
            throttle.update_range(name, range_m, now_ns)
        if now_ns % (20 * MS) == 0:
            odometry.append((now_ns + 20 * MS, vehicle.speed_mps * (1 + rng.gauss(0, 0.01))))
        while odometry and odometry[0][0] <= now_ns:
            throttle.update_odometry(odometry.popleft()[1], now_ns)
        if now_ns >= change_ns:
            change_ns = now_ns + round(rng.uniform(1.0, 6.0) * S)
            value, steering_duty = rng.uniform(0.6, 3.0), round(5000 + rng.choice((0, 1)) * rng.uniform(-800, 800))
        if now_ns % (20 * MS) == 0:
            throttle.arbiter.update_human(now_ns > 1500 * MS, now_ns)  # let go first: the ESC is armed meanwhile
            throttle.arbiter.update_steering(PLANNER, "", now_ns)
            throttle.update_turn(1 / vehicle.curvature_per_m if vehicle.curvature_per_m else math.inf, 0.0)
            throttle.update_planner(value, now_ns)
            duty = throttle.decide(now_ns).duty
            throttle.update_output([-1, duty, *[-1] * 14], now_ns)
            chip.command(steering_duty, duty, now_ns)
        history.append((now_ns, vehicle.pose, vehicle.curvature_per_m, vehicle.speed_mps))
        before_mps = vehicle.speed_mps
        vehicle.step(STEP_NS, *chip.duties(now_ns))
        if collisions.count:
            return Result(seed, abs(before_mps), _was_seen(world, history, profile), vehicle.travel_m)
    return Result(seed, 0.0, False, vehicle.travel_m)


def _was_seen(world, history, profile):
    """Whether what the car touches was on its arc and in a cone for as long as it took to stop."""
    hit_ns, pose = history[-1][:2]
    touched = [point for point in _surface(world, pose) if _inside(pose, point, 0.03)]
    stop_mps2 = DRAG_MPS2 if profile == "unverified" else BRAKE_MPS2
    first_ns = next((at_ns for at_ns, _, _, speed_mps in reversed(history)
                     if (hit_ns - at_ns) / S >= REACTION_S + speed_mps / stop_mps2), 0)
    samples = [entry for entry in history[::8] if first_ns <= entry[0] <= hit_ns - 0.15 * S]
    if not samples:
        return True
    return any(all(_in_a_cone(world, past, point) and _on_arc(past, curvature, point)
                   for _, past, curvature, _ in samples) for point in touched)


def _surface(world, pose):
    """Points of walls, boxes and posts near a pose."""
    for x, y, dx, dy in world._segments:
        count = max(2, int(math.hypot(dx, dy) / 0.01))
        for index in range(count + 1):
            point = (x + dx * index / count, y + dy * index / count)
            if math.dist(point, pose[:2]) < 0.7:
                yield point
    for x, y, radius in world._posts:
        for index in range(120):
            angle = 2 * math.pi * index / 120
            yield x + radius * math.cos(angle), y + radius * math.sin(angle)


def _from_car(pose, point):
    x, y = point[0] - pose.x_m, point[1] - pose.y_m
    cos_yaw, sin_yaw = math.cos(pose.yaw_rad), math.sin(pose.yaw_rad)
    return x * cos_yaw + y * sin_yaw, y * cos_yaw - x * sin_yaw


def _inside(pose, point, margin_m):
    ahead, left = _from_car(pose, point)
    return (-CAR.rear_m - margin_m <= ahead <= CAR.front_m + margin_m and abs(left) <= CAR.width_m / 2 + margin_m)


def _in_a_cone(world, pose, point):
    ahead, left = _from_car(pose, point)
    for mount in world.config.mounts[:3]:
        x, y = ahead - mount.x_m, left - mount.y_m
        off = math.remainder(math.atan2(y, x) - mount.yaw_rad, 2 * math.pi)
        if math.hypot(x, y) < 0.05 or math.hypot(x, y) <= MAX_RANGE_M and abs(off) <= CONE_RAD / 2:
            return True
    return False


def _on_arc(pose, curvature, point):
    """Whether the car, driving on along its arc, comes to touch the point."""
    x, y, yaw = pose
    for _ in range(60):  # 3 m in steps of 5 cm
        if _inside(Pose(x, y, yaw), point, 0.03):
            return True
        x, y = x + 0.05 * math.cos(yaw + 0.025 * curvature), y + 0.05 * math.sin(yaw + 0.025 * curvature)
        yaw += 0.05 * curvature
    return False


if __name__ == "__main__":
    results = run_on_all_cores(run, asked_for(__doc__))
    hits = [result for result in results if result.speed_mps]
    fast = [result for result in hits if result.speed_mps > FAST_MPS]
    seen = [result for result in fast if result.was_seen]
    print(*seen[:20], sep="\n")
    print(f"{len(results)} rooms, {sum(result.distance_m for result in results):.0f} m: {len(hits)} collisions, "
          f"{len(fast)} of them faster than {FAST_MPS} m/s, {len(seen)} of these with something that was seen; "
          f"fastest: {max((result.speed_mps for result in fast), default=0):.2f} m/s")
    sys.exit(bool(seen))
