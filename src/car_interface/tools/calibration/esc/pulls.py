"""The pulls of a drive: what the ESC had before each, and what the car did.

Consumes the duty that the servo board held and the speed; all on one even time scale. Pure numpy.
"""
from __future__ import annotations

from typing import NamedTuple

import numpy as np

from car_interface.tools.calibration.shared import runs

STEP_S = 0.02  # the PWM period
STANDS_MPS = 0.08
MOVES_MPS = 0.2
# Fractions of the span from neutral to an end: nearer than the first is neutral; from the second on no ESC is in its
# dead band any more, and a car on a floor moves.
NEUTRAL_BAND, STRONG = 0.01, 0.25
HELD_S = 0.8  # a car that has stood so long under a pull is held: the slowest crawler turns within some tenths
DELAY_S = 0.3  # what the car did by a pull shows no later: the chip, a period, the odometry, the motor
TURN_PULSES, MIN_TURN_PULSES = 7, 5  # of a wheel, before it stands and after: by so many its turn is timed

BACKWARD, HELD, UNCLEAR = "backward", "held", "unclear"


class EscDrive(NamedTuple):
    """What a drive recorded."""

    # when the servo board's duty for the ESC changed, and to what, (N,) each; rising times. Less than 1 = no pulse.
    duty_s: np.ndarray
    duty: np.ndarray
    speed_s: np.ndarray  # the odometry, (M,) each; forward positive, rising times
    speed_mps: np.ndarray
    neutral: float  # the duties of the centered stick and of the ends, in the configuration that was used
    full_forward: float
    full_reverse: float
    # (times, distances in m) at the pulses of each wheel, backward falling; empty = not recorded
    wheels: tuple[tuple[np.ndarray, np.ndarray], ...] = ()


class Sampled(NamedTuple):
    """A drive each STEP_S; (K,) each."""

    t_s: np.ndarray
    duty: np.ndarray
    fraction: np.ndarray  # of the way from neutral to the end; NaN without a pulse
    speed_mps: np.ndarray
    wheels: tuple[tuple[np.ndarray, np.ndarray], ...] = ()  # of EscDrive


class Pull(NamedTuple):
    """A pull: from neutral backward, and to neutral again."""

    strong_s: float  # how long it was STRONG
    neutral_s: float  # of neutral right before it
    since_forward_s: float  # of neutral since the ESC drove forward; inf = there was a pull in between, or no forward
    follows_pull: bool  # with nothing but neutral in between
    speed_mps: float  # at its begin
    outcome: str  # BACKWARD, HELD (the car stood under it) or UNCLEAR
    pause_s: float  # of a BACKWARD one that began rolling: how long the car stood in between; NaN otherwise
    slowed_mps2: float  # the deceleration while it rolled forward, and the acceleration backward; NaN
    backed_mps2: float
    is_exact: bool  # the last three are by the wheels' pulses


def sampled(drive: EscDrive) -> Sampled | None:
    """Return the drive each STEP_S; ``None`` where it is too short, or never in neutral."""
    if not len(drive.duty_s) or len(drive.speed_s) < 2:
        return None
    begin_s = max(drive.duty_s[0], drive.speed_s[0])
    t_s = np.arange(begin_s, drive.speed_s[-1], STEP_S)
    if t_s.size < 50:
        return None
    index = np.searchsorted(drive.duty_s, t_s, side="right") - 1
    duty = np.asarray(drive.duty, float)[index]
    span = np.where(duty > drive.neutral, drive.full_forward - drive.neutral, drive.neutral - drive.full_reverse)
    fraction = np.where(duty >= 1, (duty - drive.neutral) / span, np.nan)
    if not (np.abs(fraction) <= NEUTRAL_BAND).any():
        return None
    return Sampled(t_s, duty, fraction, np.interp(t_s, drive.speed_s, drive.speed_mps), drive.wheels)


def pulls(drive: Sampled) -> list[Pull]:
    """Return the pulls of a drive, in their order."""
    side = np.where(drive.fraction > NEUTRAL_BAND, 1, np.where(drive.fraction < -NEUTRAL_BAND, -1, 0))
    side = np.where(np.isnan(drive.fraction), 2, side)
    edges = np.flatnonzero(np.diff(side)) + 1
    begins, ends = np.r_[0, edges], np.r_[edges, side.size]
    found: list = []
    neutral_s, since_forward_s, follows_pull = 0.0, np.inf, False
    for begin, end in zip(begins, ends):
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
    outcome, turn = UNCLEAR, _NO_TURN
    if strong.any():
        first = int(strong.argmax())
        backward = np.flatnonzero((speed < -MOVES_MPS) & (np.arange(speed.size) >= first))
        stands = (np.abs(speed) < STANDS_MPS) & strong
        if backward.size:
            outcome = BACKWARD
            if speed[0] > MOVES_MPS:
                turn = _turn_by_pulses(drive.wheels, *drive.t_s[[begin, end - 1]]) or _turn_by_speed(speed)
        elif speed.min() > -STANDS_MPS and any((stop - start) * STEP_S >= HELD_S for start, stop in runs(stands)):
            outcome = HELD
    return Pull(float(strong.sum() * STEP_S), neutral_s, since_forward_s, follows_pull, float(drive.speed_mps[begin]),
                outcome, *turn)


_NO_TURN = np.nan, np.nan, np.nan, False


def _turn_by_pulses(wheels, begin_s, end_s):
    """Return how long it stood between forward and backward, deceleration before, acceleration after, and ``True``.

    The deceleration is constant shortly before it stands, and so is the acceleration after: both are parabolas through
    pulses, and their vertices are where it came to stand, and left. ``None`` = too few pulses.
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
    return (*(float(value) for value in np.mean(turns, axis=0)), True) if turns else None


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
        return _NO_TURN
    slowed = -np.polyfit(np.arange(before.size) * STEP_S, before, 1)[0]
    backed = -np.polyfit(np.arange(after.size) * STEP_S, after, 1)[0]
    if slowed <= 0.1 or backed <= 0.1:
        return _NO_TURN
    pause_s = (go - stop) * STEP_S - speed[stop] / slowed + speed[go] / backed
    return float(pause_s), float(slowed), float(backed), False
