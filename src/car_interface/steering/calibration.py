"""Convert a steering request or a turn radius to a servo duty, and back: a car's steering calibration.

Steering −1 is full right and +1 full left; a turn radius is in metres, right negative; a duty is 0..65535 of the PWM
period.
"""
from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from itertools import takewhile
from typing import Any, Sequence

from car_interface.common import declared
from car_interface.common.declared import REQUIRED
from car_interface.common.errors import require
from car_interface.common.lookup_table import LookupTable, round_half_away
from car_interface.common.units import MAX_DUTY

WIDE_M = 100.0  # a table should reach this radius, or it lacks the duties for almost straight ahead
# At this lateral acceleration the linear and the cubic term of understeer are equal. From 3 to 3.5 m/s² a real car's
# left-hand circles are predicted to 1.1 % from slower ones (2.75: 1.7 %, 4: 1.9 %, root mean square); its right-hand
# ones, and those with noise in the commands, want a larger one: docs/accuracy.md, "Understeer".
UNDERSTEER_MPS2 = 3.5
TABLE_DIGITS = 1  # decimals of a duty in a trimmed table; a servo resolves less


@dataclass(frozen=True)
class SteeringCalibration:
    """The servo's end positions and center, and tables of turn radius to duty, as driven slowly.

    The center lies between the ends, either of which may be the larger. ``understeer`` is by how much turns widen with
    speed: see ``lost_per_m``.

    Raises:
        ConfigError: naming the parameter.
    """

    servo_left: int = declared.duty("servo_left", REQUIRED, "full left", search_parents=True)
    servo_center: int = declared.duty("servo_center", REQUIRED, "straight on", search_parents=True)
    servo_right: int = declared.duty("servo_right", REQUIRED, "full right", search_parents=True)
    servo_channel: int = declared.channel("servo_channel", REQUIRED, "channel of the servo board", search_parents=True)
    radius_axis_m: Sequence[float] = declared.numbers(
        "m_turnrad_axis_servo", REQUIRED, "turn radii of the two tables, rising", "m", low=0.001, high=1_000_000,
        search_parents=True)
    left_duties: Sequence[float] = declared.duties(
        "k_pwmcmd_left_table_servo", REQUIRED, "the duty for each radius, to each side", search_parents=True)
    right_duties: Sequence[float] = declared.duties(
        "k_pwmcmd_right_table_servo", REQUIRED, "the duty for each radius, to each side", search_parents=True)
    understeer: float = declared.number(
        "understeer", 0.0, "by how much [turns widen with speed](limits.md#turns-that-widen-with-speed)",
        "1/m for each (m/s²)²", low=0, high=1)
    _left: LookupTable = field(init=False, repr=False, compare=False)
    _right: LookupTable = field(init=False, repr=False, compare=False)

    def __post_init__(self):
        require(min(self.servo_left, self.servo_right) <= self.servo_center <= max(self.servo_left, self.servo_right),
                "servo_center", self.servo_center,
                f"a duty between servo_left {self.servo_left} and servo_right {self.servo_right}")
        require(self.servo_left != self.servo_right, "servo_right", self.servo_right, "a duty other than servo_left's")
        for name, duties, parameter in (("_left", self.left_duties, "k_pwmcmd_left_table_servo"),
                                        ("_right", self.right_duties, "k_pwmcmd_right_table_servo")):
            object.__setattr__(self, name, LookupTable(self.radius_axis_m, duties, "m_turnrad_axis_servo", parameter))

    def teleop_duty(self, steering: float) -> int:
        """Return the duty for a gamepad request, clamped to −1..1; linear from the center to the end of each side."""
        steering = max(-1.0, min(1.0, steering))
        travel = self.servo_center - self.servo_left if steering > 0 else self.servo_right - self.servo_center
        return round_half_away(self.servo_center - steering * travel)

    def planner_duty(self, radius_m: float, speed_mps: float = 0.0) -> int:
        """Return the duty for a turn radius at a speed.

        It is looked up by magnitude and saturated beyond the axis; the sign selects the table; ±inf = straight on.
        """
        if math.isinf(radius_m):
            return self.servo_center
        table = self._left if radius_m > 0 else self._right
        return round_half_away(table(slow_radius_m(abs(radius_m), speed_mps, self.understeer)))

    def tightest_radius_m(self, side: float, speed_mps: float = 0.0) -> float:
        """Return the radius of the tightest turn to a side (positive = left) at a speed; it is positive.

        Where several radii have the duty of the tightest one, the wheels are at their stop: the widest is taken.
        """
        return driven_radius_m(_tightest_m(self._left if side > 0 else self._right), speed_mps, self.understeer)

    def turn_radius_m(self, duty: float, speed_mps: float = 0.0) -> float:
        """Return the turn radius of a duty at a speed, right negative; inf = straight ahead, or wider than the axis."""
        radius_m = self._slow_radius_m(duty)
        return math.copysign(driven_radius_m(abs(radius_m), speed_mps, self.understeer), radius_m)

    def _slow_radius_m(self, duty):
        """Return the turn radius of a duty by the tables."""
        is_left = (duty - self.servo_center) * (self.servo_left - self.servo_center) > 0
        table, sign = (self._left, 1) if is_left else (self._right, -1)
        direction = 1 if table.values[0] > self.servo_center else -1  # of duty, from the center to the tightest turn
        if direction * (duty - self.servo_center) <= 0:
            return math.inf
        if direction * (duty - table.values[0]) >= 0:
            return sign * _tightest_m(table)
        for radius, wider, tight, wide in zip(table.axis, table.axis[1:], table.values, table.values[1:]):
            if direction * (duty - wide) >= 0:
                return sign * (radius + (wider - radius) * (tight - duty) / (tight - wide))
        return math.inf


def _tightest_m(table):
    """Return the widest radius that has the same duty as the tightest one, as sent."""
    duty = round_half_away(table.values[0])
    return max(radius_m for radius_m, _ in takewhile(lambda pair: round_half_away(pair[1]) == duty,
                                                     zip(table.axis, table.values)))


def lost_per_m(curvature_per_m: Any, speed_mps: Any, understeer: float) -> Any:
    """Return the curvature that a path of ``curvature_per_m`` has lost by its speed; numbers or arrays, left positive.

    Odd in the lateral acceleration a, as tyres are: a linear term, the understeer gradient, and a cubic one, by which
    sliding begins: understeer · (a A + a³ / A) / 2, A being UNDERSTEER_MPS2, where that is understeer · a².
    """
    lateral_mps2 = curvature_per_m * speed_mps ** 2
    return understeer * lateral_mps2 * (UNDERSTEER_MPS2 + lateral_mps2 ** 2 / UNDERSTEER_MPS2) / 2


def slow_radius_m(radius_m: float, speed_mps: float, understeer: float) -> float:
    """Return the radius to steer by, so that the car turns on ``radius_m`` (positive) at this speed."""
    loss = lost_per_m(1.0 / radius_m, speed_mps, understeer)
    return radius_m / (1.0 + radius_m * loss) if loss else radius_m


def driven_radius_m(slow_m: float, speed_mps: float, understeer: float) -> float:
    """Return the radius on which a car steered by ``slow_m`` (positive) turns at this speed: the inverse."""
    linear = 1.0 + understeer * UNDERSTEER_MPS2 * speed_mps ** 2 / 2
    cubic = understeer * speed_mps ** 6 / UNDERSTEER_MPS2 / 2
    if cubic < 1e-12 or slow_m == math.inf:  # at a crawl, where its root can't be computed, or straight on
        return slow_m * linear
    # cubic κ³ + linear κ = 1 / slow_m: its only real root.
    scale_per_m = 2 * math.sqrt(linear / cubic / 3)
    return 1 / (scale_per_m * math.sinh(math.asinh(3 / (linear * slow_m * scale_per_m)) / 3))


def trimmed(calibration: SteeringCalibration, servo_left: int, servo_center: int,
            servo_right: int) -> SteeringCalibration:
    """Return a calibration with other ends and another center; both tables are scaled with them.

    Every duty keeps its ratio between the center and the end of its side: the duty for straight ahead becomes the new
    center, the one for full left the new full left. A shift of all three shifts every duty.

    Raises:
        ConfigError: naming the parameter: the center must stay between the ends, and these must stay on their sides.
    """
    before = (calibration.servo_left, calibration.servo_center, calibration.servo_right)
    after = (servo_left, servo_center, servo_right)
    if before == after:
        return calibration
    require(calibration.servo_center not in (calibration.servo_left, calibration.servo_right),
            "servo_center", calibration.servo_center, "a duty between servo_left and servo_right, in the file already: "
            "from one of them on nothing can be tuned", "is an end at start")
    require((servo_left < servo_right) == (calibration.servo_left < calibration.servo_right),
            "servo_left", servo_left, f"a duty on the same side of servo_right {servo_right} as before")
    # With a travel of 0 the ratios are lost: it couldn't be tuned back.
    require(servo_center not in (servo_left, servo_right), "servo_center", servo_center,
            f"a duty between servo_left {servo_left} and servo_right {servo_right}, and neither of them")

    def scaled(duty):
        end = 0 if (duty - before[1]) * (before[0] - before[1]) > 0 else 2
        old_travel, new_travel = before[end] - before[1], after[end] - after[1]
        wanted = after[1] + (duty - before[1]) * new_travel / old_travel
        return max(0.0, min(float(MAX_DUTY), round(wanted, TABLE_DIGITS)))

    return replace(calibration, servo_left=servo_left, servo_center=servo_center, servo_right=servo_right,
                   left_duties=[scaled(duty) for duty in calibration.left_duties],
                   right_duties=[scaled(duty) for duty in calibration.right_duties])
