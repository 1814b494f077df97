"""Log lines about repeated faults: counted by kind, logged at most every 10 s each."""
from __future__ import annotations

from collections import Counter
from typing import Callable

import rospy

from car_interface.common.units import NS_PER_S
from car_interface.ros.clocks import Clocks

WARNING_PERIOD_NS = 10 * NS_PER_S


class ThrottledWarnings:
    """Counts faults by kind, and logs each kind at once and then at most every 10 s.

    Args:
        clocks: the node's.
        log: rospy's function of the level.
    """

    def __init__(self, clocks: Clocks, log: Callable = rospy.logwarn):
        self.counts: Counter = Counter()
        self._clocks = clocks
        self._log = log
        self._next_log_ns: dict[str, int] = {}

    def warn(self, kind: str, text: str, count: int = 1) -> None:
        """Count ``count`` of ``kind``; log ``text`` and the sum so far unless this kind was logged recently."""
        self.counts[kind] += count
        now_ns = self._clocks.now_ns()
        if now_ns >= self._next_log_ns.get(kind, 0):
            self._next_log_ns[kind] = now_ns + WARNING_PERIOD_NS
            times = self.counts[kind]
            self._log("%s%s", text, f" ({times} so far)" if times > 1 else "")
