"""The area in which the car stays: where an arc leads, and how far the car can go until no turn keeps it inside.

A pose is that of the middle of the rear axle, in odometry's frame; curvatures are in 1/m, left positive.
"""
from __future__ import annotations

import cmath
import math
from typing import NamedTuple, Sequence

from car_interface.throttle.obstacle_stop import Outline

STEP_M = 0.2  # from one pose that is looked at to the next
TURN_STEP_RAD = 0.2
SLASH = Outline()
INWARD_RAD = math.radians(60)  # a car that looks to the center within this angle is on its way back
INWARD_COS = math.cos(INWARD_RAD)
TURN_STEPS = math.ceil(2 * math.pi / TURN_STEP_RAD)


class Pose(NamedTuple):
    """Position in m and heading in rad."""

    x_m: float
    y_m: float
    yaw_rad: float


NOWHERE = Pose(0.0, 0.0, 0.0)


class Turn(NamedTuple):
    """A tight turn.

    Attributes:
        curvature_per_m: left positive.
        reaction_m: what the car drives until its wheels are turned for it.
    """

    curvature_per_m: float
    reaction_m: float


def moved(pose: Pose, distance_m: float, curvature_per_m: float) -> Pose:
    """The pose after an arc."""
    x_m, y_m, yaw_rad = pose
    half_rad = distance_m * curvature_per_m / 2
    chord_m = distance_m * (math.sin(half_rad) / half_rad if abs(half_rad) > 1e-6 else 1.0)
    return Pose(x_m + chord_m * math.cos(yaw_rad + half_rad), y_m + chord_m * math.sin(yaw_rad + half_rad),
                yaw_rad + 2 * half_rad)


class Area:
    """A circle around a start that no part of the car leaves.

    Args:
        center: x and y in m.
        radius_m: of the circle.
        outline: of the car.
    """

    def __init__(self, center: tuple[float, float], radius_m: float, outline: Outline = SLASH):
        self.center, self.radius_m = center, radius_m
        half_m = outline.width_m / 2
        self._front_m, self._rear_m, self._half_m = outline.front_m, outline.rear_m, half_m

    def extent_m(self, pose: Pose) -> float:
        """How far the car's farthest corner is from the center."""
        return math.sqrt(self._square(self._seen_from(pose)))

    def ahead_m(self, pose: Pose, radius_m: float) -> float:
        """How far the car can go straight on until its front leaves a circle of that radius; 0 = it has."""
        cos_yaw, sin_yaw = math.cos(pose.yaw_rad), math.sin(pose.yaw_rad)
        x_m = pose.x_m + self._front_m * cos_yaw - self.center[0]
        y_m = pose.y_m + self._front_m * sin_yaw - self.center[1]
        along_m, square = x_m * cos_yaw + y_m * sin_yaw, x_m * x_m + y_m * y_m - radius_m * radius_m
        return max(0.0, -along_m + math.sqrt(along_m * along_m - square)) if square < 0 else 0.0

    def inward_rad(self, pose: Pose) -> float:
        """The angle between the car's heading and the direction to the center, 0 to π."""
        towards_rad = math.atan2(self.center[1] - pose.y_m, self.center[0] - pose.x_m)
        return abs(math.remainder(towards_rad - pose.yaw_rad, 2 * math.pi))

    def circle_extent_m(self, pose: Pose, curvature_per_m: float) -> float:
        """How far the car's farthest corner is from the center anywhere on the whole circle of an arc."""
        radius_m = 1 / curvature_per_m
        x_m = pose.x_m - radius_m * math.sin(pose.yaw_rad) - self.center[0]
        y_m = pose.y_m + radius_m * math.cos(pose.yaw_rad) - self.center[1]
        return math.hypot(x_m, y_m) + math.hypot(abs(radius_m) + self._half_m, self._front_m)

    def turn_extent_m(self, pose: Pose, curvature_per_m: float) -> float:
        """The same on a tight turn from here until the car looks inward again."""
        whole_m = self.circle_extent_m(pose, curvature_per_m)
        if whole_m <= self.radius_m:
            return whole_m
        # In the car's frame one step of an arc is one multiplication: this runs thousands of times a second.
        rel = self._seen_from(pose)
        step = complex(*moved(NOWHERE, TURN_STEP_RAD / abs(curvature_per_m), curvature_per_m)[:2])
        back = cmath.rect(1.0, -math.copysign(TURN_STEP_RAD, curvature_per_m))
        square = 0.0
        for _ in range(TURN_STEPS):
            square = max(square, self._square(rel))
            if -rel.real > INWARD_COS * abs(rel):
                break
            rel = (rel + step) * back
        return math.sqrt(square)

    def _seen_from(self, pose):
        """The car's place relative to the center in the car's frame: ahead, and to the left as the imaginary part."""
        return complex(pose.x_m - self.center[0], pose.y_m - self.center[1]) * cmath.rect(1.0, -pose.yaw_rad)

    def _square(self, rel):
        """The square of the farthest corner's distance from the center, m²."""
        ahead_m, left_m, front_m, rear_m, half_m = rel.real, abs(rel.imag), self._front_m, self._rear_m, self._half_m
        along_m = max(abs(ahead_m + front_m), abs(ahead_m - rear_m))
        return along_m * along_m + (left_m + half_m) ** 2

    def ways_out(self, pose: Pose, curvature_per_m: float, turns: Sequence[Turn]) -> list[float]:
        """How far the car's corners get from the center on each of the tight turns.

        Args:
            pose: now.
            curvature_per_m: of the arc on which it goes on until its wheels are turned.
            turns: the tight turns.
        """
        extents = []
        for turn in turns:
            after = moved(pose, turn.reaction_m, curvature_per_m)
            extents.append(max(self.extent_m(pose), self.extent_m(after),
                               self.turn_extent_m(after, turn.curvature_per_m)))
        return extents

    def free_m(self, pose: Pose, curvature_per_m: float, turns: Sequence[Turn], max_m: float,
               min_ahead_m: float = 0.0) -> float:
        """How far the car can go on an arc until no tight turn keeps it inside any more, at most ``max_m``.

        Args:
            pose: where the arc begins.
            curvature_per_m: of the arc.
            turns: the tight turns.
            max_m: as above.
            min_ahead_m: so far it must be able to go straight on from everywhere, as it does when it is let go.
        """
        if curvature_per_m and self.circle_extent_m(pose, curvature_per_m) <= self.radius_m:
            return max_m
        gone_m = 0.0
        while gone_m < max_m:
            if (self.ahead_m(pose, self.radius_m) < min_ahead_m
                    or min(self.ways_out(pose, curvature_per_m, turns)) > self.radius_m):
                return gone_m
            pose, gone_m = moved(pose, STEP_M, curvature_per_m), gone_m + STEP_M
        return max_m
