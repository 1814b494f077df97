"""Collects the messages of one topic as columns of numbers.

Columns grow as bytes, not as Python's numbers, so that a recording of 10 GB fits into memory. Each class of columns
holds arrays of the same length (N,), a row for each sample; its ``t_s`` is in seconds since the recording's first
message and never falls.
"""
from __future__ import annotations

import math
from array import array
from typing import Any, NamedTuple

import numpy as np

from car_interface.common.units import CHANNELS, MAX_DUTY, NS_PER_S, UNCHANGED, stamp_ns, yaw_rad
from car_interface.pca9685.registers import counts_of_duty, duty_of_counts

STEP_BACK_S = 1.0  # the recorder's own time goes back by more only when the computer's clock was set
BREAK_S = 10.0  # from what was recorded before such a step to what was recorded after it
MIN_GRAVITY_MPS2 = 5.0  # less on the average: something has taken it off already
UPRIGHT = 0.8  # the cosine of the largest tilt of an upright IMU
MAX_STAMP_OFFSET_S = 2.0  # a stamp farther from when its message was recorded is wrong
# An odometry whose twist is always 0 has none if its pose moves by more than motion capture's noise.
MIN_MOVED_M, POSE_WINDOW_S = 0.1, 0.1  # in a circle of 1 m at 2.5 m/s the window's chord is 0.3 % short
POSE_ONLY = "its twist is 0 throughout while its pose moves: speed and turn rate are taken from the pose"
REPEATED_S = 0.5  # how often an output that doesn't change is kept
MAX_NUMBER = 1e9  # in m, m/s, rad or m/s²: no car's, and the sums of its squares would overflow
DUTY_CYCLE, VOLTAGE = ("duty_cycle", "duty_cycle_now"), ("voltage_input", "INPUT_VOLTAGE")  # see vesc_number
STAMP_BACK, ODD_STAMP, NOT_FINITE, WRONG_LENGTH = (
    "with a stamp that doesn't rise: left out",
    "with a stamp seconds away from when it was recorded: recording time taken",
    "with a number that is none: left out", "that don't have 16 duties: left out")


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
    """A commanded number, or a planner's angle, each row until the next one; both columns have the shape (N,)."""

    t_s: np.ndarray
    value: np.ndarray


class Pulses(NamedTuple):
    """Encoder pulses of one wheel at the last pulse of each report; both columns have the shape (N,)."""

    t_s: np.ndarray
    count: np.ndarray  # forward pulses less backward pulses


class Timeline:
    """Converts ROS time to seconds since the first message.

    Where the clock was set back, all that follows is moved behind what was recorded before.
    """

    def __init__(self):
        self.start_ns: int | None = None  # ROS time of the first message; None = there is none
        self.last_s = 0.0  # of the newest message
        self._shift_s = 0.0
        self.notes: list[str] = []  # a line for each time that the clock was set back

    def recorded_s(self, time_ns: int) -> float:
        """Return the time at which a message was recorded; called once for each message, in order."""
        if self.start_ns is None:
            self.start_ns = time_ns
        now_s = (time_ns - self.start_ns) / NS_PER_S + self._shift_s
        if now_s < self.last_s - STEP_BACK_S:
            back_s = self.last_s - now_s
            self.notes.append(f"the computer's clock was set back by {back_s:.1f} s, {self.last_s:.1f} s after the "
                              "start: what follows counts as another drive")
            self._shift_s += back_s + BREAK_S
            now_s = self.last_s + BREAK_S
        self.last_s = max(self.last_s, now_s)
        return now_s

    def stamped_s(self, time_ns: int) -> float:
        """Return the time of a stamp in the newest message."""
        return (time_ns - self.start_ns) / NS_PER_S + self._shift_s


class Gravity:
    """The mean of an IMU's accelerations: on a drive all but gravity cancels out."""

    def __init__(self):
        self._count = 0
        self._sum_mps2 = [0.0, 0.0, 0.0]

    def add(self, *axes: float) -> None:
        """Add the linear acceleration of a sensor_msgs/Imu along x, y and z."""
        if all(map(math.isfinite, axes)):
            self._count += 1
            self._sum_mps2 = [before + now for before, now in zip(self._sum_mps2, axes)]

    def note(self, topic: str) -> str:
        """Return what is wrong with the mounting of the IMU on a topic; empty: nothing, or it isn't known."""
        mean_mps2 = [total / max(self._count, 1) for total in self._sum_mps2]
        size_mps2 = math.sqrt(sum(mean**2 for mean in mean_mps2))
        if size_mps2 < MIN_GRAVITY_MPS2 or abs(mean_mps2[2]) >= UPRIGHT * size_mps2:
            return ""
        axis = max(range(3), key=lambda index: abs(mean_mps2[index]))
        return (f"{topic}: gravity lies along its {'xyz'[axis]} axis, not along z: it is mounted on its side, and its "
                "turn rate about z isn't the car's")


class StampedColumn:
    """The messages of one topic that count by their stamps; one that is seconds away from the recording time gives way
    to that.

    ``row(message)`` returns its numbers, of which the last ``optional`` may be anything; ``series(times, *columns)``
    returns the columns, and lines on what is odd about them.
    """

    optional = 0

    def __init__(self, topic: str):
        self.topic = topic
        self._rows, self._width = array("d"), 0

    def add(self, recorded: Any, now_s: float, timeline: Timeline) -> None:
        """Add a ``recording.Recorded`` that was recorded at ``now_s``."""
        numbers, message_ns = self.row(recorded.message), message_stamp_ns(recorded.message)
        self._rows.extend((now_s, timeline.stamped_s(message_ns) if message_ns else now_s, *numbers))
        self._width = 2 + len(numbers)

    def build(self) -> tuple[Any, list[str]]:
        """Return the columns, ``None`` = without a message that can be used, and lines on what is odd or left out."""
        if not self._width:
            return None, []
        rows = np.frombuffer(self._rows).reshape(-1, self._width)
        is_number = (np.abs(rows[:, 2:self._width - self.optional]) <= MAX_NUMBER).all(axis=1)
        recorded_s, at_s, *columns = rows[is_number].T
        is_odd = np.abs(at_s - recorded_s) > MAX_STAMP_OFFSET_S
        at_s = np.where(is_odd, recorded_s, at_s)
        rises = at_s > np.maximum.accumulate(np.r_[-np.inf, at_s])[:-1]
        notes = _odd_messages(self.topic, {
            NOT_FINITE: len(rows) - is_number.sum(), ODD_STAMP: is_odd.sum(), STAMP_BACK: (~rises).sum()})
        if not rises.any():
            return None, notes
        series, odd = self.series(at_s[rises], *(column[rises] for column in columns))
        return series, [*notes, *odd]

    def series(self, *columns):
        return Value(*columns), []


class OdomColumn(StampedColumn):
    """nav_msgs/Odometry."""

    def row(self, message):
        pose = message.pose.pose
        return (pose.position.x, pose.position.y, yaw_rad(pose.orientation), message.twist.twist.linear.x,
                has_twist(message))

    def series(self, t_s, x_m, y_m, yaw_rad, speed_mps, is_moving):
        odom = Odom(t_s, x_m, y_m, np.unwrap(yaw_rad), speed_mps)
        if is_moving.any() or math.hypot(np.ptp(x_m), np.ptp(y_m)) <= MIN_MOVED_M:
            return odom, []
        return odom._replace(speed_mps=_pose_speed_mps(odom)), [f"{self.topic}: {POSE_ONLY}"]


class ImuColumn(StampedColumn):
    """sensor_msgs/Imu."""

    optional = 3

    def row(self, message):
        acceleration = message.linear_acceleration
        return (message.angular_velocity.z, acceleration.x, acceleration.y, acceleration.z, _pitch_rad(message))

    def series(self, t_s, yaw_rate_radps, *columns):
        gravity = Gravity()
        for axes in zip(*columns[:3]):
            gravity.add(*axes)
        return Imu(t_s, yaw_rate_radps, columns[0], columns[-1]), [*filter(None, [gravity.note(self.topic)])]


class AckermannColumn(StampedColumn):
    """The steering angle in ackermann_msgs/AckermannDriveStamped, or AckermannDrive, which counts by when it was
    recorded: in rad, of a wheel in the middle of the front axle, left positive.
    """

    def row(self, message):
        return (ackermann_drive(message).steering_angle,)


class ValueColumn(StampedColumn):
    """A message with a number named ``data``, or a VESC's telemetry, whose duty cycle it is."""

    def row(self, message):
        return value_of(message), hasattr(message, "state")

    def series(self, t_s, value, is_vesc):
        return Value(t_s, value), [f"{self.topic}: the value is a VESC's duty cycle, -1 to 1"] if is_vesc.any() else []


class OutputColumn:
    """The duties that the servo board outputs, by recording time; otherwise like a StampedColumn."""

    def __init__(self, topic: str):
        self.topic = topic
        self._times, self._duties = array("d"), array("i")
        self._newest: list = []
        self._left_out = {WRONG_LENGTH: 0, STAMP_BACK: 0}

    def add(self, recorded: Any, now_s: float, timeline: Timeline) -> None:
        """Add a ``recording.Recorded`` that was recorded at ``now_s``."""
        duties, last_s = [int(duty) for duty in recorded.message.data], self._times[-1] if self._times else -math.inf
        if len(duties) != CHANNELS:
            self._left_out[WRONG_LENGTH] += 1
            return
        duties = self._resolved(duties)
        if duties == self._newest and now_s < last_s + REPEATED_S:
            return
        if now_s < last_s:
            self._left_out[STAMP_BACK] += 1
            return
        self._newest = duties
        self._times.append(now_s)
        self._duties.extend(duties)

    def build(self) -> tuple[Output | None, list[str]]:
        """Return the columns, and lines on what is left out."""
        output = Output(np.array(self._times), np.array(self._duties).reshape(-1, CHANNELS)) if self._times else None
        return output, _odd_messages(self.topic, self._left_out)

    def _resolved(self, duties):
        return duties


class CommandColumn(OutputColumn):
    """The duties that the servo board was sent: −1 leaves a channel alone, and the chip takes the nearest count."""

    def _resolved(self, duties):
        before = self._newest or [UNCHANGED] * CHANNELS
        return [duty_of_counts(counts_of_duty(duty)) if 0 <= duty <= MAX_DUTY else held
                for duty, held in zip(duties, before)]


def _odd_messages(topic, counts):
    """Return a line for each reason of which there are messages."""
    return [f"{topic}: {count} message{'s' if count > 1 else ''} {reason}" for reason, count in counts.items() if count]


def has_twist(message) -> bool:
    """Return whether a nav_msgs/Odometry has a speed that isn't 0."""
    linear = message.twist.twist.linear
    return bool(linear.x or linear.y)


def message_stamp_ns(message) -> int:
    """Return a message's stamp, of its header or its own; 0 when it has none."""
    stamp = message.header.stamp if hasattr(message, "header") else getattr(message, "stamp", None)
    return stamp_ns(stamp) if stamp is not None else 0


def ackermann_drive(message) -> Any:
    """Return the AckermannDrive in a message that may be stamped."""
    return message.drive if hasattr(message, "drive") else message


def value_of(message) -> float:
    """Return the number named ``data``, or the duty cycle in a vesc_msgs/VescStateStamped."""
    return float(vesc_number(message, DUTY_CYCLE) if hasattr(message, "state") else message.data)


def vesc_number(message, names: tuple[str, str]) -> float:
    """Return a number in a vesc_msgs/VescStateStamped: DUTY_CYCLE or VOLTAGE, by its name in F1TENTH's definition, or
    in that of MIT's for firmware 5. AttributeError: it has neither.
    """
    known, other = names
    return getattr(message.state, known) if hasattr(message.state, known) else getattr(message.state, other)


def _pose_speed_mps(odom):
    """Return the speed at each pose (N,), forward positive: how far it moves in the POSE_WINDOW_S around it."""
    begin_s, end_s = (np.clip(odom.t_s + half_s, odom.t_s[0], odom.t_s[-1])
                      for half_s in (-POSE_WINDOW_S / 2, POSE_WINDOW_S / 2))
    dx, dy = (np.interp(end_s, odom.t_s, place) - np.interp(begin_s, odom.t_s, place) for place in (odom.x_m, odom.y_m))
    # By the length, not by its part along the heading: a body of motion capture may be turned against the car.
    return np.hypot(dx, dy) / (end_s - begin_s) * np.sign(dx * np.cos(odom.yaw_rad) + dy * np.sin(odom.yaw_rad))


def _pitch_rad(message):
    q = message.orientation
    length = q.x ** 2 + q.y ** 2 + q.z ** 2 + q.w ** 2
    # REP-145: −1 as the first covariance means that the message has no orientation.
    if message.orientation_covariance[0] == -1 or not 0.9 < length < 1.1:
        return math.nan
    return math.asin(max(-1.0, min(1.0, 2 * (q.w * q.y - q.z * q.x) / length)))
