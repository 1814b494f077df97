"""Which nodes command each channel of the servo board: several may publish, but each on channels of its own."""
from __future__ import annotations

from typing import Sequence

from car_interface.common.servo_channels import UNCHANGED
from car_interface.common.units import NS_PER_S

WINDOW_NS = NS_PER_S  # a node that has not commanded a channel for so long commands it no more


class ChannelSenders:
    """Remembers who commanded which channel."""

    def __init__(self):
        self._times_ns: dict[int, dict[str, int]] = {}  # by channel and node

    def update(self, node: str, duties: Sequence[int], now_ns: int) -> None:
        """A node's vector of duties; ``UNCHANGED`` commands nothing."""
        for channel, duty in enumerate(duties):
            if duty != UNCHANGED:
                self._times_ns.setdefault(channel, {})[node] = now_ns

    def conflicts(self, now_ns: int) -> dict[tuple[str, ...], list[int]]:
        """The channels that several nodes command at the moment, by the names of these nodes, sorted."""
        found: dict[tuple[str, ...], list[int]] = {}
        for channel, times_ns in sorted(self._times_ns.items()):
            recent = {node: at_ns for node, at_ns in times_ns.items() if now_ns - at_ns < WINDOW_NS}
            self._times_ns[channel] = recent
            if len(recent) > 1:
                found.setdefault(tuple(sorted(recent)), []).append(channel)
        return found
