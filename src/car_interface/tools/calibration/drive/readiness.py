"""What a calibration drive still needs before it can begin, as sentences with their remedy."""
from __future__ import annotations

from dataclasses import dataclass, field

from car_interface.common import causes
from car_interface.planner.source_arbiter import SPEED

LAUNCH = "roslaunch car_interface car.launch throttle:=true planner:=speed"
NO_PULSE = (-1, 0, 65535)  # unknown, off, always on
UNHEARD = frozenset({causes.JOY_NEVER_RECEIVED, causes.JOY_STALE, *causes.JOY_UNUSABLE})


@dataclass
class Seen:
    """What was heard of the car so far.

    Attributes:
        steering, throttle: a state of turn_arb, of throttle_arb.
        calibrates_esc: throttle_arb was started with calibration_drive:=true.
        planner: which source planner_interface obeys; ``None``: it was never heard.
        odom: an odometry.
        duty: what the servo board holds on the steering's channel; ``None``: it was never heard.
        gamepad: cause and reason of teleop_logi's state; ``None``: it was never heard.
        sonars: those that are used and were never heard.
        others: who else asks for something, as sentences.
    """

    steering: bool = False
    throttle: bool = False
    calibrates_esc: bool = False
    planner: str | None = None
    odom: bool = False
    duty: int | None = None
    gamepad: tuple[str, str] | None = None
    sonars: tuple[str, ...] = ()
    others: list[str] = field(default_factory=list)


def missing(seen: Seen, by_stick: bool) -> list[str]:
    """What is missing, most basic first; empty: it can begin.

    Args:
        seen: of the car.
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
    """What is missing of the gamepad, which is waited for; empty: nothing."""
    if seen.gamepad is None:
        return ["teleop_logi isn't heard, which reads the gamepad with the deadman: is it running?"]
    cause, reason = seen.gamepad
    if cause not in UNHEARD:
        return []
    return [(f"the gamepad isn't there ({reason}): switch it on, or on the virtual car start keyboard_drive in another "
             "terminal")]
