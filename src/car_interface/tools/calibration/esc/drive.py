"""A drive with an ESC, on one even time scale: read from a recording; and its pulls: what the ESC had before each, and
what the car did.
"""
from __future__ import annotations

from collections import Counter
from typing import Mapping, NamedTuple, Sequence

import numpy as np

from car_interface.common import causes
from car_interface.common.errors import CarInterfaceError
from car_interface.pca9685.registers import DUTY_PER_COUNT
from car_interface.throttle.calibration import ThrottleCalibration, trimmed
from car_interface.tools.calibration.shared import (
    RecordedDrive,
    Series,
    held,
    interval_s,
    recorded_duty,
    runs,
    wheel_distances,
)
from car_interface.tools.recordings import recording, roles, signals

MAX_TUNED_RATIO = 0.05  # of a drive that may have had another neutral, without spoiling what the rest shows
MAX_ODOM_GAP_S, MAX_OUTPUT_GAP_S = 0.5, 2.5  # odometry comes each 0.2 s at least, the board's output each second
STEP_S = 0.02  # the PWM period
STANDS_MPS = 0.08
MOVES_MPS = 0.2
# Fractions of the span from neutral to an end: nearer than the first is neutral; from the second on no ESC is in its
# dead band any more, and a car on a floor moves.
NEUTRAL_BAND, STRONG = 0.01, 0.25
HELD_S = 0.8  # a car that has stood so long under a pull is held: the slowest crawler turns within some tenths
TURN_PULSES, MIN_TURN_PULSES = 7, 5  # of a wheel, before it stands and after: by so many its turn is timed

BACKWARD, HELD, UNCLEAR = "backward", "held", "unclear"
CALIBRATION_DRIVE = "roslaunch car_interface car.launch throttle:=true calibration_drive:=true"


class EscDrive(NamedTuple):
    """A drive each STEP_S; (K,) each."""

    t_s: np.ndarray
    duty: np.ndarray  # of the ESC; NaN where there was no pulse, or nothing is known
    fraction: np.ndarray  # of the way from neutral to the end; NaN likewise
    speed_mps: np.ndarray  # by odometry, forward positive
    neutral: float  # the duties of the centered stick and of the ends, in the configuration that was used
    full_forward: float
    full_reverse: float
    wheels: Sequence[Series] = ()  # distances in m at the pulses of each, backward falling; empty = not recorded


class Pull(NamedTuple):
    """A pull: from neutral backward, and to neutral again."""

    strong_s: float  # how long it was STRONG
    neutral_s: float  # of neutral right before it
    since_forward_s: float  # of neutral since the ESC drove forward; inf = there was a pull in between, or no forward
    follows_pull: bool  # with nothing but neutral in between
    speed_mps: float  # at its begin
    outcome: str  # BACKWARD, HELD (the car stood under it) or UNCLEAR
    # Of a BACKWARD one that began rolling:
    pause_s: float = np.nan  # how long the car stood in between
    slowed_mps2: float = np.nan  # the deceleration while it rolled forward, and the acceleration backward
    backed_mps2: float = np.nan
    is_exact: bool = False  # the last three are by the wheels' pulses


def load_esc_drive(path: str, calibration: ThrottleCalibration, topics: Mapping[str, str] | None = None,
                   namespace: str = "/") -> RecordedDrive:
    """Read one recording.

    Args:
        calibration: the ESC's channel and duties in the drive; its neutral may have been another one, which
            throttle_arb's state tells.
        topics: named by the user, by role: ``odom`` and ``output``.

    Returns:
        The drive; where an ESC takes a shorter pulse for forward, its duties are mirrored at neutral.

    Raises:
        NoRecording: it can't be read, or lacks what is needed.
        CarInterfaceError: it is no drive that shows an ESC.
    """
    topics = topics or {}
    recording.require(path, {topics.get(roles.OUTPUT.name, roles.OUTPUT.topics[0]): roles.DUTY_TYPES}, namespace,
                      "which says what the ESC got", f"; name another by --map TOPIC={roles.OUTPUT.name}")
    found = signals.load(path, (roles.ODOM.name, roles.OUTPUT.name), optional=(signals.PULSES,), namespace=namespace,
                         **topics)
    neutral, notes = _drive_s_neutral(path, namespace, calibration)
    reverse, *_, forward = trimmed(calibration, neutral).duty_table
    if neutral in (forward, reverse):
        raise CarInterfaceError(f"{path}: servo/neutral {neutral} is an end of servo/duty_table: give the file of this "
                                "drive by --base")
    duty = recorded_duty(found, calibration.channel, "ESC")
    if forward < neutral:
        duty, forward, reverse = Series(duty.t_s, 2.0 * neutral - duty.y), 2 * neutral - forward, 2 * neutral - reverse
    speed = Series(found.odom.t_s, found.odom.speed_mps)
    drive = sampled(duty, speed, float(neutral), float(forward), float(reverse),
                    wheel_distances(found.pulses or (), speed))
    return RecordedDrive(path, drive, (*notes, *found.notes), found.duration_s, signals.trail(found))


def _drive_s_neutral(path, namespace, calibration):
    """Return (the neutral in the drive, notes).

    Raises:
        CarInterfaceError: throttle_arb withheld the pulls, or its neutral was tuned.
    """
    neutrals: Counter = Counter()
    states = passed = 0
    for recorded in recording.read(path, roles.THROTTLE_STATE, namespace):
        message = recorded.message
        try:
            states += 1
            passed += message.esc_cause == causes.CALIBRATION_DRIVE
            if not message.granted:
                neutrals[message.duty] += 1
        except AttributeError as error:
            raise recording.other_version(path, recorded) from error
    if not states:
        return calibration.neutral, (f"{path} has no throttle_arb/state: who drove, and whether by hand, isn't known",)
    if not passed:
        raise CarInterfaceError(f"{path} was driven without calibration_drive, so that throttle_arb withheld the pulls "
                                f"that would show what the ESC makes of them: {CALIBRATION_DRIVE}, and drive again")
    if not neutrals:
        return calibration.neutral, ()
    neutral, _ = neutrals.most_common(1)[0]
    others = sum(count for duty, count in neutrals.items() if abs(duty - neutral) > DUTY_PER_COUNT / 2)
    if others > MAX_TUNED_RATIO * sum(neutrals.values()):
        raise CarInterfaceError(f"{path}: servo/neutral was tuned during the drive (it was "
                                f"{min(neutrals)} to {max(neutrals)}): drive again, and leave it as it is")
    return neutral, ()


def sampled(duty: Series, speed: Series, neutral: float, full_forward: float, full_reverse: float,
            wheels: Sequence[Series] = ()) -> EscDrive:
    """Return the drive of a duty, each sample until the next, NaN = no pulse, and of odometry's speed in m/s.

    In their gaps nothing is known of the ESC.
    """
    t_s = np.arange(max(duty.t_s[0], speed.t_s[0]), speed.t_s[-1], STEP_S)
    is_gap = ((interval_s(speed.t_s, t_s) > MAX_ODOM_GAP_S)
              | (t_s - held(duty.t_s, duty.t_s, t_s) > MAX_OUTPUT_GAP_S))
    at = np.where(is_gap, np.nan, held(duty.t_s, duty.y, t_s))
    span = np.where(at > neutral, full_forward - neutral, neutral - full_reverse)
    return EscDrive(t_s, at, (at - neutral) / span, np.interp(t_s, speed.t_s, speed.y), neutral, full_forward,
                    full_reverse, wheels)


# --- pulls ---


def pulls(drive: EscDrive) -> list[Pull]:
    """Return the pulls of a drive, in their order."""
    side = np.where(np.abs(drive.fraction) <= NEUTRAL_BAND, 0, np.nan_to_num(np.sign(drive.fraction), nan=2))
    edges = np.r_[0, np.flatnonzero(np.diff(side)) + 1, side.size]
    found: list = []
    neutral_s, since_forward_s, follows_pull = 0.0, np.inf, False
    for begin, end in zip(edges, edges[1:]):
        if side[begin] == 0:
            neutral_s = (end - begin) * STEP_S
            since_forward_s += neutral_s
        elif side[begin] == 1:
            # A forward that may lie within the dead band doesn't make an ESC forget its brake.
            since_forward_s = 0.0 if (drive.fraction[begin:end] >= STRONG).any() else np.inf
            follows_pull = False
        elif side[begin] == -1:
            found.append(_pull(drive, begin, end, neutral_s, since_forward_s, follows_pull))
            since_forward_s, follows_pull = np.inf, True
        else:
            since_forward_s, follows_pull = np.inf, False
    return found


def _pull(drive, begin, end, neutral_s, since_forward_s, follows_pull):
    strong = drive.fraction[begin:end] <= -STRONG
    speed = drive.speed_mps[begin:end]
    outcome, turn = UNCLEAR, ()
    if strong.any():
        stands = (np.abs(speed) < STANDS_MPS) & strong
        if (speed[int(strong.argmax()):] < -MOVES_MPS).any():
            outcome = BACKWARD
            if speed[0] > MOVES_MPS:
                turn = _turn_by_pulses(drive.wheels, *drive.t_s[[begin, end - 1]]) or _turn_by_speed(speed)
        elif speed.min() > -STANDS_MPS and any((stop - start) * STEP_S >= HELD_S for start, stop in runs(stands)):
            outcome = HELD
    return Pull(float(strong.sum() * STEP_S), neutral_s, since_forward_s, follows_pull, float(drive.speed_mps[begin]),
                outcome, *turn)


def _turn_by_pulses(wheels, begin_s, end_s):
    """Return how long it stood between forward and backward, deceleration before, acceleration after, and ``True``.

    The deceleration is constant shortly before it stands, and so is the acceleration after: both are parabolas through
    pulses, and their vertices are where it came to stand, and left. Nothing where there are too few pulses.
    """
    turns = []
    for wheel_s, wheel_m in wheels:
        inside = (wheel_s >= begin_s) & (wheel_s <= end_s)
        t_s, distance_m = wheel_s[inside], wheel_m[inside]
        if not t_s.size:
            continue
        top = int(distance_m.argmax())
        before, after = slice(max(0, top + 1 - TURN_PULSES), top + 1), slice(top + 1, top + 1 + TURN_PULSES)
        if min(t_s[before].size, t_s[after].size) < MIN_TURN_PULSES:
            continue
        stop_s, slowed = _vertex(t_s[before], distance_m[before])
        go_s, backed = _vertex(t_s[after], distance_m[after])
        if min(slowed, backed) > 0.1:
            turns.append((go_s - stop_s, slowed, backed))
    return (*(float(value) for value in np.mean(turns, axis=0)), True) if turns else ()


def _vertex(t_s, distance_m):
    """Return (time of the vertex of the parabola through points, deceleration)."""
    square, linear, _ = np.polyfit(t_s - t_s[0], distance_m, 2)
    return t_s[0] - linear / (2 * square), -2 * square


def _turn_by_speed(speed):
    """Return the same by odometry, whose filter makes it uncertain by 0.1 s, and ``False``."""
    stop, go = int((speed < MOVES_MPS).argmax()), int((speed < -MOVES_MPS).argmax())
    # Both accelerations over 0.2 s, and from them when it really came to a standstill, and left it.
    width = round(0.2 / STEP_S)
    before, after = speed[max(0, stop - width):stop + 1], speed[go:go + width + 1]
    if before.size < 4 or after.size < 4:
        return ()
    slowed = -np.polyfit(np.arange(before.size) * STEP_S, before, 1)[0]
    backed = -np.polyfit(np.arange(after.size) * STEP_S, after, 1)[0]
    if slowed <= 0.1 or backed <= 0.1:
        return ()
    pause_s = (go - stop) * STEP_S - speed[stop] / slowed + speed[go] / backed
    return float(pause_s), float(slowed), float(backed), False
