"""Compute how far a car gets along an arc: until it touches a point (``Arc``), and until it leaves the fan (``Fan``).

The fan is the area between the outermost edges of the sonars' cones at one end of the car, as far as each sonar
reaches. Each place in it belongs to the sonar whose axis is nearest. So the strips between two cones, and the area just
before the bumper, count as looked at. The middle of the bumper stands for the car.

Pure geometry in the car's frame: x metres ahead of the rear axle's middle, y metres to the left. Mirrored, a car that
drives backward or turns right drives forward and turns left; so everything here is written for forward and left.
"""
from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Iterable, Mapping, NamedTuple

from car_interface.common import declared
from car_interface.common.vehicle_geometry import FRONT_M, REAR_M, WIDTH_M

MIN_CURVATURE_PER_M = 1e-3  # a straight line is computed as a circle of 1 km
CONE_POINTS = 9  # across a cone: of 30° at 2 m every 0.13 m
OUTLINE = "the car's outline, from the middle of the rear axle"  # the description of three parameters
MAX_EDGE_RAD = math.pi / 2  # the fan doesn't reach behind the bumper


class Mount(NamedTuple):
    """A sonar's pose: metres from the middle of the rear axle, and the direction in rad, left positive."""

    x_m: float
    y_m: float
    yaw_rad: float

    @property
    def looks_back(self) -> bool:
        return math.cos(self.yaw_rad) < 0.0


@dataclass(frozen=True)
class Outline:
    """The car from above. The default is a Slash's."""

    front_m: float = declared.number(
        "front", FRONT_M, OUTLINE, "m", above=0.0, high=10.0)
    rear_m: float = declared.number("rear", REAR_M, OUTLINE, "m", low=0.0, high=10.0)
    width_m: float = declared.number("width", WIDTH_M, OUTLINE, "m", above=0.0, high=10.0)


def cone_points(mount: Mount, range_m: float, field_of_view_rad: float) -> list[tuple[float, float]]:
    """Return points across a cone at a range, edges included: an echo may come from any of them."""
    angles_rad = (mount.yaw_rad + field_of_view_rad * (index / (CONE_POINTS - 1) - 0.5) for index in range(CONE_POINTS))
    return [(mount.x_m + range_m * math.cos(angle_rad), mount.y_m + range_m * math.sin(angle_rad))
            for angle_rad in angles_rad]


class Arc:
    """The arc that a car drives, with the area that its body sweeps.

    Args:
        curvature_per_m: left positive.
        margin_m: added to the body at both sides.
    """

    def __init__(self, curvature_per_m: float, is_backward: bool, outline: Outline, margin_m: float):
        self._ahead, self._left = (-1.0 if is_backward else 1.0), (-1.0 if curvature_per_m < 0.0 else 1.0)
        self._bumper_m, trailing_m = (outline.rear_m, outline.front_m) if is_backward else (
            outline.front_m, outline.rear_m)
        self._half_m = half_m = outline.width_m / 2 + margin_m
        self._is_straight = abs(curvature_per_m) < MIN_CURVATURE_PER_M
        self._radius_m = radius_m = 1.0 / max(MIN_CURVATURE_PER_M, abs(curvature_per_m))
        # Distances from the turn's centre: the inner and the outer side, the bumper's corners, the farthest corner.
        self._inner_m, self._outer_m = radius_m - half_m, radius_m + half_m
        self._inner_corner_m = math.hypot(max(0.0, self._inner_m), self._bumper_m)
        self._outer_corner_m = math.hypot(self._outer_m, self._bumper_m)
        farthest_m = max(self._outer_corner_m, math.hypot(self._outer_m, trailing_m))
        self._near_m2, self._far_m2 = max(0.0, self._inner_m) ** 2, farthest_m ** 2

    def sweeps(self, points: Iterable[tuple[float, float]]) -> list[bool]:
        """Return for each point whether the car may touch it: a quick test, true for each point that it does touch."""
        if self._is_straight:
            half_m = self._half_m
            return [-half_m <= y_m <= half_m for _, y_m in points]
        near_m2, far_m2, centre_m = self._near_m2, self._far_m2, self._radius_m * self._left
        return [near_m2 <= x_m * x_m + (centre_m - y_m) * (centre_m - y_m) <= far_m2 for x_m, y_m in points]

    def distance_m(self, x_m: float, y_m: float) -> float | None:
        """Return how far the rear axle's middle can drive (m) until the car touches a point; ``None``: it never does.

        With 0 or less it touches the point already.
        """
        x_m, y_m = x_m * self._ahead, y_m * self._left
        if self._is_straight:
            return x_m - self._bumper_m if abs(y_m) <= self._half_m and x_m > 0.0 else None
        across_m = self._radius_m - y_m
        from_centre_m2 = x_m * x_m + across_m * across_m
        if not self._near_m2 <= from_centre_m2 <= self._far_m2:
            return None
        from_centre_m, round_rad = math.sqrt(from_centre_m2), math.atan2(x_m, across_m)
        # The part of the car that touches it: the bumper, or the inner side if the point is nearer to the centre. If it
        # is farther, the outer side of the trailing end, such as a front that swings out while the car reverses.
        if from_centre_m > self._outer_corner_m:
            to_go_rad = round_rad + math.acos(self._outer_m / from_centre_m)
            return self._radius_m * to_go_rad if to_go_rad > 0.0 else None
        if round_rad <= 0.0:
            return None  # beside or behind the axle: the car drives away from it
        if self._inner_m <= 0.0 or from_centre_m >= self._inner_corner_m:
            part_rad = math.asin(min(1.0, self._bumper_m / from_centre_m))
        else:
            part_rad = math.acos(min(1.0, self._inner_m / from_centre_m))
        return self._radius_m * (round_rad - part_rad)


class FanEnd(NamedTuple):
    """The place where an arc leaves the fan."""

    distance_m: float  # of the rear axle's middle
    sonar: str  # whose part of the fan it leaves; empty: there is no fan
    is_edge: bool  # it leaves at the fan's side, or where something hides the rest; else at the sonar's range
    sonars: tuple[str, ...]  # whose parts it leads through


class _Part(NamedTuple):
    """One sonar's part of the fan, and the edge to its left."""

    name: str
    mount: Mount
    edge_x_m: float
    edge_y_m: float
    edge_rad: float


class Fan:
    """The fan at one end of the car.

    Args:
        mounts: of the car's sonars, by name; those that look to that end count.
        field_of_view_rad: the full angle of each cone.
    """

    def __init__(self, mounts: Mapping[str, Mount], field_of_view_rad: float, outline: Outline, is_backward: bool):
        self._bumper_m = bumper_m = outline.rear_m if is_backward else outline.front_m
        mounts = {name: mount for name, mount in mounts.items() if mount.looks_back == is_backward}
        if is_backward:
            mounts = {name: Mount(-x_m, y_m, math.pi - yaw_rad) for name, (x_m, y_m, yaw_rad) in mounts.items()}
        mirrored = {name: Mount(x_m, -y_m, -yaw_rad) for name, (x_m, y_m, yaw_rad) in mounts.items()}
        self._to_left, self._to_right = (_parts(sonars, field_of_view_rad, bumper_m) for sonars in (mounts, mirrored))

    def end(self, curvature_per_m: float, reaches_m: Mapping[str, float]) -> FanEnd:
        """Return where the middle of the bumper leaves the fan on an arc (1/m, left positive).

        ``reaches_m`` is the distance that each sonar sees now, by name: to its echo, or its largest range.
        """
        right_rad, parts = self._to_right if curvature_per_m < 0.0 else self._to_left
        radius_m = 1.0 / max(MIN_CURVATURE_PER_M, abs(curvature_per_m))
        start_rad = math.atan2(self._bumper_m, radius_m)
        if not parts or start_rad < right_rad:
            return FanEnd(0.0, "", True, ())  # it is outside of the fan from the start, or there is none
        path_m = math.hypot(self._bumper_m, radius_m)
        at_rad, passed, part = start_rad, [], None
        for part in parts:
            edge_rad = _crosses_edge_rad(part, radius_m, path_m)
            if edge_rad <= at_rad and part is not parts[-1]:
                continue
            passed.append(part.name)
            reach_rad = _leaves_circle_rad(part.mount, reaches_m[part.name], radius_m, path_m)
            if reach_rad <= edge_rad:  # if it enters this part beyond the reach, something nearer hides the rest
                is_hidden = reach_rad < at_rad
                return FanEnd(radius_m * (max(at_rad, reach_rad) - start_rad), part.name, is_hidden, tuple(passed))
            at_rad = max(at_rad, edge_rad)
        return FanEnd(radius_m * (at_rad - start_rad), part.name, True, tuple(passed))


def _parts(mounts, field_of_view_rad, bumper_m):
    """Return (direction of the fan's right edge, its parts from right to left)."""
    in_order = sorted(((math.remainder(mount.yaw_rad, 2.0 * math.pi), name) for name, mount in mounts.items()))
    if not in_order:
        return 0.0, []
    parts, half_rad = [], field_of_view_rad / 2.0
    for index, (yaw_rad, name) in enumerate(in_order):
        mount = Mount(mounts[name].x_m, mounts[name].y_m, yaw_rad)
        if index + 1 < len(in_order):
            next_rad, next_name = in_order[index + 1]
            after = mounts[next_name]
            edge = ((mount.x_m + after.x_m) / 2.0, (mount.y_m + after.y_m) / 2.0, (yaw_rad + next_rad) / 2.0)
        else:
            edge = (mount.x_m, mount.y_m, min(MAX_EDGE_RAD, yaw_rad + half_rad))
            # The area just before the bumper counts: an edge that would cut off its middle is moved to it.
            if _is_left(bumper_m, 0.0, edge):
                edge = (bumper_m, 0.0, edge[2])
        parts.append(_Part(name, mount, *edge))
    return max(-MAX_EDGE_RAD, in_order[0][0] - half_rad), parts


def _is_left(x_m, y_m, edge):
    edge_x_m, edge_y_m, edge_rad = edge
    return math.cos(edge_rad) * (y_m - edge_y_m) > math.sin(edge_rad) * (x_m - edge_x_m)


def _crosses_edge_rad(part, radius_m, path_m):
    """Return the angle about the turn's centre, (0, radius), at which the path crosses an edge, or is closest to it."""
    ratio = (math.cos(part.edge_rad) * (radius_m - part.edge_y_m) + math.sin(part.edge_rad) * part.edge_x_m) / path_m
    return part.edge_rad + math.acos(max(-1.0, min(1.0, ratio)))


def _leaves_circle_rad(mount, reach_m, radius_m, path_m):
    """Return the angle at which the path leaves a circle around a sonar; inf: never."""
    across_m = radius_m - mount.y_m
    from_centre_m = math.hypot(mount.x_m, across_m)
    ratio = (path_m ** 2 + from_centre_m ** 2 - reach_m ** 2) / (2.0 * path_m * from_centre_m)
    if ratio <= -1.0:
        return math.inf
    return math.atan2(mount.x_m, across_m) + math.acos(min(1.0, ratio))
