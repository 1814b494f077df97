"""The Teensy's records as measurements: from bytes on the wire to SI units on the host's clock."""
from __future__ import annotations

import math

import pytest

from car_interface.sim.teensy_config import FirmwareConfig
from car_interface.sim.teensy_firmware import TeensyFirmware
from car_interface.sim.teensy_wheels import FORWARD as ROLLS_FORWARD
from car_interface.sim.teensy_wheels import LEFT, RIGHT
from car_interface.teensy.link.framing import FrameDecoder
from car_interface.teensy.link.pinging import Answer, Pinger
from car_interface.teensy.link.protocol import FORWARD, Pong, SonarStatus, Wheel, WheelStatus, decode
from car_interface.teensy.sensing import verdicts
from car_interface.teensy.sensing.measurements import (
    MAX_QUEUED,
    MeasurementConfig,
    Measurements,
    MotionMeasurement,
    RangeMeasurement,
)
from car_interface.teensy.sensing.plausibility import GateConfig

MS, S = 1_000_000, 1_000_000_000
START_NS = 5_000 * S
PULSE_M = math.pi * 0.095 / 20
ECHO_US = 5824  # there and back over a metre at 20 °C


class Host:
    """The host's side of a line in virtual time: pings, reads, measures."""

    def __init__(self, firmware, config=None):
        self.firmware = firmware
        self.measured = Measurements(config or MeasurementConfig())
        self.decoder = FrameDecoder()
        self.pinger = Pinger(S, "shipped", START_NS)
        self.results = []
        self.now_ns = START_NS

    def until(self, now_ns, pulses=()):
        """Live on; ``pulses`` are (time, side) of wheels that roll forward."""
        pulses = sorted(pulses)
        while self.now_ns < now_ns:
            self.now_ns += 2 * MS
            while pulses and pulses[0][0] <= self.now_ns:
                at_ns, side = pulses.pop(0)
                self.firmware.wheel_pulse(side, ROLLS_FORWARD, at_ns)
            if self.now_ns >= self.pinger.due_ns:
                self.firmware.receive(self.pinger.ping(self.now_ns // MS % 2 ** 32, self.now_ns), self.now_ns)
            for body in self.decoder.feed(self.firmware.transmit(self.now_ns)):
                self.update(decode(body))

    def update(self, record):
        measured = self.measured
        if isinstance(record, Pong):
            result = measured.pong(record, self.pinger.pong(record.timestamp1, self.now_ns), self.now_ns)
        elif isinstance(record, SonarStatus):
            result = measured.sonar(record, self.now_ns)
        elif isinstance(record, WheelStatus):
            result = measured.wheels(record, self.now_ns)
        else:
            return
        if result is not None:
            self.results.append(result)

    def of(self, kind):
        return [result for result in self.results if isinstance(result, kind)]


@pytest.fixture
def host():
    return Host(TeensyFirmware(FirmwareConfig(), lambda sensor, at_ns: ECHO_US, START_NS))


def rolling(from_s, to_s, period_s, sides=(LEFT, RIGHT)):
    """Pulses at a steady pace."""
    count = int((to_s - from_s) / period_s)
    return [(START_NS + round((from_s + period_s * index) * S), side) for index in range(count) for side in sides]


def test_wheels_that_roll_a_metre_move_the_car_by_a_metre_at_the_speed_of_their_pulses_and_echoes_become_metres(host):
    pace_s = PULSE_M / 0.5
    host.until(START_NS + 12 * S, rolling(10.0, 12.0, pace_s))
    ranges = host.of(RangeMeasurement)
    assert {result.sensor for result in ranges} == set(range(6))
    assert all(result.range_m == pytest.approx(1.0, abs=0.001) for result in ranges)
    motion = host.of(MotionMeasurement)[-1].motion
    assert motion.x_m == pytest.approx(1.0, abs=0.02)
    assert motion.y_m == pytest.approx(0.0, abs=0.005)
    assert motion.speed_mps == pytest.approx(0.5, rel=0.02)


def test_stamp_is_when_the_wheel_was_there_not_when_that_was_read(host):
    host.until(START_NS + 10 * S)
    pulses = rolling(10.0, 11.0, 0.030)
    host.until(START_NS + 11 * S, pulses)
    stamps_ns = [result.stamp.time_ns for result in host.of(MotionMeasurement)]
    for at_ns, _ in pulses[:-2]:
        assert min(abs(stamp_ns - at_ns) for stamp_ns in stamps_ns) < 1.0 * MS
    assert stamps_ns == sorted(stamps_ns)
    assert all(result.stamp.time_ns <= host.now_ns for result in host.results if hasattr(result, "stamp"))


@pytest.mark.parametrize("record, reason", (
    (SonarStatus(0, ECHO_US, 2_000), verdicts.TICK_BACK),
    (SonarStatus(0, ECHO_US, 90_000), verdicts.TICK_AHEAD),
    (Pong(1234, 9_000), verdicts.NOT_OUR_PING),
    (WheelStatus(Wheel(0, 3, 9_000, 0, 0), Wheel(0, 0, 9_000, 1, 1)), verdicts.SENSOR_ERROR),
))
def test_bad_record_is_named_and_changes_nothing(host, record, reason):
    host.until(START_NS + 10 * S)
    before = len(host.results), host.measured.clock.translate(9_000)
    host.update(record)
    assert host.measured.gates.counts[reason] == 1
    assert (len(host.results), host.measured.clock.translate(9_000)) == before


def test_reboot_while_rolling_restarts_the_clock_and_leaves_the_pose_where_it_was(host):
    pace_s = PULSE_M / 1.0
    host.until(START_NS + 12 * S, rolling(10.0, 12.0, pace_s))
    before = host.of(MotionMeasurement)[-1].motion
    host.firmware.reboot(host.now_ns)
    host.until(START_NS + 14 * S, rolling(12.0, 14.0, pace_s))
    after = host.of(MotionMeasurement)[-1]
    assert after.motion.x_m == pytest.approx(before.x_m + 2.0, abs=0.3)  # some of it was lost meanwhile
    assert after.motion.speed_mps == pytest.approx(1.0, rel=0.03)
    assert after.motion.yaw_rad == pytest.approx(0.0, abs=0.05)
    assert after.stamp.time_ns == pytest.approx(host.now_ns, abs=40 * MS)
    assert host.measured.gates.counts[verdicts.CLOCK_RESTARTED] == 1
    stamps_ns = [result.stamp.time_ns for result in host.of(MotionMeasurement)]
    assert all(earlier < later for earlier, later in zip(stamps_ns, stamps_ns[1:]))


def test_pongs_alone_are_heard_however_far_apart_the_gates_let_them_be():
    measured = Measurements(MeasurementConfig(gates=GateConfig(max_gap_ms=20_000)))
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
    measured = Measurements(on_motion=lambda result, received_ns: results.append(received_ns))
    for count in range(3):
        measured.queue_wheels(report_of(count), START_NS + 100 * count * MS)
    assert measured.has_queued and results == []
    end(measured)
    assert not measured.has_queued and results == [START_NS + 100 * count * MS for count in range(3)]


def test_queue_is_bounded_and_a_refused_report_in_it_makes_nothing():
    results = []
    measured = Measurements(on_motion=lambda result, received_ns: results.append(received_ns))
    for count in range(MAX_QUEUED):
        assert results == []
        measured.queue_wheels(report_of(count), START_NS + 100 * count * MS)
    assert len(results) == MAX_QUEUED and not measured.has_queued
    measured.queue_wheels(WheelStatus(*2 * (Wheel(65535, FORWARD, 1000, 1, 1),)), START_NS + S)
    measured.process_queue()
    assert len(results) == MAX_QUEUED and not measured.has_queued and measured.gates.refused == 1
