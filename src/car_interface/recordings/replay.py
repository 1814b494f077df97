"""Puts a recording's raw records through the core again: what odometry and ranges would have been with this code.

The raw topics hold everything that a live node had: records by kind, and on teensy_clock when each ping left and its
pong came. What they don't hold is when a sonar's or the wheels' report was read: for that the time stands at which the
recorder took its message, a little later. It shifts stamps a little before the clock has converged, and no pose.
"""
from __future__ import annotations

from typing import Iterable, Iterator

from car_interface.recordings.recording import Recorded
from car_interface.teensy.link.pinging import Answer
from car_interface.teensy.link.protocol import Pong, SonarStatus, Wheel, WheelStatus
from car_interface.teensy.sensing.measurements import (
    MeasurementConfig,
    Measurements,
    MotionMeasurement,
    RangeMeasurement,
)

TOPICS = ("teensy_clock", "teensy_distance", "teensy_wheel")


def replay(recorded: Iterable[Recorded],
           config: MeasurementConfig) -> Iterator[MotionMeasurement | RangeMeasurement]:
    """Yield what is measured, in order, stamped on the monotonic clock of the computer that recorded.

    Args:
        recorded: of ``TOPICS``, in order.
        config: of the car.
    """
    measurements = Measurements(config)
    to_monotonic_ns = None  # from ROS time; known with the first pong
    waiting = []
    for time_ns, topic, message in recorded:
        if topic == "teensy_clock":
            to_monotonic_ns = message.received - _ns(message.stamp)
            for earlier in waiting:
                yield from _measure(measurements, earlier, to_monotonic_ns)
            waiting.clear()
            answer = Answer(message.sent, message.received - message.sent, message.sent_bytes)
            measurements.pong(Pong(0, message.tick), answer, message.received)
        elif to_monotonic_ns is None:
            waiting.append(Recorded(time_ns, topic, message))
        else:
            yield from _measure(measurements, Recorded(time_ns, topic, message), to_monotonic_ns)
    for earlier in waiting:  # no ping was ever answered
        yield from _measure(measurements, earlier, 0)


def _measure(measurements, recorded, to_monotonic_ns):
    received_ns, message = recorded.time_ns + to_monotonic_ns, recorded.message
    if recorded.topic == "teensy_wheel":
        measured = measurements.wheels(WheelStatus(_wheel(message.left), _wheel(message.right)), received_ns)
    else:
        measured = measurements.sonar(SonarStatus(message.sensor, message.distance, message.when), received_ns)
    if measured is not None:
        yield measured


def _wheel(message):
    return Wheel(message.speed, message.direction, message.when, message.dist, message.dist_abs)


def _ns(stamp):
    """A time of a message as rosbags has it, or rospy."""
    seconds = stamp.sec if hasattr(stamp, "sec") else stamp.secs
    nanoseconds = stamp.nanosec if hasattr(stamp, "nanosec") else stamp.nsecs
    return seconds * 1_000_000_000 + nanoseconds
