"""Decide whether the car may move at all, by emergency stop (the lock) and deadman (the human).

Consumes both, each with its arrival on the monotonic clock, and answers with an ``Inhibit`` or ``None``. The
arbiters of steering and throttle are an interlock each, so that they stop together without depending on each other.

Motion is permitted on positive, fresh evidence only, and re-armed by a deliberate act: after the deadman was stale or
the lock was on, the deadman must be released and held again. Otherwise a car that was stopped while driving would set
off as soon as a radio link recovers. The same holds after a start: the node may replace one that died while the car was
driving.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from car_interface.common import causes, declared
from car_interface.common.staleness import DROPPED, STARTED, TimedInput
from car_interface.common.units import NS_PER_S

UNLOCK = "it unlocks once somebody keeps publishing {} false"
# How to re-arm, in the state message, the log and /diagnostics.
REARM_REASON = "let go once: publish false, then true"
EXPLANATION_TIMEOUT_S = 0.5  # teleop_logi sends its state 10 times a second
MAX_EXPLANATION = 300  # characters, so that another node's text can't flood the log: three lines


@dataclass(frozen=True)
class InterlockConfig:
    """Timeouts and rules of lock and deadman.

    Unless ``grant_at_start`` the interlock also waits for the first e_stop until its timeout has passed, and for the
    phones' that was on (``await_phone_e_stop``); with a timeout of 0 it doesn't wait.
    """

    human_timeout_s: float = declared.timeout("human_timeout", 0.5, "age at which the deadman is stale")
    e_stop_timeout_s: float = declared.timeout(
        "e_stop_timeout", 1.0, "an e-stop that was received once and is stale counts as true")
    e_stop_required: bool = declared.flag(
        "e_stop_required", False, "true = an e-stop that was never received counts as true")
    grant_at_start: bool = declared.flag(
        "grant_at_start", True, "false, as in the launch files = a deadman that is held at start must be "
                                "[released first](safety.md#deadman-and-re-arming)")


class Inhibit(NamedTuple):
    """The reason why the car may not move."""

    locked: bool  # by the emergency stop; False: by the deadman
    cause: str  # one of causes.INHIBITS
    reason: str


class MotionInterlock:
    """Permit or inhibit motion, by the newest of lock and deadman.

    After a stale deadman, a lock, dropped messages, or the start unless ``grant_at_start``, re-arming takes a false of
    the deadman while none of these holds any more, and then a true. The start is the first call with a time.
    """

    def __init__(self, config: InterlockConfig):
        self._config = config
        self._human = TimedInput("human_in_loop", config.human_timeout_s)
        self._e_stop = TimedInput("e_stop", config.e_stop_timeout_s)
        self._phone_e_stop = TimedInput("phone/e_stop", config.e_stop_timeout_s)
        self._explanation = TimedInput("teleop_logi's state", EXPLANATION_TIMEOUT_S)
        self._rearm_reason = "" if config.grant_at_start else STARTED  # why the deadman must be released first
        # Why and since when the first e_stop is awaited: a lock that is on may take a while to arrive.
        self._wait_reason = "" if config.grant_at_start else STARTED
        self._waiting_since_ns: int | None = None
        self._awaits_phone = False

    def update_human(self, present: bool, now_ns: int) -> None:
        """Take the deadman: true while a human holds it."""
        self._update_rearm_reason(now_ns)
        self._human.update(bool(present), now_ns)
        if not present and self._lock(now_ns) is None and not self._awaited_e_stop(now_ns):
            self._rearm_reason = ""

    def explain_human(self, present: bool, reason: str, now_ns: int) -> None:
        """Take what teleop_logi says of deadman and requests. It is only quoted, of a deadman while that is false."""
        self._explanation.update((present, " ".join(reason.split())), now_ns)

    def update_e_stop(self, locked: bool, now_ns: int) -> None:
        """Take the emergency stop: true = stop, false = not now."""
        self._update_rearm_reason(now_ns)
        self._e_stop.update(bool(locked), now_ns)

    def update_phone_e_stop(self, locked: bool, now_ns: int) -> None:
        """Take the phones' emergency stop: either locks, and a false of one doesn't unlock the other."""
        self._update_rearm_reason(now_ns)
        self._phone_e_stop.update(bool(locked), now_ns)

    def await_phone_e_stop(self) -> None:
        """Take note that the phones' emergency stop was on as this node started: it may take a while to arrive."""
        self._awaits_phone = True

    def mark_stale(self, now_ns: int) -> None:
        """Take note that messages were dropped: all are stale, and must be re-armed as after a start."""
        for timed in (self._human, self._e_stop, self._phone_e_stop):
            timed.mark_stale()
        self._rearm_reason = self._wait_reason = DROPPED
        self._waiting_since_ns = now_ns

    def inhibit(self, now_ns: int) -> Inhibit | None:
        """Return why the car may not move at ``now_ns``; ``None`` = it may."""
        self._update_rearm_reason(now_ns)
        lock = self._lock(now_ns)
        if lock is not None:
            return lock
        awaited = self._awaited_e_stop(now_ns)
        if awaited:
            return Inhibit(False, causes.STARTING,
                           f"{self._wait_reason}: it waits up to {self._config.e_stop_timeout_s:g} s for {awaited}")
        if self._human.is_stale(now_ns):
            return Inhibit(False, causes.HUMAN_STALE if self._human.was_received else causes.HUMAN_NEVER_RECEIVED,
                           self._human.stale_reason(now_ns))
        if not self._human.value:
            return Inhibit(False, causes.HUMAN_ABSENT, self._absent_reason(now_ns))
        if self._rearm_reason:
            return Inhibit(False, causes.NOT_REARMED, f"{self._rearm_reason}; {REARM_REASON}")
        return None

    def is_released(self, now_ns: int) -> bool:
        """Return whether the deadman is known to be released."""
        return not self._human.is_stale(now_ns) and not self._human.value

    def _absent_reason(self, now_ns):
        present, reason = self._explanation.fresh(now_ns) or (True, "")
        is_explained = reason and not present
        return f"human_in_loop is false: {reason[:MAX_EXPLANATION]}" if is_explained else "human_in_loop is false"

    def _lock(self, now_ns):
        if self._config.e_stop_required and not self._e_stop.was_received:
            return Inhibit(True, causes.E_STOP_NEVER_RECEIVED, "e_stop was never heard, and e_stop_required is true")
        for e_stop in (self._e_stop, self._phone_e_stop):
            if e_stop.was_received and e_stop.is_stale(now_ns):
                return Inhibit(True, causes.E_STOP_STALE,
                               f"{e_stop.stale_reason(now_ns)}; {UNLOCK.format(e_stop.name)}")
            if e_stop.value:
                return Inhibit(True, causes.E_STOP, f"{e_stop.name} is true")
        return None

    def _awaited_e_stop(self, now_ns):
        """Return the name of an e-stop that may arrive for the first time yet; empty: none is waited for."""
        waited_ns = now_ns - self._waiting_since_ns
        if not self._wait_reason or waited_ns >= round(self._config.e_stop_timeout_s * NS_PER_S):
            return ""
        awaited = (self._e_stop, self._phone_e_stop) if self._awaits_phone else (self._e_stop,)
        return next((each.name for each in awaited if not each.was_received), "")

    def _update_rearm_reason(self, now_ns):
        if self._waiting_since_ns is None:
            self._waiting_since_ns = now_ns
        if self._lock(now_ns) is not None:
            was_dropped = self._e_stop.is_marked_stale or self._phone_e_stop.is_marked_stale
            self._rearm_reason = DROPPED if was_dropped else "the lock was on"
        elif self._human.was_received and self._human.is_stale(now_ns):
            self._rearm_reason = DROPPED if self._human.is_marked_stale else "human_in_loop was silent"
