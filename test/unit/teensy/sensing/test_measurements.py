"""The Teensy's records as measurements: what is refused, and the queue. test_captures.py has the numbers."""

import pytest

from captures import load, replay
from car_interface.teensy.link.pinging import Answer
from car_interface.teensy.link.protocol import FORWARD, NO_DIRECTION, Pong, SonarStatus, Wheel, WheelStatus
from car_interface.teensy.sensing import plausibility
from car_interface.teensy.sensing.measurements import MeasurementConfig, Measurements
from car_interface.teensy.sensing.odometry import Odometry

US, MS, S = 1_000, 1_000_000, 1_000_000_000
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


FAST_LINE = MeasurementConfig(baud=1_000_000)  # a byte takes 10 µs, a report of the wheels 380


def test_report_without_a_newer_pulse_is_as_new_as_its_receipt_and_one_with_it_as_that_pulse():
    measured = Measurements(FAST_LINE)
    stamps_ns = [measured.wheels(report_of(count), START_NS + at_us * US).stamp.time_ns - START_NS
                 for count, at_us in ((0, 0), (0, 50_100), (1, 200_000))]
    assert stamps_ns == [-380 * US, 50_100 * US, 100_000 * US - 380 * US]


@pytest.mark.parametrize("ahead_us, time_ms", [(16_000, 1100.5), (16_001, 1083.999)], ids=["pulse", "receipt"])
def test_pulse_may_be_16_ms_ahead_of_a_clock_that_has_had_no_pong(ahead_us, time_ms):
    measured = Measurements(FAST_LINE)
    measured.wheels(report_of(0), START_NS)  # the middle of tick 1000 was 380 µs ago
    received_ns = START_NS - 380 * US + 99_500 * US - ahead_us * US
    assert measured.wheels(report_of(1), received_ns).motion.time_ms == pytest.approx(time_ms, abs=1e-6)


@pytest.mark.parametrize("later_ns, used", [(-1, False), (0, True)])
def test_pong_of_14_bytes_may_come_as_soon_as_the_line_allows(later_ns, used):
    received_ns = START_NS + (15 + 14) * 10 * US + later_ns
    sync = Measurements(FAST_LINE).pong(Pong(0, 1000), Answer(START_NS, received_ns - START_NS, 15), received_ns)
    assert sync.used == used


def test_accelerating_car_s_speed_is_uncertain_by_a_third_of_what_it_may_gain_until_its_stamp(monkeypatch):
    """Without pongs a stamp is good to 251 ms: the Teensy's buffers, and a tick. That bound is three sigma."""
    def variance(acceleration_mps2):
        monkeypatch.setattr(Odometry, "acceleration_mps2", acceleration_mps2)
        return Measurements().wheels(report_of(0), START_NS).motion.speed_variance
    assert variance(2.0) - variance(0.0) == pytest.approx((2.0 * 0.251 / 3) ** 2)


def test_after_a_reboot_that_the_wheels_reveal_stamps_go_by_the_new_clock_from_that_report_on():
    measured = Measurements(FAST_LINE)
    measured.sonar(SonarStatus(0, ECHO_US, 100_000), START_NS)
    parked, rolled = Wheel(0, NO_DIRECTION, 0, 0, 0), Wheel(0, FORWARD, 99_900, 1, 20)
    first, later = (Wheel(9, FORWARD, tick, 1, count) for tick, count in ((400, 1), (500, 2)))
    for at_s, wheel in ((1, rolled), (2, parked)):
        assert measured.wheels(WheelStatus(wheel, wheel), START_NS + at_s * S)
    boot, after = (measured.wheels(WheelStatus(wheel, wheel), START_NS + at_ms * MS)
                   for wheel, at_ms in ((first, 3000), (later, 3150)))
    assert measured.gates.counts[plausibility.CLOCK_RESTARTED] == 1
    assert boot.stamp.time_ns == START_NS + 3000 * MS - 380 * US
    assert after.stamp.time_ns == START_NS + 3100 * MS  # though it came 50 ms late
