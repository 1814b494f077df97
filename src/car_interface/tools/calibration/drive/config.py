"""Settings of the calibration drive."""
from __future__ import annotations

from dataclasses import dataclass, field

from car_interface.common.errors import ConfigError
from car_interface.throttle.obstacle_stop import ObstacleConfig, Outline


@dataclass(frozen=True)
class DriveConfig:
    """Where and how the car drives; the names are those of the ROS parameters.

    Attributes:
        radius_m: no part of the car leaves a circle of this radius around the start: 3 m is an area of 6 × 6 m.
        speed_mps: in wide turns; tight ones are slower.
        tight_speed_mps: in the tightest turns.
        max_time_s: of driving, that is of the held button; then it ends with what there is.
        braking_mps2: the deceleration that a stop is certain of, such as the drag's, less a slope's 0.2 m/s² for each
            2 %, where the kind of ESC isn't known. Where it is seen to stop with less, that counts, and with more once
            two stops or more without a brake have shown it.
        outline: of the car from above.
        obstacles: the sonars, as throttle_arb takes them; ``None`` = none is looked at.

    Raises:
        ConfigError: naming the parameter.
    """

    radius_m: float = 3.0
    speed_mps: float = 1.2
    tight_speed_mps: float = 0.9
    max_time_s: float = 300.0
    braking_mps2: float = 0.15
    outline: Outline = field(default_factory=Outline)
    obstacles: ObstacleConfig | None = None

    def __post_init__(self):
        for name, low, high in (("radius_m", 2.5, 100.0), ("speed_mps", 0.4, 3.0), ("tight_speed_mps", 0.4, 3.0),
                                ("max_time_s", 30.0, 3600.0), ("braking_mps2", 0.1, 10.0)):
            value = getattr(self, name)
            if not low <= value <= high:
                raise ConfigError(name.rsplit("_", 1)[0], value, f"a number from {low:g} to {high:g}")


DEFAULTS = DriveConfig()
