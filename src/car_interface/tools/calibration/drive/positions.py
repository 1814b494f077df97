"""Which positions of the steering to measure next, what curvature to expect of them, and how to hold one.

First the ends and the center, and some in between; then wherever the fit knows least. A position is a duty, always one
of the board's counts.
"""
from __future__ import annotations

import math
from typing import Callable, NamedTuple, Sequence

import numpy as np

from car_interface.steering.calibration import SteeringCalibration
from car_interface.tools.calibration.drive.knowledge import NOTHING_KNOWN, Knowledge
from car_interface.tools.calibration.steering.drive import COUNT, Delay

# Parts of the way from the center to each end, with their needs: ends and center, from both sides, count for most.
FIRST = ((1.0, 4.0, 0), (-1.0, 4.0, 0), (0.0, 3.0, 1), (0.0, 2.5, -1), (0.5, 2.0, 0), (-0.5, 2.0, 0), (0.75, 1.5, 0),
         (-0.75, 1.5, 0), (0.25, 1.5, 0), (-0.25, 1.5, 0), (0.9, 1.5, 0), (-0.9, 1.5, 0))
MAX_CANDIDATES = 12  # of the fit's
APART_DUTY = 2 * COUNT  # of two candidates
NEAR_DUTY = 1.5 * COUNT  # what was measured as near to a candidate answers it
LOST_END_NEED = 4.0
SIDES_DUTY = 5 * COUNT  # positions as near as this to each other are come to from different sides
ANSWERED = 0.3  # the part of a need that remains until the next fit
REPEATED = 0.3  # by how much each time a position was held makes it worth less to hold it again
MAX_NEED = 1.5  # of the fit's: how much more isn't known says little, and the first positions come first
NEARLY = 0.9  # of what the tool refuses: the last fit's errors differ by some percent from those before
MAX_NICE_NEED = 1.0  # of what the tool doesn't refuse
STEEP_RATIO, STEEP_PER_M, STEEP_NEED = 0.08, 0.03, 1.2  # of the curvature from count to count
UNKNOWN_TURN_PER_M = 0.8  # of the ends before they were driven: as wide as a car in so small an area may turn
PAST_DUTY = 90.0  # so far it is passed by, which is more than any usual backlash
CROSSED_DUTY = 50.0  # of these; from there on it comes back
SETTLED_DUTY = 5.0
MARGIN_S = 0.06


class Candidate(NamedTuple):
    """A position that is worth measuring."""

    duty: int  # the position
    need: float  # how much: the fit's error there as a ratio of what the tool allows, or its rank among the first ones
    # the side from which to come to it, in duty: 1 from higher ones, −1 from lower ones, 0 = as it comes
    from_side: int


class Measured(NamedTuple):
    """One position that was held."""

    duty: int
    from_side: int  # 1 or −1, as a candidate's
    curvature_per_m: float


class Hold:
    """One position, from the moment at which it is asked for.

    Args:
        servo_duty: where the servo is about now.
        limits: the lowest and the highest duty that may be asked for.
        delay: the servo's.
    """

    def __init__(self, candidate: Candidate, servo_duty: float, limits: Sequence[float], delay: Delay, now_ns: int):
        self.duty = duty = candidate.duty
        natural = 1 if servo_duty > duty else -1
        self.from_side = candidate.from_side or natural
        self._past_duty, self._past_ns, at_duty = float(duty), now_ns, servo_duty
        if abs(servo_duty - duty) < PAST_DUTY or self.from_side != natural:
            self._past_duty = min(max(duty + self.from_side * PAST_DUTY, limits[0]), limits[1])
            crossed = duty + self.from_side * min(CROSSED_DUTY, abs(self._past_duty - duty) * 0.8)
            past_s = _time_s(abs(self._past_duty - servo_duty), abs(self._past_duty - crossed), delay)
            self._past_ns = now_ns + round(past_s * 1e9)
            at_duty = self._past_duty
        settle_s = MARGIN_S + _time_s(abs(at_duty - duty), SETTLED_DUTY, delay)
        self.settled_ns = self._past_ns + round(settle_s * 1e9)
        self.length_m = self.turned_rad = 0.0
        self.is_noted = False  # it was measured, and goes on

    def asked_duty(self, now_ns: int) -> float:
        """Return what to ask for now."""
        return self._past_duty if now_ns < self._past_ns else float(self.duty)

    def is_settled(self, now_ns: int) -> bool:
        """Return whether the wheels are where they are to be."""
        return now_ns >= self.settled_ns

    def update_motion(self, distance_m: float, turned_rad: float, at_ns: int) -> None:
        """Take what odometry saw since the last call."""
        if at_ns >= self.settled_ns:
            self.length_m += distance_m
            self.turned_rad += turned_rad

    def seconds_to_settle(self, now_ns: int) -> float:
        """Until it is settled; 0 = it is."""
        return max(0.0, (self.settled_ns - now_ns) / 1e9)

    def measured(self) -> Measured:
        """Return the result so far."""
        return Measured(self.duty, self.from_side, self.turned_rad / max(self.length_m, 1e-6))


class Positions:
    """The positions of one drive.

    Args:
        base: the ends and the rough center; the signs of its radii, not their values.

    Attributes:
        knowledge: the newest with a curve; as long as there was none NOTHING_KNOWN, with a reason.
        first: those of FIRST that weren't measured yet.
        held: the duties that were held, one for each time.
    """

    def __init__(self, base: SteeringCalibration):
        self._base = base
        self._left_sign = 1 if base.servo_left > base.servo_right else -1  # of the duty towards a left turn
        duties = [base.teleop_duty(part) for part, _, _ in FIRST]
        self._all_first = [Candidate(duty if abs(part) == 1 else nearest_count(duty, base), need, from_side)
                           for duty, (part, need, from_side) in zip(duties, FIRST)]
        self.first = list(self._all_first)
        self.knowledge = NOTHING_KNOWN
        self.held: list[int] = []
        self._known = 0  # how many of them its samples have
        self._newest: dict[int, Measured] = {}  # by duty

    def update_knowledge(self, knowledge: Knowledge, known: int) -> None:
        """Take a fit's curve; so many positions had been held when its samples were taken."""
        self.knowledge, self._known = knowledge, known

    def add(self, measured: Measured) -> None:
        """Take what was measured of a position that was held."""
        self.held.append(measured.duty)
        self._newest[measured.duty] = measured
        answered = [candidate for candidate in self.first if abs(candidate.duty - measured.duty) <= NEAR_DUTY / 2
                    and candidate.from_side in (0, measured.from_side)]
        if answered:
            self.first.remove(answered[0])

    def candidates(self, accepts: Callable[[float], bool] = lambda duty: True) -> list[Candidate]:
        """Return what is worth measuring of the duties that ``accepts`` takes, needs falling."""
        if self.knowledge.reason:  # where all were held, and there is no curve yet, once more
            found = [candidate for candidate in self.first or self._all_first if accepts(candidate.duty)]
        else:
            found = [candidate for candidate in (*self.first, *self._lost_ends()) if accepts(candidate.duty)]
            found += self._by_errors(MAX_CANDIDATES - len(found) // 2, accepts)
        return sorted(found, key=lambda candidate: -candidate.need)

    def _lost_ends(self):
        """Yield the ends that aren't on the fit's curve, such as one that was held too shortly for a segment."""
        known, asked = self.knowledge, {candidate.duty for candidate in self.first}
        slack_duty = 2 * COUNT + (known.given.backlash_duty or 0.0) / 2
        for end in (self._base.servo_left, self._base.servo_right):
            is_on_it = known.duties[0] - slack_duty <= end <= known.duties[-1] + slack_duty
            if not is_on_it and end not in asked and end not in self.held[self._known:]:
                yield Candidate(end, LOST_END_NEED, 0)

    def _by_errors(self, count, accepts):
        """Return the greatest errors of the fit, apart from each other; of equal needs that of which least is known."""
        known, found = self.knowledge, []
        columns = self._needs(), np.maximum(known.errors, known.needs), known.duties
        for need, _, at in sorted(zip(*(column.tolist() for column in columns)), reverse=True):
            if len(found) >= count:
                break
            duty = nearest_count(at, self._base)
            if accepts(at) and all(abs(duty - other.duty) >= APART_DUTY for other in found):
                found.append(Candidate(duty, need, self._other_side(duty)))
        return found

    @property
    def has_gaps(self) -> bool:
        """Whether there are counts that weren't held where one count changes much: see ``_needs``."""
        return not self.knowledge.reason and bool(self._gaps().any())

    def _needs(self):
        """Return what remains of the fit's by what was measured since, and the more often the less, (K,). Where one
        count changes much no fit knows what lies between two of them.
        """
        known = self.knowledge
        needs = np.maximum(np.minimum(known.errors, MAX_NEED), np.minimum(known.needs, MAX_NICE_NEED))
        for duty in self.held[self._known:]:
            needs[np.abs(duty - known.duties) <= NEAR_DUTY] *= ANSWERED
        needs /= 1 + REPEATED * self._times_held(NEAR_DUTY)
        return np.where(self._gaps(), np.maximum(needs, STEEP_NEED), needs)

    def _gaps(self):
        """Return at which counts one count changes much, or that are nearly refused, and that weren't held (K,)."""
        duties, curvatures = self.knowledge.duties, self.knowledge.curvatures
        changes = np.abs(curvatures[2:] - curvatures[:-2]) / 2
        is_steep = changes > np.maximum(STEEP_RATIO * np.abs(curvatures[1:-1]), STEEP_PER_M)
        # What the tool would refuse beside positions that were held often is a bend between them.
        is_open = np.pad(is_steep | (self.knowledge.errors[1:-1] > NEARLY), 1)
        low, high = sorted((self._base.servo_left, self._base.servo_right))
        return is_open & (duties >= low) & (duties <= high) & (self._times_held(COUNT / 2) == 0)

    def _times_held(self, near_duty):
        """Return how often each count of the fit, or one near to it, was held (K,)."""
        held, duties = np.sort(self.held), self.knowledge.duties
        return np.searchsorted(held, duties + near_duty) - np.searchsorted(held, duties - near_duty)

    def _other_side(self, duty):
        """Return the side from which a position wasn't come to last; 0 = it is new, and any will do."""
        near = [(abs(one.duty - duty), one.from_side) for one in self._newest.values()
                if abs(one.duty - duty) <= SIDES_DUTY]
        return -min(near)[1] if near else 0

    def expected_per_m(self, duty: float) -> float:
        """Return the curvature to expect at a duty: by the fit, else by what was driven, else a guess by the ends."""
        known = self.knowledge
        if not known.reason and known.duties[0] <= duty <= known.duties[-1]:
            return float(np.interp(duty, known.duties, known.curvatures))
        base, curve = self._base, {one.duty: one.curvature_per_m for one in self._newest.values()}
        curve = curve or {base.servo_center: 0.0}
        lowest, highest = min(curve), max(curve)
        for end, sign in ((base.servo_left, 1.0), (base.servo_right, -1.0)):
            if not lowest <= end <= highest:
                curve[end] = sign * max(UNKNOWN_TURN_PER_M, sign * curve[lowest if end < lowest else highest])
        below, above = ([at for at in curve if (at - base.servo_center) * sign > 0] for sign in (-1, 1))
        if base.servo_center not in curve and below and above and curve[max(below)] * curve[min(above)] < 0:
            curve[base.servo_center] = 0.0  # not half way between both: many linkages are flat in the middle
        return float(np.interp(duty, *zip(*sorted(curve.items()))))

    def half_way_duty(self, end: int) -> float:
        """Return the held position nearest to the center that turns half as tightly as that end; else the end."""
        tightest = self.expected_per_m(end)
        found = [at for at, one in self._newest.items() if one.curvature_per_m * tightest >= tightest * tightest / 2]
        return min(found, key=lambda at: abs(at - self._base.servo_center), default=float(end))

    def least_per_m(self, duty: float) -> float:
        """Return the least curvature, by its magnitude, that a duty can have: that of the next position towards the
        center that was held, as curves are monotone; 0 = there is none. A fit of few positions may be far off in
        between.
        """
        outward = 1 if duty >= self._base.servo_center else -1
        inner = [one for one in self._newest.values() if (duty - one.duty) * outward >= 0]
        next_one = min(inner, key=lambda one: abs(one.duty - duty), default=None)
        sign = self._left_sign * outward
        return sign * max(0.0, sign * next_one.curvature_per_m) if next_one else 0.0

    def steering(self, duty: float) -> float:
        """Return the request, −1 right to 1 left, that turn_arb makes this duty of."""
        base, sign = self._base, self._left_sign
        return float(np.interp(sign * duty, [sign * base.servo_right, sign * base.servo_center, sign * base.servo_left],
                               [-1.0, 0.0, 1.0]))


def nearest_count(duty: float, base: SteeringCalibration) -> int:
    """Return the board's nearest count that lies between the ends; an end that isn't a count stays as it is."""
    low, high = sorted((base.servo_left, base.servo_right))
    return int(min(max(math.floor(duty / COUNT + 0.5) * COUNT, low), high))


def _time_s(from_duty, to_duty, delay):
    """Return how long a servo takes from one distance to its target to a smaller one."""
    return delay.delay_s + (delay.lag_s * math.log(from_duty / to_duty) if from_duty > to_duty > 0 else 0.0)
