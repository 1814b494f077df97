"""How a value map is fitted to drives."""
from __future__ import annotations

from dataclasses import dataclass, field

from car_interface.tools.calibration.value_map.acceleration import WindowConfig
from car_interface.tools.calibration.value_map.surface import Roughness

# Rows: a throttle curve's (6·u^1.5 has 9 on the average, over a value axis taken as 1). Columns, per (m/s)²: a motor's
# that has half its thrust at 9 m/s.
ROUGHNESS = Roughness(8.0, 0.15)


@dataclass(frozen=True)
class FitConfig:
    """How a map is fitted, and what supports one.

    Attributes:
        window: how drives are divided into windows.
        neutral: the value at which the actuator neither drives nor brakes; the map may bend there.
        value_timeout_s: a value counts for no longer than this.
        max_pitch_rad: beyond it a window doesn't count.
        roughness: the expected second derivatives of the map.
        min_sigma_mps2: no window's acceleration is known better: floors are uneven, tyres flex.
        support_s, support_manoeuvres, support_sigma_mps2: a node is supported by at least this much driving around
            it, in this many manoeuvres, if its standard error is at most this.
        delay_s: from value to acceleration; ``None`` = estimated.
        from_imu: accelerations are the IMU's; the wheels' only give its bias.
    """

    window: WindowConfig = field(default_factory=WindowConfig)
    neutral: float = 0.0
    value_timeout_s: float = 0.5
    max_pitch_rad: float = 0.15
    roughness: Roughness = ROUGHNESS
    min_sigma_mps2: float = 0.03
    support_s: float = 0.1
    support_manoeuvres: int = 2
    support_sigma_mps2: float = 0.08
    delay_s: float | None = None
    from_imu: bool = False


DEFAULTS = FitConfig()
