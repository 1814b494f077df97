"""Turns the Teensy's records into measurements: checked, in SI units, stamped on the host's monotonic clock.

Consumes each pong, sonar report and wheel report with the time at which it was read; records that the plausibility
gates accept go through clock, ranging or odometry. The live node and the replay of a recording both use it.
"""
from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Callable, NamedTuple

from car_interface.common.units import NS_PER_MS, NS_PER_S
from car_interface.common.vehicle_geometry import SONARS
from car_interface.teensy.link.pinging import Answer
from car_interface.teensy.link.protocol import UINT32, Pong, SonarStatus, WheelStatus, ahead
from car_interface.teensy.link.reboot import reached_tick
from car_interface.teensy.sensing.clock import Clock, Stamp, Sync
from car_interface.teensy.sensing.odometry import Motion, Odometry, OdometryConfig
from car_interface.teensy.sensing.plausibility import MAX_GAP_MS, Gates, has_pulsed
from car_interface.teensy.sensing.ranging import BOOT_MS, FIRMWARE_WAIT_MS, EchoPulses, Ranging, RangingConfig

# The smallest frames on the line: with checksum and closing flag, without escapes, with a shared opening flag. The time
# that is subtracted from the receipt for them must not be more than the line took.
PONG_BYTES, SONAR_BYTES, WHEEL_BYTES = 14, 14, 38
TICK_MIDDLE_MS = 0.5
# On a full line reports leave up to 16 ms late, so that a clock without pongs yet is late by as much.
MAX_CLOCK_ERROR_MS = 16
MAX_SILENCE_NS = NS_PER_S  # a standing car's wheels are reported every 0.2 s
MAX_QUEUED = 10  # reports of the wheels: raw messages must not wait long behind them


@dataclass(frozen=True)
class MeasurementConfig:
    """One car's sensors."""

    odometry: OdometryConfig = field(default_factory=OdometryConfig)
    ranging: RangingConfig = field(default_factory=RangingConfig)
    baud: int = 115200  # of the serial line
    max_gap_ms: int = MAX_GAP_MS


class RangeMeasurement(NamedTuple):
    stamp: Stamp
    sensor: int  # index in SONARS
    range_m: float  # never NaN


class MotionMeasurement(NamedTuple):
    stamp: Stamp
    motion: Motion


class Measurements:
    """Everything that one Teensy measures.

    Args:
        on_motion: called with the measurement of each queued report of the wheels.

    Attributes:
        queue: reports of the wheels that wait, and when they were received.
    """

    def __init__(self, config: MeasurementConfig = MeasurementConfig(),
                 on_motion: Callable[[MotionMeasurement], None] = lambda measured: None):
        self.gates = Gates(config.odometry.pulse_m, config.odometry.top_speed_mps, config.max_gap_ms)
        self.clock = Clock(config.baud)
        self.ranging = Ranging(config.ranging)
        self._pulses = EchoPulses()
        self._odometry = Odometry(config.odometry)
        self._on_motion = on_motion
        self.queue: list[tuple] = []
        self._received_ns = 0  # when the newest record was received
        self._answered: tuple | None = None  # the newest pong's tick, and when it was received
        self._shift_ms = 0.0  # from the Teensy's clock to the odometry's, which never restarts
        self._newest_ms = -math.inf  # of the wheels' pulses and repeats, on the odometry's clock
        # Of the newest of each kind: stamps rise even when the relation of the clocks changes.
        self._motion_ns = 0
        self._range_ns = [0] * len(SONARS)

    def pong(self, record: Pong, answer: Answer | None, received_ns: int) -> Sync | None:
        """Take a pong, and the ping that it answers (``None``: no ping of ours); return ``None`` if it was refused."""
        self.process_queue()
        self._note_receipt(received_ns)
        reached = self._answered and answer and reached_tick(*self._answered, answer.sent_ns)
        verdict = self.gates.pong(record, answer is not None, reached)
        if not verdict.accepted:
            return None
        self._update_tick(verdict, record.timestamp2, received_ns)
        self._answered = (record.timestamp2, received_ns)
        return self.clock.pong(record.timestamp2, answer.sent_ns, answer.sent_bytes, received_ns, PONG_BYTES)

    def sonar(self, record: SonarStatus, received_ns: int, is_trusted: bool = True,
              wait_ms: int = FIRMWARE_WAIT_MS) -> RangeMeasurement | None:
        """Take a sonar's report, and SONAR_WAIT; return ``None`` if it was refused, or has no range."""
        self.process_queue()
        self._note_receipt(received_ns)
        verdict = self.gates.sonar(record)
        if not verdict.accepted:
            return None
        self._update_tick(verdict, record.when, received_ns)
        self.clock.update_tick(record.when, received_ns, SONAR_BYTES)
        echo_us = self._pulses.unwrap_us(record.echo_us, record.when, wait_ms)
        range_m = self.ranging.range(record.sensor, echo_us, record.when, is_trusted)
        if range_m is None:
            return None
        time_ns, uncertainty_ns = self.clock.translate(record.when, received_ns, SONAR_BYTES)
        time_ns = self._range_ns[record.sensor] = max(time_ns, self._range_ns[record.sensor] + 1)
        return RangeMeasurement(Stamp(time_ns, uncertainty_ns), record.sensor, range_m)

    def wheels(self, record: WheelStatus, received_ns: int) -> MotionMeasurement | None:
        """Take a report of the wheels; return ``None`` if it was refused."""
        self.process_queue()
        return self._measure_motion(record, received_ns)

    def queue_wheels(self, record: WheelStatus, received_ns: int) -> None:
        """Take a report of the wheels for later: several in a row cost less than one by one.

        It is processed before any later record, so that order and results are the same as with ``wheels``.
        """
        self.queue.append((record, received_ns))
        if len(self.queue) == MAX_QUEUED:
            self.process_queue()

    def process_queue(self) -> None:
        """Process the queued reports of the wheels, and call ``on_motion`` with their measurements."""
        queue, self.queue = self.queue, []
        for record, received_ns in queue:
            measured = self._measure_motion(record, received_ns)
            if measured is not None:
                self._on_motion(measured)

    def _note_receipt(self, received_ns):
        """Forget the sonars' rhythm while nothing came: the time to a later report is no echo."""
        if received_ns - self._received_ns > MAX_SILENCE_NS:
            self._pulses.restart()
        self._received_ns = received_ns

    def _measure_motion(self, record, received_ns):
        self._note_receipt(received_ns)
        verdict = self.gates.wheels(record)
        if not verdict.accepted:
            return None
        ticks = [wheel.when for wheel in record if has_pulsed(wheel)]  # of the newest pulses or repeats
        newest = max(ticks, key=lambda tick: ahead(tick, ticks[0])) if ticks else None
        if self.clock.newest is None:
            if newest is None:
                return None
            self.clock.update_tick(newest, received_ns, WHEEL_BYTES)
        if verdict.boot_tick is not None:
            self._restart_clock(verdict.boot_tick, received_ns)
        received_ms = self.clock.tick_at(received_ns) + self._shift_ms
        times_ms = [self.clock.unwrap(wheel.when) + self._shift_ms if has_pulsed(wheel) else -math.inf
                    for wheel in record]
        # It is unknown when a report was sent; but there was no later pulse before its newest pulse or repeat.
        newest_ms = -math.inf if newest is None else self.clock.unwrap(newest) + self._shift_ms
        is_news = self._newest_ms < newest_ms <= received_ms + MAX_CLOCK_ERROR_MS
        if is_news:
            self._newest_ms = newest_ms
        counted_ms = self._shift_ms + BOOT_MS if verdict.since_boot else None
        motion = self._odometry.report(record, verdict, times_ms,
                                       newest_ms + TICK_MIDDLE_MS if is_news else received_ms, counted_ms)
        stamp = self._stamp(motion.time_ms - self._shift_ms, received_ns)
        # While a stamp is uncertain, an accelerating car's speed at that stamp is, too: a bound is three sigma.
        late_mps = self._odometry.acceleration_mps2 * stamp.uncertainty_ns / NS_PER_S / 3
        return MotionMeasurement(stamp, motion._replace(speed_variance=motion.speed_variance + late_mps ** 2))

    def steer(self, curvature_per_m: float) -> None:
        """Set the commanded curvature, left positive, for an odometry that uses it; NaN = unknown."""
        self.process_queue()
        self._odometry.steer(curvature_per_m)

    def _stamp(self, time_ms, received_ns):
        """Return the stamp of a time between ticks, always later than the one before: tf refuses a repeated stamp."""
        tick = math.floor(time_ms)
        time_ns, uncertainty_ns = self.clock.translate(tick % UINT32, received_ns, WHEEL_BYTES)
        time_ns += round((time_ms - tick - TICK_MIDDLE_MS) * NS_PER_MS)
        time_ns = self._motion_ns = max(min(time_ns, received_ns), self._motion_ns + 1)
        return Stamp(time_ns, uncertainty_ns)

    def _update_tick(self, verdict, tick, received_ns):
        """Continue the odometry's time when the Teensy's clock restarts."""
        if verdict.restarted and self.clock.newest is not None:
            self._restart_clock(tick, received_ns)

    def _restart_clock(self, tick, received_ns):
        """Begin with a tick of the new clock: the Teensy rebooted."""
        self._shift_ms += self.clock.tick_at(received_ns) - tick
        self._answered = None
        self.clock.restart()
        self._pulses.restart()
        self.clock.update_tick(tick, received_ns, 0)
