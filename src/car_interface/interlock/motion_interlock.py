"""Whether the car may move at all: the lock and the human.

Consumes the emergency stop and the deadman, each with its arrival on the monotonic clock, and answers with a
``Inhibit`` or none. Steering and throttle each ask one of these, so that they stop together and neither relies on the
other.

Control is granted by positive, fresh evidence only. What has been lost comes back by a deliberate act: after the
deadman fell silent or the lock was on, somebody has to let go of the deadman and hold it again, or a car that was
stopped in mid-drive would set off the moment that a radio link recovers. A node that has just started takes everything
for lost: it may be the successor of one that died while the car was driving.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from car_interface.common import causes
from car_interface.common.staleness import DROPPED, TimedInput
from car_interface.common.units import NS_PER_S

HUMAN_TIMEOUT_S = 0.5
STARTED = "this node has just started"
# How to re-arm, in the state message, the log and /diagnostics.
REARM_REASON = "let go once: publish false, then true"


@dataclass(frozen=True)
class InterlockConfig:
    """How long lock and deadman may be silent, named as the ROS parameters.

    Attributes:
        human_timeout_s: a deadman that is silent for longer is lost; 0 = never.
        e_stop_timeout_s: an emergency stop that was heard once and is silent for longer locks; 0 = never.
        e_stop_required: also one that was never heard locks.
        grant_at_start: the first true after the start grants, as in the original. False: what was before the start
            counts as lost, and nothing is granted before the emergency stop was heard or its timeout has passed; with
            a timeout of 0, which no silence exceeds, there is nothing to wait for.
    """

    human_timeout_s: float = 0.5
    e_stop_timeout_s: float = 1.0
    e_stop_required: bool = False
    grant_at_start: bool = True


def read_interlock(params, human_timeout_s: float = HUMAN_TIMEOUT_S) -> InterlockConfig:
    """The rules from ~human_timeout (with this default), ~e_stop_timeout, ~e_stop_required and ~grant_at_start."""
    return InterlockConfig(human_timeout_s=params.timeout("human_timeout", human_timeout_s),
                            e_stop_timeout_s=params.timeout("e_stop_timeout", 1.0),
                            e_stop_required=params.flag("e_stop_required", False),
                            grant_at_start=params.flag("grant_at_start", True))


class Inhibit(NamedTuple):
    """Why the car may not move."""

    locked: bool  # by the emergency stop; else for want of a human
    cause: str  # one of causes.INHIBITS
    reason: str


class MotionInterlock:
    """Grants or refuses, from the newest of lock and deadman.

    After a loss (deadman silent, the lock on, messages dropped, or the start unless ``grant_at_start``) it takes a
    false of the deadman while nothing is lost any more, and then a true. The start is the first time that anything is
    passed in.
    """

    def __init__(self, config: InterlockConfig):
        self._config = config
        self._human = TimedInput("human_in_loop", config.human_timeout_s)
        self._e_stop = TimedInput("e_stop", config.e_stop_timeout_s)
        self._lost = "" if config.grant_at_start else STARTED  # what was lost since the deadman was last let go
        # Why an emergency stop that is on may be unheard, and since when: its first message takes a while to come.
        self._unknown = "" if config.grant_at_start else STARTED
        self._unknown_since_ns: int | None = None

    def update_human(self, present: bool, now_ns: int) -> None:
        """The deadman: true while a human holds it."""
        self._note_losses(now_ns)
        self._human.update(bool(present), now_ns)
        if not present and self._lock(now_ns) is None and not self._waits_for_e_stop(now_ns):
            self._lost = ""

    def update_e_stop(self, locked: bool, now_ns: int) -> None:
        """The emergency stop: true = stop, false = not now."""
        self._note_losses(now_ns)
        self._e_stop.update(bool(locked), now_ns)
        self._note_losses(now_ns)

    def mark_stale(self, now_ns: int) -> None:
        """Messages were dropped before they got here: all that was heard is lost, as at a start that grants nothing."""
        self._human.mark_stale()
        self._e_stop.mark_stale()
        self._lost = self._unknown = DROPPED
        self._unknown_since_ns = now_ns

    def inhibit(self, now_ns: int) -> Inhibit | None:
        """Why the car may not move at ``now_ns``; ``None`` when it may."""
        self._note_losses(now_ns)
        lock = self._lock(now_ns)
        if lock is not None:
            return lock
        if self._waits_for_e_stop(now_ns):
            return Inhibit(False, causes.STARTING,
                           f"{self._unknown}: it waits up to {self._config.e_stop_timeout_s:g} s for e_stop")
        if self._human.is_stale(now_ns):
            return Inhibit(False, causes.HUMAN_STALE if self._human.was_received else causes.HUMAN_NEVER_RECEIVED,
                           self._human.stale_reason(now_ns))
        if not self._human.value:
            return Inhibit(False, causes.HUMAN_ABSENT, "human_in_loop is false")
        if self._lost:
            return Inhibit(False, causes.NOT_REARMED, f"{self._lost}; {REARM_REASON}")
        return None

    def human_age_s(self, now_ns: int) -> float:
        """Seconds since the deadman was heard; inf = never."""
        return self._human.age_s(now_ns)

    def e_stop_age_s(self, now_ns: int) -> float:
        """Seconds since the emergency stop was heard; inf = never."""
        return self._e_stop.age_s(now_ns)

    def _lock(self, now_ns):
        if not self._e_stop.was_received:
            if self._config.e_stop_required:
                return Inhibit(True, causes.E_STOP_NEVER_RECEIVED,
                               "e_stop was never heard, and e_stop_required is true")
            return None
        if self._e_stop.is_stale(now_ns):
            return Inhibit(True, causes.E_STOP_STALE, self._e_stop.stale_reason(now_ns))
        return Inhibit(True, causes.E_STOP, "e_stop is true") if self._e_stop.value else None

    def _waits_for_e_stop(self, now_ns):
        if not self._unknown or self._e_stop.was_received:
            return False
        return now_ns - self._unknown_since_ns < round(self._config.e_stop_timeout_s * NS_PER_S)

    def _note_losses(self, now_ns):
        if self._unknown_since_ns is None:
            self._unknown_since_ns = now_ns
        if self._lock(now_ns) is not None:
            self._lost = DROPPED if self._e_stop.is_marked_stale else "the lock was on"
        elif self._human.was_received and self._human.is_stale(now_ns):
            self._lost = DROPPED if self._human.is_marked_stale else "human_in_loop was silent"
