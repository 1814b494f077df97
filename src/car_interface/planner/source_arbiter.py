"""Obey one planner, the configured source. The messages of other sources are counted, with their senders.

Consumes the requests made of the source's messages, with their arrival; answers with the request, or why there is none.
A source that falls silent has no request from then on: nothing is repeated for it. A source that sent an angle which no
wheel turns to is refused until it was sane for 2 s, since an angle in degrees that swings from side to side passes
through angles that look like radians, at full lock. Pure: ``now_ns`` is passed in.
"""
from __future__ import annotations

import math
from typing import NamedTuple

from car_interface.common import causes
from car_interface.common.sources import SPEED
from car_interface.common.staleness import TimedInput
from car_interface.common.units import NS_PER_S
from car_interface.planner.messages import PlannerRequest, Refusal

# Long enough for a slow swing: with ±3 "rad" and a period of 10 s, 1 s lies within MAX_SANE_RAD.
SANE_FOR_NS = 2 * NS_PER_S


class PlannerDecision(NamedTuple):
    """The request of the planner, or why it isn't obeyed."""

    cause: str  # one of car_interface.common.causes; PLANNER with a request
    reason: str
    request: PlannerRequest | None = None
    radius_m: float = 0.0  # what is asked of the steering; 0 = nothing


class SourceArbiter:
    """Keep the newest command of the source.

    Args:
        timeout_s: a command older than this is no request any more; above 0.
        sane_radius_m: for a source that was refused for an angle, a tighter turn than this isn't sane.
    """

    def __init__(self, source: str, timeout_s: float, sane_radius_m: float = 0.0):
        self.source = source
        self._command = TimedInput(source, timeout_s)
        self._timeout_ns = round(timeout_s * NS_PER_S)
        self._arrival_ns = 0
        self._radius_m = math.inf
        self._sane_radius_m = sane_radius_m
        self._refused_for: Refusal | None = None  # the newest angle for which the source stays refused
        self._sane_since_ns: int | None = None  # since when it has been sane; None: it isn't
        self._others: dict[str, tuple[int, str]] = {}  # messages of the others, and who sent the last, by source
        self.refused = 0

    def update(self, command: PlannerRequest | Refusal, now_ns: int) -> None:
        """Take the source's newest message."""
        command = self._unless_refused(command, now_ns)
        if isinstance(command, Refusal):
            self.refused += 1
        if isinstance(command, Refusal) or self._command.is_stale(now_ns):
            self._radius_m = math.inf
        if isinstance(command, PlannerRequest) and command.radius_m is not None:
            self._radius_m = command.radius_m
        self._command.update(command, now_ns)
        self._arrival_ns = now_ns

    def _unless_refused(self, command, now_ns):
        """Return the command, or the refusal that an earlier angle still causes."""
        if isinstance(command, Refusal) and command.is_of_angle:
            self._refused_for = command
        if self._refused_for is None:
            return command
        if isinstance(command, Refusal) or not self._is_sane(command):
            self._sane_since_ns = None
        elif self._sane_since_ns is None or self._command.is_stale(now_ns):
            self._sane_since_ns = now_ns
        if self._sane_since_ns is not None and now_ns - self._sane_since_ns >= SANE_FOR_NS:
            self._refused_for = self._sane_since_ns = None
            return command
        return command if isinstance(command, Refusal) else self._refused_for

    def _is_sane(self, request):
        return request.radius_m is None or abs(request.radius_m) > self._sane_radius_m

    def count_other(self, source: str, sender: str) -> None:
        """Count a message of a source that isn't obeyed, from a node."""
        count, _ = self._others.get(source, (0, ""))
        self._others[source] = count + 1, sender

    def mark_stale(self) -> None:
        """Take note that messages were dropped: there is no request until the next one."""
        self._command.mark_stale()

    def age_s(self, now_ns: int) -> float:
        """Return the seconds since the source's last message; inf = never received."""
        return self._command.age_s(now_ns)

    @property
    def others(self) -> str:
        """The sources that aren't obeyed, as text: ``cmd_vel: 12 messages, the last from /move_base``."""
        return "; ".join(f"{source}: {count} message{'s' if count > 1 else ''}, the last from "
                         f"{sender or 'an unknown node'}" for source, (count, sender) in sorted(self._others.items()))

    def silent_at_ns(self, now_ns: int) -> float:
        """Return when the source falls silent unless it sends something; inf = it is silent, or was never received."""
        return math.inf if self._command.is_stale(now_ns) else self._arrival_ns + self._timeout_ns + 1

    def decide(self, now_ns: int) -> PlannerDecision:
        """Return the request at ``now_ns``, or why there is none."""
        if not self._command.was_received:
            others = f"; not obeyed: {self.others}" if self._others else ""
            return PlannerDecision(causes.NO_REQUEST, f"{self._command.stale_reason(now_ns)}{others}")
        if self._command.is_stale(now_ns):
            return PlannerDecision(causes.PLANNER_STALE, self._command.stale_reason(now_ns))
        command = self._command.value
        if isinstance(command, Refusal):
            return PlannerDecision(command.cause, f"{self.source}: {command.reason}{self._remains(now_ns)}")
        radius_m = 0.0 if self.source == SPEED else self._radius_m
        return PlannerDecision(causes.PLANNER, f"{self.source} asks for {_text(command, radius_m)}", command, radius_m)

    def _remains(self, now_ns):
        """Return for how long the source stays refused for an angle, in words."""
        if self._refused_for is None:
            return ""
        left = ""
        if self._sane_since_ns is not None:
            left = f", {max(0, SANE_FOR_NS - (now_ns - self._sane_since_ns)) / NS_PER_S:.1f} s more"
        return f"; refused until it was sane for {SANE_FOR_NS / NS_PER_S:g} s{left}"


def _text(request, radius_m):
    """Return a request in words."""
    gear = f", gear {request.gear.upper()}" if request.gear else ""
    if not radius_m:
        return f"{request.speed_mps:.2f} m/s{gear}"
    path = "straight on" if math.isinf(radius_m) else f"a radius of {radius_m:.2f} m"
    return f"{request.speed_mps:.2f} m/s, {path}{gear}"
