"""Collects the messages of one topic as columns of numbers.

Columns grow as bytes, not as Python's numbers, so that a recording of 10 GB fits into memory.
"""
from __future__ import annotations

import math
from array import array
from collections import Counter
from typing import Any, Callable

import numpy as np

from car_interface.common.units import CHANNELS, MAX_DUTY, NS_PER_S, UNCHANGED, stamp_ns, yaw_rad
from car_interface.pca9685.registers import counts_of_duty, duty_of_counts
from car_interface.tools.recordings.series import Ackermann, Imu, Odom, Output, Value

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


class Timeline:
    """Converts ROS time to seconds since the first message.

    Where the clock was set back, all that follows is moved behind what was recorded before.
    """

    def __init__(self):
        self.start_ns = 0  # ROS time of the first message
        self.last_s = 0.0  # of the newest message
        self._shift_s = 0.0
        self._steps = []  # (time in s, step back in s)
        self._has_started = False

    def recorded_s(self, time_ns: int) -> float:
        """Return the time at which a message was recorded; called once for each message, in order."""
        if not self._has_started:
            self.start_ns, self._has_started = time_ns, True
        now_s = (time_ns - self.start_ns) / NS_PER_S + self._shift_s
        if now_s < self.last_s - STEP_BACK_S:
            self._steps.append((self.last_s, self.last_s - now_s))
            self._shift_s += self.last_s - now_s + BREAK_S
            now_s = self.last_s + BREAK_S
        self.last_s = max(self.last_s, now_s)
        return now_s

    def stamped_s(self, time_ns: int) -> float:
        """Return the time of a stamp in the newest message."""
        return (time_ns - self.start_ns) / NS_PER_S + self._shift_s

    def notes(self) -> tuple[str, ...]:
        """Return a line for each time that the clock was set back."""
        return tuple(f"the computer's clock was set back by {back_s:.1f} s, {at_s:.1f} s after the start: what follows "
                     "counts as another drive" for at_s, back_s in self._steps)


class Gravity:
    """The mean of an IMU's accelerations: on a drive all but gravity cancels out."""

    def __init__(self):
        self._count = 0
        self._sum_mps2 = [0.0, 0.0, 0.0]

    def add(self, acceleration: Any) -> None:
        """Add the linear_acceleration of a sensor_msgs/Imu."""
        axes = (acceleration.x, acceleration.y, acceleration.z)
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


class Column:
    """The messages of one topic.

    ``add(recorded, now_s, timeline)`` adds a message that was recorded at ``now_s``; ``build()`` builds the columns,
    where there are any.
    """

    def __init__(self, topic: str):
        self.topic = topic
        self._times = array("d")
        self._left_out: Counter = Counter()  # messages, by reason
        self._last_s = -math.inf

    @property
    def is_empty(self) -> bool:
        """Return whether no message could be used."""
        return not self._times

    def notes(self) -> list[str]:
        """Return a line for each reason for which messages were left out."""
        return [f"{self.topic}: {count} message{'s' if count > 1 else ''} {reason}"
                for reason, count in self._left_out.items()]


class StampedColumn(Column):
    """Messages that count by their stamps; ``row(message)`` returns the numbers that must be finite, for ``series``.

    A stamp that is seconds away from the recording time gives way to that.
    """

    series: Callable  # of times and columns

    def __init__(self, topic):
        super().__init__(topic)
        self._rows = array("d")

    def add(self, recorded, now_s, timeline):
        row = self.row(recorded.message)
        if not all(math.isfinite(number) and abs(number) <= MAX_NUMBER for number in row):
            self._left_out[NOT_FINITE] += 1
            return
        at_s = self._time_s(recorded.message, now_s, timeline)
        if at_s <= self._last_s:
            self._left_out[STAMP_BACK] += 1
            return
        self._last_s = at_s
        self._times.append(at_s)
        self._rows.extend(row)
        self._add_more(recorded.message)

    def build(self):
        return self.series(*self._columns())

    def _add_more(self, message):
        """Add numbers that may be NaN."""

    def _time_s(self, message, now_s, timeline):
        message_ns = message_stamp_ns(message)
        if not message_ns:
            return now_s
        at_s = timeline.stamped_s(message_ns)
        if abs(at_s - now_s) > MAX_STAMP_OFFSET_S:
            self._left_out[ODD_STAMP] += 1
            return now_s
        return at_s

    def _columns(self):
        return np.frombuffer(self._times), *np.frombuffer(self._rows).reshape(len(self._times), -1).T


class OdomColumn(StampedColumn):
    """nav_msgs/Odometry."""

    def __init__(self, topic):
        super().__init__(topic)
        self._has_twist = False

    def row(self, message):
        pose = message.pose.pose
        return pose.position.x, pose.position.y, yaw_rad(pose.orientation), message.twist.twist.linear.x

    def build(self):
        odom = Odom(*self._columns())
        odom = odom._replace(yaw_rad=np.unwrap(odom.yaw_rad))
        return odom._replace(speed_mps=_pose_speed_mps(odom)) if self._is_pose_only() else odom

    def notes(self):
        return [*super().notes(), *([f"{self.topic}: {POSE_ONLY}"] if self._is_pose_only() else [])]

    def _add_more(self, message):
        self._has_twist = self._has_twist or has_twist(message)

    def _is_pose_only(self):
        if self._has_twist or self.is_empty:
            return False
        _, x_m, y_m, *_ = self._columns()
        return math.hypot(np.ptp(x_m), np.ptp(y_m)) > MIN_MOVED_M


class ImuColumn(StampedColumn):
    """sensor_msgs/Imu."""

    def __init__(self, topic):
        super().__init__(topic)
        self._pitch = array("d")
        self._gravity = Gravity()

    def row(self, message):
        return message.angular_velocity.z, message.linear_acceleration.x

    def notes(self):
        return [*super().notes(), *filter(None, [self._gravity.note(self.topic)])]

    def _add_more(self, message):
        self._pitch.append(_pitch_rad(message))
        self._gravity.add(message.linear_acceleration)

    def build(self):
        return Imu(*self._columns(), np.frombuffer(self._pitch))


class AckermannColumn(StampedColumn):
    """ackermann_msgs/AckermannDriveStamped, or AckermannDrive, which counts by when it was recorded."""

    series = Ackermann

    def row(self, message):
        drive = ackermann_drive(message)
        return drive.steering_angle, drive.speed


class ValueColumn(StampedColumn):
    """A message with a number named ``data``, or a VESC's telemetry, whose duty cycle it is."""

    series = Value

    def __init__(self, topic):
        super().__init__(topic)
        self._is_vesc = False

    def row(self, message):
        self._is_vesc = hasattr(message, "state")
        return (value_of(message),)

    def notes(self):
        vesc = [f"{self.topic}: the value is a VESC's duty cycle, -1 to 1"] if self._is_vesc else []
        return [*super().notes(), *vesc]


class OutputColumn(Column):
    """The duties that the servo board outputs, by recording time."""

    def __init__(self, topic):
        super().__init__(topic)
        self._duties = array("i")
        self._newest: list = []

    def add(self, recorded, now_s, timeline):
        duties = [int(duty) for duty in recorded.message.data]
        if len(duties) != CHANNELS:
            self._left_out[WRONG_LENGTH] += 1
            return
        duties = self._resolved(duties)
        if duties == self._newest and now_s < self._last_s + REPEATED_S:
            return
        if now_s < self._last_s:
            self._left_out[STAMP_BACK] += 1
            return
        self._newest, self._last_s = duties, now_s
        self._times.append(now_s)
        self._duties.extend(duties)

    def build(self):
        return Output(np.frombuffer(self._times), np.frombuffer(self._duties, np.intc).reshape(-1, CHANNELS))

    def _resolved(self, duties):
        return duties


class CommandColumn(OutputColumn):
    """The duties that the servo board was sent: −1 leaves a channel alone, and the chip takes the nearest count."""

    def _resolved(self, duties):
        before = self._newest or [UNCHANGED] * CHANNELS
        return [duty_of_counts(counts_of_duty(duty)) if 0 <= duty <= MAX_DUTY else held
                for duty, held in zip(duties, before)]


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
