"""Derives a virtual car from a real one's calibration tables: near to them, and not equal on purpose."""

from __future__ import annotations

from typing import Sequence

from car_interface.common.errors import require

LEFT_RATIO, RIGHT_RATIO = 0.97, 1.03  # of the true radii to the tables': a calibration is some percent off
MIN_STEP_DUTY = 1.0  # between the curve's points: tables may end in equal duties


def steering_curve(center: float, radii_m: Sequence[float], left: Sequence[float], right: Sequence[float],
                   ) -> tuple[tuple[float, float], ...]:
    """Return the true steering for these tables: (duty, curvature in 1/m, left positive), duties rising.

    The left side may have the lower or the higher duties.

    Args:
        center: the duty that drives straight on.
        radii_m: of the tables, rising.
        left, right: the duty for each radius to either side; duties that don't come nearer to the center are left out.

    Raises:
        ConfigError: the tables are no pair of sides.
    """
    require(len(radii_m) == len(left) == len(right) and len(radii_m) > 0, "steering tables",
            [len(radii_m), len(left), len(right)], "three of the same length")
    require((left[0] - center) * (right[0] - center) < 0, "steering tables", [left[0], center, right[0]],
            "left and right on different sides of the center")
    sides = (_side(center, radii_m, left, LEFT_RATIO), [(center, 0.0)],
             [(duty, -curvature) for duty, curvature in _side(center, radii_m, right, RIGHT_RATIO)])
    return tuple(sorted(point for side in sides for point in side))


def _side(center, radii_m, duties, ratio):
    """Return the points of one side, from its end to the center."""
    points = []
    for radius_m, duty in zip(radii_m, duties):
        last = points[-1][0] if points else None
        if abs(duty - center) >= MIN_STEP_DUTY and (last is None
                                                    or abs(last - center) - abs(duty - center) >= MIN_STEP_DUTY):
            points.append((float(duty), 1.0 / (ratio * radius_m)))
    return points
