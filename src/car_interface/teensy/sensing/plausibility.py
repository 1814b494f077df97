"""Judges the Teensy's records before odometry, clock and ranges use them.

A checksum of eight bits lets some wrong frames past. Each well-formed record is judged here against earlier ones:
device ticks against device ticks and pulses against pulses, and against the host's clock in one thing only: a pong is
younger than its ping. The verdict has whether it may be used, why not, and how many pulses it adds to the distance.

Three rules keep one wrong record from doing harm, and a true jump from being locked out:

- A report of the wheels that brings more pulses than the wheel's own speed explains by ``SURPRISE_PULSES`` waits until
  others confirm it. So a wrong report that is accepted moves a wheel by at most that many pulses, 4.5 cm.
- A record that contradicts the one before it, but follows from the one before that, is accepted, and the pulses of the
  wrong one are taken back.
- Any other contradiction is a jump: the Teensy rebooted, its odometers were reset, or many reports were lost. It is
  accepted with the third of ``CONSISTENT`` records in a row each of which follows from the one before it; none of the
  pulses between these is lost. Odometers at zero that have no direction yet are accepted at once: no other state looks
  like that.

Records of a healthy firmware are never refused. Pure.
"""
from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass

from car_interface.common import declared
from car_interface.teensy.link.protocol import Pong, SonarStatus, WheelStatus
from car_interface.teensy.sensing.tick_gate import TickGate
from car_interface.teensy.sensing.verdicts import CLOCK_RESTARTED, NOT_OUR_PING, Verdict
from car_interface.teensy.sensing.wheel_gate import WheelGate


@dataclass(frozen=True)
class GateConfig:
    """The bounds of the possible."""

    top_speed_mps: float = declared.number(
        "top_speed", 20.0, "of a wheel; anything faster is rejected as line noise", "m/s",
        above=0.0, high=1000)
    pulse_m: float = math.pi * 0.095 / 20  # a wheel's distance from pulse to pulse: 20 around a 9.5 cm wheel
    # Between ticks of a line that is whole; at least two periods of the pings, of which one may be lost.
    max_gap_ms: int = 2_000


class Gates:
    """Judges the records of one Teensy, in the order in which they arrived.

    ``counts`` has the refused records and the notable accepted ones, by reason.
    """

    def __init__(self, config: GateConfig = GateConfig()):
        self.counts: Counter = Counter()
        self.accepted = 0
        self.refused = 0
        self._ticks = TickGate(config.max_gap_ms)
        self._wheels = WheelGate(config.pulse_m, config.max_gap_ms, config.top_speed_mps)

    def pong(self, record: Pong, is_ours: bool, reached: int | None = None) -> Verdict:
        """Judge a pong.

        Args:
            is_ours: it answers a ping that waited (a duplicate answers none).
            reached: when that ping was sent, the clock had passed this tick, unless it restarted; ``None`` = unknown.
        """
        if not is_ours:
            return self._counted(Verdict(False, NOT_OUR_PING))
        return self._counted(self._judge_tick(record.timestamp2, reached))

    def sonar(self, record: SonarStatus) -> Verdict:
        """Judge a sonar's report by its tick: any echo time is possible, see ``ranging``."""
        return self._counted(self._judge_tick(record.when))

    def wheels(self, record: WheelStatus) -> Verdict:
        """Judge a report of the wheels. They may turn in opposite directions: a car can spin."""
        verdict = self._wheels.judge(record, self._ticks.newest, self._ticks.restarts)
        if verdict.boot_tick is not None:
            self._ticks.restart(verdict.boot_tick)
            self.counts[CLOCK_RESTARTED] += 1
        return self._counted(verdict)

    def _judge_tick(self, tick, reached=None):
        if self._wheels.is_zero_again and self._ticks.is_young_again(tick):
            self._ticks.restart(tick)
            return Verdict(True, CLOCK_RESTARTED, restarted=True)
        return self._ticks.judge(tick, reached)

    def _counted(self, verdict):
        self.accepted += verdict.accepted
        self.refused += not verdict.accepted
        if verdict.reason:
            self.counts[verdict.reason] += 1
        return verdict
