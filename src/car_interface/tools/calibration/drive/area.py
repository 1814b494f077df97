"""The area in which the car stays: where an arc leads, and by how much a turn leaves it.

A pose is that of the middle of the rear axle, in odometry's frame; curvatures are in 1/m, left positive.
"""
from __future__ import annotations

import cmath
import math
from typing import NamedTuple, Sequence

from car_interface.throttle.obstacle_stop import Outline

SLASH = Outline()


class Pose(NamedTuple):
    """Position in m and heading in rad."""

    x_m: float
    y_m: float
    yaw_rad: float


class Turn(NamedTuple):
    """A tight turn."""

    curvature_per_m: float  # left positive
    reaction_s: float  # until the wheels are turned for it


class WayOut(NamedTuple):
    """What comes of a tight turn that is begun now."""

    extent_m: float  # how far the car's corners get from the center
    excess_m: float  # by how much it leaves the area, also where it stops when it is let go on it: straight on


def moved(pose: Pose, distance_m: float, curvature_per_m: float) -> Pose:
    """Return the pose after an arc."""
    x_m, y_m, yaw_rad = pose
    half_rad = distance_m * curvature_per_m / 2
    chord_m = distance_m * (math.sin(half_rad) / half_rad if abs(half_rad) > 1e-6 else 1.0)
    return Pose(x_m + chord_m * math.cos(yaw_rad + half_rad), y_m + chord_m * math.sin(yaw_rad + half_rad),
                yaw_rad + 2 * half_rad)


class Area:
    """A circle around a center (x, y) that no part of the car leaves, and one of ``stop_radius_m`` in which it comes to
    a stop when it is let go; ``None`` = the same.
    """

    def __init__(self, center: tuple[float, float], radius_m: float, outline: Outline = SLASH,
                 stop_radius_m: float | None = None):
        self.center, self.radius_m = center, radius_m
        self.stop_radius_m = radius_m if stop_radius_m is None else stop_radius_m
        self._front_m, self._rear_m, self._half_m = outline.front_m, outline.rear_m, outline.width_m / 2

    def extent_m(self, pose: Pose) -> float:
        """Return how far the car's farthest corner is from the center."""
        rel = self._seen_from(pose)
        along_m = max(abs(rel.real + self._front_m), abs(rel.real - self._rear_m))
        return math.hypot(along_m, abs(rel.imag) + self._half_m)

    def ahead_m(self, pose: Pose, radius_m: float) -> float:
        """Return how far the car can go straight on until its front leaves a circle of that radius; 0 = it has."""
        front = self._seen_from(pose) + self._front_m
        square = abs(front) ** 2 - radius_m ** 2
        return max(0.0, math.sqrt(front.real ** 2 - square) - front.real) if square < 0 else 0.0

    def inward_rad(self, pose: Pose) -> float:
        """Return the angle between the car's heading and the direction to the center, 0 to π."""
        return math.pi - abs(cmath.phase(self._seen_from(pose)))

    def circle_extent_m(self, pose: Pose, curvature_per_m: float, stop_m: float = 0.0) -> float:
        """Return how far the car's farthest corner is from the center anywhere on the whole circle of an arc, or after
        it went straight on from there for ``stop_m``.
        """
        return abs(self._seen_from(pose) + 1j / curvature_per_m) + self._swept_m(curvature_per_m, stop_m)

    def has_circle(self, curvature_per_m: float) -> bool:
        """Return whether the car stays inside on a whole circle around the center."""
        return self._swept_m(curvature_per_m, 0.0) <= self.radius_m

    def _swept_m(self, curvature_per_m, stop_m):
        """Return how far the same corner is from the middle of the arc."""
        return math.hypot(1 / abs(curvature_per_m) + self._half_m, self._front_m + stop_m)

    def _seen_from(self, pose):
        """Return the car's place relative to the center in the car's frame: ahead, and to the left as the imaginary
        part.
        """
        return complex(pose.x_m - self.center[0], pose.y_m - self.center[1]) * cmath.rect(1.0, -pose.yaw_rad)

    def ways_out(self, pose: Pose, curvature_per_m: float, turns: Sequence[Turn], speed_mps: float,
                 stop_m: float) -> list[WayOut]:
        """Return what comes of each of the tight turns, after the arc on which the car goes on until its wheels are
        turned; ``stop_m``: what it takes to stop.
        """
        ways = []
        for turn in turns:
            after = moved(pose, speed_mps * turn.reaction_s, curvature_per_m)
            extent_m = max(self.extent_m(pose), self.extent_m(after), self.circle_extent_m(after, turn.curvature_per_m))
            stops_m = self.circle_extent_m(after, turn.curvature_per_m, stop_m)
            ways.append(WayOut(extent_m, max(extent_m - self.radius_m, stops_m - self.stop_radius_m)))
        return ways
