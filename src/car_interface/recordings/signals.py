"""What a recording tells of a car's motion and of what it was told, as columns of numbers on one scale of time.

Odometry and the IMU count by their stamps, what the servo board holds by when it was recorded. A stamp that is seconds
away from when its message was recorded is no use: the recorder's time stands for it. Where the computer's clock was set
back, what follows is moved behind what was before it, so that time always rises; whatever looks at more than a moment
has to mind gaps.

Columns grow as bytes and not as Python's numbers: a recording of 10 GB fits.
"""
from __future__ import annotations

import math
import os
from abc import ABC, abstractmethod
from array import array
from collections import Counter
from typing import Collection, NamedTuple, Sequence

import numpy as np

from car_interface.common.servo_channels import CHANNELS, MAX_DUTY, UNCHANGED
from car_interface.pca9685.registers import counts_of_duty, duty_of_counts
from car_interface.recordings import recording
from car_interface.recordings.recording import NoRecording, Recorded
from car_interface.teensy.link.protocol import Pong, Wheel, WheelStatus
from car_interface.teensy.sensing.clock import Clock
from car_interface.teensy.sensing.measurements import PONG_BYTES, WHEEL_BYTES
from car_interface.teensy.sensing.plausibility import Gates

NS_PER_S = 1_000_000_000
ODOM, OUTPUT, IMU, VALUE, PULSES = PARTS = "odom", "output", "imu", "value", "pulses"
VALUE_TOPIC, IMU_TOPIC, WHEEL_TOPIC, CLOCK_TOPIC = "generic/output/value", "imu/data", "teensy_wheel", "teensy_clock"
# What the board holds; or else what it was told, which leaves channels alone that have their duty from elsewhere.
OUTPUT_TOPIC, COMMAND_TOPICS = "/servo/output", ("/servo/cmdVector", "command")
VALUE_TYPES = ("car_interface/Float64Stamped", "autoware_internal_debug_msgs/Float64Stamped",
               "tier4_debug_msgs/Float64Stamped", "tier4_debug_msgs/Float32Stamped", "std_msgs/Float64",
               "std_msgs/Float32")
TYPES = {ODOM: "nav_msgs/Odometry", OUTPUT: "std_msgs/Int32MultiArray", IMU: "sensor_msgs/Imu", VALUE: VALUE_TYPES}
ODD_STAMP_S = 2.0  # farther from its recording no message is that came from this computer, just now
STEP_BACK_S = 1.0  # the recorder's own time goes back so far only when the clock was set
BREAK_S = 10.0  # between what was before that and what is after it
REPEATED_S = 0.5  # an unchanged output is kept so often
SAME_S, MIN_SAME = 1e-5, 50  # odometry within this at the same place is the same; so many of it are no chance
STAMP_BACK, ODD_STAMP, NOT_FINITE, WRONG_LENGTH, REFUSED = (
    "with a stamp that doesn't rise: left out",
    "with a stamp seconds away from when it was recorded: recording time taken",
    "with a number that is none: left out", "that don't have 16 duties: left out",
    "of the wheels that make no sense: left out")


class Odom(NamedTuple):
    """Where the car was, and how it moved; a row for each message."""

    t_s: np.ndarray
    x_m: np.ndarray
    y_m: np.ndarray
    yaw_rad: np.ndarray  # unwrapped
    speed_mps: np.ndarray  # backward negative
    yaw_rate_radps: np.ndarray


class Output(NamedTuple):
    """What the servo board held from each moment on, until the next row."""

    t_s: np.ndarray
    duties: np.ndarray  # int, a column for each channel; −1 = never set

    def at(self, channel: int, t_s: np.ndarray) -> np.ndarray:
        """A channel's duty at moments; −1 before the first."""
        index = np.searchsorted(self.t_s, t_s, side="right") - 1
        return np.where(index < 0, UNCHANGED, self.duties[np.maximum(index, 0), channel])


class Imu(NamedTuple):
    """What an IMU on the car felt."""

    t_s: np.ndarray
    yaw_rate_radps: np.ndarray
    acceleration_mps2: np.ndarray  # forward, with gravity's share on a slope
    pitch_rad: np.ndarray  # nose down positive; NaN where it tells none


class Value(NamedTuple):
    """A number that was commanded, until the next row."""

    t_s: np.ndarray
    value: np.ndarray


class Pulses(NamedTuple):
    """A wheel's pulses: how many it had made, backward ones taken off, at the last one of each report."""

    t_s: np.ndarray
    count: np.ndarray


class Signals(NamedTuple):
    """A recording's columns; ``None`` for what wasn't asked for or isn't in it.

    Attributes:
        path: of the recording.
        start_s: ROS time at which all ``t_s`` begin.
        duration_s: from the first message to the last.
        odom, output, imu, value: see there.
        pulses: of the left and the right wheel.
        notes: what was left out, in words, with the topic.
    """

    path: str
    start_s: float
    duration_s: float
    odom: Odom | None
    output: Output | None
    imu: Imu | None
    value: Value | None
    pulses: tuple[Pulses, Pulses] | None
    notes: tuple[str, ...]


class Trail(NamedTuple):
    """Where the car was when, on the computer's clock; by it driving is known again in another recording."""

    path: str
    t_s: np.ndarray
    x_m: np.ndarray
    y_m: np.ndarray


def trail(found: Signals) -> Trail:
    """Of a recording with odometry; what stood still is left out."""
    moved = np.concatenate(([False], (np.diff(found.odom.x_m) != 0) | (np.diff(found.odom.y_m) != 0)))
    return Trail(found.path, *(column[moved] for column in (found.start_s + found.odom.t_s, found.odom.x_m,
                                                            found.odom.y_m)))


def check_twice(paths: Sequence[str]) -> None:
    """Refuse a recording that is given twice: its evidence would count twice.

    Raises:
        NoRecording: naming it both times.
    """
    seen: dict = {}
    for path in paths:
        real = os.path.realpath(path)
        if real in seen:
            raise NoRecording(f"{seen[real]} and {path} are the same recording: it would count twice")
        seen[real] = path


def check_apart(trails: Sequence[Trail]) -> None:
    """Refuse recordings that have some driving in common, such as a copy, or a part: it would count twice.

    Times alone don't tell: a computer without a clock of its own may begin at the same time again.

    Raises:
        NoRecording: naming two.
    """
    for index, one in enumerate(trails):
        for other in trails[:index]:
            if not (one.t_s.size and other.t_s.size):
                continue
            nearest = np.clip(np.searchsorted(other.t_s, one.t_s - SAME_S), 0, other.t_s.size - 1)
            same = ((np.abs(other.t_s[nearest] - one.t_s) <= SAME_S) & (other.x_m[nearest] == one.x_m)
                    & (other.y_m[nearest] == one.y_m))
            if same.sum() >= MIN_SAME:
                raise NoRecording(f"{other.path} and {one.path} have the same driving in them, at {same.sum()} moments "
                                  "of odometry: it would count twice")


def load(path: str, wanted: Collection[str], *, optional: Collection[str] = (), namespace: str = "/",
         odom: str = "odom", imu: str | None = None, value: str = VALUE_TOPIC, progress: bool = False) -> Signals:
    """Read a recording.

    Args:
        path: of the recording.
        wanted: those of ``PARTS`` that must be there.
        optional: those that are taken if they are there. An ``imu`` that is named must be there.
        namespace: the car's.
        odom, imu, value: topics.
        progress: show a bar.

    Raises:
        NoRecording: it can't be read, lacks a topic, or has nothing on it.
    """
    wanted = set(wanted) | ({IMU} if imu else set())
    topics = {ODOM: odom, IMU: imu or IMU_TOPIC, VALUE: value}
    names = _names(path, wanted, set(optional), topics, namespace)
    columns = {part: kind(topic) for part, topic, kind in names}
    by_topic = {topic: columns[part] for part, topic, _ in names}
    types = {topic: TYPES[part] for part, topic, _ in names if part in TYPES}
    if PULSES in columns:
        by_topic[CLOCK_TOPIC] = columns[PULSES]
        types.update({WHEEL_TOPIC: "car_interface/Wheel", CLOCK_TOPIC: "car_interface/TeensyClock"})
    time = _Time()
    for recorded in recording.read(path, types, namespace, progress):
        try:
            by_topic[recorded.topic].take(recorded, time.of_recording(recorded.time_ns), time)
        except AttributeError as error:
            raise recording.other_version(path, recorded) from error
    for column in columns.values():
        column.finish(time)
    for part, topic, _ in names:
        if part in wanted and columns[part].is_empty:
            raise NoRecording(f"{path}: nothing that can be used was recorded of {topic}")
    notes = tuple(note for column in columns.values() for note in column.notes()) + time.notes()
    made = {part: None if column.is_empty else column.made() for part, column in columns.items()}
    return Signals(str(path), time.start_ns / NS_PER_S, time.last_s, made.get(ODOM), made.get(OUTPUT), made.get(IMU),
                   made.get(VALUE), made.get(PULSES), notes)


def _names(path, wanted, optional, topics, namespace):
    """(part, topic, kind of column) of what there is to be read."""
    recorded = recording.contents(path).topics
    found = []
    for part, kind in ((ODOM, _OdomColumn), (IMU, _ImuColumn), (VALUE, _ValueColumn)):
        if part in wanted:
            recording.require(path, [topics[part]], namespace)
        if part in wanted or part in optional and recording.absolute_names(recorded, [topics[part]], namespace):
            found.append((part, topics[part], kind))
    if OUTPUT in wanted or OUTPUT in optional:
        # A name that a message was recorded of goes before one that was only announced.
        there = [topic for topic in (OUTPUT_TOPIC, *COMMAND_TOPICS)
                 if any(recorded[name].count for name in recording.absolute_names(recorded, [topic], namespace))]
        if there:
            found.append((OUTPUT, there[0], _OutputColumn if there[0] == OUTPUT_TOPIC else _CommandColumn))
        elif OUTPUT in wanted:
            recording.require(path, [OUTPUT_TOPIC], namespace)
            raise NoRecording(f"{path} has no messages of {OUTPUT_TOPIC}")
    if PULSES in wanted:
        recording.require(path, [WHEEL_TOPIC], namespace)
    if PULSES in wanted or PULSES in optional and recording.absolute_names(recorded, [WHEEL_TOPIC], namespace):
        found.append((PULSES, WHEEL_TOPIC, _PulseColumns))
    return found


class _Time:
    """From ROS time to seconds since the start that never run back."""

    def __init__(self):
        self.start_ns = 0
        self.last_s = 0.0
        self._shift_s = 0.0
        self._jumps = []
        self._has_begun = False

    def of_recording(self, time_ns):
        """Of a message's recording."""
        if not self._has_begun:
            self.start_ns, self._has_begun = time_ns, True
        now_s = (time_ns - self.start_ns) / NS_PER_S + self._shift_s
        if now_s < self.last_s - STEP_BACK_S:
            self._jumps.append((self.last_s, self.last_s - now_s))
            self._shift_s += self.last_s - now_s + BREAK_S
            now_s = self.last_s + BREAK_S
        self.last_s = max(self.last_s, now_s)
        return now_s

    def of_stamp(self, time_ns):
        """Of a stamp in a message that was recorded just now."""
        return (time_ns - self.start_ns) / NS_PER_S + self._shift_s

    def notes(self):
        """What happened to it."""
        return tuple(f"the computer's clock was set back by {back_s:.1f} s, {at_s:.1f} s after the start: what follows "
                     "counts as another drive" for at_s, back_s in self._jumps)


class _Column:
    """What one topic carried, message by message."""

    def __init__(self, topic):
        self.topic = topic
        self._times = array("d")
        self._counts: Counter = Counter()
        self._last_s = -math.inf

    @property
    def is_empty(self):
        return not self._times

    def finish(self, time):
        """All was read."""

    def notes(self):
        """What was left out."""
        return [f"{self.topic}: {count} message{'s' if count > 1 else ''} {what}"
                for what, count in self._counts.items()]


class _StampedColumn(_Column, ABC):
    """Of messages with a stamp: a row of numbers each."""

    def __init__(self, topic):
        super().__init__(topic)
        self._rows = array("d")

    def take(self, recorded, now_s, time):
        """Take a message that was recorded at ``now_s``."""
        row = self.row(recorded.message)
        if not all(map(math.isfinite, row)):
            self._counts[NOT_FINITE] += 1
            return
        at_s = self._stamped(recorded.message, now_s, time)
        if at_s <= self._last_s:
            self._counts[STAMP_BACK] += 1
            return
        self._last_s = at_s
        self._times.append(at_s)
        self._rows.extend(row)
        self._take_more(recorded.message)

    @abstractmethod
    def row(self, message):
        """The numbers of a message."""

    def _take_more(self, message):
        """What need not be finite."""

    def _stamped(self, message, now_s, time):
        stamp_ns = _stamp_ns(message)
        if not stamp_ns:
            return now_s
        at_s = time.of_stamp(stamp_ns)
        if abs(at_s - now_s) > ODD_STAMP_S:
            self._counts[ODD_STAMP] += 1
            return now_s
        return at_s

    def _columns(self):
        return np.frombuffer(self._times), np.frombuffer(self._rows).reshape(len(self._times), -1).T


class _OdomColumn(_StampedColumn):
    def row(self, message):
        pose, twist = message.pose.pose, message.twist.twist
        turned = pose.orientation
        yaw_rad = math.atan2(2 * (turned.w * turned.z + turned.x * turned.y), 1 - 2 * (turned.y ** 2 + turned.z ** 2))
        return pose.position.x, pose.position.y, yaw_rad, twist.linear.x, twist.angular.z

    def made(self):
        times, (x_m, y_m, yaw_rad, speed_mps, yaw_rate_radps) = self._columns()
        return Odom(times, x_m, y_m, np.unwrap(yaw_rad), speed_mps, yaw_rate_radps)


class _ImuColumn(_StampedColumn):
    def __init__(self, topic):
        super().__init__(topic)
        self._pitch = array("d")

    def row(self, message):
        return message.angular_velocity.z, message.linear_acceleration.x

    def _take_more(self, message):
        self._pitch.append(_pitch_rad(message))

    def made(self):
        times, (yaw_rate_radps, acceleration_mps2) = self._columns()
        return Imu(times, yaw_rate_radps, acceleration_mps2, np.frombuffer(self._pitch))


class _ValueColumn(_StampedColumn):
    def row(self, message):
        return (float(message.data),)

    def made(self):
        times, (value,) = self._columns()
        return Value(times, value)


class _OutputColumn(_Column):
    """What the board says that it holds."""

    def __init__(self, topic):
        super().__init__(topic)
        self._duties = array("i")
        self._newest: list = []

    def take(self, recorded, now_s, time):
        duties = [int(duty) for duty in recorded.message.data]
        if len(duties) != CHANNELS:
            self._counts[WRONG_LENGTH] += 1
            return
        duties = self._resolved(duties)
        if duties == self._newest and now_s < self._last_s + REPEATED_S:
            return
        if now_s < self._last_s:
            self._counts[STAMP_BACK] += 1
            return
        self._newest, self._last_s = duties, now_s
        self._times.append(now_s)
        self._duties.extend(duties)

    def made(self):
        return Output(np.frombuffer(self._times), np.frombuffer(self._duties, np.intc).reshape(-1, CHANNELS))

    def _resolved(self, duties):
        return duties


class _CommandColumn(_OutputColumn):
    """What the board was told: −1 leaves a channel alone, and the chip takes the nearest count."""

    def _resolved(self, duties):
        before = self._newest or [UNCHANGED] * CHANNELS
        return [duty_of_counts(counts_of_duty(duty)) if 0 <= duty <= MAX_DUTY else held
                for duty, held in zip(duties, before)]


class _PulseColumns:
    """The wheels' reports, through the gates and the clock that a live car has."""

    def __init__(self, topic):
        self.topic = topic
        self._gates, self._clock = Gates(), Clock()
        self._to_monotonic_ns = None  # from ROS time; known with the first pong
        self._waiting = []
        self._has_tick = False
        self._times, self._counts = (array("d"), array("d")), (array("q"), array("q"))
        self._unproven = [0, 0]
        self._refused = 0

    @property
    def is_empty(self):
        return not (self._times[0] or self._times[1])

    def take(self, recorded, now_s, time):
        message = recorded.message
        if recorded.topic == CLOCK_TOPIC:
            self._to_monotonic_ns = message.received - _stamp_ns(message)
            self._take_waiting(time)
            self._take_pong(message)
        elif self._to_monotonic_ns is None:
            self._waiting.append((recorded, now_s))
        else:
            self._take_wheels(recorded, now_s, time)

    def finish(self, time):
        """No ping was ever answered: the ticks' arrival has to do."""
        if self._to_monotonic_ns is None:
            self._to_monotonic_ns = 0
        self._take_waiting(time)

    def notes(self):
        return [f"{self.topic}: {self._refused} reports {REFUSED}"] if self._refused else []

    def made(self):
        return tuple(Pulses(np.frombuffer(times), np.frombuffer(counts, np.int64))
                     for times, counts in zip(self._times, self._counts))

    def _take_waiting(self, time):
        for recorded, now_s in self._waiting:
            self._take_wheels(recorded, now_s, time)
        self._waiting.clear()

    def _take_pong(self, message):
        verdict = self._gates.pong(Pong(0, message.tick), True)
        if verdict.accepted:
            self._update_tick(verdict)
            self._clock.pong(message.tick, message.sent, message.sent_bytes, message.received, PONG_BYTES)

    def _take_wheels(self, recorded: Recorded, now_s, time):
        report = WheelStatus(_wheel(recorded.message.left), _wheel(recorded.message.right))
        verdict = self._gates.wheels(report)
        if not verdict.accepted:
            self._refused += 1
            return
        if verdict.boot_tick is not None:
            self._clock.restart()
        received_ns = recorded.time_ns + self._to_monotonic_ns
        for side, (wheel, pulses, times, counts) in enumerate(
                zip(report, verdict.pulses, self._times, self._counts)):
            self._unproven[side] += verdict.unproven[side]
            if not pulses:
                continue
            # Pulses whose direction the firmware didn't know were made in that of the first one that it did.
            made = pulses + (self._unproven[side] if pulses > 0 else -self._unproven[side])
            self._unproven[side] = 0
            stamp_ns = self._clock.translate(wheel.when, received_ns, WHEEL_BYTES).time_ns
            at_s = time.of_stamp(stamp_ns - self._to_monotonic_ns)
            if abs(at_s - now_s) > ODD_STAMP_S:
                at_s = now_s
            if times and at_s <= times[-1]:
                at_s = times[-1] + 1e-6  # of pulses none may be lost
            times.append(at_s)
            counts.append((counts[-1] if counts else 0) + made)

    def _update_tick(self, verdict):
        if verdict.restarted and self._has_tick:
            self._clock.restart()
        self._has_tick = True


def _pitch_rad(message):
    turned = message.orientation
    length = turned.x ** 2 + turned.y ** 2 + turned.z ** 2 + turned.w ** 2
    # REP-145: a first covariance of −1 says that there is no orientation.
    if message.orientation_covariance[0] == -1 or not 0.9 < length < 1.1:
        return math.nan
    return math.asin(max(-1.0, min(1.0, 2 * (turned.w * turned.y - turned.z * turned.x) / length)))


def _wheel(message):
    return Wheel(message.speed, message.direction, message.when, message.dist, message.dist_abs)


def _stamp_ns(message):
    """A message's stamp; 0 when it has none."""
    stamp = message.header.stamp if hasattr(message, "header") else getattr(message, "stamp", None)
    return stamp.sec * NS_PER_S + stamp.nanosec if stamp is not None else 0
