"""Return the speed from which the car can stop within the space that its sonars look at, on the arc that it drives.

``ObstacleStop`` takes ranges, each with its arrival, and the car's motion. ``bound`` takes an arc and the deceleration
that a stop is certain of, and returns a ``SpeedBound``. With d metres to go, t seconds until a new range takes effect,
and the deceleration a, the car stops in time if v t + v² / 2a ≤ d − margin, which is

    v ≤ a (−t + √(t² + 2 (d − margin) / a)).

The distance ends in two ways:

* An echo may come from anywhere in its cone at that range. The place counts that the car's body reaches first. It stays
  where it is while the car moves, even outside of the cone (``echo_memory``); so t is a cycle of the sonar plus the
  actuation time.
* The unknown begins where the middle of the bumper leaves the fan of the cones (``sonar_fan``). The same formula holds,
  but t includes the range's age, and a creep is always allowed, to look farther.

A sonar that is stale or measures NaN allows no speed into its part of the fan. Nothing here sees what no cone reaches:
above, below, from the side, and the strips between the cones. Pure: ``now_ns`` is passed in.
"""
from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field, replace
from typing import Mapping, Sequence

from car_interface.common import causes, declared
from car_interface.common.errors import require
from car_interface.common.staleness import TimedInput
from car_interface.common.vehicle_geometry import SONARS
from car_interface.throttle.echo_memory import EchoMemory
from car_interface.throttle.limits import SpeedBound
from car_interface.throttle.sonar_fan import Arc, Fan, Mount, Outline, cone_points

USED = "used"
HUB = "sonar_hub/"  # where the launch files put the sensor hub's sonars.yaml, below this node's name
SIDE_MARGIN_M = 0.05  # what the car would pass at a smaller distance is in its way
MIN_STOP_MPS2 = 0.02  # a stop with less isn't certain
MAX_CYCLE_S = 0.43  # of six sonars in turn, all of which wait for an echo in vain
CYCLES = 3  # the longest of the last three cycles counts


@dataclass(frozen=True)
class ObstacleConfig:
    """Configure the sonars and the car.

    Attributes:
        mounts: of the sonars that are used, by name.
        field_of_view_rad: the full angle of each cone.
        max_range_m: the sonars measure no farther.
    """

    mounts: Mapping[str, Mount] = field(default_factory=dict)
    field_of_view_rad: float = 0.5236
    max_range_m: float = 2.0
    outline: Outline = declared.group(Outline(), "obstacle/")
    margin_m: float = declared.number(
        "obstacle/margin", 0.1, "what is left between the car and what it stops for", "m", low=0.0, high=10.0)
    # Of the 0.1 s a far echo takes 38 ms.
    actuation_s: float = declared.number(
        "obstacle/actuation_time", 0.1, "from a range's arrival to the ESC's new pulse", "s", low=0.0, high=10.0)
    timeout_s: float = declared.number(
        "obstacle/sonar_timeout", 1.0, "age at which a sonar is silent", "s", above=0.0, high=10.0)
    creep_mps: float = declared.number(
        "obstacle/creep", 0.3, "the speed that is left into what no sonar looks at; never towards an echo", "m/s",
        low=0.0, high=1.0)
    is_on: bool = declared.flag(
        "obstacle_stop", False, "true = [no faster than the car can stop within what the sonars look "
                                "at](limits.md#obstacle_stop); then it needs `sonars.yaml` below `sonar_hub`, where "
                                "the launch files put it")
    uses: Sequence[str] = declared.choice(
        "obstacle/sonars/", (USED,) * len(SONARS), "a sonar that the car doesn't have is absent", family=SONARS,
        choices=(USED, "absent"))

    def completed(self, params) -> ObstacleConfig | None:
        """Return the same with the sonars from the sensor hub's file, below ~sonar_hub; ``None`` = off.

        Raises:
            ConfigError: naming the parameter.
        """
        if not self.is_on:
            return None
        return replace(
            self, mounts={name: _read_mount(params, name) for name, use in zip(SONARS, self.uses) if use == USED},
            field_of_view_rad=params.number(HUB + "field_of_view", self.field_of_view_rad, above=0.0, high=3.0),
            max_range_m=params.number(HUB + "max_range", self.max_range_m, above=0.0, high=100.0))


def _read_mount(params, name):
    numbers = params.numbers(f"{HUB}sonars/{name}")
    require(len(numbers) == len(Mount._fields), f"{HUB}sonars/{name}", numbers,
            "three numbers: x, y in m, and yaw in rad")
    return Mount(*numbers)


class ObstacleStop:
    """Bound one car's speed by its sonars."""

    def __init__(self, config: ObstacleConfig):
        self.config = config
        self._ranges = {name: TimedInput(name, config.timeout_s) for name in config.mounts}
        self._cycles_s: dict[str, deque] = {name: deque(maxlen=CYCLES) for name in config.mounts}
        self._reaches_m = dict.fromkeys(config.mounts, config.max_range_m)
        self._echoes = EchoMemory(config.mounts, config.field_of_view_rad, config.outline, SIDE_MARGIN_M)
        self._fans = {is_backward: Fan(config.mounts, config.field_of_view_rad, config.outline, is_backward)
                      for is_backward in (False, True)}

    def update_range(self, name: str, range_m: float, now_ns: int) -> None:
        """Take a sonar's range in m; inf = no echo, −inf = too near, NaN = a fault."""
        timed = self._ranges.get(name)
        if timed is None:
            return
        if timed.was_received:
            self._cycles_s[name].append(timed.silence_s(now_ns))
        timed.update(range_m, now_ns)
        if range_m == range_m:
            self._reaches_m[name] = max(0.0, min(self.config.max_range_m, range_m))
            self._echoes.look(name, self._reaches_m[name], range_m < self.config.max_range_m)

    def update_motion(self, speed_mps: float, curvature_per_m: float, now_ns: int) -> None:
        """Take the speed (backward negative) and arc (1/m, left positive) of the car since the last call.

        Before the first call no echo is moved; then each counts where it was measured, with its age.
        """
        self._echoes.move(speed_mps, curvature_per_m, now_ns)

    def mark_stale(self) -> None:
        """Treat all ranges as stale, since messages were dropped on their way here."""
        for timed in self._ranges.values():
            timed.mark_stale()

    def bound(self, curvature_per_m: float, is_backward: bool, stop_mps2: float, now_ns: int,
              late_s: float = 0.0, counts_sides: bool = True) -> SpeedBound | None:
        """Return the speed that the car may have on an arc; ``None`` = any, which only ``counts_sides=False`` allows.

        Args:
            curvature_per_m: of the arc, left positive.
            stop_mps2: the deceleration that is certain if the car stops.
            late_s: additional time at that speed towards an echo: odometry's age, and the motor's lag.
            counts_sides: the unknown begins at the fan's sides, too. False for a caller that knows the room there.
        """
        end = self._fans[is_backward].end(curvature_per_m, self._reaches_m)
        silent = self._silent(end, curvature_per_m, is_backward, now_ns)
        if silent is not None:
            return silent
        bound = self._bound_of_unknown(end, stop_mps2, now_ns) if counts_sides or not end.is_edge else None
        for name, met in self._echoes.meets(curvature_per_m, is_backward).items():
            age_s = 0.0 if self._echoes.are_moved else self._ranges[name].age_s(now_ns)
            time_s = age_s + self._cycle_s(name) + self.config.actuation_s + late_s
            speed_mps = stopping_speed_mps(met.distance_m - self.config.margin_m, time_s, stop_mps2)
            if bound is None or speed_mps < bound.speed_mps:
                bound = SpeedBound(speed_mps, causes.OBSTACLE_SLOWED, self._echo_words(name, met))
        return bound

    def _bound_of_unknown(self, end, stop_mps2, now_ns):
        config = self.config
        if not end.sonar:
            return SpeedBound(config.creep_mps, causes.OBSTACLE_SLOWED, "no sonar looks along this arc, which allows")
        time_s = max(self._ranges[end.sonar].age_s(now_ns), self._cycle_s(end.sonar)) + config.actuation_s
        speed_mps = stopping_speed_mps(end.distance_m - config.margin_m, time_s, stop_mps2)
        words = (f"no sonar looks beyond {end.distance_m:.2f} m of this arc, which allows" if end.is_edge
                 else f"{end.sonar} sees nothing to {config.max_range_m:g} m, which allows")
        return SpeedBound(max(config.creep_mps, speed_mps), causes.OBSTACLE_SLOWED, words)

    def _cycle_s(self, name):
        return max(self._cycles_s[name], default=MAX_CYCLE_S)

    def _echo_words(self, name, met):
        if met.is_current:
            return f"{name} sees {self._reaches_m[name]:.2f} m, which allows"
        return f"{name} saw something, {max(0.0, met.distance_m):.2f} m from here on this arc, which allows"

    def _silent(self, end, curvature_per_m, is_backward, now_ns):
        """Return a bound of 0 if the arc leads through a faulty sonar's part of the fan or touches its cone's end."""
        for name, timed in self._ranges.items():
            is_stale = timed.is_stale(now_ns)
            if not is_stale and timed.value == timed.value:
                continue
            mount = self.config.mounts[name]
            if mount.looks_back != is_backward or not (name in end.sonars or self._touches_cone(
                    mount, curvature_per_m, is_backward)):
                continue
            why = timed.stale_reason(now_ns) if is_stale else f"{name} measures {timed.value}"
            return SpeedBound(0.0, causes.SONAR_SILENT, f"{why}, and the car doesn't drive blind:")
        return None

    def _touches_cone(self, mount, curvature_per_m, is_backward):
        config = self.config
        arc = Arc(curvature_per_m, is_backward, config.outline, SIDE_MARGIN_M)
        return any(arc.distance_m(x_m, y_m) is not None
                   for x_m, y_m in cone_points(mount, config.max_range_m, config.field_of_view_rad))


def stopping_speed_mps(distance_m: float, time_s: float, stop_mps2: float) -> float:
    """Return the speed from which a car stops within a distance, after ``time_s`` at that speed; 0 without room."""
    if distance_m <= 0.0 or stop_mps2 < MIN_STOP_MPS2:
        return 0.0
    return stop_mps2 * (math.sqrt(time_s * time_s + 2.0 * distance_m / stop_mps2) - time_s)
