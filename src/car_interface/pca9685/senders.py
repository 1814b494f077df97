"""Finds which nodes command each channel of the servo board: several may, but each on its own channels. Pure."""
from __future__ import annotations

from typing import Mapping, Sequence

from car_interface.common.causes import CHANNEL_TIMED_OUT
from car_interface.common.publishers import CommandTopic, Fault, Publisher, second_publisher
from car_interface.common.units import NS_PER_S, UNCHANGED
from car_interface.pca9685.channels import TimedOut

WINDOW_NS = NS_PER_S  # a node that has not commanded a channel for this long no longer does: ten periods of 10 Hz


class ChannelSenders:
    """Remembers who commanded which channel."""

    def __init__(self):
        self._times_ns: dict[int, dict[str, int]] = {}  # by channel and node
        self._last: dict[int, str] = {}  # by channel

    def update(self, node: str, duties: Sequence[int], now_ns: int) -> None:
        """Take a node's vector of duties; ``UNCHANGED`` commands nothing."""
        for channel, duty in enumerate(duties):
            if duty != UNCHANGED:
                self._times_ns.setdefault(channel, {})[node] = now_ns
                self._last[channel] = node

    def last(self, channel: int) -> str:
        """Return the node that commanded a channel last, however long ago; empty = none did, or it is unknown."""
        return self._last.get(channel, "")

    def conflicts(self, now_ns: int) -> dict[tuple[str, ...], list[int]]:
        """Return the channels that several nodes command now, by the sorted names of these nodes."""
        found: dict[tuple[str, ...], list[int]] = {}
        for channel, times_ns in sorted(self._times_ns.items()):
            recent = {node: at_ns for node, at_ns in times_ns.items() if now_ns - at_ns < WINDOW_NS}
            self._times_ns[channel] = recent
            if len(recent) > 1:
                found.setdefault(tuple(sorted(recent)), []).append(channel)
        return found

    def conflict_faults(self, now_ns: int, topics: Sequence[CommandTopic]) -> list[Fault]:
        """Return a fault for channels that several nodes command; the topics' publishers show where these run."""
        known = _publishers(topics)
        return [second_publisher(listed(channels), f"{len(nodes)} nodes command {listed(channels)}",
                                 [known.get(node) or Publisher(node, "an unknown machine", "") for node in nodes])
                for nodes, channels in self.conflicts(now_ns).items()]

    def timeout_faults(self, timed_out: Mapping[int, TimedOut], now_ns: int, topics: Sequence[CommandTopic],
                       process: str) -> list[Fault]:
        """Return a fault for the channels that timed out, one for those that the same node commanded last.

        Args:
            now_ns: for how long ago that was, of the first channel of each fault.
            topics: the command topics with their publishers; none = they aren't known yet.
            process: the process whose restart forgets that a channel was ever commanded.
        """
        groups: dict[tuple[str, bool], list[int]] = {}
        for channel, each in sorted(timed_out.items()):
            groups.setdefault((self.last(channel), each.was_made_safe), []).append(channel)
        return [_timeout_fault(channels, min(timed_out[channel].since_ns for channel in channels), was_made_safe, node,
                               now_ns, topics, process) for (node, was_made_safe), channels in groups.items()]


def listed(channels: Sequence[int]) -> str:
    """Return channels as a text: "channel 1" or "channels 1, 2"."""
    return ("channel " if len(channels) == 1 else "channels ") + ", ".join(map(str, channels))


def _timeout_fault(channels, since_ns, was_made_safe, node, now_ns, topics, process):
    reason = f"{CHANNEL_TIMED_OUT}: {listed(channels)}, for {(now_ns - since_ns) / NS_PER_S:.1f} s"
    if was_made_safe:
        reason += ", since this node stood still or lost messages: no command has come after that"
    publisher = _publishers(topics).get(node)
    remedy = "See which node should command it"
    if node:
        them = "it" if len(channels) == 1 else "them"
        now = "publishes, but commands nothing there" if publisher else "is gone" if topics else "no longer commands"
        reason += f"; {publisher or node}, which commanded {them} last, {now}"
        remedy = f"See its report on /diagnostics and whether it hangs: rosnode ping {node}"
    if node and topics and not publisher:
        remedy = (f"Start {node} again; or, where nobody is to command {listed(channels)} any more, start this node "
                  f"again: rosnode kill {process}")
    return Fault(CHANNEL_TIMED_OUT, listed(channels), reason, remedy)


def _publishers(topics):
    return {publisher.node: publisher for topic in topics for publisher in topic.publishers}
