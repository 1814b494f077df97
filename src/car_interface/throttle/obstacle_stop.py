"""How fast a car may drive towards what its sonars see on the arc that it drives.

Pure: ranges, each with its arrival, and the arc in, a speed and the reason out. With d metres to go until the car
touches what a sonar sees, t seconds until a new range has an effect, and a deceleration a that a stop is certain of,
the car stops in time when v t + v² / 2a ≤ d − margin, which is v ≤ a (−t + √(t² + 2 (d − margin) / a)).

t is the range's age, a cycle of the sonar and the actuation. A sonar's echo may come from anywhere in its cone: the
place counts where the car arrives first. No echo counts as one at the largest range: beyond nothing is known. A sonar
that is silent, or measures nonsense, allows no speed towards it.

It can't see what no cone reaches: beside the car, above and below, and where a turn leaves the cones.
"""
from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import Mapping, NamedTuple

from car_interface.common import causes
from car_interface.common.errors import ConfigError
from car_interface.common.staleness import TimedInput
from car_interface.common.units import NS_PER_S
from car_interface.throttle.limits import SpeedBound

NAMES = ("front_right", "front_middle", "front_left", "rear_right", "rear_middle", "rear_left")
HUB = "sonar_hub/"  # the sensor hub's file, sonars.yaml, below the node
CONE_POINTS = 9
SIDE_MARGIN_M = 0.05  # what the car passes by more closely is in its way
STRAIGHT_PER_M = 1e-3
MAX_CYCLE_S = 0.43  # of six sonars, all of which wait for an echo in vain
CYCLES = 3  # the longest of so many counts


class Mount(NamedTuple):
    """A sonar's pose: metres from the middle of the rear axle, and its direction in rad, left positive."""

    x_m: float
    y_m: float
    yaw_rad: float


class Outline(NamedTuple):
    """The car from above: metres before and behind the rear axle's middle, and across. The default is a Slash's."""

    front_m: float = 0.426
    rear_m: float = 0.142
    width_m: float = 0.296


@dataclass(frozen=True)
class ObstacleConfig:
    """The sonars and the car.

    Attributes:
        mounts: of the sonars that count, by name.
        field_of_view_rad: the whole cone.
        max_range_m: beyond this nothing is measured.
        outline: of the car.
        margin_m: what is to be left between the car and what it stops for.
        actuation_s: from a range's arrival to the ESC's new pulse, and the 38 ms that an echo from afar takes.
        timeout_s: a sonar without a range for so long is silent.
    """

    mounts: Mapping[str, Mount] = field(default_factory=dict)
    field_of_view_rad: float = 0.5236
    max_range_m: float = 2.0
    outline: Outline = field(default_factory=Outline)
    margin_m: float = 0.1
    actuation_s: float = 0.1
    timeout_s: float = 1.0


def read_obstacle_stop(params, is_complete: bool = True) -> ObstacleConfig | None:
    """The configuration from ~obstacle_stop, ~obstacle/… and, below ~sonar_hub, the sensor hub's file; ``None`` = off,
    or that file's parameters are not among them, as ``is_complete`` says.

    Raises:
        ConfigError: naming the parameter.
    """
    default, outline = ObstacleConfig(), Outline()
    is_on = params.flag("obstacle_stop", False)
    front_m = params.number("obstacle/front", outline.front_m, above=0.0, high=10.0)
    rear_m = params.number("obstacle/rear", outline.rear_m, low=0.0, high=10.0)
    width_m = params.number("obstacle/width", outline.width_m, above=0.0, high=10.0)
    config = ObstacleConfig(
        mounts={}, outline=Outline(front_m, rear_m, width_m),
        margin_m=params.number("obstacle/margin", default.margin_m, low=0.0, high=10.0),
        actuation_s=params.number("obstacle/actuation_time", default.actuation_s, low=0.0, high=10.0),
        timeout_s=params.number("obstacle/sonar_timeout", default.timeout_s, above=0.0, high=10.0))
    names = [params.text(f"obstacle/sonars/{name}", "used") for name in NAMES]
    for name, use in zip(NAMES, names):
        if use not in ("used", "absent"):
            raise ConfigError(f"obstacle/sonars/{name}", use, "used or absent")
    if not is_on or not is_complete:
        return None
    mounts = {name: _read_mount(params, name) for name, use in zip(NAMES, names) if use == "used"}
    return ObstacleConfig(mounts, params.number(HUB + "field_of_view", default.field_of_view_rad, above=0.0, high=3.0),
                          params.number(HUB + "max_range", default.max_range_m, above=0.0, high=100.0),
                          config.outline, config.margin_m, config.actuation_s, config.timeout_s)


def _read_mount(params, name):
    numbers = params.numbers(f"{HUB}sonars/{name}")
    if len(numbers) != len(Mount._fields):
        raise ConfigError(f"{HUB}sonars/{name}", numbers, "three numbers: x, y in m, and yaw in rad")
    return Mount(*numbers)


class Guarantee(NamedTuple):
    """The deceleration that a stop is certain of."""

    stop_mps2: float
    coasts_below_mps: float  # below this speed it is drag's
    drag_mps2: float


class ObstacleStop:
    """Bounds one car's speed by its sonars."""

    def __init__(self, config: ObstacleConfig):
        self.config = config
        self._ranges = {name: TimedInput(name, config.timeout_s) for name in config.mounts}
        self._arrivals_ns: dict[str, deque] = {name: deque(maxlen=CYCLES + 1) for name in config.mounts}

    def update_range(self, name: str, range_m: float, now_ns: int) -> None:
        """A sonar's range; inf = no echo, −inf = too near, NaN = nonsense."""
        timed = self._ranges.get(name)
        if timed is None:
            return
        timed.update(range_m, now_ns)
        self._arrivals_ns[name].append(now_ns)

    def mark_stale(self) -> None:
        """Messages were dropped before they got here."""
        for timed in self._ranges.values():
            timed.mark_stale()

    def bound(self, curvature_per_m: float, is_backward: bool, guarantee: Guarantee, now_ns: int) -> SpeedBound | None:
        """The speed that the car may have on this arc (1/m, left positive); ``None`` = no sonar looks along it."""
        bounds = [bound for name in self._ranges
                  for bound in [self._bound_of(name, curvature_per_m, is_backward, guarantee, now_ns)] if bound]
        return min(bounds) if bounds else None

    def _bound_of(self, name, curvature_per_m, is_backward, guarantee, now_ns):
        config, timed = self.config, self._ranges[name]
        range_m = timed.value
        is_faulty = timed.is_stale(now_ns) or range_m != range_m
        seen_m = config.max_range_m if is_faulty else max(0.0, min(config.max_range_m, range_m))
        distance_m = cone_distance_m(config.mounts[name], seen_m, config.field_of_view_rad, curvature_per_m,
                                     is_backward, config.outline)
        if distance_m is None:
            return None
        if is_faulty:
            why = timed.stale_reason(now_ns) if timed.is_stale(now_ns) else f"{name} measures {range_m}"
            return SpeedBound(0.0, causes.SONAR_SILENT, f"{why}, and the car doesn't drive blind:")
        time_s = timed.age_s(now_ns) + self._cycle_s(name) + config.actuation_s
        speed_mps = stopping_speed_mps(distance_m - config.margin_m, time_s, guarantee)
        seen = f"{max(0.0, range_m):.2f} m" if range_m < config.max_range_m else f"nothing to {seen_m:g} m"
        return SpeedBound(speed_mps, causes.OBSTACLE_SLOWED, f"{name} sees {seen}, which allows")

    def _cycle_s(self, name):
        arrivals_ns = self._arrivals_ns[name]
        if len(arrivals_ns) < 2:
            return MAX_CYCLE_S
        arrivals = list(arrivals_ns)
        return max(after - before for before, after in zip(arrivals, arrivals[1:])) / NS_PER_S


def stopping_speed_mps(distance_m: float, time_s: float, guarantee: Guarantee) -> float:
    """The speed from which a car stops within a distance, ``time_s`` of it at that speed; 0 without any distance."""
    def speed_mps(way_m, deceleration_mps2):
        return deceleration_mps2 * (math.sqrt(time_s * time_s + 2.0 * way_m / deceleration_mps2) - time_s)

    if distance_m <= 0.0:
        return 0.0
    stop_mps2, coasts_mps, drag_mps2 = guarantee
    coasting_mps = speed_mps(distance_m, drag_mps2)
    # Braking ends at coasts_mps, and drag does the rest: the way that this takes longer is not there for braking.
    way_m = distance_m - coasts_mps * coasts_mps / 2.0 * (1.0 / drag_mps2 - 1.0 / stop_mps2)
    braking_mps = speed_mps(way_m, stop_mps2) if way_m > 0.0 else 0.0
    return max(coasting_mps, braking_mps) if braking_mps >= coasts_mps else coasting_mps


def cone_distance_m(mount: Mount, range_m: float, field_of_view_rad: float, curvature_per_m: float, is_backward: bool,
                    outline: Outline) -> float | None:
    """How far the car can drive along an arc until it touches the nearest of what a sonar may have seen.

    Args:
        mount: the sonar's.
        range_m: what it measured: at this distance, anywhere in its cone.
        field_of_view_rad: the whole cone.
        curvature_per_m: of the arc, left positive.
        is_backward: it drives backward on it.
        outline: the car's.

    Returns:
        Metres of the rear axle's middle; 0 or less: it touches that already. ``None``: it never does.
    """
    nearest_m = None
    for index in range(CONE_POINTS):
        angle_rad = mount.yaw_rad + field_of_view_rad * (index / (CONE_POINTS - 1) - 0.5)
        x_m = mount.x_m + range_m * math.cos(angle_rad)
        y_m = mount.y_m + range_m * math.sin(angle_rad)
        distance_m = point_distance_m(x_m, y_m, curvature_per_m, is_backward, outline)
        if distance_m is not None and (nearest_m is None or distance_m < nearest_m):
            nearest_m = distance_m
    return nearest_m


def point_distance_m(x_m: float, y_m: float, curvature_per_m: float, is_backward: bool, outline: Outline
                     ) -> float | None:
    """The same for one point, in metres ahead of the rear axle's middle and to the left."""
    bumper_m, trailing_m = outline.front_m, outline.rear_m
    if is_backward:  # the same arc, seen from the other end of the car
        x_m, bumper_m, trailing_m = -x_m, trailing_m, bumper_m
    half_m = outline.width_m / 2 + SIDE_MARGIN_M
    if abs(curvature_per_m) < STRAIGHT_PER_M:
        return x_m - bumper_m if abs(y_m) <= half_m and x_m > 0.0 else None
    if curvature_per_m < 0.0:
        y_m = -y_m
    radius_m = 1.0 / abs(curvature_per_m)
    # About the turn's centre, (0, radius): the point's distance from it, and how far round it is.
    across_m = radius_m - y_m
    from_centre_m = math.hypot(x_m, across_m)
    inner_m, outer_m = radius_m - half_m, radius_m + half_m
    corner_m = math.hypot(outer_m, bumper_m)
    if not max(0.0, inner_m) <= from_centre_m <= max(corner_m, math.hypot(outer_m, trailing_m)):
        return None
    round_rad = math.atan2(x_m, across_m)
    # The part of the car that meets it: the bumper; nearer to the centre the inner side; farther from it the outer side
    # of the end that comes behind, such as a front that swings out while the car reverses.
    if from_centre_m > corner_m:
        to_go_rad = round_rad + math.acos(outer_m / from_centre_m)
        return radius_m * to_go_rad if to_go_rad > 0.0 else None
    if round_rad <= 0.0:
        return None  # beside or behind the axle: the car drives away from it
    if inner_m <= 0.0 or from_centre_m >= math.hypot(inner_m, bumper_m):
        part_rad = math.asin(min(1.0, bumper_m / from_centre_m))
    else:
        part_rad = math.acos(min(1.0, inner_m / from_centre_m))
    return radius_m * (round_rad - part_rad)
