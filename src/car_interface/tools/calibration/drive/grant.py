"""Tells whether the car obeys a program that steers and drives it, and what is missing before a calibration drive.

Pure: the newest states of turn_arb, throttle_arb and planner_interface, and who else asks, each with its arrival.
"""
from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

from car_interface.common import causes
from car_interface.common.causes import AUTONOMOUS
from car_interface.common.sources import LOCKED, NEUTRAL, NO_HUMAN, PLANNER, SPEED, TELEOP
from car_interface.common.staleness import TimedInput
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
LAUNCH = "roslaunch car_interface car.launch throttle:=true planner:=speed"
NO_PULSE = (-1, 0, 65535)  # unknown, off, always on
UNHEARD = frozenset({causes.JOY_NEVER_RECEIVED, causes.JOY_STALE, *causes.JOY_UNUSABLE})


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
        """Take turn_arb's state."""
        self._steering.update(steering, now_ns)

    def update_throttle(self, throttle: Throttle, now_ns: int) -> None:
        """Take throttle_arb's state."""
        self._throttle.update(throttle, now_ns)

    def update_planner(self, source: str, now_ns: int) -> None:
        """Take the source that planner_interface obeys."""
        self._planner.update(source, now_ns)

    def update_other(self, topic: str, sender: str, now_ns: int) -> None:
        """Note that another program published on a topic of a planner."""
        self._others.setdefault(topic, TimedInput(topic, OTHER_TIMEOUT_S)).update(sender, now_ns)

    @property
    def stops_by_itself(self) -> bool:
        """Whether nobody steers or drives now with the manual deadman, and the ESC neither brakes nor reverses."""
        is_by_hand = any(timed.was_received and timed.value.source == TELEOP
                         for timed in (self._steering, self._throttle))
        return not is_by_hand and not (self._throttle.was_received and self._throttle.value.esc in SLOWS)

    def others(self, now_ns: int) -> list[str]:
        """Return who else publishes, as sentences."""
        return [f"{timed.value} publishes {topic}, too: end it" for topic, timed in sorted(self._others.items())
                if not timed.is_stale(now_ns)]

    def decide(self, now_ns: int) -> Granted:
        """Decide whether both arbiters obey the planner, or would if it asked for something."""
        for timed in (self._steering, self._throttle, self._planner):
            if timed.is_stale(now_ns):
                return Granted(False, timed.stale_reason(now_ns))
        source = self._planner.value
        trouble = (_steering_trouble(self._steering.value) or _throttle_trouble(self._throttle.value)
                   or (f"planner_interface obeys {source}" if source != SPEED else "; ".join(self.others(now_ns))))
        return Granted(not trouble, trouble)

    def decide_by_hand(self, now_ns: int) -> Granted:
        """Decide whether turn_arb obeys a person's stick."""
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


# --- before it begins ---


@dataclass
class Seen:
    """What was received of the car so far."""

    steering: bool = False  # a state of turn_arb
    throttle: bool = False  # a state of throttle_arb
    calibrates_esc: bool = False  # throttle_arb was started with calibration_drive:=true
    planner: str | None = None  # which source planner_interface obeys; ``None``: it was never heard
    odom: bool = False  # an odometry
    duty: int | None = None  # what the servo board holds on the steering's channel; ``None``: it was never heard
    gamepad: tuple[str, str] | None = None  # cause and reason of teleop_logi's state; ``None``: it was never heard
    sonars: tuple[str, ...] = ()  # those that are used and were never heard
    others: list[str] = field(default_factory=list)  # who else asks for something, as sentences


def missing(seen: Seen, by_stick: bool) -> list[str]:
    """Return what is missing, most basic first; empty: it can begin.

    Args:
        by_stick: a person drives: neither planner_interface nor throttle_arb is needed, nor the sonars.
    """
    found = []
    if not seen.steering:
        found.append(f"turn_arb isn't heard: is the car launched, and in this namespace? {LAUNCH}")
    if seen.duty is None:
        found.append("/servo/output isn't heard: is pca9685 running?")
    elif seen.duty in NO_PULSE:
        found.append("the servo board gives no pulse on the steering's channel: rosrun car_interface doctor")
    if not seen.odom:
        found.append("there is no odometry on odom: is teensy_sensor_hub running, and the Teensy plugged in?")
    if not by_stick:
        found += _missing_of_a_program(seen)
    return found


def _missing_of_a_program(seen):
    if not seen.throttle:
        yield f"throttle_arb isn't heard, which drives the ESC: launch with throttle:=true ({LAUNCH})"
    elif seen.calibrates_esc:
        yield ("throttle_arb was launched with calibration_drive:=true, which is for calibrate_esc and lets no stop "
               "brake: launch without")
    if seen.planner is None:
        yield f"planner_interface isn't heard: launch with planner:=speed ({LAUNCH})"
    elif seen.planner != SPEED:
        yield f"planner_interface obeys {seen.planner}, not speeds: launch with planner:=speed in its place"
    if seen.sonars:
        yield (f"no range of the sonar{'s' * (len(seen.sonars) > 1)} {', '.join(seen.sonars)} is heard: a sonar that "
               "the car doesn't have is `absent` in throttle.yaml (obstacle/sonars); --no-sonars drives without any, "
               "and then only you keep it from running into something")
    yield from seen.others


def missing_gamepad(seen: Seen) -> list[str]:
    """Return what is missing of the gamepad, which is waited for; empty: nothing."""
    if seen.gamepad is None:
        return ["teleop_logi isn't heard, which reads the gamepad with the deadman: is it running?"]
    cause, reason = seen.gamepad
    if cause not in UNHEARD:
        return []
    return [(f"the gamepad isn't there ({reason}): switch it on, or on the virtual car start keyboard_drive in another "
             "terminal")]
