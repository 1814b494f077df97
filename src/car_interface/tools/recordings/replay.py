"""Recomputes odometry and ranges from a recording's raw records, with the code as it is now.

The raw topics have all the inputs of a live node: records by kind, and on teensy_clock the times of each ping and pong.
They lack the time at which a report of a sonar or of the wheels was read; the time at which the recorder received the
message, a little later, stands for it. Before the clock has converged, which takes five pongs, that shifts stamps by as
much, and where the car moves then, its pose by some mm; later neither.
"""
from __future__ import annotations

import warnings
from typing import Iterable, Iterator

from car_interface.common.units import stamp_ns
from car_interface.teensy.link.pinging import Answer
from car_interface.teensy.link.protocol import Pong, SonarStatus, WheelStatus
from car_interface.teensy.sensing.measurements import (
    MeasurementConfig,
    Measurements,
    MotionMeasurement,
    RangeMeasurement,
)
from car_interface.tools.recordings.pulses import wheel
from car_interface.tools.recordings.recording import NoRecording, Recorded

MEASURED = {"teensy_distance", "teensy_wheel"}
TOPICS = ("teensy_clock", *sorted(MEASURED))


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
    for time_ns, topic, message in recorded:
        missing.discard(topic)
        if topic == "teensy_clock":
            to_monotonic_ns = message.received - stamp_ns(message.stamp)
            for earlier in pending:
                yield from _measure(measurements, earlier, to_monotonic_ns)
            pending.clear()
            answer = Answer(message.sent, message.received - message.sent, message.sent_bytes)
            measurements.pong(Pong(0, message.tick), answer, message.received)
        elif to_monotonic_ns is None:
            pending.append(Recorded(time_ns, topic, message))
        else:
            yield from _measure(measurements, Recorded(time_ns, topic, message), to_monotonic_ns)
    for earlier in pending:  # the recording has no pong
        yield from _measure(measurements, earlier, 0)
    if missing:
        text = f"the recording has no message of {', '.join(sorted(missing))}"
        if missing >= MEASURED:
            raise NoRecording(f"{text}: there is nothing to replay")
        warnings.warn(text, stacklevel=2)


def _measure(measurements, recorded, to_monotonic_ns):
    received_ns, message = recorded.time_ns + to_monotonic_ns, recorded.message
    if recorded.topic == "teensy_wheel":
        measured = measurements.wheels(WheelStatus(wheel(message.left), wheel(message.right)), received_ns)
    else:
        measured = measurements.sonar(SonarStatus(message.sensor, message.distance, message.when), received_ns)
    if measured is not None:
        yield measured
