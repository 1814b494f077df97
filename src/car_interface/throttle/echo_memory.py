"""Remember where the echoes of a car's sonars came from, while the car drives on.

``look`` takes a range, ``move`` the car's motion, and ``meets`` returns what the car meets first on an arc. An echo
shows how far something is, but not its direction: it may be anywhere in the cone at that range, and reach into the
strip beside it. So points across the cone, and one beside each edge, stand for it. They keep their place while the car
moves (by its integrated speed and curvature), even where no cone reaches them: at the bumper's corners, and beside the
car in a turn. They are forgotten

* all together, when the sonar's next echo may come from one of them: that echo's points stand for the thing now,
* each when a sonar has looked there again and seen farther: twice with an echo, or four times without any, since a
  single echo may get lost,
* each when the car has passed it, or stands where it was.

Pure. The frame is the car's frame at its start.
"""
from __future__ import annotations

import math
from typing import Mapping, NamedTuple

from car_interface.common.units import NS_PER_S
from car_interface.throttle.sonar_fan import Arc, Mount, Outline, cone_points

MISSES, MISSED_BY_ECHO, MISSED_BY_NONE = 4, 2, 1  # if one echo in 20 is lost, four in a row are 6 in a million
SAME_M = 0.08  # ranges that differ by less are of the same thing: noise of sonar and odometry
# A place this near to a cone's edge may be inside or outside of the cone. A sonar's own echo did come from inside.
EDGE_RAD, ROUNDING_RAD = math.radians(2.0), math.radians(0.2)
MAX_POINTS = 32  # besides the newest echoes': the nearest are kept
# What echoes at a cone's edge may reach so far beyond it: half of the strip between two front cones. Its sonar looks
# there again only as long as the car has not moved that place farther out: a thin post in the strip is seen by no one.
BESIDE_M = 0.05
CELL_M = 0.08  # one point of a sonar stands for all its points in a square of this size
FORGET_M = 2.5  # from the rear axle's middle; the sonars see what is farther again before the car gets there
MAX_STEP_S = 1.0  # without reports the car is moved on for this long at most


class Met(NamedTuple):
    """The first echo of a sonar that the car meets on an arc."""

    distance_m: float  # of the rear axle's middle
    is_current: bool  # it is the sonar's newest echo; else a remembered one


class _Point:
    __slots__ = ("beside_m", "echo", "is_current", "misses", "sonar", "x_m", "y_m")

    def __init__(self, x_m, y_m, beside_m, sonar, echo):
        self.x_m, self.y_m, self.beside_m, self.sonar, self.echo = x_m, y_m, beside_m, sonar, echo
        self.misses, self.is_current = 0, True


class EchoMemory:
    """Keep the places of one car's echoes.

    Args:
        field_of_view_rad: the full angle of each cone.
        margin_m: what the car would pass at a smaller distance is in its way.
    """

    def __init__(self, mounts: Mapping[str, Mount], field_of_view_rad: float, outline: Outline, margin_m: float):
        self._mounts, self._field_of_view_rad = mounts, field_of_view_rad
        self._outline, self._margin_m = outline, margin_m
        self._x_m = self._y_m = self._yaw_rad = 0.0
        self._moved_ns: int | None = None
        self._points: list[_Point] = []
        self._echoes = 0  # so far; an echo's number is that of its points

    @property
    def are_moved(self) -> bool:
        """Return whether the points follow the car's motion: ``move`` was called."""
        return self._moved_ns is not None

    def move(self, speed_mps: float, curvature_per_m: float, now_ns: int) -> None:
        """Move the car on: its speed (backward negative) and arc (1/m, left positive) since the last call."""
        if self._moved_ns is not None:
            way_m = speed_mps * min(MAX_STEP_S, (now_ns - self._moved_ns) / NS_PER_S)
            yaw_rad = self._yaw_rad + way_m * curvature_per_m / 2.0
            self._x_m += way_m * math.cos(yaw_rad)
            self._y_m += way_m * math.sin(yaw_rad)
            self._yaw_rad += way_m * curvature_per_m
        self._moved_ns = now_ns

    def look(self, sonar: str, range_m: float, is_echo: bool) -> None:
        """Take a sonar's newest range; without an echo the distance up to which it would have seen one."""
        mount = self._mounts[sonar]
        half_rad = self._field_of_view_rad / 2.0
        cos_yaw, sin_yaw = math.cos(self._yaw_rad), math.sin(self._yaw_rad)
        sonar_x_m = self._x_m + mount.x_m * cos_yaw - mount.y_m * sin_yaw
        sonar_y_m = self._y_m + mount.x_m * sin_yaw + mount.y_m * cos_yaw
        axis_rad = self._yaw_rad + mount.yaw_rad
        kept, seen_again = [], set()
        for point in self._points:
            is_own = point.sonar == sonar
            if is_own:
                point.is_current = False
            to_x_m, to_y_m = point.x_m - sonar_x_m, point.y_m - sonar_y_m
            away_m = math.hypot(to_x_m, to_y_m)
            beyond_m = away_m - range_m
            off_rad = abs(math.remainder(math.atan2(to_y_m, to_x_m) - axis_rad, 2.0 * math.pi))
            # A point stands for its cell: another sonar has looked there if all of that was in its cone.
            edge_rad = (ROUNDING_RAD + _beside_rad(point.beside_m, away_m) if is_own
                        else -EDGE_RAD - math.atan2(CELL_M / 2.0, away_m))
            is_in_cone = off_rad <= half_rad + edge_rad
            if is_own and is_echo and is_in_cone and abs(beyond_m) <= SAME_M:
                seen_again.add(point.echo)
            if beyond_m < -SAME_M and is_in_cone:
                point.misses += MISSED_BY_ECHO if is_echo else MISSED_BY_NONE
                if point.misses >= MISSES:
                    continue
            kept.append(point)
        self._points = self._remembered([point for point in kept if point.echo not in seen_again])
        if is_echo:
            self._echoes += 1
            for x_m, y_m, beside_m in _places(mount, range_m, self._field_of_view_rad):
                self._points.append(_Point(self._x_m + x_m * cos_yaw - y_m * sin_yaw,
                                           self._y_m + x_m * sin_yaw + y_m * cos_yaw, beside_m, sonar, self._echoes))

    def _remembered(self, points):
        """Return the points that the car hasn't passed: the newest echoes', and MAX_POINTS others at most."""
        found, current, cells = [], [], set()
        for point in reversed(points):
            if point.is_current:
                current.append(point)
                continue
            x_m, y_m = self._from_car(point)
            away_m = math.hypot(x_m, y_m)
            cell = point.sonar, round(point.x_m / CELL_M), round(point.y_m / CELL_M)
            is_near = point.misses or away_m <= FORGET_M
            if is_near and cell not in cells and not self._is_passed(point.sonar, x_m, y_m):
                cells.add(cell)
                found.append((away_m, point))
        current.reverse()
        if len(found) > MAX_POINTS:
            found = sorted(found, key=lambda one: one[0])[:MAX_POINTS]
        return current + [point for _, point in found]

    def _is_passed(self, sonar, x_m, y_m):
        outline = self._outline
        if x_m > outline.front_m if self._mounts[sonar].looks_back else x_m < -outline.rear_m:
            return True
        return -outline.rear_m < x_m < outline.front_m and abs(y_m) < outline.width_m / 2

    def _from_car(self, point):
        to_x_m, to_y_m = point.x_m - self._x_m, point.y_m - self._y_m
        cos_yaw, sin_yaw = math.cos(self._yaw_rad), math.sin(self._yaw_rad)
        return to_x_m * cos_yaw + to_y_m * sin_yaw, to_y_m * cos_yaw - to_x_m * sin_yaw

    def meets(self, curvature_per_m: float, is_backward: bool) -> dict[str, Met]:
        """Return the first echo of each sonar that the car meets on an arc, by name; others are left out."""
        outline, found = self._outline, {}
        arc = Arc(curvature_per_m, is_backward, outline, self._margin_m)
        # Without the margin, for points beside the car: it already passes them closely.
        body = Arc(curvature_per_m, is_backward, outline, 0.0)
        cos_yaw, sin_yaw = math.cos(self._yaw_rad), math.sin(self._yaw_rad)
        from_x_m, from_y_m = self._x_m * cos_yaw + self._y_m * sin_yaw, self._y_m * cos_yaw - self._x_m * sin_yaw
        places = [(point.x_m * cos_yaw + point.y_m * sin_yaw - from_x_m,
                   point.y_m * cos_yaw - point.x_m * sin_yaw - from_y_m) for point in self._points]
        for point, (x_m, y_m), is_swept in zip(self._points, places, arc.sweeps(places)):
            if not is_swept:
                continue
            touched = body if -outline.rear_m <= x_m <= outline.front_m else arc
            distance_m = touched.distance_m(x_m, y_m)
            if distance_m is not None:
                before = found.get(point.sonar)
                if before is None or distance_m < before.distance_m:
                    found[point.sonar] = Met(distance_m, point.is_current)
        return found


def _beside_rad(beside_m, away_m):
    """Return the angle beyond a cone's edge of what is so far beside it; all around at the sonar itself."""
    return math.asin(beside_m / away_m) if away_m > beside_m else math.pi


def _places(mount, range_m, field_of_view_rad):
    """Return where an echo may come from, as (x, y, how far beside the cone)."""
    across = [(x_m, y_m, 0.0) for x_m, y_m in cone_points(mount, range_m, field_of_view_rad)]
    beside = []
    for (x_m, y_m, _), side_m in ((across[0], -BESIDE_M), (across[-1], BESIDE_M)):
        edge_rad = mount.yaw_rad + math.copysign(field_of_view_rad / 2.0, side_m)
        beside.append((x_m - side_m * math.sin(edge_rad), y_m + side_m * math.cos(edge_rad), BESIDE_M))
    return beside + across
