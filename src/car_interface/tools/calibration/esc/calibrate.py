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
from car_interface.tools.calibration.esc.drive import (
    BACKWARD,
    HELD,
    MOVES_MPS,
    NEUTRAL_BAND,
    STANDS_MPS,
    STEP_S,
    STRONG,
    EscDrive,
    pulls,
)
from car_interface.tools.calibration.shared import RecordedDrive, runs

MIN_SEEN = 2  # nothing counts that was seen once
FRESH_S = 0.5  # a pull so soon after forward is the first, to any ESC
LONG_COAST_S = 5.0  # an ESC that still brakes then is taken for one that never forgets: known ones forget sooner
# Between forward and backward a direct ESC doesn't pause, a crawler's does. By the wheels' pulses a pause is known to
# 0.03 s (of 80 turns of virtual cars without one the longest was 0.022 s), by odometry to 0.1 s.
NO_PAUSE_S, CLEAR_PAUSE_S, CLEAR_PAUSE_BY_SPEED_S = 0.03, 0.08, 0.2
DELAY_S = 0.3  # what the car did by a pull shows no later: the chip, a period, the odometry, the motor
SAME_PUSH = 0.3  # an ESC without a brake slows the car as strongly as it drives it backward, give or take this
DRAG_MPS2 = 0.35
CREEP_MPS = 0.05
SET_OFF_S = 0.26  # a car that creeps by now was set off so long ago: two pulses of a wheel, at the least
MAX_JUMP = 0.03  # a stick that moved farther within SET_OFF_S doesn't show where the car sets off
MAX_SET_OFF = 0.35  # a car that needs more to set off stands at something
COAST_MPS = (0.4, 2.0)
PUSHED_MPS = (0.1, 1.0)  # where a motor's thrust is still that at standstill

MIN_SAMPLES = 50  # of a drive: a second

NEUTRAL = "servo/neutral"
# The parameters that a drive may show beside that.
FIELDS = ("profile", "dead_band_forward", "dead_band_reverse", "dwell_s", "reverse_after_neutral_s",
          "drag_deceleration_mps2")  # of EscConfig
PARAMETERS = [parameter_of(EscConfig, name) for name in FIELDS]
PROFILE, FORWARD_BAND, REVERSE_BAND, DWELL, FORGET, DRAG = (parameter.name for parameter in PARAMETERS)
ACCEPTED = {parameter.name: parameter.accepted for parameter in PARAMETERS}
NOTHING_KNOWN = "nothing is known: the recording needs odom and the servo board's output, with servo/neutral in it"
HEAD = ("Written by calibrate_esc; throttle_arb loads it. Duties are 0..65535 of the PWM period, dead bands fractions",
        "of the duty between neutral and each end.", "")


@dataclass
class EscFit:
    """What a drive shows."""

    # By name: the profile; the duty in the middle of what the ESC takes for neutral; the fractions from there to each
    # end at which the car sets off; neutral that was long enough for reverse, as short as it was seen; the neutral
    # after which the first pull is reverse, 0 where the ESC still braked after LONG_COAST_S; the least deceleration in
    # neutral.
    values: dict[str, Value] = field(default_factory=dict)
    seen: dict[str, str] = field(default_factory=dict)  # what shows a parameter, in words, by its name
    missing: list[str] = field(default_factory=list)  # what is not known, and what to drive for it

    def show(self, name: str, value: Value, seen: str) -> None:
        """Keep a parameter's value and what shows it."""
        self.values[name], self.seen[name] = value, seen


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
    found = fit([one.drive for one in recorded])
    if NEUTRAL in found.values:
        neutral = found.values[NEUTRAL]
        if base.duty_table[-1] < base.neutral:
            neutral = 2 * first.drive.neutral - neutral
        found.values[NEUTRAL] = round(neutral)
        found.values["servo/duty_table"] = list(trimmed(base, round(neutral)).duty_table)
    return found


def yaml_text(found: EscFit, base: ThrottleConfig, base_text: str, report: Sequence[str]) -> str:
    """Return the text of throttle_arb's file: the base with what the drives show, and the report as its head."""
    over = {"esc/calibration_drive": False} if base.esc.calibration_drive else {}
    return rewritten(base_text, {**found.values, **over}, [*HEAD, *report])


def report(found: EscFit, recorded: Sequence[RecordedDrive], base: ThrottleConfig) -> Iterator[str]:
    """Yield the report's lines: each parameter, its value in the configuration before, and what shows it."""
    seconds = sum(one.duration_s for one in recorded)
    yield f"ESC by {', '.join(one.path for one in recorded)}: {seconds:.0f} s"
    yield from (f"  {note}" for one in recorded for note in one.notes)
    profile, *numbers = ((parameter.name, getattr(base.esc, name), f" {parameter.unit}".rstrip())
                         for name, parameter in zip(FIELDS, PARAMETERS))
    for name, old, unit in (profile, (NEUTRAL, base.calibration.neutral, ""), *numbers):
        if name not in found.values:
            yield f"  {name}: not shown by the drive, stays {old}{unit}"
            continue
        changed = f" (was {old}{unit})" if found.values[name] != old else ""
        yield f"  {name}: {found.values[name]}{unit}{changed}: {found.seen[name]}"
    yield from (f"  missing: {problem}" for problem in found.missing)


# --- what drives show ---


def fit(drives: Sequence[EscDrive]) -> EscFit:
    """Return what drives with the same neutral and ends show of their ESC."""
    found, drives = EscFit(), [drive for drive in drives if drive.t_s.size >= MIN_SAMPLES]
    if not any((np.abs(drive.fraction) <= NEUTRAL_BAND).any() for drive in drives):
        found.missing.append(NOTHING_KNOWN)
        return found
    pulled = [pull for drive in drives for pull in pulls(drive)]
    _profile(found, pulled)
    _dead_band(found, drives)
    if found.values.get(PROFILE) == BRAKE_THEN_REVERSE:
        _dwell(found, pulled)
        _forget(found, pulled)
    _drag(found, drives)
    return found


# --- profile ---


def _profile(found, pulled):
    """Find the one profile that all pulls fit."""
    firsts = [pull for pull in pulled if pull.since_forward_s <= FRESH_S and pull.speed_mps > MOVES_MPS]
    held = [pull for pull in firsts if pull.outcome == HELD]
    turned = [pull for pull in firsts if pull.outcome == BACKWARD]
    if held and turned:
        found.missing.append(f"the profile: of {len(firsts)} brakes after driving forward, {len(held)} held the car "
                             f"and {len(turned)} drove it backward: on a level floor, again")
    elif len(held) >= MIN_SEEN:
        _profile_that_holds(found, pulled, f"{len(held)} brakes held the car,")
    elif len(turned) >= MIN_SEEN:
        _profile_that_turns(found, turned)
    else:
        found.missing.append("the profile: full stick for a good second, pull back all the way, and hold until the car "
                             "has stood for two seconds or rolls backward; three times")
    if PROFILE in found.values:
        found.values["esc/profile_measured"] = True


def _profile_that_holds(found, pulled, text):
    seconds = [pull for pull in _seconds(pulled) if pull.neutral_s >= FRESH_S]
    reversed_ = sum(pull.outcome == BACKWARD for pull in seconds)
    refused = sum(pull.outcome == HELD for pull in seconds)
    if reversed_ >= MIN_SEEN and not refused:
        found.show(PROFILE, BRAKE_THEN_REVERSE, f"{text} {reversed_} second pulls drove it backward")
    # A second pull within an unclear one is no second: only those count that certainly had their neutral.
    elif refused > MIN_SEEN and not reversed_ and not any(pull.outcome == BACKWARD for pull in pulled):
        found.show(PROFILE, FORWARD_ONLY, f"{text} and {refused} second pulls did, too")
    else:
        found.missing.append("the profile: after a brake, center the stick for a second and pull back all the way for "
                             "two seconds; four times")


def _profile_that_turns(found, turned):
    exact = [pull for pull in turned if pull.is_exact]
    is_exact = len(exact) >= MIN_SEEN
    clear = exact if is_exact else [pull for pull in turned if np.isfinite(pull.pause_s)]
    text = f"{len(turned)} brakes that were held drove the car backward"
    # The median: one of them has the noise of a few pulses.
    pause_s = float(np.median([pull.pause_s for pull in clear])) if len(clear) >= MIN_SEEN else np.nan
    if pause_s >= (CLEAR_PAUSE_S if is_exact else CLEAR_PAUSE_BY_SPEED_S):
        found.show(PROFILE, BRAKE_BECOMES_REVERSE, f"{text}, after it had stood for {pause_s:.2f} s")
    elif is_exact and pause_s <= NO_PAUSE_S and _is_same_push(exact):
        found.show(PROFILE, DIRECT_REVERSE, f"{text}, without a pause, and as strongly as they slowed it")
    else:
        found.missing.append("the profile: a brake that is held drives the car backward, but it is not clear whether "
                             "it brakes first: full stick for a good second, pull back all the way, and hold until it "
                             "rolls backward; four times more"
                             + ("" if is_exact else "; and record the wheels' pulses, too (rosbag record -a)"))


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
    seconds = _seconds(pulled)
    enough = [pull.neutral_s for pull in seconds if pull.outcome == BACKWARD]
    short = [pull.neutral_s for pull in seconds if pull.outcome == HELD]
    high = ACCEPTED[DWELL]["high"]
    if not enough or min(enough) > high or short and max(short) >= min(enough):
        found.missing.append(f"{DWELL}: after a brake, center the stick for less than {high:g} s and pull back for a "
                             "second; several times, each a little quicker")
    else:  # the next pulse may be a period later
        found.show(DWELL, _in_range(DWELL, min(enough) + STEP_S, 2), f"{min(enough):.2f} s of neutral were enough"
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
        found.show(FORGET, round(float(max(forget_s, FRESH_S)), 2),
                   f"after {min(forgot):.1f} s in neutral the first pull was reverse, {earlier}")
    elif braked and not forgot and max(braked) >= LONG_COAST_S:
        found.show(FORGET, 0.0, f"after {max(braked):.1f} s in neutral the first pull was a brake")
    else:
        found.missing.append(f"{FORGET}: full stick for a good second, center it, and after {LONG_COAST_S + 3:g} s "
                             "pull back all the way for two seconds; twice"
                             + (" (they contradict each other)" if forgot else ""))


class _SetOff(NamedTuple):
    """Where the car sets off from standstill to one side."""

    duty: float  # the least
    times: int
    edge: float  # the duty where the ESC begins to push, by how much more it takes to move the car


def _set_off(drives, sign):
    """Return where the car sets off; ``None`` = not seen."""
    ago, still = round(SET_OFF_S / STEP_S), round(0.2 / STEP_S)
    found = []
    for drive in drives:
        creeps = drive.speed_mps * sign > CREEP_MPS
        begins = np.flatnonzero(creeps[1:] & ~creeps[:-1]) + 1
        for begin in begins[begins >= ago + still]:
            pushed = drive.fraction[begin - ago] * sign
            stood = np.abs(drive.speed_mps[begin - ago - still:begin - ago]).max() < CREEP_MPS
            slowly = (drive.fraction[begin] - drive.fraction[begin - ago]) * sign <= MAX_JUMP
            if stood and slowly and NEUTRAL_BAND < pushed < MAX_SET_OFF:
                found.append(float(drive.duty[begin - ago]))
    if len(found) < MIN_SEEN:
        return None
    duty = min(found, key=lambda one: one * sign)
    gain = _gain(drives, sign, duty)
    return None if gain is None else _SetOff(duty, len(found), duty - sign * DRAG_MPS2 / gain)


def _gain(drives, sign, set_off):
    """Return the acceleration by each duty beyond where the car sets off; ``None`` = not seen."""
    low, high = PUSHED_MPS

    def is_pushed(drive):
        speed_mps = drive.speed_mps * sign
        pushed = (drive.fraction * sign > STRONG) & (speed_mps > low) & (speed_mps < high)
        pushed[1:] &= np.diff(drive.duty) == 0  # not while the stick moves
        return pushed
    gains = [slope / (duty - set_off) for slope, duty in _slopes(drives, is_pushed, 0.15)]
    gains = [gain for gain in gains if gain > 0]
    return float(np.median(gains)) if len(gains) >= MIN_SEEN else None


def _dead_band(found, drives):
    """Find the neutral and the dead bands: fractions from that neutral, of the distance that both ends have from the
    drive's.

    An ESC without reverse shows nothing behind neutral: it keeps the neutral that it has.
    """
    is_forward_only = found.values.get(PROFILE) == FORWARD_ONLY
    forward, backward = _set_off(drives, 1), None if is_forward_only else _set_off(drives, -1)
    wanted = [(forward, FORWARD_BAND, "push"), (backward, REVERSE_BAND, "pull")][:1 if is_forward_only else 2]
    found.missing += [f"{name}: from standstill, {text} the stick so slowly that the car just sets off; three times"
                      for side, name, text in wanted if side is None]
    if any(side is None for side, _, _ in wanted):
        if not is_forward_only:
            found.missing.append(f"{NEUTRAL}: it lies between where the car sets off to both sides")
        return
    neutral = drives[0].neutral if is_forward_only else (forward.edge + backward.edge) / 2
    spans = drives[0].full_forward - drives[0].neutral, drives[0].full_reverse - drives[0].neutral
    bands = {name: (side.duty - neutral) / span for (side, name, _), span in zip(wanted, spans)}
    fits = all(0 < band <= ACCEPTED[name]["high"] for name, band in bands.items())
    if not (fits and (is_forward_only or forward.edge > backward.edge)):
        found.missing.append(
            (f"{FORWARD_BAND}: the car set off at {forward.duty:.0f}; that fits no neutral of {neutral:.0f}: on a "
             f"level floor, again, or set {NEUTRAL}") if is_forward_only else
            (f"{NEUTRAL}: the car set off at {backward.duty:.0f} and {forward.duty:.0f}; that fits no neutral: on a "
             "level floor, again"))
        return
    shown = f"the car set off at {forward.duty:.0f} ({forward.times} times)"
    if not is_forward_only:
        found.show(NEUTRAL, round(neutral, 1), f"{shown} and {backward.duty:.0f} ({backward.times} times)")
        shown = "from there to where the car sets off"
    for name, band in bands.items():
        found.show(name, _in_range(name, band, 3), shown)


def _drag(found, drives):
    """Find the least deceleration in neutral at low speed."""
    low, high = COAST_MPS
    width = round(DELAY_S / STEP_S)

    def is_rolling(drive):
        neutral = np.abs(np.nan_to_num(drive.fraction, nan=1.0)) <= NEUTRAL_BAND
        settled = np.convolve(neutral, np.ones(width), "full")[:neutral.size] >= width
        return settled & (drive.speed_mps > low) & (drive.speed_mps < high)
    slowed = [-slope for slope, _ in _slopes(drives, is_rolling, 0.2) if slope < 0]
    if len(slowed) < MIN_SEEN:
        found.missing.append(f"{DRAG}: full stick for a good second, then center it until the car stands; three times")
    else:
        found.show(DRAG, _in_range(DRAG, min(slowed), 2), f"{min(slowed):.2f} to {max(slowed):.2f} m/s² in neutral"
                   + (": the ESC has a drag brake" if min(slowed) > 3 * DRAG_MPS2 else ""))


def _slopes(drives, flags_of, min_s):
    """Yield (the acceleration in m/s², the duty at its begin) of each run of samples that a function of a drive flags,
    if it lasts so long.
    """
    for drive in drives:
        for begin, end in runs(flags_of(drive)):
            if (end - begin) * STEP_S >= min_s:
                yield np.polyfit(drive.t_s[begin:end], drive.speed_mps[begin:end], 1)[0], drive.duty[begin]


def _in_range(name, value, digits):
    """Return a value as near as its parameter may have it, rounded."""
    return round(float(min(ACCEPTED[name]["high"], max(ACCEPTED[name]["low"], value))), digits)
