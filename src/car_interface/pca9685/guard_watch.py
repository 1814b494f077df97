"""Follows the guard for its node: is it there, has it acted, and may commands be obeyed?

A node that stood still for longer than the guard waits was overruled: the guard has brought the chip to its timeout
values. The node obeys commands again once the guard has answered a later sign of life, so that the guard's last write
comes before the node's first.
"""
from __future__ import annotations

import math
from typing import Sequence

from car_interface.common.units import NS_PER_MS, NS_PER_S
from car_interface.pca9685.guard import SILENCE_NS
from car_interface.pca9685.guard_protocol import ALIVE, NOT_TRIED, WAITING, WATCHING, NodeMessage, guard_reader

PERIOD_NS = 50 * NS_PER_MS  # of the signs of life: a fifth of what the guard waits
ANSWER_NS = 400 * NS_PER_MS  # a guard that doesn't answer for this long hangs: eight periods
BUSY_NS = 3 * NS_PER_S  # the same for a guard that starts, or may wait for a transfer on a bus that is held


class GuardWatch:
    """The node's knowledge of its guard."""

    def __init__(self):
        self.is_present = False  # a guard runs and answers, as far as is known
        self.error = NOT_TRIED  # errno of the guard's last attempt on the chip; 0 = it worked
        self.interventions = 0  # how often guards have acted, as far as the node knows
        self._messages = guard_reader()
        self._sequence = 0
        self._sent_ns = -math.inf  # the newest sign of life
        self._has_reached = False  # the chip, at that time: until then no standstill can do harm
        self._answer_due_ns = math.inf
        self._state = WAITING
        self._interventions = self._acknowledged = 0
        self._obeys_from = 0  # the sign of life that the guard must have answered

    @property
    def due_ns(self) -> float:
        """Return when the next sign of life is due."""
        return self._sent_ns + PERIOD_NS

    @property
    def watches(self) -> bool:
        """Return whether the guard is there and has received a sign of life."""
        return self.is_present and self._state == WATCHING

    @property
    def holds(self) -> bool:
        """Return whether commands must be ignored, since the guard may still be writing."""
        return self.is_present and self._obeys_from > 0

    def start(self, now_ns: int) -> None:
        self.is_present = True
        self.error = NOT_TRIED
        self._messages = guard_reader()
        self._answer_due_ns = now_ns + BUSY_NS
        self._state = WAITING
        self._interventions = self._acknowledged = self._obeys_from = 0

    def lose(self) -> None:
        self.is_present = False

    def receive(self, data: bytes, now_ns: int) -> None:
        """Take bytes of the guard's pipe."""
        for message in self._messages.feed(data):
            is_busy = message.state != WATCHING or message.error != 0
            self._answer_due_ns = now_ns + (BUSY_NS if is_busy else ANSWER_NS)
            self.interventions += message.interventions - self._interventions
            self._state, self._interventions, self.error = message.state, message.interventions, message.error
            if message.state == WATCHING and message.sequence >= self._obeys_from:
                self._obeys_from = 0

    def was_overruled(self) -> bool:
        """Return whether the guard has acted since the last call, by its own messages or by the time."""
        is_new = self.is_present and self._interventions != self._acknowledged
        if is_new:
            self._acknowledge()
        return is_new

    def stood_still_ns(self, now_ns: int) -> int:
        """Return for how long the node gave no sign of life, if that was too long for the guard; else 0."""
        if not self.is_late(now_ns):
            return 0
        self._acknowledge()
        self._answer_due_ns = max(self._answer_due_ns, now_ns + ANSWER_NS)  # an answer could not be received
        return int(now_ns - self._sent_ns)

    def is_late(self, now_ns: int) -> bool:
        """Return whether the newest sign of life is so old that the guard acts."""
        return self._has_reached and now_ns - self._sent_ns >= SILENCE_NS

    def _acknowledge(self):
        self._acknowledged = self._interventions
        self._obeys_from = self._sequence + 1

    def hangs(self, now_ns: int) -> bool:
        """Return whether the guard's answer is overdue."""
        return self.is_present and now_ns > self._answer_due_ns

    def sign_of_life(self, now_ns: int, timeout_counts: Sequence[int], has_reached: bool, kind: int = ALIVE) -> bytes:
        """Return the bytes to write into the guard's pipe now.

        Args:
            timeout_counts: of each channel, 0..4096.
            has_reached: the chip was reached before, and may be pulsing.
            kind: ALIVE, ENDING or ENDED.
        """
        self._sequence += 1
        self._sent_ns = now_ns
        self._has_reached = has_reached
        return NodeMessage(kind, has_reached, self._sequence, self._acknowledged, timeout_counts).encode()
