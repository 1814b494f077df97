"""Calibrates an ESC by recorded drives: the parameters ``esc/…`` and ``servo/neutral``, only what the drives show, and
a report on what shows each of them.

What a drive has to hold, each at least twice; docs/calibrate.md has it second by second:

* set off: from standstill, pushed so slowly that the car just sets off; the same backward;
* brake: forward, then at once pulled back and held until the car has stood for a second, or rolls backward;
* pull twice: after such a brake the stick in the center, for a second and less, and pulled back again;
* wait and pull: forward, the stick in the center for eight seconds, then pulled back: does the ESC still brake?

A profile is named only if every pull of the drive fits it.
"""
from __future__ import annotations

from dataclasses import dataclass, field
from typing import Iterator, NamedTuple, Sequence

import numpy as np

from car_interface.common.declared import parameter_of
from car_interface.common.errors import CarInterfaceError
from car_interface.common.yaml_edit import Value, rewritten
from car_interface.throttle.calibration import ThrottleCalibration, trimmed
from car_interface.throttle.config import ThrottleConfig
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
    Sampled,
    pulls,
    sampled,
)
from car_interface.tools.calibration.esc.recorded import joined
from car_interface.tools.calibration.shared import RecordedDrive, runs

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

PROFILE, NEUTRAL, DWELL, FORGET, DRAG = (
    "esc/profile", "servo/neutral", "esc/dwell", "esc/reverse_after_neutral", "esc/drag_deceleration")
NOTHING_KNOWN = "nothing is known: the recording needs odom and the servo board's output, with servo/neutral in it"
HEAD = ("Written by calibrate_esc; throttle_arb loads it. Duties are 0..65535 of the PWM period, dead bands fractions",
        "of the duty between neutral and each end.", "")
# Numbers of the fit, as throttle.yaml has them, and their units.
FITTED = {"dead_band_forward": "", "dead_band_reverse": "", "dwell_s": " s", "reverse_after_neutral_s": " s",
          "drag_deceleration_mps2": " m/s²"}
NOT_SHOWN = "not shown by the drive"


def calibrate(recorded: Sequence[RecordedDrive], base: ThrottleCalibration) -> EscFit:
    """Calibrate by recorded drives. An ESC that takes a shorter pulse for forward gets its neutral mirrored back.

    Raises:
        CarInterfaceError: two were driven with different neutrals.
    """
    first = recorded[0]
    for one in recorded:
        if one.drive.neutral != first.drive.neutral:
            raise CarInterfaceError(f"{first.path} was driven with servo/neutral {first.drive.neutral:.0f} and "
                                    f"{one.path} with {one.drive.neutral:.0f}: calibrate by one of them")
    found = fit(joined([one.drive for one in recorded]))
    if found.neutral is not None and base.duty_table[-1] < base.neutral:
        found.neutral = 2 * first.drive.neutral - found.neutral
    return found


def yaml_values(found: EscFit, base: ThrottleCalibration) -> dict[str, Value]:
    """Return the parameters that the drives show, by name."""
    values = {}
    if found.neutral is not None:
        neutral = round(found.neutral)
        values = {NEUTRAL: neutral, "servo/duty_table": list(trimmed(base, neutral).duty_table)}
    if found.profile is not None:
        values.update({PROFILE: found.profile, "esc/profile_measured": True})
    for name in FITTED:
        value = getattr(found, name)
        if value is not None:
            values[parameter_of(EscConfig, name).name] = value
    return values


def yaml_text(found: EscFit, base: ThrottleConfig, base_text: str, report: Sequence[str]) -> str:
    """Return the text of throttle_arb's file: the base with what the drives show, and the report as its head."""
    values = yaml_values(found, base.calibration)
    if base.esc.calibration_drive:
        values["esc/calibration_drive"] = False
    return rewritten(base_text, values, [*HEAD, *report])


def report(found: EscFit, recorded: Sequence[RecordedDrive], base: ThrottleConfig) -> Iterator[str]:
    """Yield the report's lines: each parameter, its value in the configuration before, and what shows it."""
    seconds = sum(one.duration_s for one in recorded)
    yield f"ESC by {', '.join(one.path for one in recorded)}: {seconds:.0f} s"
    yield from (f"  {note}" for one in recorded for note in one.notes)
    values = yaml_values(found, base.calibration)
    olds = {PROFILE: (base.esc.profile, ""), NEUTRAL: (base.calibration.neutral, ""),
            **{parameter_of(EscConfig, name).name: (getattr(base.esc, name), unit) for name, unit in FITTED.items()}}
    for name, (old, unit) in olds.items():
        if name not in values:
            yield f"  {name}: {NOT_SHOWN}, stays {old}{unit}"
            continue
        changed = f" (was {old}{unit})" if values[name] != old else ""
        shown = found.seen.get(name) or ("from there to where the car sets off" if "dead_band" in name else "")
        yield f"  {name}: {values[name]}{unit}{changed}" + (f": {shown}" if shown else "")
    yield from (f"  missing: {problem}" for problem in found.missing)


# --- what a drive shows ---


@dataclass
class EscFit:
    """What a drive shows; ``None`` = it does not."""

    profile: str | None = None  # of esc_config
    neutral: float | None = None  # the duty in the middle of what the ESC takes for neutral
    dead_band_forward: float | None = None  # the fraction from that neutral at which the car sets off
    dead_band_reverse: float | None = None  # the same backward
    dwell_s: float | None = None  # neutral that was long enough for reverse, as short as it was seen
    reverse_after_neutral_s: float | None = None  # 0 where the ESC still braked after LONG_COAST_S
    drag_deceleration_mps2: float | None = None  # the least in neutral
    seen: dict[str, str] = field(default_factory=dict)  # what shows a parameter, in words, by its name
    missing: list[str] = field(default_factory=list)  # what is not known, and what to drive for it


def fit(drive: EscDrive) -> EscFit:
    """Return what a drive shows of its ESC."""
    data, found = sampled(drive), EscFit()
    if data is None:
        found.missing.append(NOTHING_KNOWN)
        return found
    pulled = pulls(data)
    found.profile = _profile(found, pulled)
    _dead_band(found, drive, *(_set_off(data, sign, found.profile) for sign in (1, -1)))
    if found.profile == BRAKE_THEN_REVERSE:
        _dwell(found, pulled)
        _forget(found, pulled)
    _drag(found, data)
    return found


# --- profile ---


def _profile(found, pulled):
    """Return the one profile that all pulls fit, or ``None``."""
    firsts = [pull for pull in pulled if pull.since_forward_s <= FRESH_S and pull.speed_mps > MOVES_MPS]
    held = [pull for pull in firsts if pull.outcome == HELD]
    turned = [pull for pull in firsts if pull.outcome == BACKWARD]
    if held and turned:
        found.missing.append(f"the profile: of {len(firsts)} brakes after driving forward, {len(held)} held the car "
                             f"and {len(turned)} drove it backward: on a level floor, again")
        return None
    if len(held) >= MIN_SEEN:
        return _profile_that_holds(found, pulled, held)
    if len(turned) >= MIN_SEEN:
        return _profile_that_turns(found, turned)
    found.missing.append("the profile: full stick for a good second, pull back all the way, and hold until the car has "
                         "stood for two seconds or rolls backward; three times")
    return None


def _profile_that_holds(found, pulled, held):
    seconds = [pull for pull in _seconds(pulled) if pull.neutral_s >= FRESH_S]
    reversed_ = [pull for pull in seconds if pull.outcome == BACKWARD]
    refused = [pull for pull in seconds if pull.outcome == HELD]
    text = f"{len(held)} brakes held the car,"
    if len(reversed_) >= MIN_SEEN and not refused:
        found.seen[PROFILE] = f"{text} {len(reversed_)} second pulls drove it backward"
        return BRAKE_THEN_REVERSE
    # A second pull within an unclear one is no second: only those count that certainly had their neutral.
    if len(refused) > MIN_SEEN and not reversed_ and not any(pull.outcome == BACKWARD for pull in pulled):
        found.seen[PROFILE] = f"{text} and {len(refused)} second pulls did, too"
        return FORWARD_ONLY
    found.missing.append("the profile: after a brake, center the stick for a second and pull back all the way for two "
                         "seconds; four times")
    return None


def _profile_that_turns(found, turned):
    exact = [pull for pull in turned if pull.is_exact]
    clear = exact if len(exact) >= MIN_SEEN else [pull for pull in turned if np.isfinite(pull.pause_s)]
    text = f"{len(turned)} brakes that were held drove the car backward"
    if len(clear) >= MIN_SEEN:
        # The median: one of them has the noise of a few pulses.
        pause_s = float(np.median([pull.pause_s for pull in clear]))
        if pause_s >= (CLEAR_PAUSE_S if clear is exact else CLEAR_PAUSE_BY_SPEED_S):
            found.seen[PROFILE] = f"{text}, after it had stood for {pause_s:.2f} s"
            return BRAKE_BECOMES_REVERSE
        if clear is exact and pause_s <= NO_PAUSE_S and _is_same_push(clear):
            found.seen[PROFILE] = f"{text}, without a pause, and as strongly as they slowed it"
            return DIRECT_REVERSE
    found.missing.append("the profile: a brake that is held drives the car backward, but it is not clear whether it "
                         "brakes first: full stick for a good second, pull back all the way, and hold until it rolls "
                         "backward; four times more"
                         + ("" if clear is exact else "; and record the wheels' pulses, too (rosbag record -a)"))
    return None


def _is_same_push(turned):
    """Return whether the car is slowed as strongly as it is driven backward: drag helps the first and hinders the
    second.
    """
    push = np.array([pull.backed_mps2 + DRAG_MPS2 for pull in turned])
    slowed = np.array([pull.slowed_mps2 - DRAG_MPS2 for pull in turned])
    return bool(np.median(np.abs(slowed - push) / push) <= SAME_PUSH)


def _seconds(pulled):
    """Return the pulls from standstill that follow a brake, with nothing but neutral in between."""
    return [pull for before, pull in zip(pulled, pulled[1:])
            if before.since_forward_s <= FRESH_S and before.outcome == HELD and abs(pull.speed_mps) < STANDS_MPS
            and pull.follows_pull and pull.strong_s > 0]


# --- numbers ---


def _dwell(found, pulled):
    enough = [pull.neutral_s for pull in _seconds(pulled) if pull.outcome == BACKWARD]
    short = [pull.neutral_s for pull in _seconds(pulled) if pull.outcome == HELD]
    low, high = _range("dwell_s")
    if not enough or min(enough) > high or short and max(short) >= min(enough):
        found.missing.append(f"{DWELL}: after a brake, center the stick for less than {high:g} s and pull back for a "
                             "second; several times, each a little quicker")
        return
    found.dwell_s = round(float(min(high, max(low, min(enough) + STEP_S))), 2)  # the next pulse may be a period later
    found.seen[DWELL] = (f"{min(enough):.2f} s of neutral were enough"
                         + (f", {max(short):.2f} s were not" if short else ""))


def _forget(found, pulled):
    """Find the neutral after which the first pull is reverse; 0 = it never is."""
    # Some brake a car that still rolls, although they have forgotten: only from standstill it shows.
    stood = [pull for pull in pulled if np.isfinite(pull.since_forward_s) and abs(pull.speed_mps) < STANDS_MPS]
    braked = [pull.since_forward_s for pull in stood if pull.outcome == HELD]
    forgot = [pull.since_forward_s for pull in stood if pull.outcome == BACKWARD]
    if forgot and max(braked, default=0.0) < min(forgot):
        # Without a brake from standstill nothing longer is trusted than what any known ESC remembers.
        forget_s = max(braked, default=FRESH_S)
        earlier = f"after {forget_s:.1f} s a brake" if braked else "and none from standstill was a brake"
        found.seen[FORGET] = f"after {min(forgot):.1f} s in neutral the first pull was reverse, {earlier}"
        found.reverse_after_neutral_s = round(float(max(forget_s, FRESH_S)), 2)
    elif braked and not forgot and max(braked) >= LONG_COAST_S:
        found.seen[FORGET] = f"after {max(braked):.1f} s in neutral the first pull was a brake"
        found.reverse_after_neutral_s = 0.0
    else:
        found.missing.append(f"{FORGET}: full stick for a good second, center it, and after {LONG_COAST_S + 3:g} s "
                             "pull back all the way for two seconds; twice"
                             + (" (they contradict each other)" if forgot else ""))


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
    gains = [slope * sign / ((data.duty[begin] - set_off) * sign) for slope, begin in _slopes(data, pushed, 0.15)]
    gains = [gain for gain in gains if gain > 0]
    return float(np.median(gains)) if len(gains) >= MIN_SEEN else None


def _dead_band(found, drive, forward, backward):
    """Find the neutral and the dead bands: fractions from that neutral, of the distance that both ends have from the
    drive's.

    An ESC without reverse shows nothing behind neutral: it keeps the neutral that it has.
    """
    is_forward_only = found.profile == FORWARD_ONLY
    wanted = [(forward, "forward", "push"), (backward, "reverse", "pull")][:1 if is_forward_only else 2]
    for side, name, text in wanted:
        if side is None:
            found.missing.append(f"esc/dead_band_{name}: from standstill, {text} the stick so slowly that the car just "
                                 "sets off; three times")
    if any(side is None for side, _, _ in wanted):
        if not is_forward_only:
            found.missing.append(f"{NEUTRAL}: it lies between where the car sets off to both sides")
        return
    low, high = _range("dead_band_forward")
    neutral = drive.neutral if is_forward_only else (forward.edge + backward.edge) / 2
    bands = [(forward.duty - neutral) / (drive.full_forward - drive.neutral)]
    if not is_forward_only:
        bands.append((neutral - backward.duty) / (drive.neutral - drive.full_reverse))
    is_possible = all(0 < band <= high for band in bands)
    sets_off = f"the car set off at {forward.duty:.0f} ({forward.times} times)"
    if is_forward_only and not is_possible:
        found.missing.append(f"esc/dead_band_forward: the car set off at {forward.duty:.0f}; that fits no neutral of "
                             f"{drive.neutral:.0f}: on a level floor, again, or set {NEUTRAL}")
    elif is_forward_only:
        found.seen["esc/dead_band_forward"] = sets_off
    elif not forward.edge > backward.edge or not is_possible:
        found.missing.append(f"{NEUTRAL}: the car set off at {backward.duty:.0f} and {forward.duty:.0f}; that fits no "
                             "neutral: on a level floor, again")
        return
    else:
        found.neutral = round(neutral, 1)
        found.seen[NEUTRAL] = f"{sets_off} and {backward.duty:.0f} ({backward.times} times)"
    if is_possible:
        found.dead_band_forward, found.dead_band_reverse = ([round(max(low, band), 3) for band in bands] + [None])[:2]


def _drag(found, data):
    """Find the least deceleration in neutral at low speed."""
    neutral = np.abs(np.nan_to_num(data.fraction, nan=1.0)) <= NEUTRAL_BAND
    width = round(DELAY_S / STEP_S)
    settled = np.convolve(neutral, np.ones(width), "full")[:neutral.size] >= width
    low, high = COAST_MPS
    rolls = settled & (data.speed_mps > low) & (data.speed_mps < high)
    slowed = [-slope for slope, _ in _slopes(data, rolls, 0.2) if slope < 0]
    if len(slowed) < MIN_SEEN:
        found.missing.append(f"{DRAG}: full stick for a good second, then center it until the car stands; three times")
        return
    least, most = _range("drag_deceleration_mps2")
    found.drag_deceleration_mps2 = round(float(min(max(min(slowed), least), most)), 2)
    found.seen[DRAG] = (f"{min(slowed):.2f} to {max(slowed):.2f} m/s² in neutral"
                        + (": the ESC has a drag brake" if min(slowed) > 3 * DRAG_MPS2 else ""))


def _slopes(data, flags, min_s):
    """Yield (the acceleration in m/s², the first index) of each run of true in flags (K,) that lasts so long."""
    for begin, end in runs(flags):
        if (end - begin) * STEP_S >= min_s:
            yield np.polyfit(data.t_s[begin:end], data.speed_mps[begin:end], 1)[0], begin


def _range(name):
    accepted = parameter_of(EscConfig, name).accepted
    return accepted["low"], accepted["high"]
