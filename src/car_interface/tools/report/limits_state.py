"""Which requests of a drive were cut by a limit, when, and why: as the arbiters report."""
from __future__ import annotations

from typing import Any, NamedTuple

from car_interface.common import causes
from car_interface.tools.report.faults import MAX_ENTRIES

CUTS = causes.STEERING_CUTS | causes.THROTTLE_CUTS
SAME_AFTER_S = 0.5  # a cut that comes back sooner is the same one


class CutEpisode(NamedTuple):
    """A time in which an arbiter granted something else than was asked for, for the same cause."""

    start_s: float
    end_s: float
    node: str
    cause: str  # a constant of common.causes
    reason: str  # in words, at its start


class LimitsWatch:
    """Follows the states of turn_arb and throttle_arb.

    Attributes:
        episodes: up to MAX_ENTRIES, by their starts once finished.
        counts: by node, how often a request began to be limited, by its own count.
        dropped: how many episodes more there were.
    """

    def __init__(self):
        self.episodes: list[CutEpisode] = []
        self.counts: dict[str, int] = {}
        self.dropped = 0
        self._current: dict[str, CutEpisode] = {}
        self._seen: dict[str, int] = {}  # a node's newest count

    def on_state(self, time_s: float, message: Any, node: str) -> None:
        """car_interface/SteeringState or ThrottleState; one from before there were limits says nothing."""
        cause = getattr(message, "limit", "")
        self._count(node, getattr(message, "cuts", 0))
        current = self._current.get(node)
        if cause not in CUTS:
            return
        if current is not None and (current.cause != cause or time_s - current.end_s > SAME_AFTER_S):
            self._keep(self._current.pop(node))
            current = None
        if current is None:
            self._current[node] = CutEpisode(time_s, time_s, node, cause, message.limit_reason)
        else:
            self._current[node] = current._replace(end_s=time_s)

    def finish(self) -> None:
        """Close the last episodes."""
        for episode in self._current.values():
            self._keep(episode)
        self._current.clear()
        self.episodes.sort(key=lambda episode: episode.start_s)

    def _count(self, node, cuts):
        before = self._seen.get(node, cuts)
        rise = cuts - before if cuts >= before else cuts  # a restarted node begins at 0
        self._seen[node] = cuts
        self.counts[node] = self.counts.get(node, 0) + rise

    def _keep(self, episode):
        if len(self.episodes) < MAX_ENTRIES:
            self.episodes.append(episode)
        else:
            self.dropped += 1
