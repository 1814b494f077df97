"""A car's steering calibration: the servo's ends and center, and turn radius to servo duty by tables.

A turn radius is in metres; a duty is 0..65535 of the PWM period.
"""
from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Sequence

from car_interface.common.errors import ConfigError
from car_interface.common.servo_channels import MAX_DUTY
from car_interface.interlock.motion_interlock import InterlockConfig

WIDE_M = 100.0  # a table that ends before it has no duty for almost straight on
TABLE_DIGITS = 1  # of a duty in a table that was moved: finer than anything that a servo follows


@dataclass(frozen=True)
class SteeringConfig:
    """A car's steering calibration, and how long each input may be silent.

    Attributes:
        servo_left, servo_center, servo_right: duty 0..65535 at full left, straight ahead and full right; the center
            lies between the other two (either may be the larger).
        servo_channel: 0..15.
        radius_axis_m: magnitudes of turn radius in metres, positive, increasing.
        left_duties, right_duties: the duty that turns that tight, one for each radius.
        tele_steer_neutral: the request that means "not steering" (0.5 for an old 0..1 stack).
        tele_steer_deadband: requests this near to it mean the same.
        slew_limit: how fast gamepad and planner may move the servo, in duty per second; 0 = as fast as it can.
        interlock: the rules of lock and deadman.
        teleop_timeout_s, planner_timeout_s: silence longer than this is a loss; 0 = never.

    Raises:
        ConfigError: naming the ROS parameter.
    """

    servo_left: int
    servo_center: int
    servo_right: int
    servo_channel: int
    radius_axis_m: Sequence[float]
    left_duties: Sequence[float]
    right_duties: Sequence[float]
    tele_steer_neutral: float = 0.0
    tele_steer_deadband: float = 0.001
    slew_limit: float = 0.0
    interlock: InterlockConfig = field(default_factory=InterlockConfig)
    teleop_timeout_s: float = 0.5
    planner_timeout_s: float = 0.5

    def __post_init__(self):
        if not min(self.servo_left, self.servo_right) <= self.servo_center <= max(self.servo_left, self.servo_right):
            raise ConfigError("servo_center", self.servo_center,
                              f"a duty between servo_left {self.servo_left} and servo_right {self.servo_right}")
        if self.servo_left == self.servo_right:
            raise ConfigError("servo_right", self.servo_right, "a duty other than servo_left's")
        if self.radius_axis_m and self.radius_axis_m[0] <= 0:
            raise ConfigError("m_turnrad_axis_servo[0]", self.radius_axis_m[0], "a radius above 0 m")


def trimmed(config: SteeringConfig, servo_left: int, servo_center: int, servo_right: int) -> SteeringConfig:
    """A calibration with other ends and another center; the tables of both sides move along.

    Every duty keeps its share of the way from the center to the end of its side: what drove straight on is the new
    center, what was full left is the new full left. All three moved alike move every duty alike.

    Raises:
        ConfigError: naming the parameter: the center must stay between the ends, and these must stay on their sides.
    """
    before = (config.servo_left, config.servo_center, config.servo_right)
    after = (servo_left, servo_center, servo_right)
    if before != after and config.servo_center in (config.servo_left, config.servo_right):
        raise ConfigError("servo_center", config.servo_center, "a duty between servo_left and servo_right, in the file "
                          "already: from one of them on nothing can be tuned", "is an end at start")
    if (servo_left < servo_right) != (config.servo_left < config.servo_right):
        raise ConfigError("servo_left", servo_left, f"a duty on the same side of servo_right {servo_right} as before")
    if before == after:
        return config
    if servo_center in (servo_left, servo_right):  # a side without a way has no shares, and couldn't be tuned back
        raise ConfigError("servo_center", servo_center,
                          f"a duty between servo_left {servo_left} and servo_right {servo_right}, and neither of them")

    def moved(duty):
        end = 0 if (duty - before[1]) * (before[0] - before[1]) > 0 else 2
        old_travel, new_travel = before[end] - before[1], after[end] - after[1]
        wanted = after[1] + (duty - before[1]) * new_travel / old_travel
        return max(0.0, min(float(MAX_DUTY), round(wanted, TABLE_DIGITS)))

    return replace(config, servo_left=servo_left, servo_center=servo_center, servo_right=servo_right,
                   left_duties=[moved(duty) for duty in config.left_duties],
                   right_duties=[moved(duty) for duty in config.right_duties])
