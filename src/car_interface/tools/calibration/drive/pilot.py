"""Drives from position to position, inside the area and around what the sonars see.

It holds one position after another. Each is chosen by what measuring it is worth for the time that it takes, among
those for which there is room from here: along its arc, until no tight turn would keep the car inside any more. Where
there is room for none, it turns tightly, and measures that turn. Wide turns thus become chords through the area, with
tight circles at both ends.

Of the tight turns, and of the ends of the steering, 0 is the one to the left, 1 that to the right.
"""
from __future__ import annotations

import math
from typing import NamedTuple, Sequence

from car_interface.common.units import NS_PER_S
from car_interface.tools.calibration.drive.area import Pose, moved
from car_interface.tools.calibration.drive.outlook import BY_HAND, FREE_MPS, REACTION_S, Outlook, beside_middle
from car_interface.tools.calibration.drive.positions import Candidate, Hold
from car_interface.tools.calibration.drive.survey import (
    AVOIDING,
    BLOCKED,
    MEASURING,
    SETTLING,
    TURNING,
    Step,
    Survey,
    steering_text,
)

# --- what could be held ---
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
# --- how it is held ---
SOUGHT_RAD, LOST_RAD = 2 * 2 * math.pi, 3 * 2 * math.pi  # turned to the other side meanwhile, one turn of it in search
KEPT_LENGTH_M = 0.5  # one that was cut short counts from here on
BLIND_M = 0.3  # after a pause
ACROSS_M = 0.5  # from one end to the other, so much farther out than turns and servo's lag say (practice.launch's car)
LITTLE_NEED = 0.3
BEGIN_RATIO, LEAVE_RATIO = 0.3, 0.9  # of the best worth: what is begun, and for what a turn is left
TURNED_RAD = 2 * math.pi  # after a whole turn another one may be tried
PATIENT_RAD = 1.3 * math.pi  # a turn that has lasted this long makes do with any room
CHOICE_NS = NS_PER_S // 10
WRONG_M, WRONG_PER_M = 0.3, 0.1  # so far, and as tightly to the other side
STUCK_NS, STUCK_M = 3 * NS_PER_S, 0.15  # so long without moving so far: it can't go on


class Choice(NamedTuple):
    """A position that could be begun now."""

    hold: Hold  # its hold, if it is begun now
    want_m: float  # the length that it wants
    is_turn: bool = False  # it turns back into the area
    need: float = 0.0  # of such a turn, how much it is worth to measure it
    worth: float = 0.0  # of another position, for the time that it takes
    # what measuring it is worth for each second, and the turn that follows: with all the room that it wants and the
    # turn that is worth more, and with the room that there is. 0 = there is no room for it.
    ideal: float = 0.0
    score: float = 0.0
    length_m: float = -math.inf  # how long it could be measured, negative where it wouldn't even settle


class Choices:
    """What could be held next: for each position what measuring it is worth for the time that it takes, by the room
    that there is from here.
    """

    def __init__(self, survey: Survey, outlook: Outlook):
        self._survey, self._outlook, self._ends = survey, outlook, survey.ends

    def all(self, now_ns: int) -> list[Choice]:
        """Return the candidates as they could be begun now, without those that can't be the best any more."""
        turns_worth = [TURN_WORTH * need ** NEED_POWER for need in self.turns_needs()]
        ideals = [self._ideal(candidate, max(turns_worth), now_ns) for candidate in self._survey.positions.candidates()]
        found, best = [], 0.0
        for ideal in sorted(ideals, key=lambda choice: -choice.ideal):
            if ideal.ideal < best:
                break
            found.append(self._from_here(ideal, turns_worth, now_ns))
            best = max(best, found[-1].score)
        return found

    def turn(self, candidate: Candidate, side: int, now_ns: int) -> Choice:
        """Return a tight turn at a position, whatever room there is."""
        want_m = wanted_length_m(self._outlook.turns_per_m()[side])
        return Choice(self._hold_for(candidate, now_ns), want_m, True, candidate.need)

    def in_turn(self, held: Hold, side: int, now_ns: int) -> Choice | None:
        """Return what a turn to that side that has to go on could measure in place of what is held; ``None``: nothing.

        One that is refused or a gap by now may turn less tightly, where there is room for it; else, once what is held
        was measured, one that is as tight will do.
        """
        missing = [candidate for candidate in self._survey.positions.candidates(
            lambda duty: self._turns(duty, side, SAME_TURN_RATIO))
            if candidate.need >= MISSING_NEED and candidate.duty != held.duty]
        choices = [self._from_here(self._ideal(candidate, 0.0, now_ns), (0.0, 0.0), now_ns) for candidate in missing]
        best = max(choices, key=lambda choice: choice.score, default=None)
        if best is not None and best.score:
            return best._replace(is_turn=True, need=MISSING_NEED)
        other = self.tight(side, self._survey.motion.pose, now_ns, LITTLE_NEED) if held.is_noted else None
        return None if other is None or other.duty == held.duty else self.turn(other, side, now_ns)

    def tight(self, side: int, pose: Pose, now_ns: int, least_need: float = 0.0) -> Candidate | None:
        """Return the tight position to that side of which least is known, and that stays inside; ``None``: there is
        none.
        """
        positions, area, turn_per_m = self._survey.positions, self._outlook.area, self._outlook.turns_per_m()[side]
        for candidate in positions.candidates(lambda duty: positions.least_per_m(duty) / turn_per_m > TIGHT_RATIO):
            curvature = positions.least_per_m(candidate.duty)
            if (candidate.need > least_need and area.circle_extent_m(pose, curvature) <= area.radius_m
                    and self._outlook.sonar_mps(curvature, now_ns) >= SEEN_MPS):
                return candidate
        return None

    def turns_needs(self) -> list[float]:
        """Return the greatest need of what each of the tight turns would show, of the candidates by now."""
        candidates = self._survey.positions.candidates()
        return [max((candidate.need for candidate in candidates if self._turns(candidate.duty, side, TIGHT_WAY_RATIO)),
                    default=0.0) for side in (0, 1)]

    def _turns(self, duty, side, ratio):
        """Return whether a position is expected to turn to that side, more than that ratio of its tight turn."""
        return self._survey.positions.expected_per_m(duty) / self._outlook.turns_per_m()[side] > ratio

    def _ideal(self, candidate, turn_worth, now_ns):
        """Return what a candidate is worth with all the room that it wants."""
        curvature = self._survey.positions.expected_per_m(candidate.duty)
        hold, want_m = self._hold_for(candidate, now_ns), wanted_length_m(curvature)
        worth = candidate.need ** NEED_POWER
        seconds = hold.seconds_to_settle(now_ns) + want_m / self._outlook.cruise_mps(curvature)
        return Choice(hold, want_m, worth=worth, ideal=(worth + turn_worth) / (seconds + TURN_S))

    def _from_here(self, ideal, turns_worth, now_ns):
        """Return what it is worth from here, ending with the tight turn that makes it worth most."""
        hold, want_m = ideal.hold, ideal.want_m
        curvature = self._survey.positions.expected_per_m(hold.duty)
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
        for length_m, turn_worth in zip(lengths_m, turns_worth):
            if length_m >= least_m:
                known = min(1.0, length_m / want_m) ** LENGTH_POWER
                score = (ideal.worth * known + turn_worth) / (settle_s + length_m / speed_mps + TURN_S)
                best = max(best, ideal._replace(score=score, length_m=length_m), key=lambda one: one.score)
        return best

    def _hold_for(self, candidate, now_ns):
        return Hold(candidate, self._outlook.servo_duty, sorted(self._ends), self._survey.servo_delay, now_ns)


def wanted_length_m(curvature_per_m):
    """Return how long a turn is to be measured."""
    return WANT_WIDE_M if abs(curvature_per_m) < WIDE_PER_M else WANT_TIGHT_M + 0.8 * max(
        0.0, 1 - abs(curvature_per_m) / 0.5)


class LostTurns:
    """Notices that turns to one side are missing, and that the car only ever turns to the other: after two of those one
    to that side is sought for a whole turn, and then a person has to place the car.

    A car that turns widely goes from one turn to the next one to the same side, as no way across the area leads to one
    to the other side that stays inside.

    Attributes:
        asked: the one for which a person is asked to place the car; ``None`` = nobody is.
    """

    def __init__(self):
        self.asked: int | None = None
        self._since_rad = [0.0, 0.0]  # turned to the other side since each was driven last
        self._sought: int | None = None

    def update_motion(self, turned_rad: float) -> None:
        """Take by how much the heading changed, left positive."""
        self._since_rad[0] += max(0.0, -turned_rad)
        self._since_rad[1] += max(0.0, turned_rad)

    def drive(self, side: int) -> int | None:
        """Take that a tight turn to that side is driven now; return the other one, if it is sought."""
        self._since_rad[side] = 0.0
        if self._sought == side:
            self._sought = None
        return 1 - side if self._since_rad[1 - side] >= SOUGHT_RAD else None

    def seek(self, side: int) -> float:
        """Seek that one; return for how many turns it is sought by now: from 1 on it is lost, and a person is asked for
        it. It is sought again after two more turns to the other side.
        """
        if self._sought != side:
            self._sought, self._since_rad[side] = side, SOUGHT_RAD
        sought = (self._since_rad[side] - SOUGHT_RAD) / (LOST_RAD - SOUGHT_RAD)
        if sought >= 1:
            self.asked, self._sought, self._since_rad[side] = side, None, 0.0
        return sought

    def text(self, turns_per_m: Sequence[float]) -> str:
        """Return what to do, for a person; the turns have these curvatures, (2,)."""
        return (f"{('left', 'right')[self.asked]} turns are missing, and no way leads to one: place the car "
                f"{beside_middle(turns_per_m[self.asked])}, {BY_HAND}")


class Pilot:
    """Decides steering and speed while the button is held."""

    def __init__(self, survey: Survey, outlook: Outlook):
        self.outlook = outlook
        self._survey, self._motion, self._ends = survey, survey.motion, survey.ends
        self._choices = Choices(survey, outlook)
        self._choice: Choice | None = None  # that is held; ``None`` = nothing was yet
        self._hold: Hold | None = None  # its hold; ``None`` = the button was let go
        self._avoids = False
        self._turned_rad = 0.0
        self._chosen_ns = 0
        self._free_ns: int | None = None  # when it last had moved on
        self._stood_m = 0.0  # since then
        self._is_quick = False  # the turn
        self._was_paused = False
        self._lost = LostTurns()

    def pause(self) -> None:
        """Leave what was half measured: the button was let go."""
        self._note_hold()
        self._hold = self._free_ns = self._lost.asked = None
        self._avoids, self._was_paused = False, True

    @property
    def turns_wrongly(self) -> bool:
        """Whether the end that is held now turns to the other side than its name says."""
        hold = self._hold
        return (hold is not None and hold.duty in self._ends and hold.length_m >= WRONG_M
                and hold.measured().curvature_per_m * (1 if hold.duty == self._ends[0] else -1) < -WRONG_PER_M)

    def update_motion(self, distance_m: float, turned_rad: float, at_ns: int) -> None:
        """Take what odometry saw since the last call."""
        if self._hold is not None:
            self._hold.update_motion(distance_m, turned_rad, at_ns)
            self._lost.update_motion(turned_rad)
        self._turned_rad += abs(turned_rad)
        self._stood_m += abs(distance_m)

    def step(self, held_duty: float, now_ns: int) -> Step:
        """Return what to ask for, the servo board holding ``held_duty``."""
        self.outlook.servo_duty = held_duty
        if self._free_ns is None or self._stood_m >= STUCK_M:
            self._free_ns, self._stood_m = now_ns, 0.0
        self._steer_on(now_ns)
        hold = self._hold
        speed_mps, text = self.outlook.allowed_mps(hold, self._choice.is_turn and self._is_quick, now_ns)
        phase, said = self._phase(now_ns)
        if self._lost.asked is not None:
            speed_mps, phase, text = 0.0, BLOCKED, self._lost.text(self.outlook.turns_per_m())
        elif now_ns - self._free_ns > STUCK_NS:
            phase, said = BLOCKED, f"it doesn't move at {speed_mps:.1f} m/s: is the car held, or the battery empty?"
        steering = self._survey.positions.steering(hold.asked_duty(now_ns))
        return Step(steering, speed_mps, phase, text or said, hold.duty)

    def path(self) -> list[tuple[float, float]]:
        """Return the next 2 m, by the position that is held."""
        if self._hold is None:
            return []
        pose, curvature = self._motion.pose, self._survey.positions.expected_per_m(self._hold.duty)
        return [moved(pose, 0.1 * index, curvature)[:2] for index in range(21)]

    # --- which position ---

    def _steer_on(self, now_ns):
        """Keep the position or take another one."""
        hold, choice = self._hold, self._choice
        if hold is None:
            self._begin_any(now_ns)
            return
        is_due = now_ns - self._chosen_ns >= CHOICE_NS
        is_tightest = choice.is_turn and hold.duty in self._ends and self._turned_rad < TURNED_RAD
        if not is_tightest and self._is_cut_off(now_ns):
            self._turn(now_ns, tightest=choice.is_turn)
        elif not choice.is_turn:
            if hold.length_m >= choice.want_m:
                self._begin_any(now_ns)
        elif not self._takes_lost_turn(now_ns) and is_due and (
                hold.length_m >= choice.want_m or choice.need < LITTLE_NEED and hold.is_settled(now_ns)):
            self._leave_turn(now_ns)

    def _takes_lost_turn(self, now_ns):
        """Return whether a turn to the other side is sought: its positions are missing, and it only turns to this one.

        The tight turn to this side is held, which leads to the middle of the area, until one to the other side stays
        inside; the longer it is sought, the less room will do. After a whole turn a person is asked for help.
        """
        look, lost = self.outlook, self._lost.drive(self._held_side())
        if lost is None or self._choices.turns_needs()[lost] < MISSING_NEED:
            return False
        turn_per_m = look.turns_per_m()[lost]
        if not look.area.has_circle(turn_per_m):
            return False
        sought = self._lost.seek(lost)
        is_free = (look.ways_out(self._hold, now_ns)[lost].excess_m <= -ACROSS_M * (1 - sought)
                   and look.sonar_mps(turn_per_m, now_ns) >= FREE_MPS)
        if sought < 1:
            self._turn(now_ns, lost if is_free else 1 - lost, tightest=not is_free)
        return True

    def _is_cut_off(self, now_ns):
        """Return whether the arc ends here: by the area, or by a sonar."""
        look = self.outlook
        if look.sonar_mps(look.path_per_m(self._hold, now_ns), now_ns) < FREE_MPS:
            self._avoids = True
            return True
        if self._choice.is_turn:  # it is on its way back
            return min(way.excess_m for way in look.ways_out(self._hold, now_ns)) > 0
        return look.is_outside_soon(self._hold, now_ns)

    def _begin_any(self, now_ns):
        """Begin the best position for which there is room; else a tight turn."""
        self._note_hold()
        if not self._begin_best(self._choices.all(now_ns), BEGIN_RATIO, now_ns):
            self._turn(now_ns)

    def _leave_turn(self, now_ns):
        """Take the best position once there is room for it; the longer the turn, the less will do."""
        self._note_hold(self._choice.want_m)
        choices = self._choices.all(now_ns)
        patience = max(0.0, 1.0 - self._turned_rad / PATIENT_RAD)
        if self._begin_best(choices, LEAVE_RATIO * patience, now_ns):
            return
        if not patience and choices:
            # A circle around the middle leaves room for nothing: from one at the edge the way across is longer.
            farthest = max(choices, key=lambda choice: choice.length_m)
            if farthest.length_m > -MIN_LENGTH_M:
                self._begin(farthest, now_ns)
        elif self._hold.is_noted or self._choice.need < LITTLE_NEED:  # it has to go on, where enough is known
            other = self._choices.in_turn(self._hold, self._held_side(), now_ns)
            if other is not None:
                self._begin(other, now_ns)

    def _begin_best(self, choices, ratio, now_ns):
        """Begin the best of them, if its worth is this part of what any would have with all the room; return whether it
        is.
        """
        self._chosen_ns = now_ns
        best = max(choices, key=lambda choice: choice.score, default=None)
        if best is None or not best.score or best.score < ratio * max(choice.ideal for choice in choices):
            return False
        self._begin(best, now_ns)
        return True

    def _turn(self, now_ns, side=None, tightest=False):
        """Turn tightly towards where there is room, or to a side."""
        side = self._way(now_ns) if side is None else side
        reaction_m = self._motion.speed_mps * (REACTION_S + sum(self._survey.servo_delay))
        pose = moved(self._motion.pose, reaction_m, self.outlook.path_per_m(self._hold, now_ns))
        best = None if tightest else self._choices.tight(side, pose, now_ns)
        best = best or Candidate(self._ends[side], 0.0, 0)
        if self._hold is not None and self._hold.duty == best.duty:
            self._choice = self._choice._replace(is_turn=True)
        else:
            self._begin(self._choices.turn(best, side, now_ns), now_ns)

    def _held_side(self):
        """Return to which side it turns."""
        return 0 if self._survey.positions.expected_per_m(self._hold.duty) > 0 else 1

    def _way(self, now_ns):
        """Return the tight turn to take: the one that stays inside and is free; of two the one about which less is
        known.
        """
        look = self.outlook
        seen = [look.sonar_mps(turn, now_ns) for turn in look.turns_per_m()]
        if min(seen) < FREE_MPS and max(seen) > min(seen) + 0.1:
            return seen.index(max(seen))
        excesses = [way.excess_m for way in look.ways_out(self._hold, now_ns)]
        if max(excesses) > 0:
            return excesses.index(min(excesses))
        needs = self._choices.turns_needs()
        return needs.index(max(needs))

    def _begin(self, choice, now_ns):
        self._note_hold()
        if not (choice.is_turn and self._choice is not None and self._choice.is_turn):
            self._turned_rad = 0.0
        self._hold, self._choice, self._chosen_ns = choice.hold, choice, now_ns
        if self._was_paused:
            # Meanwhile the servo went elsewhere, and the fit doesn't know at which side of its backlash the linkage
            # lies until the servo has moved once more: what is held first shows nothing.
            self._was_paused, self._hold.is_noted, self._choice = False, True, choice._replace(want_m=BLIND_M)
        if not choice.is_turn:
            self._avoids = False
            return
        known = self._survey.positions.knowledge  # while it doesn't show by how much turns widen every other is quick
        self._is_quick = not (known.reason or known.has_understeer or self._is_quick) and choice.hold.duty in self._ends

    def _note_hold(self, least_m=KEPT_LENGTH_M):
        """Note what was measured, if it was enough."""
        hold = self._hold
        if hold is not None and hold.length_m >= least_m and not hold.is_noted:
            self._survey.positions.add(hold.measured())
            hold.is_noted = True

    def _phase(self, now_ns):
        """Return (the phase, the same in words)."""
        hold = self._hold
        side = steering_text(self._survey.positions.steering(hold.duty), "straight on")
        if self._avoids:
            return AVOIDING, f"a sonar sees something: it turns at {side}"
        if self._choice.is_turn:
            return TURNING, f"it turns back into the area at {side}"
        if not hold.is_settled(now_ns):
            return SETTLING, f"to {side}, duty {hold.duty}"
        return MEASURING, f"it measures {side}, duty {hold.duty}: {hold.length_m:.1f} of {self._choice.want_m:.1f} m"
