"""How fast a car that is pushed blindly drives where there is nothing, by its arc."""
from __future__ import annotations

import json
from itertools import product
from pathlib import Path

from .car import CarConfig
from .drive import run
from .fan import bound_mps
from .room import Pose, Room
from .scene import ESCS, Driver, Scene

BASELINE = Path(__file__).resolve().parents[1] / "data" / "obstacle_stop_speeds.json"
CURVATURES_PER_M = (0.0, 0.1, 0.2, 0.3, 0.45, 0.6, 0.8, 1.0)
SETTLED_S = 5.0
WIDE_PER_M = 0.3  # up to here the speeds of the baseline are kept; tighter arcs go by the fan
WIDE_SHARE, TIGHT_SHARE = 0.95, 0.80
# Their recorded 2.67 m/s, of the 1.44 that docs/limits.md had, counted on a brake that a pause takes away: on level
# ground such cars then coasted into a wall in plain view. They are held to the speed of an unverified ESC.
COUNTED_ON_A_LAPSED_BRAKE = {f"{kind}, 4 m, mostly ahead, 0 1/m": "unverified, 4 m, mostly ahead, 0 1/m"
                             for kind in ("not measured", "crawler")}
# Cars that count on drag alone: on arcs their recorded speeds counted on level ground at headings where that was never
# measured, and on slopes of 5 % such cars ran into what they had seen. This is what rolling in neutral leaves them.
ROLLS_FROM_PER_M, ROLLS_SHARE = 0.2, 0.88
CAR = CarConfig(becomes_reverse=False, hold_s=0.2, dwell_s=0.2, dead_band=0.05, drag_brake=0.0, motor_lag_s=0.05,
                push_mps2=4.0, top_mps=8.0, brake_mps2=4.0, drag_mps2=0.4, breakaway_mps2=0.5, slope=0.0,
                uphill_rad=0.0, steering_lag_s=0.05, grip_mps2=7.0)


def scenes() -> dict[str, Scene]:
    """Each kind of ESC, range and sequence on each arc, by a name."""
    named = {}
    for kind, range_m, is_ahead, curvature in product(ESCS, (2.0, 4.0), (False, True), CURVATURES_PER_M):
        car = CAR._replace(becomes_reverse=kind == "crawler")
        driver = Driver("planner", 1.5, False, False, "arc", curvature, 5.0)
        name = f"{kind}, {range_m:g} m, {'mostly ahead' if is_ahead else 'all in turn'}, {curvature:g} 1/m"
        named[name] = Scene(0, Room(()), Pose(0.0, 0.0, 0.0), car, kind, driver, range_m, is_ahead, firing_s=0.065,
                            dropouts=0.0, noise_m=0.0, odometry_late_s=0.0)
    return named


def mean_mps(scene: Scene) -> float:
    """The mean speed of a drive once it has settled."""
    speeds = [sample.speed_mps for sample in run(scene).samples if sample.at_s >= SETTLED_S]
    return sum(speeds) / len(speeds) if speeds else 0.0


def wanted_mps(name: str, scene: Scene, baseline: dict[str, float]) -> float:
    if scene.driver.curvature_per_m <= WIDE_PER_M:
        rolls = scene.kind != "measured" and scene.driver.curvature_per_m >= ROLLS_FROM_PER_M
        return (ROLLS_SHARE if rolls else WIDE_SHARE) * baseline[COUNTED_ON_A_LAPSED_BRAKE.get(name, name)]
    return TIGHT_SHARE * bound_mps(scene)


def read_baseline() -> dict[str, float]:
    return json.loads(BASELINE.read_text(encoding="utf-8"))


def write_baseline(speeds: dict[str, float]) -> None:
    """Keep today's speeds on the wider arcs, where they are kept."""
    named = scenes()
    kept = {name: round(speed, 3) for name, speed in speeds.items()
            if named[name].driver.curvature_per_m <= WIDE_PER_M}
    BASELINE.write_text(json.dumps(kept, indent=0) + "\n", encoding="utf-8")
