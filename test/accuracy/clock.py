#!/usr/bin/env python3
"""How well the Teensy's ticks become host time, measured on the virtual Teensy, whose true clock is known.

    PYTHONPATH=src:test python3 -m accuracy.clock

Exit code 1 when 99 % of the stamps aren't within 1 ms of the truth, from 10 s after start or reboot on, or when less
than 99.9 % of the truths lie within the uncertainty that came with them. Half a millisecond of the error is the tick's.

Idle: sonars every 50 ms and more, a pulse of each wheel every 0.3 s. Saturated: no wait between the sonars, a report of
the wheels every 5 ms, and all counters once a second, which is more than the cars' firmware ever sends.

An error is that of a stamp against the true time of what it stands for: a wheel's last pulse, a sonar's echo, the
making of a pong. Beside it what one-way methods make of the same bytes: receipt minus tick, of the newest tick.
"""
from __future__ import annotations

import math
import random
import sys
from collections import deque
from dataclasses import dataclass, field

from car_interface.sim.line import BitErrors
from car_interface.sim.teensy_firmware import FirmwareConfig, TeensyFirmware
from car_interface.sim.teensy_sensors import BACKWARD, ECHO_RISE_US, FORWARD
from car_interface.teensy.link import protocol
from car_interface.teensy.link.framing import RESYNC_FILLER, SHIPPED, FrameDecoder, encode
from car_interface.teensy.link.pinging import Pinger
from car_interface.teensy.sensing.clock import Clock
from car_interface.teensy.sensing.plausibility import Gates

NS_PER_S, NS_PER_MS, NS_PER_US = 1_000_000_000, 1_000_000, 1_000
BYTE_NS = 10 * NS_PER_S / 115200
PONG_BYTES, SONAR_BYTES, WHEEL_BYTES = 14, 14, 38
START_NS = 5_000 * NS_PER_S
LOOK_NS = 100 * NS_PER_US  # so often the host's UART is looked at: about a byte
SCORED_AFTER_NS = 10 * NS_PER_S
GOAL_MS, GOAL_SHARE = 1.0, 0.999


@dataclass(frozen=True)
class Scenario:
    name: str
    saturated: bool = False
    drift_ppm: float = 0.0
    ramp_ppm_per_h: float = 0.0
    clock_start_ms: int = 12_345
    reboot_s: float = 0.0  # when the Teensy reboots; 0 = never
    bit_errors: float = 0.0  # the share of bits that are wrong, both ways
    seconds: float = 120.0
    seed: int = 1


@dataclass
class Score:
    """What came of it; errors in ms."""

    clock: list = field(default_factory=list)
    newest: list = field(default_factory=list)  # by the newest tick's offset
    inside: int = 0  # truths within the uncertainty
    bytes_per_s: float = 0.0
    converged_s: float = math.nan

    @property
    def share(self) -> float:
        return self.inside / max(1, len(self.clock))

    def failures(self) -> list[str]:
        p99_ms = percentile(self.clock, 0.99)
        late = [f"p99 {p99_ms:.3f} ms > {GOAL_MS} ms"] if p99_ms > GOAL_MS else []
        dishonest = [f"only {self.share:.2%} of the truths within the uncertainty"] if self.share < GOAL_SHARE else []
        return late + dishonest


def percentile(values: list, share: float) -> float:
    """The value that this share of them doesn't exceed."""
    return sorted(values)[min(len(values) - 1, int(share * len(values)))] if values else math.nan


class Bench:
    """A virtual Teensy, a host that sometimes writes and reads late, and the truth."""

    def __init__(self, scenario: Scenario):
        self._scenario = scenario
        self._random = random.Random(scenario.seed)
        self._noise = BitErrors(scenario.seed), BitErrors(scenario.seed + 1)
        for noise in self._noise:
            noise.set_rate(scenario.bit_errors)
        self._teensy = TeensyFirmware(
            FirmwareConfig(clock_start_ms=scenario.clock_start_ms, clock_drift_ppm=scenario.drift_ppm,
                           clock_ramp_ppm_per_h=scenario.ramp_ppm_per_h), self._echo_us, START_NS)
        self._truth: dict = {}  # (what, tick) → when it was
        self._ping_truth: dict = {}  # timestamp1 → when its pong was made
        self._wire_free_ns = START_NS
        self._writes: deque = deque()  # (when the UART gets it, bytes, timestamp1 of the ping in it)
        self._arrived = b""
        self._read_ns = math.inf
        self._period_ns = 2_700 * NS_PER_US if scenario.saturated else 300 * NS_PER_MS
        self._pulses = [[START_NS + self._period_ns, 0], [START_NS + self._period_ns * 3 // 2, 1]]
        self._counters_ns = START_NS + NS_PER_S if scenario.saturated else math.inf
        self._reboot_ns = START_NS + round(scenario.reboot_s * NS_PER_S) if scenario.reboot_s else math.inf
        self._decoder = FrameDecoder()
        self._gates = Gates()
        self._pinger = Pinger(NS_PER_S, SHIPPED, START_NS + NS_PER_S // 2)
        self._clock = Clock()
        self._newest_ns = None  # receipt minus tick
        self._score_from_ns = START_NS + SCORED_AFTER_NS
        self._score = Score()

    def run(self) -> Score:
        now_ns = START_NS
        end_ns = START_NS + round(self._scenario.seconds * NS_PER_S)
        self._write(RESYNC_FILLER, now_ns)
        if self._scenario.saturated:
            self._write(encode(protocol.sonar_wait(0), SHIPPED), now_ns)
        look_ns = now_ns
        while now_ns < end_ns:
            now_ns = min(look_ns, self._pulses[0][0], self._pinger.next_event_ns(), self._read_ns, self._counters_ns,
                         self._reboot_ns, self._writes[0][0] if self._writes else math.inf)
            self._drive(now_ns)
            self._talk(now_ns)
            if now_ns >= look_ns:
                look_ns += LOOK_NS
                self._look(now_ns)
            if now_ns >= self._read_ns:
                self._read(now_ns)
        self._score.bytes_per_s = self._decoder.tally.bytes_in / self._scenario.seconds
        return self._score

    def _echo_us(self, sensor, at_ns):
        """Of walls at all distances; the time at which it's heard is the truth of the sonar's tick."""
        echo_us = self._random.randrange(1_000, 14_000)
        heard_ns = at_ns + (ECHO_RISE_US + echo_us) * NS_PER_US
        if hasattr(self, "_teensy"):
            self._truth["sonar", sensor, self._teensy.clock.millis(heard_ns)] = heard_ns
        return echo_us

    def _drive(self, now_ns):
        while self._pulses[0][0] <= now_ns:
            at_ns, side = self._pulses[0]
            self._truth["wheel", side, self._teensy.clock.millis(at_ns)] = at_ns
            self._teensy.wheel_pulse(side, BACKWARD if side and not self._scenario.saturated else FORWARD, at_ns)
            self._pulses[0][0] += round(self._period_ns * self._random.uniform(0.97, 1.03))
            self._pulses.sort()
        if now_ns >= self._reboot_ns:
            self._reboot_ns = math.inf
            self._truth.clear()
            self._teensy.reboot(now_ns)
            self._score_from_ns = now_ns + SCORED_AFTER_NS
            if self._scenario.saturated:
                self._write(encode(protocol.sonar_wait(0), SHIPPED), now_ns + 400 * NS_PER_MS)  # it has booted

    def _write(self, data, now_ns, timestamp1=None):
        late_ns = self._random.uniform(0.2, 2.0) if self._random.random() < 0.02 else self._random.uniform(0, 0.2)
        at_ns = now_ns + round(late_ns * NS_PER_MS)
        if self._writes:
            at_ns = max(at_ns, self._writes[-1][0])
        self._writes.append((at_ns, data, timestamp1))

    def _talk(self, now_ns):
        while self._writes and self._writes[0][0] <= now_ns:
            at_ns, data, timestamp1 = self._writes.popleft()
            self._wire_free_ns = max(at_ns, self._wire_free_ns) + math.ceil(len(data) * BYTE_NS)
            if timestamp1 is not None:
                self._ping_truth[timestamp1] = self._wire_free_ns
            self._teensy.receive(self._noise[0].flip(data), at_ns)
        if now_ns >= self._pinger.next_event_ns():
            self._pinger.expire(now_ns)
        if now_ns >= self._pinger.due_ns:
            timestamp1 = now_ns // NS_PER_MS % protocol.UINT32
            self._write(self._pinger.ping(timestamp1, now_ns), now_ns, timestamp1)
        if now_ns >= self._counters_ns:
            self._counters_ns += NS_PER_S
            self._write(encode(protocol.SEND_COUNTERS, SHIPPED), now_ns)

    def _look(self, now_ns):
        arrived = self._teensy.transmit(now_ns)
        if arrived:
            self._arrived += self._noise[1].flip(arrived)
            if self._read_ns == math.inf:
                late_ms = self._random.expovariate(1 / 0.3)
                if self._random.random() < 0.01:
                    late_ms += self._random.uniform(5, 10)
                self._read_ns = now_ns + round(late_ms * NS_PER_MS)

    def _read(self, now_ns):
        self._arrived += self._teensy.transmit(now_ns) if not self._scenario.bit_errors else b""
        data, self._arrived, self._read_ns = self._arrived, b"", math.inf
        for body in self._decoder.feed(data):
            record = protocol.decode(body)
            if isinstance(record, protocol.Pong):
                self._on_pong(record, now_ns)
            elif isinstance(record, protocol.SonarStatus):
                self._on_sonar(record, now_ns)
            elif isinstance(record, protocol.WheelStatus) and self._gates.wheels(record).accepted:
                for side, wheel in enumerate(record):
                    if wheel.direction != protocol.NO_DIRECTION:
                        truth_ns = self._truth.get(("wheel", side, wheel.when))
                        self._judge(wheel.when, truth_ns, now_ns, WHEEL_BYTES)

    def _on_pong(self, record, now_ns):
        answer = self._pinger.pong(record.timestamp1, now_ns)
        verdict = self._gates.pong(record, answer is not None)
        if not verdict.accepted:
            return
        self._restart_if(verdict)
        sync = self._clock.pong(record.timestamp2, answer.sent_ns, answer.sent_bytes, now_ns, PONG_BYTES)
        if sync.converged and math.isnan(self._score.converged_s):
            self._score.converged_s = (now_ns - START_NS) / NS_PER_S
        self._on_tick(record.timestamp2, self._ping_truth.pop(record.timestamp1, None), now_ns, PONG_BYTES)

    def _on_sonar(self, record, now_ns):
        verdict = self._gates.sonar(record)
        if verdict.accepted:
            self._restart_if(verdict)
            self._clock.update_tick(record.when, now_ns, SONAR_BYTES)
            self._on_tick(record.when, self._truth.get(("sonar", record.sensor, record.when)), now_ns, SONAR_BYTES)

    def _restart_if(self, verdict):
        if verdict.restarted:
            self._clock.restart()
            self._newest_ns = None
            self._pinger.retry_now()

    def _on_tick(self, tick, truth_ns, now_ns, byte_count):
        self._newest_ns = now_ns - round(byte_count * BYTE_NS) - middle_ns(self._clock.unwrap(tick))
        self._judge(tick, truth_ns, now_ns, byte_count)

    def _judge(self, tick, truth_ns, now_ns, byte_count):
        if truth_ns is None or now_ns < self._score_from_ns or self._newest_ns is None:
            return
        score, stamp = self._score, self._clock.translate(tick, now_ns, byte_count)
        score.clock.append(abs(stamp.time_ns - truth_ns) / NS_PER_MS)
        score.inside += abs(stamp.time_ns - truth_ns) <= stamp.uncertainty_ns
        newest_ns = middle_ns(self._clock.unwrap(tick)) + self._newest_ns
        score.newest.append(abs(newest_ns - truth_ns) / NS_PER_MS)


def middle_ns(tick: int) -> int:
    """The Teensy's time in the middle of a tick."""
    return (2 * tick + 1) * NS_PER_MS // 2


def run(scenario: Scenario) -> Score:
    return Bench(scenario).run()


def scenarios(seconds: float) -> list[Scenario]:
    found = []
    for saturated in (False, True):
        load = "saturated" if saturated else "idle"
        for name, changes in (
                *((f"{drift_ppm:+d} ppm", {"drift_ppm": drift_ppm}) for drift_ppm in (0, 40, -40, 100, -100)),
                ("+20 ppm/h", {"ramp_ppm_per_h": 20, "seconds": 5 * seconds}),
                ("wrap", {"drift_ppm": 40, "clock_start_ms": protocol.UINT32 - round(500 * seconds)}),
                ("reboot", {"drift_ppm": 40, "reboot_s": seconds / 2}),
                ("1e-4 bits wrong", {"drift_ppm": 40, "bit_errors": 1e-4})):
            found.append(Scenario(f"{name}, {load}", saturated, **{"seconds": seconds, **changes}))
    return found


HEADING = (f"{'':26}|{'line':>6} |{'the clock: error in ms':>24} {'truth':>8} |{'newest tick':>20}\n"
           f"{'':26}|{'kB/s':>6} |{'median':>8}{'p99':>8}{'max':>8} {'within':>8} |{'median':>7}{'p99':>7}{'max':>6}")


def row(name: str, score: Score) -> str:
    def three(values, width, digits):
        shown = (percentile(values, 0.5), percentile(values, 0.99), max(values, default=math.nan))
        return "".join(f"{value:{width}.{digits}f}" for value in shown)
    return (f"{name:26}|{score.bytes_per_s / 1000:6.1f} |{three(score.clock, 8, 3)} {score.share:8.2%} |"
            f"{three(score.newest, 7, 2)}")


def main() -> int:
    print(HEADING)
    failed = False
    for each in scenarios(120.0):
        score = run(each)
        failed = failed or bool(score.failures())
        print(row(each.name, score), *(f"FAILED: {failure}" for failure in score.failures()), flush=True)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
