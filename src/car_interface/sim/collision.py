"""Finds what the virtual car runs into: its outline against walls, boxes and posts.

Pure: poses in, whether they are free out. A step into an obstacle is not made: the car stays where it was before it.
"""

from __future__ import annotations

import math
from typing import Sequence

from car_interface.common.vehicle_geometry import FRONT_M, REAR_M, WIDTH_M

APART_M = 0.01  # a car that has driven this far since it was stopped no longer touches the obstacle
# The outline's middle moves farther than the rear axle's on a turn: for c = 0.14 m before it by √(1 + c²/r²), which is
# 1.38 on the tightest turn that VehicleConfig accepts (r = 0.148 m).
MAX_CENTER_RATIO = 1.5


class Obstacles:
    """Everything upright in a room, and the outline of the car among it, a rectangle: by default a Slash 4x4's.

    Args:
        segments: sides of walls and boxes: x and y of one end, and from there to the other, in metres.
        posts: x, y, radius.
        rear_m, front_m, width_m: of the car: behind and before the rear axle's middle, and across.
    """

    def __init__(self, segments: Sequence[tuple], posts: Sequence[tuple], rear_m: float = REAR_M,
                 front_m: float = FRONT_M, width_m: float = WIDTH_M):
        self._segments, self._posts = tuple(segments), tuple(posts)
        self._low_m, self._high_m, self._half_m = -rear_m, front_m, width_m / 2
        self._center_m = (self._low_m + self._high_m) / 2
        self._radius_m = math.hypot(self._high_m - self._center_m, self._half_m)  # of the circle around the outline

    def is_free(self, pose: Sequence[float]) -> bool:
        """Return whether a car whose rear axle's middle is at x, y (m) and yaw (rad) touches nothing."""
        x_m, y_m, yaw_rad = pose
        cos_yaw, sin_yaw = math.cos(yaw_rad), math.sin(yaw_rad)

        def seen_from_car(to_x_m, to_y_m):
            return to_x_m * cos_yaw + to_y_m * sin_yaw, to_y_m * cos_yaw - to_x_m * sin_yaw
        for start_x_m, start_y_m, along_x_m, along_y_m in self._segments:
            if self._meets_segment(*seen_from_car(start_x_m - x_m, start_y_m - y_m),
                                   *seen_from_car(along_x_m, along_y_m)):
                return False
        for post_x_m, post_y_m, radius_m in self._posts:
            ahead_m, left_m = seen_from_car(post_x_m - x_m, post_y_m - y_m)
            beside_m = ahead_m - min(max(ahead_m, self._low_m), self._high_m)
            if math.hypot(beside_m, left_m - min(max(left_m, -self._half_m), self._half_m)) < radius_m:
                return False
        return True

    def clearance_m(self, pose: Sequence[float]) -> float:
        """Return how far the outline's middle can move before the car may touch something; 0 or less = it may now."""
        x_m = pose[0] + self._center_m * math.cos(pose[2])
        y_m = pose[1] + self._center_m * math.sin(pose[2])
        nearest_m = math.inf
        for start_x_m, start_y_m, along_x_m, along_y_m in self._segments:
            to_x_m, to_y_m = x_m - start_x_m, y_m - start_y_m
            ratio = (to_x_m * along_x_m + to_y_m * along_y_m) / (along_x_m * along_x_m + along_y_m * along_y_m)
            ratio = min(max(ratio, 0.0), 1.0)
            nearest_m = min(nearest_m, math.hypot(to_x_m - ratio * along_x_m, to_y_m - ratio * along_y_m))
        for post_x_m, post_y_m, radius_m in self._posts:
            nearest_m = min(nearest_m, math.hypot(x_m - post_x_m, y_m - post_y_m) - radius_m)
        return nearest_m - self._radius_m

    def _meets_segment(self, ahead_m, left_m, along_m, across_m):
        """Return whether a segment, seen from the car, has a part inside the outline (Liang and Barsky's clipping)."""
        first, last = 0.0, 1.0
        for start_m, to_m, low_m, high_m in ((ahead_m, along_m, self._low_m, self._high_m),
                                             (left_m, across_m, -self._half_m, self._half_m)):
            if to_m == 0.0:
                if not low_m <= start_m <= high_m:
                    return False
                continue
            enters, leaves = sorted(((low_m - start_m) / to_m, (high_m - start_m) / to_m))
            first, last = max(first, enters), min(last, leaves)
            if first > last:
                return False
        return True


class Collisions:
    """Blocks a car's steps into obstacles, and counts how often it ran into one.

    Attributes:
        count: of collisions; a car that keeps pushing, or backs off less than a centimetre, has one.
        speed_mps: of the newest collision, backward negative.
    """

    def __init__(self, obstacles: Obstacles):
        self._obstacles = obstacles
        self._clear_m = 0.0  # how far it can go before the next check
        self._since_m = math.inf  # driven since it was blocked
        self.count = 0
        self.speed_mps = 0.0

    def blocks(self, pose: Sequence[float], distance_m: float, speed_mps: float) -> bool:
        """Return whether a step that ends at ``pose`` runs into something.

        Args:
            pose: of the rear axle's middle after the step.
            distance_m: of the step, signed.
            speed_mps: before the step.
        """
        self._clear_m -= MAX_CENTER_RATIO * abs(distance_m)
        if self._clear_m <= 0.0:
            if not self._obstacles.is_free(pose):
                if self._since_m > APART_M:
                    self.count += 1
                    self.speed_mps = speed_mps
                self._since_m = 0.0
                return True
            self._clear_m = self._obstacles.clearance_m(pose)
        self._since_m += abs(distance_m)
        return False
