"""Recomputes odometry and ranges, or the wheels' pulses, from a recording's raw records, with the code as it is now.

The raw topics have all the inputs of a live node: records by kind, and on teensy_clock the times of each ping and pong.
They lack the time at which a report of a sonar or of the wheels was read; the time at which the recorder received the
message, a little later, stands for it. Before the clock has converged, which takes five pongs, that shifts stamps by as
much, and where the car moves then, its pose by some mm; later neither.
"""
from __future__ import annotations

import warnings
from array import array
from typing import Any, Iterable, Iterator

import numpy as np

from car_interface.teensy.link.pinging import Answer
from car_interface.teensy.link.protocol import Pong, SonarStatus, Wheel, WheelStatus
from car_interface.teensy.sensing.clock import Clock
from car_interface.teensy.sensing.measurements import (
    PONG_BYTES,
    WHEEL_BYTES,
    MeasurementConfig,
    Measurements,
    MotionMeasurement,
    RangeMeasurement,
)
from car_interface.teensy.sensing.plausibility import Gates
from car_interface.tools.recordings.columns import MAX_STAMP_OFFSET_S, Pulses, Timeline, message_stamp_ns
from car_interface.tools.recordings.recording import NoRecording, Recorded

WHEEL_TOPIC, CLOCK_TOPIC = "teensy_wheel", "teensy_clock"
MEASURED = {"teensy_distance", WHEEL_TOPIC}
TOPICS = (CLOCK_TOPIC, *sorted(MEASURED))
REFUSED = "of the wheels that make no sense: left out"
MIN_STEP_S = 1e-6  # between pulses that were translated to the same time: none may be left out


class PulseColumns:
    """The pulses of the left and the right wheel, from ``WHEEL_TOPIC`` and ``CLOCK_TOPIC``; like a StampedColumn."""

    def __init__(self, topic):
        self.topic = topic
        self._gates, self._clock = Gates(), Clock()
        self._to_monotonic_ns = None  # from ROS time; known with the first pong
        self._pending = []  # messages before that, as they were added
        self._wheel_times, self._counts = (array("d"), array("d")), (array("q"), array("q"))
        self._without_direction = [0, 0]
        self._refused = 0

    def add(self, recorded: Any, now_s: float, timeline: Timeline) -> None:
        """Add a ``recording.Recorded`` that was recorded at ``now_s``."""
        self._pending.append((recorded, now_s, timeline))
        if recorded.topic == CLOCK_TOPIC:
            self._to_monotonic_ns = recorded.message.received - message_stamp_ns(recorded.message)
        if self._to_monotonic_ns is not None:
            self._add_pending()

    def build(self) -> tuple[tuple[Pulses, Pulses] | None, list[str]]:
        """Return both wheels' pulses, ``None`` = there is none, and a line on reports that were left out.

        Without a single pong the reports count by their arrival.
        """
        if self._to_monotonic_ns is None:
            self._to_monotonic_ns = 0
            self._add_pending()
        notes = [f"{self.topic}: {self._refused} reports {REFUSED}"] if self._refused else []
        left, right = (Pulses(np.frombuffer(times), np.frombuffer(counts, np.int64))
                       for times, counts in zip(self._wheel_times, self._counts))
        return (left, right) if left.t_s.size or right.t_s.size else None, notes

    def _add_pending(self):
        for recorded, *when in self._pending:
            if recorded.topic == CLOCK_TOPIC:
                self._add_pong(recorded.message)
            else:
                self._add_wheels(recorded, *when)
        self._pending.clear()

    def _add_pong(self, message):
        verdict = self._gates.pong(Pong(0, message.tick), True)
        if verdict.restarted:
            self._clock.restart()
        if verdict.accepted:
            self._clock.pong(message.tick, message.sent, message.sent_bytes, message.received, PONG_BYTES)

    def _add_wheels(self, recorded, now_s, timeline):
        report = _wheels(recorded.message)
        verdict = self._gates.wheels(report)
        if not verdict.accepted:
            self._refused += 1
            return
        if verdict.boot_tick is not None:
            self._clock.restart()
        received_ns = recorded.time_ns + self._to_monotonic_ns
        for side, (one, pulses) in enumerate(zip(report, verdict.pulses)):
            self._without_direction[side] += verdict.unproven[side]
            if not pulses:
                continue
            # Pulses whose direction the firmware didn't know have that of the first one for which it did.
            undirected, self._without_direction[side] = self._without_direction[side], 0
            time_ns = self._clock.translate(one.when, received_ns, WHEEL_BYTES).time_ns
            at_s = timeline.stamped_s(time_ns - self._to_monotonic_ns)
            at_s = at_s if abs(at_s - now_s) <= MAX_STAMP_OFFSET_S else now_s
            times, counts = self._wheel_times[side], self._counts[side]
            if times and at_s <= times[-1]:
                at_s = times[-1] + MIN_STEP_S
            times.append(at_s)
            counts.append((counts[-1] if counts else 0) + pulses + (undirected if pulses > 0 else -undirected))


def _wheels(message):
    """Return a car_interface/TeensyWheel as the protocol has it."""
    return WheelStatus(*(Wheel(wheel.speed, wheel.direction, wheel.when, wheel.dist, wheel.dist_abs)
                         for wheel in (message.left, message.right)))


def replay(recorded: Iterable[Recorded],
           config: MeasurementConfig) -> Iterator[MotionMeasurement | RangeMeasurement]:
    """Yield the measurements in order, stamped on the monotonic clock of the computer that recorded.

    Args:
        recorded: messages of ``TOPICS``, in order. A warning names those of which there is none.

    Raises:
        NoRecording: there is nothing to measure: no message of the wheels, none of the sonars.
    """
    measurements = Measurements(config)
    to_monotonic_ns = None  # from ROS time; known with the first pong
    pending = []  # records before that
    missing = set(TOPICS)
    for one in recorded:
        missing.discard(one.topic)
        pending.append(one)
        if one.topic == CLOCK_TOPIC:
            to_monotonic_ns = one.message.received - message_stamp_ns(one.message)
        if to_monotonic_ns is not None:
            yield from _measured(measurements, pending, to_monotonic_ns)
            pending.clear()
    yield from _measured(measurements, pending, 0)  # the recording has no pong
    if missing:
        text = f"the recording has no message of {', '.join(sorted(missing))}"
        if missing >= MEASURED:
            raise NoRecording(f"{text}: there is nothing to replay")
        warnings.warn(text, stacklevel=2)


def _measured(measurements, records, to_monotonic_ns):
    for topic, received_ns, message in ((one.topic, one.time_ns + to_monotonic_ns, one.message) for one in records):
        measured = None
        if topic == CLOCK_TOPIC:
            answer = Answer(message.sent, message.received - message.sent, message.sent_bytes)
            measurements.pong(Pong(0, message.tick), answer, message.received)
        elif topic == WHEEL_TOPIC:
            measured = measurements.wheels(_wheels(message), received_ns)
        else:
            measured = measurements.sonar(SonarStatus(message.sensor, message.distance, message.when), received_ns)
        if measured is not None:
            yield measured
