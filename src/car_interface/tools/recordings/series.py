"""The signals of a recording as columns of numbers.

Each class holds arrays of the same length (N,), a row for each sample. ``t_s`` is in seconds since the recording's
first message and never falls.
"""
from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Odom(NamedTuple):
    """Pose and speed of the car, by odometry; all columns have the shape (N,)."""

    t_s: np.ndarray
    x_m: np.ndarray
    y_m: np.ndarray
    yaw_rad: np.ndarray  # unwrapped
    speed_mps: np.ndarray  # forward positive


class Output(NamedTuple):
    """The duties that the servo board outputs, each row until the next one."""

    t_s: np.ndarray  # (N,)
    duties: np.ndarray  # (N, 16), int, a column for each channel; −1 = never set


class Imu(NamedTuple):
    """What an IMU on the car measures; all columns have the shape (N,)."""

    t_s: np.ndarray
    yaw_rate_radps: np.ndarray
    acceleration_mps2: np.ndarray  # forward; includes gravity's part on a slope
    pitch_rad: np.ndarray  # nose down positive; NaN where the message has no orientation


class Value(NamedTuple):
    """A commanded number, each row until the next one; both columns have the shape (N,)."""

    t_s: np.ndarray
    value: np.ndarray


class Ackermann(NamedTuple):
    """What a planner asks for, each row until the next one; all columns have the shape (N,)."""

    t_s: np.ndarray
    angle_rad: np.ndarray  # of a wheel in the middle of the front axle, left positive
    speed_mps: np.ndarray  # of the middle of the rear axle, forward positive


class Pulses(NamedTuple):
    """Encoder pulses of one wheel at the last pulse of each report; both columns have the shape (N,)."""

    t_s: np.ndarray
    count: np.ndarray  # forward pulses less backward pulses
