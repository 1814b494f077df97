"""Selects the guard's readings of its chip that are published, as the node would: on change, and at 10 Hz.

A reading is published when it arrives or not at all: a repetition by a timer could come after another node has begun
to drive the chip.
"""
from __future__ import annotations

from car_interface.common.units import NS_PER_S
from car_interface.pca9685.registers import duty_of_counts

PERIOD_NS = NS_PER_S // 10
MAX_PENDING = 100  # older ones are dropped: 10 s at 10 Hz


class OutputReadings:
    """The readings of one guard."""

    def __init__(self):
        self.pending: list[list[int]] = []  # 16 duties each, oldest first; their publisher removes them
        self._newest: tuple[int, ...] | None = None
        self._repeat_ns = 0

    def update(self, counts: tuple[int, ...], now_ns: int) -> None:
        """Take a reading: 16 times 0..4096 counts."""
        if counts == self._newest and (now_ns < self._repeat_ns or self.pending):
            return  # it still waits, or was published just now
        self._newest = counts
        self._repeat_ns = now_ns + PERIOD_NS
        self.pending.append([duty_of_counts(each) for each in counts])
        del self.pending[:-MAX_PENDING]
