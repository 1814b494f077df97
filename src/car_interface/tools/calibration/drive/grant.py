"""Tells whether the car obeys a program that steers and drives it, and what is missing before a calibration drive.

Pure: the newest states of turn_arb, throttle_arb, planner_interface and teleop_logi, and who else asks, each with its
arrival.
"""
from __future__ import annotations

from typing import Any, Iterator, Sequence

from car_interface.common import causes
from car_interface.common.causes import AUTONOMOUS
from car_interface.common.sources import LOCKED, NEUTRAL, NO_HUMAN, PLANNER, SPEED, TELEOP
from car_interface.common.staleness import TimedInput
from car_interface.throttle.esc import ARMING, BRAKING, HOLD, REVERSE

STATES = ("turn_arb", "throttle_arb", "planner_interface", "teleop_logi")  # of these nodes
STATE_TIMEOUT_S = 0.5  # they come 10 times a second and more
OTHER_TIMEOUT_S = 1.0
SLOWS = frozenset({BRAKING, HOLD, REVERSE})  # of ThrottleState.esc
PLANNER_DRIVES = ("", AUTONOMOUS)  # modes in which the planner both steers and drives; empty: a deadman without modes
# Neutral for one of these means only that nothing was asked for.
IDLE = frozenset({causes.NO_REQUEST, causes.NO_RADIUS, causes.PLANNER_STALE, causes.COMMAND_STALE,
                  causes.COMMAND_AWAITED})
ABSENT = "human_in_loop is false: "  # how an arbiter begins its reason; what follows says it to a person
LAUNCH = "roslaunch car_interface car.launch throttle:=true planner:=speed"
NO_PULSE = (-1, 0, 65535)  # unknown, off, always on
UNHEARD = frozenset({causes.JOY_NEVER_RECEIVED, causes.JOY_STALE, *causes.JOY_UNUSABLE})


class Grant:
    """The newest of each state, and what else was received of the car.

    Args:
        by_stick: a person drives: neither planner_interface nor throttle_arb is needed, nor the sonars.
        calibrates_esc: throttle_arb was started with calibration_drive:=true.
        sonars: those that are used.

    Attributes:
        has_odom: an odometry was received.
        duty: what the servo board holds on the steering's channel; ``None`` = it was never heard.
        sonars: those that are used and were never heard.
    """

    def __init__(self, by_stick: bool = False, calibrates_esc: bool = False, sonars: Sequence[str] = ()):
        self.has_odom, self.duty, self.sonars = False, None, list(sonars)
        self._by_stick, self._calibrates_esc = by_stick, calibrates_esc
        self._states = {name: TimedInput(f"{name}'s state", STATE_TIMEOUT_S) for name in STATES}
        self._steering, self._throttle, self._planner, self._teleop = self._states.values()
        self._others: dict[str, TimedInput] = {}

    def update(self, name: str, state: Any, now_ns: int) -> None:
        """Take the state of a node, one of STATES, with the fields of its message."""
        self._states[name].update(state, now_ns)

    def update_other(self, topic: str, sender: str, now_ns: int) -> None:
        """Note that another program published on a topic of a planner."""
        self._others.setdefault(topic, TimedInput(topic, OTHER_TIMEOUT_S)).update(sender, now_ns)

    @property
    def is_slowed(self) -> bool:
        """Whether somebody steers or drives now with the manual deadman, or the ESC brakes or reverses."""
        states = [timed.value for timed in (self._steering, self._throttle) if timed.was_received]
        return any(state.source == TELEOP or getattr(state, "esc", None) in SLOWS for state in states)

    def others(self, now_ns: int) -> list[str]:
        """Return who else publishes, as sentences."""
        return [f"{timed.value} publishes {topic}, too: end it" for topic, timed in sorted(self._others.items())
                if not timed.is_stale(now_ns)]

    def trouble(self, now_ns: int) -> str:
        """Return why not both arbiters obey the planner, nor would if it asked for something; by hand why turn_arb
        doesn't obey the stick. In the arbiters' own words; empty: it may drive.
        """
        for timed in (self._steering,) if self._by_stick else (self._steering, self._throttle, self._planner):
            if timed.is_stale(now_ns):
                return timed.stale_reason(now_ns)
        steering = self._steering.value
        if self._by_stick:
            return "" if steering.source == TELEOP else steering.reason.replace(ABSENT, "")
        source = self._planner.value.source
        return (_steering_trouble(steering) or _throttle_trouble(self._throttle.value)
                or (f"planner_interface obeys {source}" if source != SPEED else "; ".join(self.others(now_ns))))

    def missing(self, now_ns: int) -> Iterator[str]:
        """Yield what is missing before it begins, most basic first; nothing: it can begin."""
        if not self._steering.was_received:
            yield f"turn_arb isn't heard: is the car launched, and in this namespace? {LAUNCH}"
        if self.duty is None:
            yield "/servo/output isn't heard: is pca9685 running?"
        elif self.duty in NO_PULSE:
            yield "the servo board gives no pulse on the steering's channel: rosrun car_interface doctor"
        if not self.has_odom:
            yield "there is no odometry on odom: is teensy_sensor_hub running, and the Teensy plugged in?"
        if self._by_stick:
            return
        if not self._throttle.was_received:
            yield f"throttle_arb isn't heard, which drives the ESC: launch with throttle:=true ({LAUNCH})"
        elif self._calibrates_esc:
            yield ("throttle_arb was launched with calibration_drive:=true, which is for calibrate_esc and lets no "
                   "stop brake: launch without")
        if not self._planner.was_received:
            yield f"planner_interface isn't heard: launch with planner:=speed ({LAUNCH})"
        elif self._planner.value.source != SPEED:
            yield (f"planner_interface obeys {self._planner.value.source}, not speeds: launch with planner:=speed in "
                   "its place")
        if self.sonars:
            yield (f"no range of the sonar{'s' * (len(self.sonars) > 1)} {', '.join(self.sonars)} is heard: a sonar "
                   "that the car doesn't have is `absent` in throttle.yaml (obstacle/sonars); --no-sonars drives "
                   "without any, and then only you keep it from running into something")
        yield from self.others(now_ns)

    def missing_gamepad(self) -> Iterator[str]:
        """Yield what is missing of the gamepad, which is waited for; nothing: it is there."""
        if not self._teleop.was_received:
            yield "teleop_logi isn't heard, which reads the gamepad with the deadman: is it running?"
        elif self._teleop.value.cause in UNHEARD:
            yield (f"the gamepad isn't there ({self._teleop.value.reason}): switch it on, or on the virtual car start "
                   "keyboard_drive in another terminal")


def _steering_trouble(steering):
    if steering.source == PLANNER or steering.source == NEUTRAL and steering.cause in IDLE:
        return ""
    if steering.source == TELEOP:
        return f"the gamepad steers ({steering.reason})"
    return steering.reason.replace(ABSENT, "")


def _throttle_trouble(throttle):
    if throttle.source in (LOCKED, NO_HUMAN):
        return throttle.reason.replace(ABSENT, "")
    if throttle.source == TELEOP:
        return f"the gamepad drives ({throttle.reason})"
    if throttle.mode not in PLANNER_DRIVES:
        return f"the deadman that is held is the one for {throttle.mode}, not the autonomous one"
    if throttle.esc == ARMING:
        return throttle.esc_reason
    return "" if throttle.source == PLANNER or throttle.cause in IDLE else throttle.reason
