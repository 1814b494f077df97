"""Whether a node's thread stood still: it was frozen, or held up, beyond the time at which it was to act next.

What was sent to a process while it was frozen arrives when that goes on, and looks new: its times of arrival are wrong
by as long as the process stood still.

Pure: ``now_ns`` in.
"""
from __future__ import annotations

from car_interface.common.units import NS_PER_MS, NS_PER_S

# The timeout of the arbiters' inputs (``human_timeout`` and the others): after so long each input is stale anyway, so
# that a computer which is only busy stops no car that its timeouts wouldn't stop. Less makes an input look younger by
# less than its timeout.
STANDSTILL_NS = 500 * NS_PER_MS
MAX_WAIT_NS = NS_PER_S  # a node's thread wakes at least so often


class StandstillWatch:
    """Compares when a thread was to wake with when it did, and how long its steps take.

    Args:
        now_ns: its first step is due now.
    """

    def __init__(self, now_ns: int):
        self._expected_ns = now_ns

    def begin_step(self, now_ns: int) -> int:
        """A step begins; returns for how long the thread has stood still before it, 0 = it hasn't."""
        late_ns = now_ns - self._expected_ns
        self._expected_ns = now_ns
        return late_ns if late_ns >= STANDSTILL_NS else 0

    def end_step(self, now_ns: int, due_ns: float) -> None:
        """A step has ended and the next one is due at ``due_ns``; a step that lasted too long counts before that."""
        if now_ns - self._expected_ns < STANDSTILL_NS:
            self._expected_ns = int(max(now_ns, min(due_ns, now_ns + MAX_WAIT_NS)))
