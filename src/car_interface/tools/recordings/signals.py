"""Reads the motion of a car and its commands from a recording, as columns of numbers on one time scale.

Odometry and the IMU count by their stamps, the servo board's output by when it was recorded. A stamp that is seconds
away from the recording time is replaced by that. Where the computer's clock was set back, what follows is moved behind
what was before it, so that time always rises; intervals longer than a moment may contain gaps.
"""
from __future__ import annotations

from typing import Collection, NamedTuple

import numpy as np

from car_interface.common.units import NS_PER_S
from car_interface.tools.recordings import columns, recording, roles
from car_interface.tools.recordings.recording import NoRecording
from car_interface.tools.recordings.replay import CLOCK_TOPIC, WHEEL_TOPIC, PulseColumns

PULSES = "pulses"  # the only part that plays no role: only this package records it
PARTS = (*(role.name for role in (
    roles.ODOM, roles.OUTPUT, roles.IMU, roles.VALUE, roles.ACKERMANN, roles.SERVO)), PULSES)
KINDS = {roles.ODOM: columns.OdomColumn, roles.IMU: columns.ImuColumn, roles.VALUE: columns.ValueColumn,
         roles.ACKERMANN: columns.AckermannColumn, roles.SERVO: columns.ValueColumn}
BOARD = {roles.OUTPUT: columns.OutputColumn, roles.COMMAND: columns.CommandColumn}
TYPES = {PULSES: "car_interface/Wheel", **{role.name: role.types for role in (*KINDS, roles.OUTPUT)}}
HINT = "; name another by --map TOPIC="


class Signals(NamedTuple):
    """The columns of a recording; ``None`` for those that weren't asked for or aren't in it."""

    path: str
    start_s: float  # ROS time at which all ``t_s`` begin
    duration_s: float  # from the first message to the last
    odom: columns.Odom | None
    output: columns.Output | None
    imu: columns.Imu | None
    value: columns.Value | None
    ackermann: columns.Value | None  # steering angles in rad that a planner asks for
    servo: columns.Value | None  # positions of a VESC's, 0 to 1
    pulses: tuple[columns.Pulses, columns.Pulses] | None  # of the left and the right wheel
    topics: dict[str, str]  # of each part that is there, by the part
    notes: tuple[str, ...]  # what was guessed and what was left out, a line each that names the topic


class Trail(NamedTuple):
    """Where the car was, on the computer's clock: shows which recordings contain the same driving; columns (N,)."""

    path: str
    t_s: np.ndarray  # ROS time
    x_m: np.ndarray
    y_m: np.ndarray


def load(path: str, wanted: Collection[str], *, optional: Collection[str] = (), namespace: str = "/",
         **topics: str) -> Signals:
    """Read a recording; a terminal shows a bar meanwhile.

    Args:
        wanted: those of ``PARTS`` that the recording must have.
        optional: those of ``PARTS`` that are read if it has them. An ``imu`` that is named must be there.
        topics: named by the user, by role: ``odom``, ``imu``, ``value``, ``ackermann``, ``servo``, ``output``,
            ``command``. One that isn't named: its usual topic, or the only one of its type.

    Raises:
        NoRecording: it can't be read, lacks a topic, or has no usable message of one.
    """
    parts, guesses = _columns(path, set(wanted), set(optional), topics, namespace)
    by_topic, types = ({column.topic: what[part] for part, column in parts.items()} for what in (parts, TYPES))
    if PULSES in parts:
        by_topic[CLOCK_TOPIC], types[CLOCK_TOPIC] = parts[PULSES], "car_interface/TeensyClock"
    timeline = columns.Timeline()
    for recorded in recording.read(path, types, namespace, progress=True):
        try:
            by_topic[recorded.topic].add(recorded, timeline.recorded_s(recorded.time_ns), timeline)
        except AttributeError as error:
            raise recording.other_version(path, recorded) from error
    built = {part: column.build() for part, column in parts.items()}
    for part, (series, _) in built.items():
        if series is None and part in {*wanted, *topics}:
            raise NoRecording(f"{path}: nothing that can be used was recorded of {parts[part].topic}")
    notes = (*guesses, *(note for _, notes in built.values() for note in notes), *timeline.notes)
    return Signals(str(path), (timeline.start_ns or 0) / NS_PER_S, timeline.last_s, *(
        built.get(part, (None,))[0] for part in PARTS),
        {part: parts[part].topic for part, (series, _) in built.items() if series is not None}, notes)


def trail(signals: Signals) -> Trail:
    """Return the trail of a recording with odometry, without the samples at which the car stood still."""
    odom = signals.odom
    moves = np.concatenate(([False], (np.diff(odom.x_m) != 0) | (np.diff(odom.y_m) != 0)))
    return Trail(signals.path, *(column[moves] for column in (signals.start_s + odom.t_s, odom.x_m, odom.y_m)))


def _columns(path, wanted, optional, topics, namespace):
    """Return an empty column for each part that will be read, and what was guessed."""
    recorded = recording.contents(path).topics
    parts, guesses = {}, []
    for role, kind in KINDS.items():
        part = role.name
        if part not in wanted | optional and (part != roles.IMU.name or part not in topics):
            continue
        topic, note, is_there, fits = roles.find(recorded, role, namespace, topics)
        guesses += [note] if note else []
        is_needed = part in {*wanted, *topics}
        if fits or is_needed and is_there:
            parts[part] = kind(topic)
        elif is_needed and note:
            raise NoRecording(f"{path}: {note}")
        elif is_needed:
            is_usual = topics.get(part) in (None, *role.topics)
            recording.require(path, {topic: role.types}, namespace, f"the {part}: {role.what}",
                              HINT + part if is_usual else "")
    if roles.OUTPUT.name in wanted | optional:
        parts.update(_output_column(path, recorded, roles.OUTPUT.name in wanted, topics, namespace))
    if PULSES in wanted:
        recording.require(path, [WHEEL_TOPIC], namespace)
    if PULSES in wanted or PULSES in optional and recording.absolute_names(recorded, [WHEEL_TOPIC], namespace):
        parts[PULSES] = PulseColumns(WHEEL_TOPIC)
    return parts, guesses


def _output_column(path, recorded, is_wanted, topics, namespace):
    """Return the board's outputs; without them its commands, which lack channels that were set before the recording."""
    named = [(kind, topics[role.name]) for role, kind in BOARD.items() if role.name in topics]
    offered = named or [(kind, topic) for role, kind in BOARD.items() for topic in role.topics]
    for kind, topic in offered:  # one with messages goes before one that was only advertised
        if any(recorded[name].count for name in recording.absolute_names(recorded, [topic], namespace)):
            return {roles.OUTPUT.name: kind(topic)}
    if is_wanted or named:
        topic = offered[0][1]
        recording.require(path, {topic: roles.DUTY_TYPES}, namespace, *(
            () if named else (roles.OUTPUT.what, HINT + roles.OUTPUT.name)))
        raise NoRecording(f"{path} has no messages of {topic}")
    return {}
