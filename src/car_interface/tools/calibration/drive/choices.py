"""What could be held next: for each position what measuring it is worth for the time that it takes, by the room that
there is from here.
"""
from __future__ import annotations

import math
from typing import NamedTuple, Sequence

from car_interface.tools.calibration.drive.area import Pose
from car_interface.tools.calibration.drive.outlook import Outlook
from car_interface.tools.calibration.drive.positions import Candidate, Hold
from car_interface.tools.calibration.drive.survey import Survey

MIN_LENGTH_M = 0.9  # of a position that is begun
MIN_BEND_M, BEND_PER_M = 0.6, 0.3  # the same where it turns so tightly: less shows as much of its curvature
WANT_TIGHT_M, WANT_WIDE_M, WIDE_PER_M = 0.9, 2.2, 0.12  # to measure: a wide turn's curvature is known less well
NEED_POWER = 2.0  # of a need, in what measuring it is worth: what is known least comes first, though it takes longer
LENGTH_POWER = 1.5  # of the length: a slope's variance falls with the third power, and the fit smooths
TURN_WORTH, TURN_S = 0.5, 3.0  # of the turn that follows, as a part of a position's; and how long it takes
TIGHT_RATIO = 0.6  # of the tightest curvature: tight enough to turn back with
SAME_TURN_RATIO = 0.25  # of the tightest curvature, as above: to be measured in a turn that has to go on
MISSING_NEED = 1.0  # the tool refuses a table without it, or no fit knows it
TIGHT_WAY_RATIO = 0.4  # tight enough to be measured on the way into or out of a turn to that side
SEEN_MPS = 0.45  # that the sonars must allow a position that is begun


class Choice(NamedTuple):
    """A position that could be begun now."""

    # what measuring it is worth for each second, and the turn that follows: with the room that there is. 0 = there is
    # no room for it.
    score: float
    ideal: float  # the same with all the room that it wants, and with the turn that is worth more
    want_m: float  # the length that it wants
    hold: Hold  # its hold, if it is begun now
    length_m: float = -math.inf  # how long it could be measured, negative where it wouldn't even settle
    worth: float = 0.0  # for the time that it takes
    # the tight turn with which it is to end: 0 = to the left, 1 = to the right; ``None`` = there is no room
    side: int | None = None


class Choices:
    """What could be held next by one car."""

    def __init__(self, survey: Survey, outlook: Outlook):
        self._survey, self._outlook, self._ends = survey, outlook, survey.ends

    def all(self, now_ns: int) -> list[Choice]:
        """Return the candidates as they could be begun now, without those that can't be the best any more."""
        candidates = self._survey.positions.candidates()
        turns_worth = [TURN_WORTH * need ** NEED_POWER for need in self.turns_needs(candidates)]
        ideals = sorted((self._ideal(candidate, max(turns_worth), now_ns) for candidate in candidates),
                        key=lambda choice: -choice.ideal)
        found, best = [], 0.0
        for ideal in ideals:
            if ideal.ideal < best:
                break
            found.append(self._from_here(ideal, turns_worth, now_ns))
            best = max(best, found[-1].score)
        return found

    def turn(self, candidate: Candidate, turn_per_m: float, now_ns: int) -> Choice:
        """Return a tight turn at a position, whatever room there is."""
        return Choice(0.0, 0.0, wanted_length_m(turn_per_m), self._hold_for(candidate, now_ns))

    def missing_in_turn(self, held_duty: int, turn_per_m: float, now_ns: int) -> Choice | None:
        """Return the best one to that side, other than what is held, that is refused or a gap by now; ``None``: there
        is none with room for it.
        """
        candidates = self._survey.positions.candidates(
            lambda duty: self._outlook.expected_per_m(duty) / turn_per_m > SAME_TURN_RATIO)
        choices = [self._from_here(self._ideal(candidate, 0.0, now_ns), (0.0, 0.0), now_ns) for candidate in candidates
                   if candidate.need >= MISSING_NEED and candidate.duty != held_duty]
        best = max(choices, key=lambda choice: choice.score, default=None)
        return best if best is not None and best.score else None

    def tight(self, turn_per_m: float, pose: Pose, now_ns: int, least_need: float = 0.0) -> Candidate | None:
        """Return the tight position to that side of which least is known, and that stays inside; ``None``: there is
        none.
        """
        positions, area = self._survey.positions, self._outlook.area
        for candidate in positions.candidates(lambda duty: positions.least_per_m(duty) / turn_per_m > TIGHT_RATIO):
            curvature = positions.least_per_m(candidate.duty)
            if (candidate.need > least_need and area.turn_extent_m(pose, curvature) <= area.radius_m
                    and self._outlook.sonar_mps(curvature, now_ns) >= SEEN_MPS):
                return candidate
        return None

    def turns_needs(self, candidates: Sequence[Candidate] | None = None) -> list[float]:
        """Return the greatest need of what each of the tight turns would show, of the candidates by now."""
        candidates = self._survey.positions.candidates() if candidates is None else candidates
        return [max((candidate.need for candidate in candidates
                     if self._outlook.expected_per_m(candidate.duty) / turn > TIGHT_WAY_RATIO), default=0.0)
                for turn in self._outlook.turns_per_m()]

    def _ideal(self, candidate, turn_worth, now_ns):
        """Return what a candidate is worth with all the room that it wants."""
        curvature = self._outlook.expected_per_m(candidate.duty)
        hold = self._hold_for(candidate, now_ns)
        want_m = wanted_length_m(curvature)
        seconds = hold.seconds_to_settle(now_ns) + want_m / self._outlook.cruise_mps(curvature)
        worth = candidate.need ** NEED_POWER
        return Choice(0.0, (worth + turn_worth) / (seconds + TURN_S), want_m, hold, worth=worth)

    def _from_here(self, ideal, turns_worth, now_ns):
        """Return what it is worth from here, ending with the tight turn that makes it worth most."""
        hold, want_m = ideal.hold, ideal.want_m
        curvature = self._outlook.expected_per_m(hold.duty)
        seen_mps = self._outlook.sonar_mps(curvature, now_ns)
        if seen_mps < SEEN_MPS:
            return ideal
        speed_mps = min(seen_mps, self._outlook.cruise_mps(curvature))
        settle_s = hold.seconds_to_settle(now_ns)
        settle_m = settle_s * min(speed_mps, self._outlook.now_mps)
        # What is expected of a position between others that were held may be far off: it may turn as little as the one.
        curvatures = {curvature}
        if hold.duty not in self._ends:
            curvatures.add(self._survey.positions.least_per_m(hold.duty))
        rooms_m = [self._outlook.rooms_m(hold.duty, one, speed_mps, want_m + settle_m) for one in curvatures]
        lengths_m = [min(rooms) - settle_m for rooms in zip(*rooms_m)]
        least_m = MIN_LENGTH_M if abs(curvature) < BEND_PER_M else MIN_BEND_M
        best = ideal._replace(length_m=max(lengths_m))
        for side, (length_m, turn_worth) in enumerate(zip(lengths_m, turns_worth)):
            if length_m >= least_m:
                known = min(1.0, length_m / want_m) ** LENGTH_POWER
                score = (ideal.worth * known + turn_worth) / (settle_s + length_m / speed_mps + TURN_S)
                best = max(best, ideal._replace(score=score, length_m=length_m, side=side), key=lambda one: one.score)
        return best

    def _hold_for(self, candidate, now_ns):
        return Hold(candidate, self._outlook.servo_duty, sorted(self._ends), self._survey.servo_delay, now_ns)


def wanted_length_m(curvature_per_m):
    """Return how long a turn is to be measured."""
    return WANT_WIDE_M if abs(curvature_per_m) < WIDE_PER_M else WANT_TIGHT_M + 0.8 * max(
        0.0, 1 - abs(curvature_per_m) / 0.5)
