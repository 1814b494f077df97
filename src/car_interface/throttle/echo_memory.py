"""Where the echoes of a car's sonars came from, while it drives on.

An echo tells how far something is, not in which direction: it may stand anywhere in the cone at that range, so points
across the cone stand for it. They stay where they are while the car moves (its speed and curvature are integrated),
also where no cone reaches them any more: at the bumper's corners, and beside the car in a turn. A point is forgotten
when

* its sonar's next echo comes from as far: the new one stands for it,
* a sonar looked there again and saw farther: twice, or four times where it heard no echo at all, since now and then an
  echo fails to appear,
* the car has passed it, or is where it was.

Pure. The frame is that of the car when it started.
"""
from __future__ import annotations

import math
from typing import Mapping, NamedTuple

from car_interface.common.units import NS_PER_S
from car_interface.throttle.sonar_fan import Arc, Mount, Outline, cone_points

MISSES, MISSED_BY_ECHO, MISSED_BY_NONE = 4, 2, 1  # of one lost echo in twenty, four in a row are 6 in a million
SAME_M = 0.08  # ranges that differ by less are of the same thing: the sonar's noise, and that of the odometry meanwhile
# So near to a cone's edge a place may have been looked at, or not. A sonar's own echo did come from there.
EDGE_RAD, ROUNDING_RAD = math.radians(2.0), math.radians(0.2)
MAX_POINTS = 32  # beside those of the newest echoes; the nearest stay, and what an echo may only have been lost of
CELL_M = 0.08  # one of a sonar's points stands for all in a square of this size
FORGET_M = 2.5  # from the middle of the rear axle: a thing farther away is looked at again before the car gets there
MAX_STEP_S = 1.0  # what a car without reports is moved on by
class Met(NamedTuple):
    """What the car meets on an arc."""

    distance_m: float  # of the rear axle's middle
    is_current: bool  # by the sonar's newest echo; else remembered


class _Point:
    __slots__ = ("is_current", "misses", "sonar", "x_m", "y_m")

    def __init__(self, x_m, y_m, sonar):
        self.x_m, self.y_m, self.sonar = x_m, y_m, sonar
        self.misses, self.is_current = 0, True


class EchoMemory:
    """The places of one car's echoes.

    Args:
        mounts: the sonars, by name.
        field_of_view_rad: the whole cone of each.
        outline: the car's.
        margin_m: at both sides; what the car passes by more closely is in its way.
    """

    def __init__(self, mounts: Mapping[str, Mount], field_of_view_rad: float, outline: Outline, margin_m: float):
        self._mounts, self._field_of_view_rad = mounts, field_of_view_rad
        self._outline, self._margin_m = outline, margin_m
        self._x_m = self._y_m = self._yaw_rad = 0.0
        self._moved_ns: int | None = None
        self._points: list[_Point] = []

    @property
    def are_moved(self) -> bool:
        """Whether the car's motion is known."""
        return self._moved_ns is not None

    def move(self, speed_mps: float, curvature_per_m: float, now_ns: int) -> None:
        """The car has driven at this speed (backward negative) on this arc (1/m, left positive) since the last call."""
        if self._moved_ns is not None:
            way_m = speed_mps * min(MAX_STEP_S, (now_ns - self._moved_ns) / NS_PER_S)
            yaw_rad = self._yaw_rad + way_m * curvature_per_m / 2.0
            self._x_m += way_m * math.cos(yaw_rad)
            self._y_m += way_m * math.sin(yaw_rad)
            self._yaw_rad += way_m * curvature_per_m
        self._moved_ns = now_ns

    def look(self, sonar: str, range_m: float, is_echo: bool) -> None:
        """A sonar's newest range; without an echo: how far it would have seen one."""
        mount = self._mounts[sonar]
        half_rad = self._field_of_view_rad / 2.0
        cos_yaw, sin_yaw = math.cos(self._yaw_rad), math.sin(self._yaw_rad)
        sonar_x_m = self._x_m + mount.x_m * cos_yaw - mount.y_m * sin_yaw
        sonar_y_m = self._y_m + mount.x_m * sin_yaw + mount.y_m * cos_yaw
        axis_rad = self._yaw_rad + mount.yaw_rad
        kept = []
        for point in self._points:
            is_own = point.sonar == sonar
            if is_own:
                point.is_current = False
            to_x_m, to_y_m = point.x_m - sonar_x_m, point.y_m - sonar_y_m
            beyond_m = math.hypot(to_x_m, to_y_m) - range_m
            off_rad = abs(math.remainder(math.atan2(to_y_m, to_x_m) - axis_rad, 2.0 * math.pi))
            if is_own and is_echo and abs(beyond_m) <= SAME_M and off_rad <= half_rad + ROUNDING_RAD:
                continue
            is_in_cone = off_rad <= half_rad + (ROUNDING_RAD if is_own else -EDGE_RAD)
            if beyond_m < -SAME_M and is_in_cone:
                point.misses += MISSED_BY_ECHO if is_echo else MISSED_BY_NONE
                if point.misses >= MISSES:
                    continue
            kept.append(point)
        self._points = self._remembered(kept)
        if is_echo:
            for x_m, y_m in cone_points(mount, range_m, self._field_of_view_rad):
                self._points.append(_Point(self._x_m + x_m * cos_yaw - y_m * sin_yaw,
                                           self._y_m + x_m * sin_yaw + y_m * cos_yaw, sonar))

    def _remembered(self, points):
        """Those that are still ahead of the sonar's end of the car, the nearest ones if there are many."""
        found, current, cells = [], [], set()
        for point in reversed(points):
            if point.is_current:
                current.append(point)
                continue
            x_m, y_m = self._from_car(point)
            away_m = math.hypot(x_m, y_m)
            cell = point.sonar, round(point.x_m / CELL_M), round(point.y_m / CELL_M)
            matters_m = 0.0 if point.misses else away_m
            if matters_m <= FORGET_M and cell not in cells and not self._is_passed(point.sonar, x_m, y_m):
                cells.add(cell)
                found.append((matters_m, point))
        found.reverse()
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
        """What the car meets first on an arc, of each sonar's echoes; those are left out of which it meets none."""
        if not self._points:
            return {}
        outline, found = self._outline, {}
        arc = Arc(curvature_per_m, is_backward, outline, self._margin_m)
        body = None  # the same without the margin: what stands beside the car is passed closely already
        cos_yaw, sin_yaw = math.cos(self._yaw_rad), math.sin(self._yaw_rad)
        from_x_m, from_y_m = self._x_m * cos_yaw + self._y_m * sin_yaw, self._y_m * cos_yaw - self._x_m * sin_yaw
        places = [(point.x_m * cos_yaw + point.y_m * sin_yaw - from_x_m,
                   point.y_m * cos_yaw - point.x_m * sin_yaw - from_y_m) for point in self._points]
        for point, (x_m, y_m), is_swept in zip(self._points, places, arc.sweeps(places)):
            if not is_swept:
                continue
            if -outline.rear_m <= x_m <= outline.front_m:
                if body is None:
                    body = Arc(curvature_per_m, is_backward, outline, 0.0)
                distance_m = body.distance_m(x_m, y_m)
            else:
                distance_m = arc.distance_m(x_m, y_m)
            if distance_m is not None:
                before = found.get(point.sonar)
                if before is None or distance_m < before.distance_m:
                    found[point.sonar] = Met(distance_m, point.is_current)
        return found
