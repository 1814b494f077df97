"""Which positions of the steering to measure next, what curvature to expect of them, and how to hold one.

First the ends and the center, and some in between; then wherever the fit knows least. A position is a duty, always one
of the board's counts.
"""
from __future__ import annotations

import math
from bisect import bisect_left, insort
from typing import Callable, NamedTuple

import numpy as np

from car_interface.steering.calibration import SteeringCalibration
from car_interface.tools.calibration.drive.knowledge import Knowledge
from car_interface.tools.calibration.steering.drive import COUNT

# Parts of the way from the center to each end, in the order of their importance; ends and center count for most.
FIRST = ((1.0, 4.0), (-1.0, 4.0), (0.0, 3.0), (0.5, 2.0), (-0.5, 2.0), (0.75, 1.5), (-0.75, 1.5), (0.25, 1.5),
         (-0.25, 1.5), (0.9, 1.5), (-0.9, 1.5))
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
SURELY_PER_M = 0.1  # an end that turns so tightly to the wrong side does so
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
    from_side: int
    length_m: float
    curvature_per_m: float


class Hold:
    """One position, from the moment at which it is asked for.

    Args:
        from_side: the side from which to come to it, in duty: 1 = higher, −1 = lower; 0 = as it comes.
        servo_duty: where the servo is about now.
        limits: the lowest and the highest duty that may be asked for.
        lag_s, delay_s: of the servo.
    """

    def __init__(self, duty: int, from_side: int, servo_duty: float, limits: tuple[float, float], lag_s: float,
                 delay_s: float, now_ns: int):
        self.duty = duty
        natural = 1 if servo_duty > duty else -1
        self.from_side = from_side or natural
        self._past_duty = float(duty)
        self._past_ns = now_ns
        at_duty = servo_duty
        if abs(servo_duty - duty) < PAST_DUTY or self.from_side != natural:
            self._past_duty = min(max(duty + self.from_side * PAST_DUTY, limits[0]), limits[1])
            crossed = duty + self.from_side * min(CROSSED_DUTY, abs(self._past_duty - duty) * 0.8)
            past_s = delay_s + _time_s(abs(self._past_duty - servo_duty), abs(self._past_duty - crossed), lag_s)
            self._past_ns = now_ns + round(past_s * 1e9)
            at_duty = self._past_duty
        settle_s = delay_s + MARGIN_S + _time_s(abs(at_duty - duty), SETTLED_DUTY, lag_s)
        self.settled_ns = self._past_ns + round(settle_s * 1e9)
        self.length_m = self.turned_rad = 0.0

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
        return Measured(self.duty, self.from_side, self.length_m, self.turned_rad / max(self.length_m, 1e-6))


class Positions:
    """The positions of one drive.

    Args:
        base: the ends and the rough center; the signs of its radii, not their values.

    Attributes:
        first: those of FIRST that weren't measured yet.
        count: how many positions were held.
    """

    def __init__(self, base: SteeringCalibration):
        self._base = base
        self._left_sign = 1 if base.servo_left > base.servo_right else -1  # of the duty towards a left turn
        ends = {1.0: base.servo_left, -1.0: base.servo_right}
        self.first = [Candidate(ends.get(part, nearest_count(base.teleop_duty(part), base)), need, 0)
                       for part, need in FIRST]
        center = self.first[2]
        self.first[2:3] = [center._replace(from_side=1), center._replace(from_side=-1, need=center.need - 0.5)]
        self._all_first = tuple(self.first)
        self._knowledge: Knowledge | None = None
        self._since_fit: list[Measured] = []
        self._curvatures: dict[int, float] = {}  # by duty that was held, rising
        self._held: list[int] = []  # sorted, one for each time
        self._sides: dict[int, int] = {}  # by duty: the side from which it was come to last
        self.count = 0

    @property
    def is_swapped(self) -> bool:
        """Whether an end turns to the other side than its name says."""
        held, base = self._curvatures, self._base
        return held.get(base.servo_left, 1.0) < -SURELY_PER_M or held.get(base.servo_right, -1.0) > SURELY_PER_M

    def update_knowledge(self, knowledge: Knowledge, measured_since: int) -> None:
        """Take a fit's curve; so many positions were held since its samples were taken."""
        self._knowledge = knowledge
        self._since_fit = self._since_fit[len(self._since_fit) - measured_since:]

    def add(self, measured: Measured) -> None:
        """Take what was measured of a position that was held."""
        self.count += 1
        self._since_fit.append(measured)
        insort(self._held, measured.duty)
        self._sides[measured.duty] = measured.from_side
        self._curvatures = dict(sorted({**self._curvatures, measured.duty: measured.curvature_per_m}.items()))
        for index, candidate in enumerate(self.first):
            if abs(candidate.duty - measured.duty) <= NEAR_DUTY / 2 and candidate.from_side in (0, measured.from_side):
                del self.first[index]
                break

    def candidates(self, accepts: Callable[[float], bool] = lambda duty: True) -> list[Candidate]:
        """Return what is worth measuring of the duties that ``accepts`` takes, needs falling."""
        found = [candidate for candidate in self.first if accepts(candidate.duty)]
        if self._knowledge is not None:
            found += [candidate for candidate in self._lost_ends() if accepts(candidate.duty)]
            found += self._by_errors(MAX_CANDIDATES - len(found) // 2, accepts)
        elif not self.first:  # all were held, and there is no curve yet: once more
            found = [candidate for candidate in self._all_first if accepts(candidate.duty)]
        return sorted(found, key=lambda candidate: -candidate.need)

    def _lost_ends(self):
        """Yield the ends that aren't on the fit's curve, such as one that was held too shortly for a segment."""
        known, held = self._knowledge, {candidate.duty for candidate in self.first}
        slack_duty = 2 * COUNT + (known.given.backlash_duty or 0.0) / 2
        for end in (self._base.servo_left, self._base.servo_right):
            is_on_it = known.duties[0] - slack_duty <= end <= known.duties[-1] + slack_duty
            if not is_on_it and end not in held and not any(one.duty == end for one in self._since_fit):
                yield Candidate(end, LOST_END_NEED, 0)

    def _by_errors(self, count, accepts):
        """Return the greatest errors of the fit, apart from each other; of equal needs that of which least is known."""
        known = self._knowledge
        found: list[Candidate] = []
        for need, _, at in sorted(zip(self._needs(), map(max, known.errors, known.needs), known.duties), reverse=True):
            if len(found) >= count:
                break
            duty = nearest_count(at, self._base)
            if accepts(at) and all(abs(duty - other.duty) >= APART_DUTY for other in found):
                found.append(Candidate(duty, need, self._other_side(duty)))
        return found

    @property
    def has_gaps(self) -> bool:
        """Whether there are counts that weren't held where one count changes much: see ``_needs``."""
        return self._knowledge is not None and bool(self._gaps().any())

    def _needs(self):
        """Return what remains of the fit's by what was measured since, and the more often the less, (K,). Where one
        count changes much no fit knows what lies between two of them.
        """
        known, duties = self._knowledge, np.array(self._knowledge.duties)
        needs = np.maximum(np.minimum(known.errors, MAX_NEED), np.minimum(known.needs, MAX_NICE_NEED))
        for measured in self._since_fit:
            needs[np.abs(measured.duty - duties) <= NEAR_DUTY] *= ANSWERED
        needs = needs / (1 + REPEATED * self._times_held(duties, NEAR_DUTY))
        return np.where(self._gaps(), np.maximum(needs, STEEP_NEED), needs).tolist()

    def _gaps(self):
        """Return at which counts one count changes much, or that are nearly refused, and that weren't held (K,)."""
        duties, curvatures = np.array(self._knowledge.duties), np.array(self._knowledge.curvatures)
        changes = np.abs(curvatures[2:] - curvatures[:-2]) / 2
        is_steep = changes > np.maximum(STEEP_RATIO * np.abs(curvatures[1:-1]), STEEP_PER_M)
        # What the tool would refuse beside positions that were held often is a bend between them.
        is_open = np.pad(is_steep | (np.array(self._knowledge.errors[1:-1]) > NEARLY), 1)
        low, high = sorted((self._base.servo_left, self._base.servo_right))
        return is_open & (duties >= low) & (duties <= high) & (self._times_held(duties, COUNT / 2) == 0)

    def _times_held(self, duties, near_duty):
        return np.searchsorted(self._held, duties + near_duty) - np.searchsorted(self._held, duties - near_duty)

    def _other_side(self, duty):
        """Return the side from which a position wasn't come to last; 0 = it is new, and any will do."""
        near = [(abs(other - duty), side) for other, side in self._sides.items() if abs(other - duty) <= SIDES_DUTY]
        return -min(near)[1] if near else 0

    def expected_per_m(self, duty: float) -> float:
        """Return the curvature to expect at a duty: by the fit, else by what was driven, else a guess by the ends."""
        knowledge = self._knowledge
        if knowledge is not None and knowledge.duties and knowledge.duties[0] <= duty <= knowledge.duties[-1]:
            return _interpolated(duty, knowledge.duties, knowledge.curvatures)
        base, outer, known = self._base, UNKNOWN_TURN_PER_M, dict(self._curvatures) or {self._base.servo_center: 0.0}
        lowest, highest = min(known), max(known)
        for end, sign in ((base.servo_left, 1.0), (base.servo_right, -1.0)):
            if not lowest <= end <= highest:
                known[end] = sign * max(outer, sign * known[lowest if end < lowest else highest])
        duties = sorted(known)
        index = bisect_left(duties, base.servo_center)
        if 0 < index < len(duties) and known[duties[index - 1]] * known[duties[index]] < 0:
            known[base.servo_center] = 0.0  # not half way between both: many linkages are flat in the middle
            duties.insert(index, base.servo_center)
        return _interpolated(duty, duties, [known[one] for one in duties])

    def half_way_duty(self, end: int) -> float:
        """Return the held position nearest to the center that turns half as tightly as that end; else the end."""
        tightest = self.expected_per_m(end)
        found = [at for at, curvature in self._curvatures.items() if curvature * tightest >= tightest * tightest / 2]
        return min(found, key=lambda at: abs(at - self._base.servo_center), default=float(end))

    def least_per_m(self, duty: float) -> float:
        """Return the least curvature, by its magnitude, that a duty can have: that of the next position towards the
        center that was held, as curves are monotone; 0 = there is none. A fit of few positions may be far off in
        between.
        """
        outward = 1 if duty >= self._base.servo_center else -1
        inner = [curvature for at, curvature in self._curvatures.items() if (duty - at) * outward >= 0]
        sign = self._left_sign * outward
        return sign * max(0.0, sign * (inner[-1] if outward > 0 else inner[0])) if inner else 0.0

    def steering(self, duty: float) -> float:
        """Return the request, −1 right to 1 left, that turn_arb makes this duty of."""
        base = self._base
        end = base.servo_left if (duty - base.servo_center) * (base.servo_left - base.servo_center) > 0 else (
            base.servo_right)
        ratio = 0.0 if end == base.servo_center else (duty - base.servo_center) / (end - base.servo_center)
        return max(-1.0, min(1.0, ratio if end == base.servo_left else -ratio))


def nearest_count(duty: float, base: SteeringCalibration) -> int:
    """Return the board's nearest count that lies between the ends; an end that isn't a count stays as it is."""
    low, high = sorted((base.servo_left, base.servo_right))
    return int(min(max(math.floor(duty / COUNT + 0.5) * COUNT, low), high))


def _interpolated(at, places, values):
    """Linear, level beyond the ends."""
    index = bisect_left(places, at)
    if index == 0:
        return values[0]
    if index == len(places):
        return values[-1]
    ratio = (at - places[index - 1]) / (places[index] - places[index - 1])
    return values[index - 1] + ratio * (values[index] - values[index - 1])


def _time_s(from_duty, to_duty, lag_s):
    """Return how long a first-order lag takes from one distance to its target to a smaller one."""
    return lag_s * math.log(from_duty / to_duty) if from_duty > to_duty > 0 else 0.0
