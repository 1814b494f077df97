"""Keeps the newest value of an input, and whether it is stale.

Age is measured from arrival on the monotonic clock: stamps in messages can be wrong, and ROS time can be set. A
message's stamp (``ros.clocks``) can only add to its age.
"""
from __future__ import annotations

import math

from car_interface.common.units import NS_PER_S

# Reasons why nothing that was received before counts. Messages are dropped by a full inbox, or after the node stood
# still; the newest value may be among them.
DROPPED, STARTED = "messages were dropped", "this node has just started"


class TimedInput:
    """The newest value of one input and its age.

    Args:
        name: the input's name in a reason.
        timeout_s: a value older than this is stale; 0 = never. An input that was never received is always stale.
    """

    def __init__(self, name: str, timeout_s: float):
        self.name = name
        self.value = None
        self._timeout_ns = round(timeout_s * NS_PER_S) if timeout_s else math.inf
        self._arrival_ns = None
        self._age_ns = 0  # at arrival
        self.is_marked_stale = False
        self._stale_since = DROPPED

    def update(self, value, now_ns: int, age_ns: int = 0) -> None:
        """Store ``value``, which arrived at ``now_ns`` and was as old as ``age_ns`` then."""
        self.value = value
        self._arrival_ns, self._age_ns = now_ns, max(0, age_ns)
        self.is_marked_stale = False

    def mark_stale(self, since: str = DROPPED) -> None:
        """Make the input stale until its next message, whatever its timeout; ``since`` says what happened."""
        self.is_marked_stale, self._stale_since = self.was_received, since

    @property
    def was_received(self) -> bool:
        """Return whether a message ever arrived."""
        return self._arrival_ns is not None

    def is_stale(self, now_ns: int) -> bool:
        """Return whether it was never received, is older than its timeout, or was marked stale since."""
        return (self._arrival_ns is None or self.is_marked_stale
                or now_ns - self._arrival_ns + self._age_ns > self._timeout_ns)

    def fresh(self, now_ns: int):
        """Return the newest value; None when it is stale."""
        return None if self.is_stale(now_ns) else self.value

    def age_s(self, now_ns: int) -> float:
        """Return the age of the last message in seconds; inf = never received."""
        return self.silence_s(now_ns) + self.was_late_s

    @property
    def was_late_s(self) -> float:
        """Return how old the last message was when it arrived, in seconds; 0 = not known to be late."""
        return self._age_ns / NS_PER_S

    def silence_s(self, now_ns: int) -> float:
        """Return the seconds since the last message arrived; inf = never received."""
        return math.inf if self._arrival_ns is None else max(0, now_ns - self._arrival_ns) / NS_PER_S

    def stale_reason(self, now_ns: int) -> str:
        """Return why it is stale: ``human_in_loop silent for 0.52 s``, ``odom is 0.63 s old by its stamp``."""
        if not self.was_received:
            return f"{self.name} was never heard"
        if self.is_marked_stale:
            return f"{self.name} was not heard since {self._stale_since}"
        if self._age_ns > now_ns - self._arrival_ns:
            return f"{self.name} is {self.age_s(now_ns):.2f} s old by its stamp"
        return f"{self.name} silent for {self.silence_s(now_ns):.2f} s"
