"""Models the room that the car's six sonars see and that stops it: walls, boxes and posts.

Pure: poses in; echo times out, and whether the car may be there. The room is flat, as the sonars' cones are low;
everything in it reflects and stops the car. A step into an obstacle is not made: the car stays where it was before it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, Sequence

from car_interface.common import declared
from car_interface.common.vehicle_geometry import FRONT_M, REAR_M, WIDTH_M

CONE_RAD = math.radians(30)  # the whole angle in which a sonar hears
MAX_RANGE_M = 4.0  # an echo from farther is none: 4 m with an HC-SR04. The Teensy sets no limit of its own.
APART_M = 0.01  # a car that has driven this far since it was stopped no longer touches the obstacle
# The outline's middle moves farther than the rear axle's on a turn: for c = 0.14 m before it by √(1 + c²/r²), which is
# 1.38 on the tightest turn that VehicleConfig accepts (r = 0.148 m).
MAX_CENTER_RATIO = 1.5
# The car's outline, a rectangle: its middle is ahead of the rear axle's, and the circle around it has this radius.
CENTER_M, HALF_WIDTH_M = (FRONT_M - REAR_M) / 2, WIDTH_M / 2
RADIUS_M = math.hypot(FRONT_M - CENTER_M, HALF_WIDTH_M)


class Pose(NamedTuple):
    """A place (metres) and a heading (radians, 0 along x, not wrapped): of the rear axle's middle, or of a sonar."""

    x_m: float
    y_m: float
    yaw_rad: float


@dataclass(frozen=True)
class Box:
    """An upright box: its middle, its sides along and across its heading, its heading."""

    x_m: float
    y_m: float
    length_m: float
    width_m: float
    yaw_rad: float = 0.0


@dataclass(frozen=True)
class Post:
    x_m: float
    y_m: float
    radius_m: float


@dataclass(frozen=True)
class WorldConfig:
    """The room and the sonars.

    The default room takes a figure-eight with circles of 1.5 to 2 m whose crossing is the origin and which is entered
    along x: a post in the middle of each circle, boxes and posts around both, the walls beyond.
    """

    walls: Box = Box(0.0, 0.0, 12.0, 10.0)
    boxes: tuple[Box, ...] = (Box(3.1, -1.5, 0.6, 0.4, 0.3), Box(-3.1, 2.6, 1.0, 0.5, -0.2))
    posts: tuple[Post, ...] = (
        Post(0.0, 1.8, 0.12), Post(0.0, -1.8, 0.12), Post(3.0, 1.4, 0.15), Post(3.1, 2.8, 0.15),
        Post(-3.0, -1.2, 0.2), Post(-2.9, -3.2, 0.15), Post(-3.0, 0.5, 0.15),
    )  # fmt: skip
    # The sonars by their number on the wire, each as seen from the rear axle's middle.
    mounts: tuple[Pose, ...] = (
        Pose(0.40, -0.10, math.radians(-30)), Pose(0.42, 0.0, 0.0), Pose(0.40, 0.10, math.radians(30)),
        Pose(-0.12, -0.10, math.radians(-150)), Pose(-0.14, 0.0, math.pi), Pose(-0.12, 0.10, math.radians(150)),
    )  # fmt: skip
    rays: int = 7  # how many lines, 2 or more, a sonar's cone is sampled by, both edges included
    temperature_c: float = declared.number("temperature", 20.0, "of the air", "°C", low=-50, high=60)


class World:
    """A room with a car in it: it blocks the car's steps into it, counts these collisions, and echoes its sonars."""

    def __init__(self, config: WorldConfig = WorldConfig()):
        self._segments = [side for box in (config.walls, *config.boxes) for side in _sides(box)]
        self._posts = [(post.x_m, post.y_m, post.radius_m) for post in config.posts]
        self._mounts = config.mounts
        # There and back at the speed of sound, which is linear in the temperature; good between −20 and 40 °C.
        self._us_per_m = 2e6 / (331.3 + 0.606 * config.temperature_c)
        self._angles_rad = [CONE_RAD * (ray / (config.rays - 1) - 0.5) for ray in range(config.rays)]
        self._clear_m = 0.0  # how far the car can go before the next check
        self._since_m = math.inf  # driven since it was blocked
        self.count = 0  # of collisions; a car that keeps pushing, or backs off less than a centimetre, has one
        self.speed_mps = 0.0  # of the newest collision, backward negative

    def blocks(self, pose: Sequence[float], distance_m: float, speed_mps: float) -> bool:
        """Return whether a step that ends at ``pose`` runs into something.

        Args:
            pose: of the rear axle's middle after the step.
            distance_m: of the step, signed.
            speed_mps: before the step.
        """
        self._clear_m -= MAX_CENTER_RATIO * abs(distance_m)
        if self._clear_m <= 0.0:
            if not self.is_free(pose):
                if self._since_m > APART_M:
                    self.count += 1
                    self.speed_mps = speed_mps
                self._since_m = 0.0
                return True
            self._clear_m = self.clearance_m(pose)
        self._since_m += abs(distance_m)
        return False

    def is_free(self, pose: Sequence[float]) -> bool:
        """Return whether a car whose rear axle's middle is at x, y (m) and yaw (rad) touches nothing."""
        x_m, y_m, yaw_rad = pose
        cos_yaw, sin_yaw = math.cos(yaw_rad), math.sin(yaw_rad)

        def seen_from_car(to_x_m, to_y_m):
            return to_x_m * cos_yaw + to_y_m * sin_yaw, to_y_m * cos_yaw - to_x_m * sin_yaw
        for start_x_m, start_y_m, along_x_m, along_y_m in self._segments:
            if _meets_segment(*seen_from_car(start_x_m - x_m, start_y_m - y_m), *seen_from_car(along_x_m, along_y_m)):
                return False
        for post_x_m, post_y_m, radius_m in self._posts:
            ahead_m, left_m = seen_from_car(post_x_m - x_m, post_y_m - y_m)
            beside_m = ahead_m - min(max(ahead_m, -REAR_M), FRONT_M)
            if math.hypot(beside_m, left_m - min(max(left_m, -HALF_WIDTH_M), HALF_WIDTH_M)) < radius_m:
                return False
        return True

    def clearance_m(self, pose: Sequence[float]) -> float:
        """Return how far the outline's middle can move before the car may touch something; 0 or less = it may now."""
        x_m = pose[0] + CENTER_M * math.cos(pose[2])
        y_m = pose[1] + CENTER_M * math.sin(pose[2])
        nearest_m = math.inf
        for start_x_m, start_y_m, along_x_m, along_y_m in self._segments:
            to_x_m, to_y_m = x_m - start_x_m, y_m - start_y_m
            ratio = (to_x_m * along_x_m + to_y_m * along_y_m) / (along_x_m * along_x_m + along_y_m * along_y_m)
            ratio = min(max(ratio, 0.0), 1.0)
            nearest_m = min(nearest_m, math.hypot(to_x_m - ratio * along_x_m, to_y_m - ratio * along_y_m))
        for post_x_m, post_y_m, radius_m in self._posts:
            nearest_m = min(nearest_m, math.hypot(x_m - post_x_m, y_m - post_y_m) - radius_m)
        return nearest_m - RADIUS_M

    def echo_us(self, pose: Sequence[float], sensor: int) -> int:
        """Return the microseconds from a sonar's ping to its echo, as a standing car would measure them.

        Args:
            pose: x, y (metres) and yaw (radians) of the middle of the car's rear axle.
            sensor: 0 to 5.

        Returns:
            The echo of the nearest thing in the cone; 0 when nothing is in range, and never 0 otherwise.
        """
        distance_m = self.distance_m(pose, sensor)
        return 0 if distance_m is None else max(1, round(distance_m * self._us_per_m))

    def distance_m(self, pose: Sequence[float], sensor: int) -> float | None:
        """Return the metres from a sonar to the nearest thing in its cone; None beyond ``MAX_RANGE_M``."""
        mount = self._mounts[sensor]
        x_m, y_m = _place(*pose, mount.x_m, mount.y_m)
        axis_rad = pose[2] + mount.yaw_rad
        nearest_m = min(self._ray_m(x_m, y_m, axis_rad + angle_rad) for angle_rad in self._angles_rad)
        return nearest_m if nearest_m <= MAX_RANGE_M else None

    def _ray_m(self, x_m: float, y_m: float, direction_rad: float) -> float:
        """Return the metres along one ray to the first thing that it meets; infinity if it meets none."""
        dx, dy = math.cos(direction_rad), math.sin(direction_rad)
        nearest_m = math.inf
        for start_x_m, start_y_m, along_x_m, along_y_m in self._segments:
            # Solves (x, y) + s·(dx, dy) = start + t·along by Cramer's rule; 0 ≤ t ≤ 1 lies on the segment.
            across = dx * along_y_m - dy * along_x_m
            if across == 0.0:
                continue
            to_x_m, to_y_m = start_x_m - x_m, start_y_m - y_m
            distance_m = (to_x_m * along_y_m - to_y_m * along_x_m) / across
            if 0.0 <= distance_m < nearest_m and 0.0 <= (to_x_m * dy - to_y_m * dx) / across <= 1.0:
                nearest_m = distance_m
        for post_x_m, post_y_m, radius_m in self._posts:
            to_x_m, to_y_m = post_x_m - x_m, post_y_m - y_m
            beyond = to_x_m * to_x_m + to_y_m * to_y_m - radius_m * radius_m
            if beyond <= 0.0:
                return 0.0
            along_m = to_x_m * dx + to_y_m * dy
            inside = along_m * along_m - beyond
            if along_m > 0.0 and inside >= 0.0:
                nearest_m = min(nearest_m, along_m - math.sqrt(inside))
        return nearest_m


def _meets_segment(ahead_m, left_m, along_m, across_m):
    """Return whether a segment, seen from the car, has a part inside the outline (Liang and Barsky's clipping)."""
    first, last = 0.0, 1.0
    for start_m, to_m, low_m, high_m in ((ahead_m, along_m, -REAR_M, FRONT_M),
                                         (left_m, across_m, -HALF_WIDTH_M, HALF_WIDTH_M)):
        if to_m == 0.0:
            if not low_m <= start_m <= high_m:
                return False
            continue
        enters, leaves = sorted(((low_m - start_m) / to_m, (high_m - start_m) / to_m))
        first, last = max(first, enters), min(last, leaves)
        if first > last:
            return False
    return True


def _place(x_m, y_m, yaw_rad, ahead_m, left_m):
    """Return where in the room a point is that lies ahead and to the left of a pose."""
    cos_yaw, sin_yaw = math.cos(yaw_rad), math.sin(yaw_rad)
    return x_m + ahead_m * cos_yaw - left_m * sin_yaw, y_m + ahead_m * sin_yaw + left_m * cos_yaw


def _sides(box):
    """Return a box's sides: x and y of one end, and from there to the other, in metres."""
    half_x_m, half_y_m = box.length_m / 2, box.width_m / 2
    corners = [_place(box.x_m, box.y_m, box.yaw_rad, *corner) for corner in (
        (-half_x_m, -half_y_m), (half_x_m, -half_y_m), (half_x_m, half_y_m), (-half_x_m, half_y_m))]
    return [(x, y, end_x - x, end_y - y) for (x, y), (end_x, end_y) in zip(corners, corners[1:] + corners[:1])]
