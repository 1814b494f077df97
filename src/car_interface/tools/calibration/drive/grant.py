"""Whether the car would obey a program that steers and drives it, by what the arbiters say of themselves.

Pure: the newest states of turn_arb, throttle_arb and planner_interface, and who else asks, each with its arrival.
"""
from __future__ import annotations

from typing import NamedTuple

from car_interface.common import causes
from car_interface.common.drive_modes import AUTONOMOUS
from car_interface.common.staleness import TimedInput
from car_interface.planner.source_arbiter import SPEED
from car_interface.steering.arbiter import LOCKED, NEUTRAL, NO_HUMAN, PLANNER, TELEOP
from car_interface.throttle import esc

STATE_TIMEOUT_S = 0.5  # they come 10 times a second and more
OTHER_TIMEOUT_S = 1.0
ARMING = esc.STATE_NAMES[esc.ARMING]  # of ThrottleState.esc
SLOWS = frozenset(esc.STATE_NAMES[state] for state in (esc.BRAKING, esc.HOLD, esc.REVERSE))
PLANNER_DRIVES = ("", AUTONOMOUS)  # modes in which the planner both steers and drives; empty: a deadman without modes
# Neutral for one of these means only that nothing was asked for.
IDLE = frozenset({causes.NO_REQUEST, causes.NO_RADIUS, causes.PLANNER_STALE, causes.COMMAND_STALE,
                  causes.COMMAND_AWAITED})
ABSENT = "human_in_loop is false: "  # how turn_arb begins its reason; what follows says it to a person


class Steering(NamedTuple):
    """Of turn_arb's state."""

    source: int
    cause: str
    reason: str


class Throttle(NamedTuple):
    """Of throttle_arb's state."""

    source: int
    cause: str
    reason: str
    mode: str
    esc: str
    esc_reason: str


class Granted(NamedTuple):
    """Whether it may drive, and why not, in the arbiters' own words."""

    may_drive: bool
    reason: str


class Grant:
    """The newest of each state."""

    def __init__(self):
        self._steering = TimedInput("turn_arb's state", STATE_TIMEOUT_S)
        self._throttle = TimedInput("throttle_arb's state", STATE_TIMEOUT_S)
        self._planner = TimedInput("planner_interface's state", STATE_TIMEOUT_S)
        self._others: dict[str, TimedInput] = {}

    def update_steering(self, steering: Steering, now_ns: int) -> None:
        """What turn_arb says."""
        self._steering.update(steering, now_ns)

    def update_throttle(self, throttle: Throttle, now_ns: int) -> None:
        """What throttle_arb says."""
        self._throttle.update(throttle, now_ns)

    def update_planner(self, source: str, now_ns: int) -> None:
        """Which source planner_interface obeys."""
        self._planner.update(source, now_ns)

    def update_other(self, topic: str, sender: str, now_ns: int) -> None:
        """Another program asked for something on a topic of a planner."""
        self._others.setdefault(topic, TimedInput(topic, OTHER_TIMEOUT_S)).update(sender, now_ns)

    @property
    def stops_by_itself(self) -> bool:
        """Whether nobody steers or drives now with the manual deadman, and the ESC neither brakes nor reverses."""
        is_by_hand = any(timed.was_received and timed.value.source == TELEOP
                         for timed in (self._steering, self._throttle))
        return not is_by_hand and not (self._throttle.was_received and self._throttle.value.esc in SLOWS)

    def others(self, now_ns: int) -> list[str]:
        """Who else asks, as sentences."""
        return [f"{timed.value} publishes {topic}, too: end it" for topic, timed in sorted(self._others.items())
                if not timed.is_stale(now_ns)]

    def decide(self, now_ns: int) -> Granted:
        """Whether both arbiters obey the planner, or would if it asked for something."""
        for timed in (self._steering, self._throttle, self._planner):
            if timed.is_stale(now_ns):
                return Granted(False, timed.stale_reason(now_ns))
        trouble = (_steering_trouble(self._steering.value) or _throttle_trouble(self._throttle.value)
                   or _planner_trouble(self._planner.value) or "; ".join(self.others(now_ns)))
        return Granted(not trouble, trouble)

    def decide_by_hand(self, now_ns: int) -> Granted:
        """Whether turn_arb obeys a person's stick."""
        if self._steering.is_stale(now_ns):
            return Granted(False, self._steering.stale_reason(now_ns))
        steering = self._steering.value
        return Granted(steering.source == TELEOP, "" if steering.source == TELEOP else _plain(steering.reason))


def _plain(reason):
    return reason[len(ABSENT):] if reason.startswith(ABSENT) else reason


def _steering_trouble(steering):
    if steering.source == PLANNER or steering.source == NEUTRAL and steering.cause in IDLE:
        return ""
    return f"the gamepad steers ({steering.reason})" if steering.source == TELEOP else _plain(steering.reason)


def _throttle_trouble(throttle):
    if throttle.source in (LOCKED, NO_HUMAN):
        return _plain(throttle.reason)
    if throttle.source == TELEOP:
        return f"the gamepad drives ({throttle.reason})"
    if throttle.mode not in PLANNER_DRIVES:
        return f"the deadman that is held is the one for {throttle.mode}, not the autonomous one"
    if throttle.esc == ARMING:
        return throttle.esc_reason
    return "" if throttle.source == PLANNER or throttle.cause in IDLE else throttle.reason


def _planner_trouble(source):
    return "" if source == SPEED else f"planner_interface obeys {source}"
