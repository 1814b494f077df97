"""What happens whenever a person lets the button of a calibration drive go: the records and the sums of it."""
from __future__ import annotations

from typing import NamedTuple

from accuracy.virtual_drive import NS_PER_S

ROLLS_S, STANDS_MPS = 20.0, 0.02


class Release(NamedTuple):
    """What a car did after the button had been let go for good."""

    at_s: float
    speed_mps: float
    distance_m: float
    extent_m: float  # the farthest that any corner was from the start, in a straight line
    max_m: float  # the same from the middle of the area, along x or y
    hit_mps: float | None  # the speed at which it ran into something
    took_s: float


class Releases:
    """A trace that lets the button go at regular moments while the car is driven, each time in a copy."""

    def __init__(self, every_s: float, radius_m: float):
        self.radius_m = radius_m  # that no corner should leave
        self.found: list[Release] = []
        self._every_ns = round(every_s * NS_PER_S)
        self._next_ns = 0

    def __call__(self, now_ns, bench, step):
        if now_ns >= self._next_ns and step.steering is not None and bench.vehicle.speed_mps > STANDS_MPS:
            self._next_ns = now_ns + self._every_ns
            self.found.append(bench.let_go())

    def text(self) -> str:
        """A line that sums them up."""
        found = self.found
        if not found:
            return "never let go"
        out_m = [one.extent_m - self.radius_m for one in found if one.extent_m > self.radius_m]
        hits_mps = [one.hit_mps for one in found if one.hit_mps is not None]
        return (f"let go {len(found)} times: {len(out_m)} leave {self.radius_m:g} m, "
                f"by {max(out_m, default=0.0):.2f} m at most ({max(one.max_m for one in found):.2f} m along x or y); "
                f"{len(hits_mps)} hit a wall, at {max(hits_mps, default=0.0):.2f} m/s at most; "
                f"rolls {max(one.distance_m for one in found):.2f} m, {max(one.took_s for one in found):.1f} s at most")
