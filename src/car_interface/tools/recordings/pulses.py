"""Collects the wheels' pulses from a recording of the Teensy's raw reports.

The reports pass the same plausibility checks and the same clock as in a live node.
"""
from __future__ import annotations

from array import array
from typing import Any

import numpy as np

from car_interface.teensy.link.protocol import Pong, Wheel, WheelStatus
from car_interface.teensy.sensing.clock import Clock
from car_interface.teensy.sensing.measurements import PONG_BYTES, WHEEL_BYTES
from car_interface.teensy.sensing.plausibility import Gates
from car_interface.tools.recordings.columns import MAX_STAMP_OFFSET_S, Pulses, Timeline, message_stamp_ns

WHEEL_TOPIC, CLOCK_TOPIC = "teensy_wheel", "teensy_clock"
REFUSED = "of the wheels that make no sense: left out"
MIN_STEP_S = 1e-6  # between pulses that were translated to the same time: none may be left out


class PulseColumns:
    """The pulses of the left and the right wheel, from ``WHEEL_TOPIC`` and ``CLOCK_TOPIC``; like a StampedColumn."""

    def __init__(self, topic):
        self.topic = topic
        self._gates, self._clock = Gates(), Clock()
        self._to_monotonic_ns = None  # from ROS time; known with the first pong
        self._pending = []  # reports before that: arguments of _add_wheels
        self._has_tick = False
        self._wheel_times, self._counts = (array("d"), array("d")), (array("q"), array("q"))
        self._without_direction = [0, 0]
        self._refused = 0

    def add(self, recorded: Any, now_s: float, timeline: Timeline) -> None:
        """Add a ``recording.Recorded`` that was recorded at ``now_s``."""
        message = recorded.message
        if recorded.topic == CLOCK_TOPIC:
            self._to_monotonic_ns = message.received - message_stamp_ns(message)
            self._add_pending()
            self._add_pong(message)
        elif self._to_monotonic_ns is None:
            self._pending.append((recorded, now_s, timeline))
        else:
            self._add_wheels(recorded, now_s, timeline)

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
        for pending in self._pending:
            self._add_wheels(*pending)
        self._pending.clear()

    def _add_pong(self, message):
        verdict = self._gates.pong(Pong(0, message.tick), True)
        if verdict.accepted:
            if verdict.restarted and self._has_tick:
                self._clock.restart()
            self._has_tick = True
            self._clock.pong(message.tick, message.sent, message.sent_bytes, message.received, PONG_BYTES)

    def _add_wheels(self, recorded, now_s, timeline):
        report = WheelStatus(wheel(recorded.message.left), wheel(recorded.message.right))
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
            self._append(side, at_s if abs(at_s - now_s) <= MAX_STAMP_OFFSET_S else now_s,
                         pulses + (undirected if pulses > 0 else -undirected))

    def _append(self, side, at_s, pulses):
        times, counts = self._wheel_times[side], self._counts[side]
        if times and at_s <= times[-1]:
            at_s = times[-1] + MIN_STEP_S
        times.append(at_s)
        counts.append((counts[-1] if counts else 0) + pulses)


def wheel(message) -> Wheel:
    """Return one wheel of a car_interface/Wheel message as the protocol has it."""
    return Wheel(message.speed, message.direction, message.when, message.dist, message.dist_abs)
