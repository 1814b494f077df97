"""A room from above: walls, boxes and posts, what a cone meets in it first, and what a car's outline touches."""
from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Iterator, NamedTuple

CLEAR_M = 0.6  # of a start


class Pose(NamedTuple):
    """Where something stands and looks: m, and rad, left positive."""

    x_m: float
    y_m: float
    yaw_rad: float

    def seen(self, x_m: float, y_m: float) -> tuple[float, float]:
        """A place of the room as seen from here: m ahead, m to the left."""
        dx, dy = x_m - self.x_m, y_m - self.y_m
        cos, sin = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return dx * cos + dy * sin, dy * cos - dx * sin

    def place(self, ahead_m: float, left_m: float) -> tuple[float, float]:
        """The place in the room of what is seen from here."""
        cos, sin = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return self.x_m + ahead_m * cos - left_m * sin, self.y_m + ahead_m * sin + left_m * cos

    def mounted(self, mount: Pose) -> Pose:
        """Where a thing that is mounted here, by ``mount``, stands in the room."""
        return Pose(*self.place(mount.x_m, mount.y_m), self.yaw_rad + mount.yaw_rad)


class Outline(NamedTuple):
    """A car from above: m before and behind the middle of its rear axle, and across."""

    front_m: float = 0.426
    rear_m: float = 0.142
    width_m: float = 0.296

    @property
    def radius_m(self) -> float:
        """How far the farthest corner is from the middle of the rear axle."""
        return math.hypot(max(self.front_m, self.rear_m), self.width_m / 2)


class Side(NamedTuple):
    """A flat surface: a wall, or one side of a box."""

    name: str
    x1_m: float
    y1_m: float
    x2_m: float
    y2_m: float

    def _clipped(self, pose, planes):
        """The part of it, as seen from a pose, for which c + a·ahead + b·left ≥ 0 in all planes (a, b, c)."""
        (u1, v1), (u2, v2) = pose.seen(self.x1_m, self.y1_m), pose.seen(self.x2_m, self.y2_m)
        first, last = 0.0, 1.0
        for a, b, c in planes:
            at1, at2 = a * u1 + b * v1 + c, a * u2 + b * v2 + c
            if at1 < 0 and at2 < 0:
                return None
            if at1 < 0:
                first = max(first, at1 / (at1 - at2))
            elif at2 < 0:
                last = min(last, at1 / (at1 - at2))
        if first > last:
            return None
        return tuple((u1 + share * (u2 - u1), v1 + share * (v2 - v1)) for share in (first, last))

    def distance_m(self, x_m: float, y_m: float) -> float:
        return math.dist((x_m, y_m), _nearest((self.x1_m - x_m, self.y1_m - y_m), (self.x2_m - x_m, self.y2_m - y_m),
                                              (x_m, y_m)))

    def nearest_in_cone(self, pose: Pose, half_rad: float) -> tuple[float, float] | None:
        """Its place nearest to a sonar within the cone: m ahead, m to the left of the sonar."""
        sin, cos = math.sin(half_rad), math.cos(half_rad)
        part = self._clipped(pose, ((sin, cos, 0.0), (sin, -cos, 0.0)))
        return part and _nearest(*part)

    def touched(self, pose: Pose, outline: Outline) -> tuple[float, float] | None:
        """The place, seen from the car, that its outline touches."""
        half_m = outline.width_m / 2
        part = self._clipped(pose, ((1.0, 0.0, outline.rear_m), (-1.0, 0.0, outline.front_m),
                                    (0.0, 1.0, half_m), (0.0, -1.0, half_m)))
        return part and ((part[0][0] + part[1][0]) / 2, (part[0][1] + part[1][1]) / 2)


class Post(NamedTuple):
    name: str
    x_m: float
    y_m: float
    radius_m: float

    def distance_m(self, x_m: float, y_m: float) -> float:
        return math.dist((x_m, y_m), (self.x_m, self.y_m)) - self.radius_m

    def nearest_in_cone(self, pose: Pose, half_rad: float) -> tuple[float, float] | None:
        """Its place nearest to a sonar within the cone: m ahead, m to the left of the sonar."""
        ahead_m, left_m = pose.seen(self.x_m, self.y_m)
        far_m, angle = math.hypot(ahead_m, left_m), math.atan2(left_m, ahead_m)
        looked = max(-half_rad, min(half_rad, angle))
        along_m, beside_m = far_m * math.cos(angle - looked), far_m * math.sin(angle - looked)
        if abs(beside_m) > self.radius_m or along_m <= 0:
            return None
        near_m = max(0.0, along_m - math.sqrt(self.radius_m ** 2 - beside_m ** 2))
        return near_m * math.cos(looked), near_m * math.sin(looked)

    def touched(self, pose: Pose, outline: Outline) -> tuple[float, float] | None:
        """The place, seen from the car, that its outline touches."""
        ahead_m, left_m = pose.seen(self.x_m, self.y_m)
        half_m = outline.width_m / 2
        near = max(-outline.rear_m, min(outline.front_m, ahead_m)), max(-half_m, min(half_m, left_m))
        return near if math.dist(near, (ahead_m, left_m)) <= self.radius_m else None


class Met(NamedTuple):
    """The surface that a cone meets first."""

    range_m: float
    name: str
    x_m: float  # in the room
    y_m: float


@dataclass(frozen=True)
class Room:
    things: tuple

    def first_in_cone(self, pose: Pose, half_rad: float, max_range_m: float) -> Met | None:
        """The surface nearest to a sonar within its cone and range."""
        first = None
        for thing in self.things:
            if thing.distance_m(pose.x_m, pose.y_m) > (max_range_m if first is None else first.range_m):
                continue
            near = thing.nearest_in_cone(pose, half_rad)
            range_m = math.hypot(*near) if near else math.inf
            if range_m <= (max_range_m if first is None else first.range_m):
                first = Met(range_m, thing.name, *pose.place(*near))
        return first

    def near(self, pose: Pose, distance_m: float) -> list:
        return [thing for thing in self.things if thing.distance_m(pose.x_m, pose.y_m) <= distance_m]

    def is_clear(self, pose: Pose, distance_m: float) -> bool:
        return not self.near(pose, distance_m)


def _nearest(first, last, origin=(0.0, 0.0)):
    """The place nearest to nought on the line between two, moved by ``origin``."""
    dx, dy = last[0] - first[0], last[1] - first[1]
    length2 = dx * dx + dy * dy
    share = max(0.0, min(1.0, -(first[0] * dx + first[1] * dy) / length2)) if length2 else 0.0
    return first[0] + share * dx + origin[0], first[1] + share * dy + origin[1]


def _sides(name, corners) -> Iterator[Side]:
    for number, (here, there) in enumerate(zip(corners, corners[1:] + corners[:1])):
        yield Side(f"{name}.{number}", *here, *there)


def random_room(rng) -> Room:
    """Four walls, and boxes and posts at random."""
    length_m, width_m = rng.uniform(5.0, 14.0), rng.uniform(4.0, 10.0)
    things = list(_sides("wall", [(0.0, 0.0), (length_m, 0.0), (length_m, width_m), (0.0, width_m)]))
    for number in range(rng.randint(1, 7)):
        middle = Pose(rng.uniform(0, length_m), rng.uniform(0, width_m), rng.uniform(0, math.pi))
        half_m, deep_m = rng.uniform(0.05, 0.6), rng.uniform(0.05, 0.4)
        corners = [middle.place(half_m * one, deep_m * two) for one, two in ((1, 1), (-1, 1), (-1, -1), (1, -1))]
        things += _sides(f"box{number}", corners)
    for number in range(rng.randint(0, 5)):
        things.append(Post(f"post{number}", rng.uniform(0, length_m), rng.uniform(0, width_m), rng.uniform(0.02, 0.12)))
    return Room(tuple(things))


def random_start(room: Room, rng) -> Pose:
    """A pose from which the middle of the rear axle is clear of everything."""
    walls = room.things[:4]
    while True:
        pose = Pose(rng.uniform(0, walls[0].x2_m), rng.uniform(0, walls[1].y2_m), rng.uniform(-math.pi, math.pi))
        if not room.near(pose, CLEAR_M) and not _is_in_box(room, pose):
            return pose


def _is_in_box(room, pose):
    """Whether a place is within a box: it is to the left of all four sides."""
    boxes = {thing.name.split(".")[0] for thing in room.things if thing.name.startswith("box")}
    return any(all(_is_left(side, pose) for side in room.things if side.name.startswith(box + "."))
               for box in boxes)


def _is_left(side, pose):
    return ((side.x2_m - side.x1_m) * (pose.y_m - side.y1_m) - (side.y2_m - side.y1_m) * (pose.x_m - side.x1_m)) > 0
