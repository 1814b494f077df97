"""Raw records of a recording, put through the measurements again."""
import contextlib
from types import SimpleNamespace

import pytest

from car_interface.common.units import NS_PER_MS, NS_PER_S
from car_interface.teensy.sensing.measurements import MeasurementConfig, MotionMeasurement, RangeMeasurement
from car_interface.tools.recordings.recording import NoRecording, Recorded
from car_interface.tools.recordings.replay import replay

ROS_NS, MONOTONIC_NS = 1_700_000_000 * NS_PER_S, 7 * NS_PER_S  # when the first record was made, on both clocks
FIRST_TICK = 5000


def clock(time_ms):
    time_ns = time_ms * NS_PER_MS
    received_ns = MONOTONIC_NS + time_ns
    stamp = SimpleNamespace(sec=(ROS_NS + time_ns) // NS_PER_S, nanosec=(ROS_NS + time_ns) % NS_PER_S)
    return Recorded(ROS_NS + time_ns, "teensy_clock", SimpleNamespace(
        stamp=stamp, sent=received_ns - 4 * NS_PER_MS, received=received_ns, sent_bytes=15, tick=FIRST_TICK + time_ms))


def wheels(time_ms, pulses):
    wheel = SimpleNamespace(speed=10, direction=0, when=FIRST_TICK + time_ms, dist=0, dist_abs=pulses)
    return Recorded(ROS_NS + time_ms * NS_PER_MS, "teensy_wheel", SimpleNamespace(left=wheel, right=wheel))


def sonar(time_ms, distance):
    return Recorded(ROS_NS + time_ms * NS_PER_MS, "teensy_distance", SimpleNamespace(
        sensor=1, distance=distance, when=FIRST_TICK + time_ms))


def driving(pongs=True):
    """Ten seconds straight on."""
    records = [wheels(100 * index + 50, index) for index in range(100)] + [sonar(100 * index, 500)
                                                                           for index in range(100)]
    records += [clock(200 * index + 500) for index in range(45)] if pongs else []
    return sorted(records, key=lambda record: record.time_ns)


@pytest.mark.parametrize("pongs", [True, False], ids=["with_pongs", "no_ping_was_answered"])
def test_every_record_is_measured_in_order_also_those_before_the_first_pong(pongs):
    with contextlib.nullcontext() if pongs else pytest.warns(UserWarning, match="has no message of teensy_clock$"):
        measured = list(replay(driving(pongs), MeasurementConfig()))
    motions = [one for one in measured if isinstance(one, MotionMeasurement)]
    assert len(motions) > 50 and any(isinstance(one, RangeMeasurement) for one in measured)
    stamps = [one.stamp.time_ns for one in motions]
    assert stamps == sorted(stamps)
    assert motions[-1].motion.x_m > 0.5 and abs(motions[-1].motion.yaw_rad) < 1e-6


def test_stamps_are_on_the_monotonic_clock_of_the_computer_that_recorded():
    motions = [one for one in replay(driving(), MeasurementConfig()) if isinstance(one, MotionMeasurement)]
    assert motions[-1].stamp.time_ns == pytest.approx(MONOTONIC_NS + 9_950 * NS_PER_MS, abs=20 * NS_PER_MS)


@pytest.mark.parametrize("topic", ["teensy_wheel", "teensy_distance"])
def test_topic_that_is_missing_is_named_after_what_the_others_give(topic):
    with pytest.warns(UserWarning, match=f"the recording has no message of {topic}$"):
        assert list(replay([one for one in driving() if one.topic != topic], MeasurementConfig()))


@pytest.mark.parametrize("records, missing", [([], "teensy_clock, teensy_distance, teensy_wheel"),
                                              ([clock(0)], "teensy_distance, teensy_wheel")])
def test_recording_without_any_record_to_measure_is_refused_naming_the_topics(records, missing):
    with pytest.raises(NoRecording, match=f"has no message of {missing}: there is nothing to replay"):
        list(replay(records, MeasurementConfig()))
