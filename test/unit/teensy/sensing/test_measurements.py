"""The Teensy's records as measurements: what is refused, and the queue. test_captures.py has the numbers."""

import pytest

from captures import load, replay
from car_interface.teensy.link.pinging import Answer
from car_interface.teensy.link.protocol import FORWARD, Pong, SonarStatus, Wheel, WheelStatus
from car_interface.teensy.sensing import plausibility
from car_interface.teensy.sensing.measurements import MeasurementConfig, Measurements

MS, S = 1_000_000, 1_000_000_000
START_NS = 5_000 * S
ECHO_US = 5824  # there and back over a metre at 20 °C


@pytest.mark.once
@pytest.mark.parametrize("record, reason", (
    (SonarStatus(0, ECHO_US, 2_000), plausibility.TICK_BACK),
    (SonarStatus(0, ECHO_US, 90_000), plausibility.TICK_AHEAD),
    (Pong(1234, 9_000), plausibility.NOT_OUR_PING),
    (WheelStatus(Wheel(0, 3, 9_000, 0, 0), Wheel(0, 0, 9_000, 1, 1)), plausibility.SENSOR_ERROR),
))
def test_bad_record_is_named_and_changes_nothing(record, reason):
    _, measured = replay(load("stop_go"), until_us=10_000_000)
    before = measured.clock.translate(9_000)
    if isinstance(record, Pong):
        measured.pong(record, None, 10 * S)
    else:
        assert (measured.sonar if isinstance(record, SonarStatus) else measured.wheels)(record, 10 * S) is None
    assert measured.gates.counts[reason] == 1
    assert measured.clock.translate(9_000) == before


def test_pongs_alone_are_heard_however_far_apart_the_gates_let_them_be():
    measured = Measurements(MeasurementConfig(max_gap_ms=20_000))
    for index in range(9):
        at_ns = START_NS + 10 * S * index
        assert measured.pong(Pong(index, 10_000 * index), Answer(at_ns, 4 * MS, 15), at_ns + 4 * MS).used
    assert not measured.gates.refused


def test_commanded_curvature_is_the_odometry_s(monkeypatch):
    measured, commanded = Measurements(), []
    monkeypatch.setattr(measured._odometry, "steer", commanded.append)
    measured.steer(0.3)
    assert commanded == [0.3]


def report_of(count):
    return WheelStatus(*2 * (Wheel(10, FORWARD, 1000 + 100 * count, 1, 1 + count),))


@pytest.mark.parametrize("end", [
    lambda measured: measured.process_queue(),
    lambda measured: measured.steer(0.0),
    lambda measured: measured.sonar(SonarStatus(0, ECHO_US, 1400), START_NS + S),
    lambda measured: measured.pong(Pong(0, 1400), None, START_NS + S),
    lambda measured: measured.wheels(report_of(4), START_NS + S),
], ids=["process_queue", "steer", "sonar", "pong", "wheels"])
def test_queued_reports_are_processed_before_what_comes_after_them(end):
    results = []
    measured = Measurements(on_motion=lambda result: results.append(result.stamp.time_ns))
    for count in range(3):
        measured.queue_wheels(report_of(count), START_NS + 100 * count * MS)
    assert measured.queue and results == []
    end(measured)
    assert not measured.queue
    assert [stamp_ns - results[0] for stamp_ns in results] == [100 * count * MS for count in range(3)]


def test_queue_is_bounded_and_a_refused_report_in_it_makes_nothing():
    results = []
    measured = Measurements(on_motion=lambda result: results.append(result.stamp.time_ns))
    for count in range(10):
        assert results == []
        measured.queue_wheels(report_of(count), START_NS + 100 * count * MS)
    assert len(results) == 10 and not measured.queue
    measured.queue_wheels(WheelStatus(*2 * (Wheel(65535, FORWARD, 1000, 1, 1),)), START_NS + S)
    measured.process_queue()
    assert len(results) == 10 and not measured.queue and measured.gates.refused == 1


def test_report_without_a_newer_pulse_is_as_new_as_its_receipt_and_one_with_it_as_that_pulse():
    measured = Measurements()
    first, again, next_ = (measured.wheels(report_of(count), START_NS + at_ms * MS).stamp.time_ns
                           for count, at_ms in ((0, 0), (0, 100), (1, 200)))
    assert (again - first, next_ - first) == pytest.approx((100 * MS, 100 * MS), abs=5 * MS)
