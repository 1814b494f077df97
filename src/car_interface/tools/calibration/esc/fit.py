"""The parameters ``esc/…`` and ``servo/neutral`` from a drive: only what the drive shows, each with what shows it.

What the drive has to hold, each at least twice; docs/calibrate.md has it second by second:

* set off: from standstill, pushed so slowly that the car just sets off; the same backward;
* brake: forward, then at once pulled back and held until the car has stood for a second, or rolls backward;
* pull twice: after such a brake the stick in the center, for a second and less, and pulled back again;
* wait and pull: forward, the stick in the center for eight seconds, then pulled back: does the ESC still brake?

A profile is named only if every pull of the drive fits it.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Sequence

import numpy as np

from car_interface.common.declared import parameter_of
from car_interface.throttle.esc_config import (
    BRAKE_BECOMES_REVERSE,
    BRAKE_THEN_REVERSE,
    DIRECT_REVERSE,
    FORWARD_ONLY,
    EscConfig,
)
from car_interface.tools.calibration.esc.pulls import (
    BACKWARD,
    DELAY_S,
    HELD,
    MOVES_MPS,
    NEUTRAL_BAND,
    STANDS_MPS,
    STEP_S,
    STRONG,
    EscDrive,
    Pull,
    Sampled,
    pulls,
    sampled,
)
from car_interface.tools.calibration.shared import runs

MIN_SEEN = 2  # nothing counts that was seen once
FRESH_S = 0.5  # a pull so soon after forward is the first, to any ESC
LONG_COAST_S = 5.0  # an ESC that still brakes then is taken for one that never forgets: known ones forget sooner
# Between forward and backward a direct ESC doesn't pause, a crawler's does. By the wheels' pulses a pause is known to
# 0.03 s (of 80 turns of virtual cars without one the longest was 0.022 s), by odometry to 0.1 s.
NO_PAUSE_S, CLEAR_PAUSE_S, CLEAR_PAUSE_BY_SPEED_S = 0.03, 0.08, 0.2
SAME_PUSH = 0.3  # an ESC without a brake slows the car as strongly as it drives it backward, give or take this
DRAG_MPS2 = 0.35
CREEP_MPS = 0.05
SET_OFF_S = 0.26  # a car that creeps by now was set off so long ago: two pulses of a wheel, at the least
MAX_JUMP = 0.03  # a stick that moved farther within SET_OFF_S doesn't show where the car sets off
MAX_SET_OFF = 0.35  # a car that needs more to set off stands at something
COAST_MPS = (0.4, 2.0)
PUSHED_MPS = (0.1, 1.0)  # where a motor's thrust is still that at standstill

NOTHING_KNOWN = "nothing is known: the recording needs odom and the servo board's output, with servo/neutral in it"


@dataclass(frozen=True)
class EscFit:
    """What a drive shows; ``None`` = it does not."""

    profile: str | None  # of esc_config
    neutral: float | None  # the duty in the middle of what the ESC takes for neutral
    dead_band_forward: float | None  # the fraction from that neutral at which the car sets off
    dead_band_reverse: float | None  # the same backward
    dwell_s: float | None  # neutral that was long enough for reverse, as short as it was seen
    reverse_after_neutral_s: float | None  # 0 where the ESC still braked after LONG_COAST_S
    drag_deceleration_mps2: float | None  # the least in neutral
    seen: tuple[str, ...]  # what shows each, in words
    missing: tuple[str, ...]  # what is not known, and what to drive for it


def fit(drive: EscDrive) -> EscFit:
    """Return what a drive shows of its ESC."""
    data = sampled(drive)
    if data is None:
        return EscFit(None, None, None, None, None, None, None, (), (NOTHING_KNOWN,))
    seen, missing, found = [], [], pulls(data)
    profile = _profile(found, seen, missing)
    forward, backward = _set_off(data, 1, profile), _set_off(data, -1, profile)
    neutral, bands = _dead_band(drive, forward, backward, profile, seen, missing)
    dwell_s = forget_s = None
    if profile == BRAKE_THEN_REVERSE:
        dwell_s = _dwell(found, seen, missing)
        forget_s = _forget(found, seen, missing)
    return EscFit(profile, neutral, *bands, dwell_s, forget_s, _drag(data, seen, missing), tuple(seen), tuple(missing))


# --- profile ---


def _profile(found: Sequence[Pull], seen, missing):
    """Return the one profile that all pulls fit, or ``None``."""
    firsts = [pull for pull in found if pull.since_forward_s <= FRESH_S and pull.speed_mps > MOVES_MPS]
    held = [pull for pull in firsts if pull.outcome == HELD]
    turned = [pull for pull in firsts if pull.outcome == BACKWARD]
    if held and turned:
        missing.append(f"the profile: of {len(firsts)} brakes after driving forward, {len(held)} held the car and "
                       f"{len(turned)} drove it backward: on a level floor, again")
        return None
    if len(held) >= MIN_SEEN:
        return _profile_that_holds(found, held, seen, missing)
    if len(turned) >= MIN_SEEN:
        return _profile_that_turns(turned, seen, missing)
    missing.append("the profile: full stick for a good second, pull back all the way, and hold until the car has stood "
                   "for two seconds or rolls backward; three times")
    return None


def _profile_that_holds(found, held, seen, missing):
    seconds = [pull for before, pull in zip(found, found[1:])
               if _is_second(before, pull) and pull.neutral_s >= FRESH_S]
    reversed_ = [pull for pull in seconds if pull.outcome == BACKWARD]
    refused = [pull for pull in seconds if pull.outcome == HELD]
    if len(reversed_) >= MIN_SEEN and not refused:
        seen.append(f"esc/profile: {len(held)} brakes held the car, {len(reversed_)} second pulls drove it backward")
        return BRAKE_THEN_REVERSE
    # A second pull within an unclear one is no second: only those count that certainly had their neutral.
    if len(refused) > MIN_SEEN and not reversed_ and not any(pull.outcome == BACKWARD for pull in found):
        seen.append(f"esc/profile: {len(held)} brakes held the car, and {len(refused)} second pulls did, too")
        return FORWARD_ONLY
    missing.append("the profile: after a brake, center the stick for a second and pull back all the way for two "
                   "seconds; four times")
    return None


def _profile_that_turns(turned, seen, missing):
    exact = [pull for pull in turned if pull.is_exact]
    clear = exact if len(exact) >= MIN_SEEN else [pull for pull in turned if np.isfinite(pull.pause_s)]
    text = f"esc/profile: {len(turned)} brakes that were held drove the car backward"
    if len(clear) >= MIN_SEEN:
        # The median: one of them has the noise of a few pulses.
        pause_s = float(np.median([pull.pause_s for pull in clear]))
        if pause_s >= (CLEAR_PAUSE_S if clear is exact else CLEAR_PAUSE_BY_SPEED_S):
            seen.append(f"{text}, after it had stood for {pause_s:.2f} s")
            return BRAKE_BECOMES_REVERSE
        if clear is exact and pause_s <= NO_PAUSE_S and _is_same_push(clear):
            seen.append(f"{text}, without a pause, and as strongly as they slowed it")
            return DIRECT_REVERSE
    missing.append("the profile: a brake that is held drives the car backward, but it is not clear whether it brakes "
                   "first: full stick for a good second, pull back all the way, and hold until it rolls backward; four "
                   "times more"
                   + ("" if clear is exact else "; and record the wheels' pulses, too (rosbag record -a)"))
    return None


def _is_same_push(turned):
    """Return whether the car is slowed as strongly as it is driven backward: drag helps the first and hinders the
    second.
    """
    push = np.array([pull.backed_mps2 + DRAG_MPS2 for pull in turned])
    slowed = np.array([pull.slowed_mps2 - DRAG_MPS2 for pull in turned])
    return bool(np.median(np.abs(slowed - push) / push) <= SAME_PUSH)


def _is_second(before, pull):
    """Return whether a pull from standstill follows a brake, with nothing but neutral in between."""
    return (before.since_forward_s <= FRESH_S and before.outcome == HELD and abs(pull.speed_mps) < STANDS_MPS
            and pull.follows_pull and pull.strong_s > 0)


# --- numbers ---


def _dwell(found, seen, missing):
    seconds = [pull for before, pull in zip(found, found[1:]) if _is_second(before, pull)]
    enough = [pull.neutral_s for pull in seconds if pull.outcome == BACKWARD]
    short = [pull.neutral_s for pull in seconds if pull.outcome == HELD]
    low, high = _range("dwell_s")
    if not enough or min(enough) > high or short and max(short) >= min(enough):
        missing.append(f"esc/dwell: after a brake, center the stick for less than {high:g} s and pull back for a "
                       "second; several times, each a little quicker")
        return None
    dwell_s = min(high, max(low, min(enough) + STEP_S))  # the next pulse may come a period later
    seen.append(f"esc/dwell: {min(enough):.2f} s of neutral were enough"
                + (f", {max(short):.2f} s were not" if short else ""))
    return round(float(dwell_s), 2)


def _forget(found, seen, missing):
    """Neutral after which the first pull is reverse; 0 = it never is."""
    firsts = [pull for pull in found if np.isfinite(pull.since_forward_s)]
    # Some brake a car that still rolls, although they have forgotten: only from standstill it shows.
    stood = [pull for pull in firsts if abs(pull.speed_mps) < STANDS_MPS]
    braked = [pull.since_forward_s for pull in stood if pull.outcome == HELD]
    forgot = [pull.since_forward_s for pull in stood if pull.outcome == BACKWARD]
    if forgot and max(braked, default=0.0) < min(forgot):
        # Without a brake from standstill nothing longer is trusted than what any known ESC remembers.
        forget_s = max(braked, default=FRESH_S)
        seen.append(f"esc/reverse_after_neutral: after {min(forgot):.1f} s in neutral the first pull was reverse, "
                    + (f"after {forget_s:.1f} s a brake" if braked else "and none from standstill was a brake"))
        return round(float(max(forget_s, FRESH_S)), 2)
    if braked and not forgot and max(braked) >= LONG_COAST_S:
        seen.append(f"esc/reverse_after_neutral: after {max(braked):.1f} s in neutral the first pull was a brake")
        return 0.0
    missing.append(f"esc/reverse_after_neutral: full stick for a good second, center it, and after "
                   f"{LONG_COAST_S + 3:g} s pull back all the way for two seconds; twice"
                   + (" (they contradict each other)" if forgot else ""))
    return None


class _SetOff(NamedTuple):
    """Where the car sets off from standstill to one side."""

    duty: float  # the least
    times: int
    edge: float  # the duty where the ESC begins to push, by how much more it takes to move the car


def _set_off(data: Sampled, sign, profile):
    """Return where the car sets off; ``None`` = not seen."""
    if sign < 0 and profile == FORWARD_ONLY:
        return None
    creeps = data.speed_mps * sign > CREEP_MPS
    begins = np.flatnonzero(creeps[1:] & ~creeps[:-1]) + 1
    ago, still = round(SET_OFF_S / STEP_S), round(0.2 / STEP_S)
    found = []
    for begin in begins[begins >= ago + still]:
        pushed = data.fraction[begin - ago] * sign
        stood = np.abs(data.speed_mps[begin - ago - still:begin - ago]).max() < CREEP_MPS
        slowly = (data.fraction[begin] - data.fraction[begin - ago]) * sign <= MAX_JUMP
        if stood and slowly and NEUTRAL_BAND < pushed < MAX_SET_OFF:
            found.append(float(data.duty[begin - ago]))
    if len(found) < MIN_SEEN:
        return None
    duty = min(found, key=lambda one: one * sign)
    gain = _gain(data, sign, duty)
    return None if gain is None else _SetOff(duty, len(found), duty - sign * DRAG_MPS2 / gain)


def _gain(data, sign, set_off):
    """Return the acceleration by each duty beyond where the car sets off; ``None`` = not seen."""
    low, high = PUSHED_MPS
    pushed = (data.fraction * sign > STRONG) & (data.speed_mps * sign > low) & (data.speed_mps * sign < high)
    pushed[1:] &= np.diff(data.duty) == 0  # not while the stick moves
    gains = []
    for begin, end in runs(pushed):
        if (end - begin) * STEP_S >= 0.15:
            slope = np.polyfit(data.t_s[begin:end], data.speed_mps[begin:end], 1)[0] * sign
            gains.append(slope / ((data.duty[begin] - set_off) * sign))
    gains = [gain for gain in gains if gain > 0]
    return float(np.median(gains)) if len(gains) >= MIN_SEEN else None


def _dead_band(drive, forward, backward, profile, seen, missing):
    """Return (neutral, (forward, reverse)): fractions from that neutral, of the distance that both ends have from the
    drive's.

    An ESC without reverse shows nothing behind neutral: it keeps the neutral that it has.
    """
    wanted = [(forward, "forward", "push"), (backward, "reverse", "pull")][:1 if profile == FORWARD_ONLY else 2]
    for found, name, text in wanted:
        if found is None:
            missing.append(f"esc/dead_band_{name}: from standstill, {text} the stick so slowly that the car just sets "
                           "off; three times")
    low, high = _range("dead_band_forward")
    span_forward, span_reverse = drive.full_forward - drive.neutral, drive.neutral - drive.full_reverse
    if profile == FORWARD_ONLY and forward is not None:
        band = (forward.duty - drive.neutral) / span_forward
        if not 0 < band <= high:
            missing.append(f"esc/dead_band_forward: the car set off at {forward.duty:.0f}; that fits no neutral of "
                           f"{drive.neutral:.0f}: on a level floor, again, or set servo/neutral")
            return None, (None, None)
        seen.append(f"esc/dead_band_forward: the car set off at {forward.duty:.0f} ({forward.times} times)")
        return None, (round(max(low, band), 3), None)
    if forward is None or backward is None:
        if profile != FORWARD_ONLY:
            missing.append("servo/neutral: it lies between where the car sets off to both sides")
        return None, (None, None)
    neutral = (forward.edge + backward.edge) / 2
    bands = ((forward.duty - neutral) / span_forward, (neutral - backward.duty) / span_reverse)
    if not forward.edge > backward.edge or not all(0 < band <= high for band in bands):
        missing.append(f"servo/neutral: the car set off at {backward.duty:.0f} and {forward.duty:.0f}; that fits no "
                       "neutral: on a level floor, again")
        return None, (None, None)
    seen.append(f"servo/neutral: the car set off at {forward.duty:.0f} ({forward.times} times) and {backward.duty:.0f} "
                f"({backward.times} times)")
    return round(neutral, 1), tuple(round(max(low, band), 3) for band in bands)


def _drag(data, seen, missing):
    """Return the least deceleration in neutral at low speed."""
    neutral = np.abs(np.nan_to_num(data.fraction, nan=1.0)) <= NEUTRAL_BAND
    width = round(DELAY_S / STEP_S)
    settled = np.convolve(neutral, np.ones(width), "full")[:neutral.size] >= width
    low, high = COAST_MPS
    rolls = settled & (data.speed_mps > low) & (data.speed_mps < high)
    slowed = [-np.polyfit(data.t_s[begin:end], data.speed_mps[begin:end], 1)[0]
              for begin, end in runs(rolls) if (end - begin) * STEP_S >= 0.2]
    slowed = [value for value in slowed if value > 0]
    if len(slowed) < MIN_SEEN:
        missing.append("esc/drag_deceleration: full stick for a good second, then center it until the car stands; "
                       "three times")
        return None
    least, most = _range("drag_deceleration_mps2")
    seen.append(f"esc/drag_deceleration: {min(slowed):.2f} to {max(slowed):.2f} m/s² in neutral"
                + (": the ESC has a drag brake" if min(slowed) > 3 * DRAG_MPS2 else ""))
    return round(float(min(max(min(slowed), least), most)), 2)


def _range(field):
    accepted = parameter_of(EscConfig, field).accepted
    return accepted["low"], accepted["high"]
