"""Reads the motion of a car and its commands from a recording, as columns of numbers on one time scale.

Odometry and the IMU count by their stamps, the servo board's output by when it was recorded. A stamp that is seconds
away from the recording time is replaced by that. Where the computer's clock was set back, what follows is moved behind
what was before it, so that time always rises; intervals longer than a moment may contain gaps.
"""
from __future__ import annotations

from typing import Collection, NamedTuple

from car_interface.common.units import NS_PER_S
from car_interface.recordings import recording
from car_interface.recordings.columns import CommandColumn, ImuColumn, OdomColumn, OutputColumn, ValueColumn
from car_interface.recordings.pulses import CLOCK_TOPIC, WHEEL_TOPIC, PulseColumns
from car_interface.recordings.recording import NoRecording
from car_interface.recordings.series import Imu, Odom, Output, Pulses, Value
from car_interface.recordings.timeline import Timeline

ODOM, OUTPUT, IMU, VALUE, PULSES = PARTS = "odom", "output", "imu", "value", "pulses"
VALUE_TOPIC, IMU_TOPIC = "generic/output/value", "imu/data"
# The board's outputs; without them its commands, which don't show channels that were set before the recording.
OUTPUT_TOPIC, COMMAND_TOPICS = "/servo/output", ("/servo/cmdVector", "command")
VALUE_TYPES = ("car_interface/Float64Stamped", "autoware_internal_debug_msgs/Float64Stamped",
               "tier4_debug_msgs/Float64Stamped", "tier4_debug_msgs/Float32Stamped", "std_msgs/Float64",
               "std_msgs/Float32")
TYPES = {ODOM: "nav_msgs/Odometry", OUTPUT: "std_msgs/Int32MultiArray", IMU: "sensor_msgs/Imu", VALUE: VALUE_TYPES}
PULSE_TYPES = {WHEEL_TOPIC: "car_interface/Wheel", CLOCK_TOPIC: "car_interface/TeensyClock"}


class Signals(NamedTuple):
    """The columns of a recording; ``None`` for those that weren't asked for or aren't in it.

    Attributes:
        path: of the recording.
        start_s: ROS time at which all ``t_s`` begin.
        duration_s: from the first message to the last.
        odom, output, imu, value: see their classes.
        pulses: of the left and the right wheel.
        notes: what was left out, a line each that names the topic.
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


def load(path: str, wanted: Collection[str], *, optional: Collection[str] = (), namespace: str = "/",
         odom: str = "odom", imu: str | None = None, value: str = VALUE_TOPIC, progress: bool = False) -> Signals:
    """Read a recording.

    Args:
        path: of the recording.
        wanted: those of ``PARTS`` that the recording must have.
        optional: those of ``PARTS`` that are read if it has them. An ``imu`` that is named must be there.
        namespace: the car's.
        odom, imu, value: topics.
        progress: show a bar.

    Raises:
        NoRecording: it can't be read, lacks a topic, or has no usable message of one.
    """
    wanted = set(wanted) | ({IMU} if imu else set())
    topics = {ODOM: odom, IMU: imu or IMU_TOPIC, VALUE: value}
    columns = _columns(path, wanted, set(optional), topics, namespace)
    by_topic = {column.topic: column for column in columns.values()}
    types = {column.topic: TYPES[part] for part, column in columns.items() if part in TYPES}
    if PULSES in columns:
        by_topic[CLOCK_TOPIC] = columns[PULSES]
        types.update(PULSE_TYPES)
    timeline = Timeline()
    for recorded in recording.read(path, types, namespace, progress):
        try:
            by_topic[recorded.topic].add(recorded, timeline.recorded_s(recorded.time_ns), timeline)
        except AttributeError as error:
            raise recording.other_version(path, recorded) from error
    for part, column in columns.items():
        column.finish(timeline)
        if part in wanted and column.is_empty:
            raise NoRecording(f"{path}: nothing that can be used was recorded of {column.topic}")
    notes = tuple(note for column in columns.values() for note in column.notes()) + timeline.notes()
    built = {part: None if column.is_empty else column.build() for part, column in columns.items()}
    return Signals(str(path), timeline.start_ns / NS_PER_S, timeline.last_s, *(
        built.get(part) for part in (ODOM, OUTPUT, IMU, VALUE, PULSES)), notes)


def _columns(path, wanted, optional, topics, namespace):
    """An empty column for each part that will be read."""
    recorded = recording.contents(path).topics
    columns = {}
    for part, kind in ((ODOM, OdomColumn), (IMU, ImuColumn), (VALUE, ValueColumn)):
        if part in wanted:
            recording.require(path, [topics[part]], namespace)
        if part in wanted or part in optional and recording.absolute_names(recorded, [topics[part]], namespace):
            columns[part] = kind(topics[part])
    if OUTPUT in wanted or OUTPUT in optional:
        # A topic with messages goes before one that was only advertised.
        there = [topic for topic in (OUTPUT_TOPIC, *COMMAND_TOPICS)
                 if any(recorded[name].count for name in recording.absolute_names(recorded, [topic], namespace))]
        if there:
            columns[OUTPUT] = (OutputColumn if there[0] == OUTPUT_TOPIC else CommandColumn)(there[0])
        elif OUTPUT in wanted:
            recording.require(path, [OUTPUT_TOPIC], namespace)
            raise NoRecording(f"{path} has no messages of {OUTPUT_TOPIC}")
    if PULSES in wanted:
        recording.require(path, [WHEEL_TOPIC], namespace)
    if PULSES in wanted or PULSES in optional and recording.absolute_names(recorded, [WHEEL_TOPIC], namespace):
        columns[PULSES] = PulseColumns(WHEEL_TOPIC)
    return columns
