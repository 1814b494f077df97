"""Sequences: an ESC, a car, a person or a planner, and what goes wrong. Each depends on its seed alone."""
from __future__ import annotations

import math
import random
from typing import NamedTuple, Sequence

from adversary.car_model import CarSpec
from adversary.esc_model import (
    BBR,
    BTR,
    CUT_ALL,
    CUT_FORWARD,
    DIRECT,
    FORWARD_ONLY,
    KINDS,
    OBEYS,
    REFUSES,
    RELEARNS,
    EscSpec,
)

UNVERIFIED = "unverified"
# What a person or a planner wants. SECOND: reverse, as far as the car stands; ANY: nobody can say.
STOP, HOLD, DRIVE, COAST, SECOND, ANY = "stop", "hold", "drive", "coast", "second", "any"
MANUAL, AUTONOMOUS = "manual", "autonomous"
SILENCE_S = 0.5  # a planner that is silent for so long wants a stop

STALL, DEATH, OUTPUT_LATE, OUTPUT_LOST = "stall", "death", "output late", "output lost"
ODOMETRY_LATE, ODOMETRY_LOST = "odometry late", "odometry lost"
CUT_FAULT, OFF, OFF_HELD, WALL = "cut-off", "off", "off, on under a pull", "wall"
FAULTS = (STALL, DEATH, OUTPUT_LATE, OUTPUT_LOST, ODOMETRY_LATE, ODOMETRY_LOST, CUT_FAULT, OFF_HELD, WALL)
# An ESC of one kind that is driven as another. None: its own kind, of which a trait is not known to the rules.
WRONG = [(BTR, BBR), (BTR, DIRECT), (BBR, DIRECT), (BBR, BTR), (DIRECT, BTR), (DIRECT, BBR),
         (FORWARD_ONLY, BTR), (FORWARD_ONLY, BBR), (FORWARD_ONLY, DIRECT), (BTR, BTR)]


class Segment(NamedTuple):
    """What comes from the person and the planner until ``end_s``; a ``value`` of None = the planner is silent."""

    end_s: float
    want: str
    deadman: bool = True
    e_stop: bool = False
    mode: str = MANUAL
    stick: float = 0.0
    value: float | None = None
    gear: str = ""


class Fault(NamedTuple):
    """Something that goes wrong from ``start_s`` to ``end_s``."""

    name: str
    start_s: float
    end_s: float
    value: float = 0.0  # seconds of delay, what is cut, or +1: a wall ahead, −1: behind


class Odometry(NamedTuple):
    """Speeds of the wheels, which arrive late by ``delay_s``, with their true stamp or without."""

    period_s: float = 0.02
    delay_s: float = 0.01
    is_stamped: bool = True
    noise_mps: float = 0.01


class Case(NamedTuple):
    name: str
    group: str  # right, unverified, wrong
    config: dict  # of the rules
    esc: EscSpec
    car: CarSpec
    script: Sequence[Segment]
    faults: Sequence[Fault]
    odometry: Odometry
    human_scale: float = 0.5
    speed_mps: float = 0.0  # at which the script's push ends early; 0 = it doesn't
    is_even: bool = False  # all delays are the middle ones
    cruise_mps: float = 0.0  # what the planner says that the car should drive on with; 0 = nothing

    @property
    def is_measured(self) -> bool:
        return self.config.get("profile_measured", False)


class _Script:
    """Segments one after another, and what is wanted by them."""

    def __init__(self, rng, arming_s):
        self.rng, self.now_s, self.segments = rng, 0.0, []
        self.pulls = 0  # of the stick since it was pushed
        self.is_known = True  # whether a next pull is one more of them
        self.add(arming_s + 0.15, COAST, deadman=False)
        self.add(0.12, COAST)

    def add(self, lasts_s, want, **fields):
        self.now_s += lasts_s
        self.segments.append(Segment(self.now_s, want, **fields))

    def push(self):
        self.add(self.rng.uniform(0.3, 1.8), DRIVE, stick=self.rng.uniform(0.3, 1.0))
        self.pulls, self.is_known = 0, True

    def next_pull(self):
        """What a pull wants that begins now; one that goes on wants what it did."""
        if self.segments[-1].stick < 0 and self.segments[-1].deadman:
            return self.segments[-1].want
        self.pulls += 1
        return HOLD if self.pulls == 1 else SECOND if self.is_known else ANY

    def pull(self, at_least_s=0.1):
        want = self.next_pull()
        ends_s = self.now_s + self.rng.choice((self.rng.uniform(0.1, 0.4), self.rng.uniform(0.4, 2.5)))
        ends_s = max(ends_s, self.now_s + at_least_s)
        while self.now_s < ends_s:  # a hand isn't steady
            lasts_s = min(ends_s - self.now_s, self.rng.uniform(0.2, 2.0))
            self.add(max(0.05, lasts_s), want, stick=-self.rng.choice((1.0, self.rng.uniform(0.12, 1.0))))

    def center(self):
        self.add(self.rng.choice((self.rng.uniform(0.05, 0.4), self.rng.uniform(0.2, 1.2))), COAST)

    def stop(self, **fields):
        """By deadman or e-stop; the stick stays where it was, or is let go."""
        before, stick = self.segments[-1], 0.0
        if self.rng.random() < 0.4:
            stick = before.stick
        lasts_s = self.rng.uniform(0.2, 2.5)
        if self.rng.random() < 0.35:
            self.add(lasts_s, STOP, e_stop=True, stick=stick, **fields)
            self.add(0.2, STOP, deadman=False, **fields)
        else:
            self.add(lasts_s, STOP, deadman=False, stick=stick, **fields)
        self.add(0.15, COAST, **({"value": 0.0, **fields} if "gear" in fields else fields))
        self.is_known = False

    def reverse(self):
        """As a person does it: brake until the car stands, center, pull and hold it."""
        self.add(self.rng.uniform(0.8, 2.2), self.next_pull(), stick=-self.rng.uniform(0.6, 1.0))
        self.add(self.rng.uniform(0.06, 0.6), COAST)
        self.add(self.rng.uniform(1.6, 2.6), self.next_pull(), stick=-self.rng.uniform(0.3, 1.0))

    def by_stick(self, until_s):
        while self.now_s < until_s:
            action = self.rng.random()
            if action < 0.75 or not self.pulls:
                self.push()
            after = self.rng.random()
            if after < 0.4:
                self.stop()
            elif after < 0.6:
                self.pull()
            elif after < 0.7:
                self.pull()
                self.center()
                self.pull()
            elif after < 0.85:
                self.reverse()
            else:
                self.pull(0.5)
                self.stop()

    def by_planner(self, until_s):
        rng = self.rng
        gear = rng.choice(("drive", "")) if rng.random() < 0.7 else ""
        ways = {"mode": AUTONOMOUS, "gear": gear}
        while self.now_s < until_s:
            if rng.random() < 0.85:
                self.add(rng.uniform(0.3, 1.5), DRIVE, value=rng.uniform(0.5, 3.0), **ways)
            after = rng.random()
            brakes = {"value": -rng.choice((1.5, 5.0, rng.uniform(0.4, 5.0))), **ways}
            if after < 0.3:
                self.stop(**ways)
            elif after < 0.5:
                self.add(rng.uniform(0.3, 2.5), HOLD, **brakes)
            elif after < 0.65:
                self.add(rng.uniform(0.2, 1.0), HOLD, **brakes)
                self.add(rng.uniform(0.05, 0.8), COAST, value=0.0, **ways)
                self.add(rng.uniform(0.3, 1.8), HOLD, **brakes)
            elif after < 0.75:
                self.add(rng.uniform(0.2, 1.8), HOLD, **{**brakes, "stick": -rng.uniform(0.2, 1.0)})
                self.add(0.7, COAST, value=0.0, **ways)
            elif after < 0.88:
                last = self.segments[-1]
                self.add(SILENCE_S, last.want, **{**ways, "value": None})
                self.add(rng.uniform(0.3, 2.0), STOP, **{**ways, "value": None})
            elif gear:
                self.add(rng.uniform(0.5, 1.5), HOLD, **brakes)
                self.add(rng.uniform(1.0, 2.5), SECOND, value=-rng.uniform(1.0, 3.0), mode=AUTONOMOUS, gear="reverse")
                self.add(0.3, ANY, value=0.0, **ways)


def _mostly(rng, common, share, low, high):
    return common if rng.random() < share else rng.uniform(low, high)


def _random_esc(rng, kind):
    return EscSpec(
        kind, dwell_s=rng.uniform(0.1, 0.4), dead_band=rng.uniform(0.02, 0.075), forward_s=rng.uniform(0.0, 0.4),
        pull_s=rng.choice((0.0, 0.06)), senses_speed=rng.random() < 0.4,
        forgets_s=rng.uniform(1.0, 3.0) if rng.random() < 0.2 else 0.0, fresh_reverses=rng.random() < 0.7,
        brakes_backward=rng.random() < 0.7, hold_s=rng.choice((0.0, rng.uniform(0.0, 0.3))),
        roll_mps=rng.uniform(0.02, 0.2), drag_brake=rng.choice((0.0, 0.05, 0.1, rng.uniform(0.0, 0.3))),
        arm_s=rng.uniform(0.1, 0.3), power_up=rng.choice((REFUSES, REFUSES, OBEYS, OBEYS, RELEARNS)))


def _random_car(rng):
    return CarSpec(
        lag_s=rng.uniform(0.02, 0.15), push_mps2=rng.uniform(5.0, 9.0), top_mps=rng.uniform(6.0, 15.0),
        brake_mps2=rng.uniform(3.5, 7.5), grip_mps2=rng.uniform(2.5, 7.0) if rng.random() < 0.15 else 20.0,
        drag_mps2=rng.uniform(0.25, 0.5), slope=rng.choice((0.0, 0.0, rng.uniform(-0.08, 0.08))),
        wall_m=rng.uniform(1.0, 8.0) if rng.random() < 0.1 else math.inf,
        wall_behind_m=0.0 if rng.random() < 0.1 else math.inf)


def _kinds(rng):
    """Group, the profile that is set, and the kind that the ESC has."""
    draw = rng.random()
    if draw < 0.45:
        kind = rng.choice((BTR, BTR, BTR, BBR, DIRECT, FORWARD_ONLY))
        return "right", kind, kind
    if draw < 0.7:
        return UNVERIFIED, UNVERIFIED, rng.choice((BTR, BBR, BBR, DIRECT, FORWARD_ONLY))
    return ("wrong", *rng.choice(WRONG))


def _config(rng, group, profile, esc, car):
    config = {"profile": profile, "arming_time_s": 0.5, "stop_brake": _mostly(rng, 0.5, 0.6, 0.2, 1.0),
              "brake_margin_mps": _mostly(rng, 0.5, 0.7, 0.3, 1.0),
              "dwell_s": _mostly(rng, 0.5, 0.7, min(0.5, esc.dwell_s + 0.05), 0.5),
              "brake_deceleration_mps2": min(3.0, 0.8 * min(car.brake_mps2, car.grip_mps2)),
              "drag_deceleration_mps2": min(0.3, 0.9 * car.drag_mps2)}
    if group == "right":
        config["profile_measured"] = rng.random() < 0.5
        if esc.forgets_s:
            config["reverse_after_neutral_s"] = 0.7 * esc.forgets_s
    return config


def _random_faults(rng, script):
    """Up to three, often at about the same time; some make a brake look as if it held the car, and blind the next."""
    if rng.random() < 0.1:
        return _false_proof(rng, script)
    faults = []
    for _ in range(rng.choice((0, 1, 1, 2, 2, 3))):
        fault = _random_fault(rng, script)
        if faults and rng.random() < 0.5:
            fault = make_fault(rng, fault.name, faults[0].start_s + rng.uniform(-0.3, 0.3))
        faults.append(fault)
    return faults


def _false_proof(rng, script):
    """During one brake the motor does nothing, or the car can't move; from then on odometry is lost."""
    held = [at for at, segment in enumerate(script) if segment.want == HOLD]
    if not held:
        return []
    at = rng.choice(held)
    low_s, high_s = script[at - 1].end_s, script[at].end_s
    name = rng.choice((CUT_FAULT, OFF, WALL))
    fault = Fault(name, low_s + rng.uniform(0.0, 0.3), high_s + rng.uniform(0.0, 0.2), -1 if name == WALL else CUT_ALL)
    return [fault, Fault(ODOMETRY_LOST, high_s + rng.uniform(0.0, 2.0), script[-1].end_s)]


def _random_fault(rng, script):
    wants = [(low.end_s, high.end_s) for low, high in zip(script, script[1:]) if high.want in (STOP, HOLD, SECOND)]
    low_s, high_s = rng.choice(wants) if wants and rng.random() < 0.85 else (script[0].end_s, script[-1].end_s)
    start_s = rng.uniform(low_s - 0.3, min(high_s, low_s + 1.5))
    name = rng.choice((*FAULTS, STALL, STALL, STALL, ODOMETRY_LATE, OFF))
    return make_fault(rng, name, start_s)


def make_fault(rng, name: str, start_s: float) -> Fault:
    """One that begins then, of random length and value."""
    lasts_s, value = rng.uniform(0.3, 3.0), 0.0
    if name == STALL:
        lasts_s = rng.uniform(0.05, 0.62)
    elif name == DEATH:
        lasts_s = rng.uniform(0.3, 2.0)
    elif name == OUTPUT_LATE:
        value = rng.uniform(0.06, 0.2)
    elif name == ODOMETRY_LATE:
        value = rng.uniform(0.05, 0.4)
    elif name == CUT_FAULT:
        value = rng.choice((CUT_FORWARD, CUT_ALL))
    elif name in (OFF, OFF_HELD):
        lasts_s = rng.uniform(0.05, 1.0)
    elif name == WALL:
        value = rng.choice((-1, 1))
    return Fault(name, start_s, start_s + lasts_s, value)


def random_case(seed: int) -> Case:
    rng = random.Random(f"adversary {seed}")
    group, profile, kind = _kinds(rng)
    esc, car = _random_esc(rng, kind), _random_car(rng)
    if group == "wrong" and profile == kind:
        esc = esc._replace(forgets_s=rng.uniform(1.0, 3.0))
    elif profile != kind or kind != BTR:
        esc = esc._replace(forgets_s=0.0 if kind != BTR else esc.forgets_s)
    config = _config(rng, group, profile, esc, car)
    script = _Script(rng, config["arming_time_s"])
    until_s = rng.uniform(4.0, 7.0)
    (script.by_stick if rng.random() < 0.6 else script.by_planner)(until_s)
    faults = _random_faults(rng, script.segments)
    segments = list(_with_small_values(random.Random(f"small values {seed}"), script.segments))
    return Case(str(seed), group, config, esc, car, segments, sorted(faults, key=lambda each: each.start_s),
                _random_odometry(rng), rng.uniform(0.3, 1.0),
                cruise_mps=rng.choice((0.0, rng.uniform(0.2, 2.0))))


def _with_small_values(rng, segments):
    """The same, where half of a planner's zeros, and the ends of half of its reverses, are values in the dead band."""
    for segment in segments:
        value, is_small = segment.value, segment.gear and segment.value is not None and rng.random() < 0.5
        if is_small and segment.want == COAST:
            value = rng.uniform(0.02, 0.3)
        elif is_small and segment.want == SECOND:
            yield segment._replace(end_s=segment.end_s - rng.uniform(0.1, 0.4))
            value = -rng.uniform(0.05, 0.45)
        yield segment._replace(value=value)


def _random_odometry(rng):
    delay_s = rng.uniform(0.0, 0.03) if rng.random() < 0.5 else rng.uniform(0.0, 0.4)
    return Odometry(rng.choice((0.02, 0.03, 0.05)), delay_s, rng.random() < 0.85)


# The directed sweep: a push to some speed, one way to slow down, and one fault at each 10 ms of that.
SWEEP_KINDS = ([("right", kind, kind, False) for kind in KINDS] + [("right", BTR, BTR, True)]
               + [(UNVERIFIED, UNVERIFIED, kind, False) for kind in KINDS]
               + [("wrong", profile, kind, False) for profile, kind in WRONG[:-1]])
SWEEP_STOPS = ("deadman", "e-stop", "silent planner", "pull", "planner's hold", "planner's second hold")
# What made it look as if a brake held the car before, if anything did; and what goes wrong later, at once.
SWEEP_FAULTS = (*(("", name) for name in FAULTS), ("", STALL, OUTPUT_LATE), ("", STALL, OUTPUT_LOST),
                ("", ODOMETRY_LOST, CUT_FAULT), ("", ODOMETRY_LOST, WALL), ("brake", STALL),
                *((before, ODOMETRY_LOST) for before in (CUT_FAULT, WALL, OFF)))
SWEEP_START_S, SWEEP_OFFSETS, SWEEP_STEP_S = -0.2, 180, 0.01
PROOF_S = 2.4  # a brake that holds the car before, and a push
SWEEP_CASES = len(SWEEP_KINDS) * len(SWEEP_FAULTS) * SWEEP_OFFSETS


def sweep_case(index: int) -> Case:
    """A case of the sweep, 0..SWEEP_CASES − 1: kind, fault and its moment. The rest is drawn, but the same for all
    moments of a kind and a fault, except the way to slow down, which takes turns.
    """
    pair, moment = divmod(index, SWEEP_OFFSETS)
    what, fault = divmod(pair, len(SWEEP_FAULTS))
    group, profile, kind, is_measured = SWEEP_KINDS[what]
    rng = random.Random(f"sweep {pair}")
    esc = _random_esc(rng, kind)._replace(forgets_s=0.0)
    car = _random_car(rng)._replace(wall_m=math.inf, wall_behind_m=math.inf, grip_mps2=20.0)
    config = _config(rng, group, profile, esc, car)
    if group == "right":
        config["profile_measured"] = is_measured
    odometry = Odometry(0.02, rng.choice((0.01, 0.03)))
    begins_s = 0.77 + rng.uniform(0.7, 1.1)
    start_s = begins_s + SWEEP_START_S + SWEEP_STEP_S * moment
    before, *names = SWEEP_FAULTS[fault]
    slows = SWEEP_STOPS[moment % len(SWEEP_STOPS)]
    rng = random.Random(f"sweep {index}")
    script = _sweep_script(slows, begins_s, bool(before), config["arming_time_s"])
    if before:
        begins_s, start_s = begins_s + PROOF_S, start_s + PROOF_S
    faults = [make_fault(rng, name, start_s) for name in names]
    if len(faults) > 1:
        faults[1] = faults[1]._replace(end_s=max(faults[0].end_s, faults[1].end_s) + 0.3)
    if before in FAULTS or before == OFF:
        faults = [faults[0]._replace(end_s=script[-1].end_s),
                  Fault(before, begins_s - PROOF_S + 0.05, begins_s - 0.75, -1 if before == WALL else CUT_ALL)]
    return Case(f"s{index}", group, config, esc, car, script, faults, odometry, 0.6)


def _sweep_script(slows, begins_s, pulls_before, arming_s):
    is_planner = "planner" in slows
    ways = {"mode": AUTONOMOUS, "gear": "drive"} if is_planner else {}
    pushes = {"value": 2.0, **ways} if is_planner else {"stick": 1.0}
    ready_s = arming_s + 0.15
    script = [Segment(ready_s, COAST, deadman=False, **ways), Segment(ready_s + 0.12, COAST, **ways)]
    if pulls_before:
        script += [Segment(begins_s, DRIVE, **pushes), Segment(begins_s + 1.6, HOLD, stick=-0.8, **ways)]
        begins_s += PROOF_S
    script.append(Segment(begins_s, DRIVE, **pushes))
    if slows == "planner's second hold":
        script += [Segment(begins_s + 0.25, HOLD, value=-1.0, **ways),
                   Segment(begins_s + 0.55, COAST, value=0.0, **ways)]
        slows = "planner's hold"
    ends_s = begins_s + 2.4
    if slows == "silent planner":
        script[-1] = Segment(begins_s - SILENCE_S, DRIVE, **pushes)
        script += [Segment(begins_s, DRIVE, **ways), Segment(ends_s, STOP, **ways)]
    else:
        script.append({"deadman": Segment(ends_s, STOP, deadman=False, **ways),
                       "e-stop": Segment(ends_s, STOP, e_stop=True, **ways),
                       "pull": Segment(ends_s, HOLD, stick=-0.7),
                       "planner's hold": Segment(ends_s, HOLD, value=-1.5, **ways)}[slows])
    return script
