"""Decides when the guard of a servo board acts in place of its node, and what it then does.

The node regularly sends signs of life. When they stop, or its pipe ends, the guard brings every channel to its timeout
value, verifies that by reading back, and repeats both until the node acknowledges or another node has the board. When
nobody has taken over for a while, it switches every output off; then it ends, if its node is dead.

Pure: bytes of the pipe and ``now_ns`` in, actions out. It imports as little as it can: the guard's process is small.
"""
from __future__ import annotations

import errno

from car_interface.common.units import CHANNELS, NS_PER_MS, NS_PER_S
from car_interface.pca9685.guard_protocol import (
    ACTING,
    ENDED,
    ENDING,
    NOT_TRIED,
    OFF,
    SAFE,
    WAITING,
    WATCHING,
    GuardMessage,
    node_reader,
)

# A node without five signs of life is taken for frozen: that takes as long as a channel's own timeout.
SILENCE_NS = 250 * NS_PER_MS
ENDING_SILENCE_NS = 5 * NS_PER_S  # a node that shuts down makes the chip safe by itself, and tries for this long
MIN_NEUTRAL_NS = 100 * NS_PER_MS  # before full off: more than two periods at the largest prescale, 2 · 43 ms
CHECK_PERIOD_NS = 50 * NS_PER_MS  # of reading the chip back while it holds the timeout values
OFF_CHECK_PERIOD_NS = 500 * NS_PER_MS
PROBE_PERIOD_NS = NS_PER_S
FIRST_RETRY_NS, LAST_RETRY_NS = 20 * NS_PER_MS, 200 * NS_PER_MS
LASTING_NS = 500 * NS_PER_MS  # a node that was frozen for less than this publishes the guard's writes soon itself
MAX_LASTING_NS = 8 * NS_PER_S  # doubled up to here each time that the node came back, until it was steady for:
STEADY_NS = 60 * NS_PER_S
GIVE_UP_NS = 600 * NS_PER_S  # a dead node's guard that can't reach the chip ends at last

# Actions. After each of them one of ``succeeded``, ``failed`` and ``finish`` is called.
NOTHING = "nothing"
PROBE = "probe"  # read a register while the node lives; claim the board as the newest guard if the node has reached it
ASSERT = "assert"  # write the timeout values, and read them back
CHECK = "check"  # read back, and write what differs from the timeout values
SWITCH_OFF = "switch off"
END = "end"


class Guard:
    """The decisions of one guard, which switches every output off ``off_after_ns`` after it began to act."""

    def __init__(self, off_after_ns: int):
        self.state = WAITING
        self.interventions = 0
        self.timeout_counts = (0,) * CHANNELS
        self.node_is_dead = False
        self._off_after_ns = off_after_ns
        self._limit_ns = SILENCE_NS
        self._messages = node_reader()
        self._sequence = 0
        self._last_ns = 0  # the newest sign of life
        self._since_ns = 0  # when it began to act
        self._lasting_ns = LASTING_NS
        self._back_ns = 0  # when the node came back last
        self._safe_ns = 0  # when the timeout values were verified first
        self._try_ns = 0
        self._retry_ns = FIRST_RETRY_NS
        self.node_has_reached = False  # the node reached the chip at least once
        self._has_reached = False  # the node or the guard did
        self._is_claimed = False  # older guards of the chip know of this one
        self._error = NOT_TRIED
        self._is_over = False

    @property
    def is_acting(self) -> bool:
        return self.state in (ACTING, SAFE, OFF)

    def acts_alone(self, now_ns: int) -> bool:
        """Return whether nobody else publishes what the chip holds: the node is dead, or silent for a longer time.

        A process that then publishes it has to be started. On a computer that stands still again and again these starts
        would be a load, so the more often the node has come back, the longer it has to be silent.
        """
        return self.is_acting and (self.node_is_dead or now_ns - self._since_ns >= self._lasting_ns)

    def status(self) -> bytes:
        return GuardMessage(self.state, self._sequence, self.interventions, self._error).encode()

    def receive(self, data: bytes, now_ns: int) -> None:
        """Take bytes of the node's pipe; none = it ended."""
        if not data:
            self.node_is_dead = True
        for message in self._messages.feed(data):
            self._receive_message(message, now_ns)

    def _receive_message(self, message, now_ns):
        self._last_ns = now_ns
        self._sequence = message.sequence
        self.timeout_counts = message.timeout_counts
        self.node_has_reached |= message.has_reached
        self._has_reached |= message.has_reached
        self._limit_ns = ENDING_SILENCE_NS if message.kind == ENDING else SILENCE_NS
        self._is_over |= message.kind == ENDED
        if self.state == WAITING or self.is_acting and message.acknowledged == self.interventions:
            if self.acts_alone(now_ns):
                self._lasting_ns = min(2 * self._lasting_ns, MAX_LASTING_NS)
            self._back_ns = now_ns
            self.state = WATCHING
            self._try_ns = now_ns

    def next_due_ns(self) -> float:
        """Return when ``action`` must be called even if nothing is received."""
        if self.state == WAITING:
            return float("inf")
        if self.state != WATCHING:
            return self._try_ns
        silent_ns = self._last_ns + self._limit_ns if self._has_reached else float("inf")
        return min(silent_ns, self._try_ns if self._must_probe() else silent_ns)

    def _must_probe(self):
        return self._error != 0 or self.node_has_reached and not self._is_claimed

    def action(self, now_ns: int) -> str:
        if self._is_over or self.node_is_dead and not self.is_acting and not self._has_reached:
            return END
        is_silent = self.state == WATCHING and now_ns - self._last_ns >= self._limit_ns
        if not self.is_acting and self._has_reached and (self.node_is_dead or is_silent):
            self.interventions += 1
            self.state = ACTING
            self._since_ns = self._try_ns = now_ns
            if now_ns - self._back_ns >= STEADY_NS:
                self._lasting_ns = LASTING_NS
            self._retry_ns = FIRST_RETRY_NS
        return self._due_action(now_ns)

    def _due_action(self, now_ns):
        if self.node_is_dead and (self.state == OFF or self.state == ACTING
                                  and now_ns - self._since_ns >= GIVE_UP_NS):
            return END
        if now_ns < self._try_ns:
            return NOTHING
        if self.state == ACTING:
            return ASSERT
        if self.state == SAFE:
            off_ns = max(self._since_ns + self._off_after_ns, self._safe_ns + MIN_NEUTRAL_NS)
            return SWITCH_OFF if now_ns >= off_ns else CHECK
        if self.state == OFF:
            return SWITCH_OFF
        return PROBE if self.state == WATCHING and self._must_probe() else NOTHING

    def succeeded(self, action: str, now_ns: int) -> None:
        """Take note that an action was done and verified."""
        self._error = 0
        self._has_reached = True
        self._retry_ns = FIRST_RETRY_NS
        self._is_claimed |= self.node_has_reached or action != PROBE
        if action == SWITCH_OFF:
            self.state = OFF
            self._try_ns = now_ns + OFF_CHECK_PERIOD_NS
        elif action in (ASSERT, CHECK):
            if self.state == ACTING:
                self.state = SAFE
                self._safe_ns = now_ns
            self._try_ns = now_ns + CHECK_PERIOD_NS

    def failed(self, action: str, number: int | None, now_ns: int) -> None:
        """Take note that an action failed, with the errno of the bus's error."""
        self._error = number or errno.EIO
        if action == PROBE:
            self._try_ns = now_ns + PROBE_PERIOD_NS
            return
        if self.state == SAFE and action == CHECK:
            self.state = ACTING
        self._try_ns = now_ns + self._retry_ns
        self._retry_ns = min(2 * self._retry_ns, LAST_RETRY_NS)

    def finish(self) -> None:
        """End: another node has the board, or the board is gone for good."""
        self._is_over = True
