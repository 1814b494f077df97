"""Drives from position to position, inside the area and around what the sonars see.

It holds one position after another. Each is chosen by what measuring it is worth for the time that it takes, among
those for which there is room from here: along its arc, until no tight turn would keep the car inside any more. Where
there is room for none, it turns tightly, and measures that turn. Wide turns thus become chords through the area, with
tight circles at both ends.
"""
from __future__ import annotations

import math
from typing import NamedTuple

from car_interface.calibration.drive.area import INWARD_RAD, moved
from car_interface.calibration.drive.hold import Hold
from car_interface.calibration.drive.motion import Motion
from car_interface.calibration.drive.outlook import FREE_MPS, REACTION_S, Outlook
from car_interface.calibration.drive.positions import Candidate
from car_interface.calibration.drive.step import AVOIDING, BLOCKED, MEASURING, SETTLING, TURNING, Step
from car_interface.calibration.drive.survey import Survey
from car_interface.common.units import NS_PER_S
from car_interface.steering.calibration import SteeringCalibration

MIN_LENGTH_M = 0.9  # of a position that is begun
KEPT_LENGTH_M = 0.6  # one that was cut short counts from here on
WANT_TIGHT_M, WANT_WIDE_M, WIDE_PER_M = 0.9, 2.2, 0.12  # to measure: a wide turn's curvature is known less well
BLIND_M = 0.3  # after a pause
LITTLE_NEED = 0.3
NEED_POWER = 2.0  # of a need, in what measuring it is worth: what is known least comes first, though it takes longer
LENGTH_POWER = 1.5  # of the length: a slope's variance falls with the third power, and the fit smooths
BEGIN_RATIO, LEAVE_RATIO = 0.3, 0.9  # of the best worth: what is begun, and for what a turn is left
TIGHT_RATIO = 0.6  # of the tightest curvature: tight enough to turn back with
SAME_TURN_RATIO = 0.25  # of the tightest curvature, as above: to be measured in a turn that has to go on
MISSING_NEED = 1.0  # the tool refuses a table without it, or no fit knows it
TIGHT_WAY_RATIO = 0.4  # tight enough to be measured on the way into or out of a turn to that side
TURNED_RAD = 2 * math.pi  # after a whole turn another one may be tried
PATIENT_RAD = 1.3 * math.pi  # a turn that has lasted this long makes do with any room
CHOICE_NS = NS_PER_S // 10
WRONG_M, WRONG_PER_M = 0.3, 0.1  # so far, and as tightly to the other side
SEEN_MPS = 0.45  # that the sonars must allow a position that is begun
STUCK_NS, STUCK_M = 3 * NS_PER_S, 0.15  # so long without moving so far: it can't go on


class _Choice(NamedTuple):
    """A position that could be begun now.

    Attributes:
        score: what measuring it is worth for each second: with the room that there is. 0 = there is no room for it.
        ideal: the same with all the room that it wants.
        want_m: the length that it wants.
        hold: its hold, if it is begun now.
        length_m: how long it could be measured, negative where it wouldn't even settle.
        worth: for the time that it takes.
    """

    score: float
    ideal: float
    want_m: float
    hold: Hold
    length_m: float = -math.inf
    worth: float = 0.0


class Pilot:
    """Decides steering and speed while the button is held."""

    def __init__(self, base: SteeringCalibration, survey: Survey, motion: Motion, outlook: Outlook):
        self.outlook = outlook
        self._base, self._survey, self._motion = base, survey, motion
        self._limits = tuple(float(end) for end in sorted((base.servo_left, base.servo_right)))
        self._ends = (base.servo_left, base.servo_right)
        self._hold: Hold | None = None
        self._need = 0.0
        self._want_m = 0.0
        self._is_turn = self._avoids = False
        self._is_noted = False  # what is held was measured, and goes on
        self._turned_rad = 0.0
        self._chosen_ns = 0
        self._free_ns: int | None = None  # when it last had moved on
        self._stood_m = 0.0  # since then
        self._is_quick = False  # the turn
        self._was_paused = False

    def pause(self) -> None:
        """The button was let go: what was half measured is left."""
        self._finish_hold()
        self._free_ns = None
        self._avoids = False
        self._was_paused = True

    @property
    def turns_wrongly(self) -> bool:
        """Whether the end that is held now turns to the other side than its name says."""
        hold = self._hold
        return (hold is not None and hold.duty in self._ends and hold.length_m >= WRONG_M
                and hold.measured().curvature_per_m * (1 if hold.duty == self._ends[0] else -1) < -WRONG_PER_M)

    def update_motion(self, distance_m: float, turned_rad: float, at_ns: int) -> None:
        """What odometry saw since the last call."""
        if self._hold is not None:
            self._hold.update_motion(distance_m, turned_rad, at_ns)
        self._turned_rad += abs(turned_rad)
        self._stood_m += abs(distance_m)

    def step(self, held_duty: float, now_ns: int) -> Step:
        """What to ask for, the servo board holding ``held_duty``."""
        self.outlook.servo_duty = held_duty
        if self._free_ns is None or self._stood_m >= STUCK_M:
            self._free_ns, self._stood_m = now_ns, 0.0
        self._steer_on(now_ns)
        hold = self._hold
        speed_mps, text = self.outlook.allowed_mps(hold, self._is_turn and self._is_quick, now_ns)
        steering = self._survey.positions.steering(hold.asked_duty(now_ns))
        if now_ns - self._free_ns > STUCK_NS:
            text = text or f"it doesn't move at {speed_mps:.1f} m/s: is the car held, or the battery empty?"
            return Step(steering, speed_mps, BLOCKED, text, hold.duty)
        phase = self._phase(now_ns)
        return Step(steering, speed_mps, phase, text or self._text(phase, now_ns), hold.duty)

    def expected_path(self) -> list[tuple[float, float]]:
        """The next 2 m, by the position that is held."""
        if self._hold is None:
            return []
        pose, curvature = self._motion.pose, self.outlook.expected_per_m(self._hold.duty)
        return [moved(pose, 0.1 * index, curvature)[:2] for index in range(21)]

    # --- which position ---

    def _steer_on(self, now_ns):
        """Keep the position or take another one."""
        hold = self._hold
        if hold is None:
            self._begin_any(now_ns)
            return
        is_due = now_ns - self._chosen_ns >= CHOICE_NS
        is_tightest = self._is_turn and hold.duty in self._ends and self._turned_rad < TURNED_RAD
        if not is_tightest and self._is_cut_off(now_ns):
            self._turn(now_ns, tightest=self._is_turn)
        elif self._is_turn:
            if is_due and (hold.length_m >= self._want_m or self._need < LITTLE_NEED and hold.is_settled(now_ns)):
                self._leave_turn(now_ns)
        elif hold.length_m >= self._want_m:
            self._begin_any(now_ns)

    def _is_cut_off(self, now_ns):
        """Whether the arc ends here: by the area, or by a sonar."""
        look = self.outlook
        if look.sonar_mps(look.path_per_m(self._hold, now_ns), now_ns) < FREE_MPS:
            self._avoids = True
            return True
        if self._is_turn:  # it is on its way back
            return min(look.extents_m(self._hold, now_ns)) > look.area.radius_m
        return look.is_outside_soon(self._hold, now_ns)

    def _begin_any(self, now_ns):
        """The best position for which there is room; else a tight turn."""
        self._finish_hold()
        self._chosen_ns = now_ns
        choices = self._choices(now_ns)
        best = max(choices, key=lambda choice: choice.score, default=None)
        if best is None or best.score < BEGIN_RATIO * max(choice.ideal for choice in choices):
            self._turn(now_ns)
        else:
            self._begin(best, False, now_ns)

    def _leave_turn(self, now_ns):
        """Take the best position once there is room for it; the longer the turn, the less will do."""
        self._chosen_ns = now_ns
        if self._hold.length_m >= self._want_m and not self._is_noted:
            self._survey.add(self._hold.measured())
            self._is_noted = True
        choices = self._choices(now_ns)
        best = max(choices, key=lambda choice: choice.score, default=None)
        patience = max(0.0, 1.0 - self._turned_rad / PATIENT_RAD)
        if best is not None and best.score and best.score >= LEAVE_RATIO * patience * max(
                choice.ideal for choice in choices):
            self._begin(best, False, now_ns)
        elif not patience and best is not None and not best.score:
            # A circle around the middle leaves room for nothing: from one at the edge the way across is longer.
            farthest = max(choices, key=lambda choice: choice.length_m)
            if farthest.length_m > -MIN_LENGTH_M:
                self._begin(farthest, False, now_ns)
        elif self._is_noted or self._need < LITTLE_NEED:
            self._measure_in_turn(now_ns)

    def _choices(self, now_ns):
        """The candidates as they could be begun now, without those that can't be the best any more."""
        ideals = sorted((self._ideal(candidate, now_ns) for candidate in self._survey.positions.candidates()),
                        key=lambda choice: -choice.ideal)
        found, best = [], 0.0
        for ideal in ideals:
            if ideal.ideal < best:
                break
            found.append(self._choice(ideal, now_ns))
            best = max(best, found[-1].score)
        return found

    def _ideal(self, candidate: Candidate, now_ns):
        """What a candidate is worth with all the room that it wants."""
        curvature = self.outlook.expected_per_m(candidate.duty)
        hold = self._hold_for(candidate, now_ns)
        want_m = wanted_length_m(curvature)
        seconds = hold.seconds_to_settle(now_ns) + want_m / self.outlook.cruise_mps(curvature)
        worth = candidate.need ** NEED_POWER
        return _Choice(0.0, worth / seconds, want_m, hold, worth=worth)

    def _choice(self, ideal, now_ns):
        """What it is worth from here."""
        hold, want_m = ideal.hold, ideal.want_m
        curvature = self.outlook.expected_per_m(hold.duty)
        seen_mps = self.outlook.sonar_mps(curvature, now_ns)
        if seen_mps < SEEN_MPS:
            return ideal
        speed_mps = min(seen_mps, self.outlook.cruise_mps(curvature))
        settle_s = hold.seconds_to_settle(now_ns)
        # What is expected of a position between others that were held may be far off: it may turn as little as the one.
        curvatures = {curvature}
        if hold.duty not in self._ends:
            curvatures.add(self._survey.positions.least_per_m(hold.duty))
        rooms_m = [self.outlook.room_m(hold.duty, one, speed_mps, want_m + speed_mps * settle_s) for one in curvatures]
        length_m = min(rooms_m) - speed_mps * settle_s
        if length_m < MIN_LENGTH_M:
            return ideal._replace(length_m=length_m)
        known = min(1.0, length_m / want_m) ** LENGTH_POWER
        return ideal._replace(score=ideal.worth * known / (settle_s + length_m / speed_mps))

    def _turn(self, now_ns, tightest=False):
        """Turn tightly towards where there is room."""
        turn_per_m = self._way_per_m(now_ns)
        reaction_m = self._motion.speed_mps * (REACTION_S + self._survey.servo_delay_s + self._survey.servo_lag_s)
        pose = moved(self._motion.pose, reaction_m, self.outlook.path_per_m(self._hold, now_ns))
        best = Candidate(self._base.servo_left if turn_per_m > 0 else self._base.servo_right, 0.0, 0)
        if not tightest:
            best = self._tight_candidate(turn_per_m, pose, now_ns) or best
        if self._hold is not None and self._hold.duty == best.duty:
            self._is_turn = True
            return
        choice = _Choice(0.0, 0.0, wanted_length_m(turn_per_m), self._hold_for(best, now_ns))
        self._begin(choice, True, now_ns, best.need)

    def _tight_candidate(self, turn_per_m, pose, now_ns, least_need=0.0):
        """The tight position to that side of which least is known, and that stays inside; ``None``: there is none."""
        positions, area = self._survey.positions, self.outlook.area
        for candidate in positions.candidates(lambda duty: positions.least_per_m(duty) / turn_per_m > TIGHT_RATIO):
            curvature = positions.least_per_m(candidate.duty)
            if (candidate.need > least_need and area.turn_extent_m(pose, curvature) <= area.radius_m
                    and self.outlook.sonar_mps(curvature, now_ns) >= SEEN_MPS):
                return candidate
        return None

    def _measure_in_turn(self, now_ns):
        """A turn that has to go on, at a position that is known by now: take another one that turns to the same side.

        One that is missing may turn less tightly, where there is room for it; else one that is as tight will do.
        """
        is_left = self.outlook.expected_per_m(self._hold.duty) > 0
        turn_per_m = self.outlook.expected_per_m(self._ends[0 if is_left else 1])
        missing = self._missing_in_turn(turn_per_m, now_ns)
        if missing is not None:
            self._begin(missing, True, now_ns, MISSING_NEED)
        elif self._is_noted:
            other = self._tight_candidate(turn_per_m, self._motion.pose, now_ns, LITTLE_NEED)
            if other is not None and other.duty != self._hold.duty:
                choice = _Choice(0.0, 0.0, wanted_length_m(turn_per_m), self._hold_for(other, now_ns))
                self._begin(choice, True, now_ns, other.need)

    def _missing_in_turn(self, turn_per_m, now_ns):
        """The best choice to that side that is refused or a gap by now; ``None``: there is none with room for it."""
        candidates = self._survey.positions.candidates(
            lambda duty: self.outlook.expected_per_m(duty) / turn_per_m > SAME_TURN_RATIO)
        choices = [self._choice(self._ideal(candidate, now_ns), now_ns) for candidate in candidates
                   if candidate.need >= MISSING_NEED and candidate.duty != self._hold.duty]
        best = max(choices, key=lambda choice: choice.score, default=None)
        return best if best is not None and best.score else None

    def _way_per_m(self, now_ns):
        """The tight turn to take: the one that stays inside and is free; of two the one about which less is known."""
        turns = [self.outlook.expected_per_m(end) for end in self._ends]
        seen = [self.outlook.sonar_mps(turn, now_ns) for turn in turns]
        if min(seen) < FREE_MPS and max(seen) > min(seen) + 0.1:
            return turns[seen.index(max(seen))]
        # A car that looks inward gets out again on the other turn: what counts here is the whole circle of each.
        reacted = [moved(self._motion.pose, turn.reaction_m, self.outlook.path_per_m(self._hold, now_ns))
                   for turn in self.outlook.turns_now()]
        is_inward = self.outlook.area.inward_rad(self._motion.pose) < INWARD_RAD
        extents = [max(partly_m, self.outlook.area.circle_extent_m(pose, turn)) if is_inward else partly_m
                   for partly_m, pose, turn in zip(self.outlook.extents_m(self._hold, now_ns), reacted, turns)]
        if max(extents) > self.outlook.area.radius_m:
            return turns[extents.index(min(extents))]
        needs = [max((candidate.need for candidate in self._survey.positions.candidates()
                      if self.outlook.expected_per_m(candidate.duty) / turn > TIGHT_WAY_RATIO), default=0.0)
                 for turn in turns]
        return turns[needs.index(max(needs))]

    def _begin(self, choice, is_turn, now_ns, need=0.0):
        was_turn = self._is_turn
        self._finish_hold()
        self._hold, self._want_m, self._is_turn, self._need = choice.hold, choice.want_m, is_turn, need
        self._chosen_ns = now_ns
        if self._was_paused:
            # Meanwhile the servo went elsewhere, and the fit doesn't know at which side of its backlash the linkage
            # lies until the servo has moved once more: what is held first shows nothing.
            self._was_paused, self._is_noted, self._want_m = False, True, BLIND_M
        if not (is_turn and was_turn):
            self._turned_rad = 0.0
        if not is_turn:
            self._avoids = False
        elif self._survey.wants_speeds and choice.hold.duty in self._ends:
            self._is_quick = not self._is_quick
        else:
            self._is_quick = False

    def _finish_hold(self):
        """Note what was measured, if it was enough."""
        hold, self._hold = self._hold, None
        if hold is not None and hold.length_m >= KEPT_LENGTH_M and not self._is_noted:
            self._survey.add(hold.measured())
        self._is_noted = False

    def _hold_for(self, candidate, now_ns):
        survey = self._survey
        return Hold(candidate.duty, candidate.from_side, self.outlook.servo_duty, self._limits, survey.servo_lag_s,
                    survey.servo_delay_s, now_ns)

    def _phase(self, now_ns):
        if self._avoids:
            return AVOIDING
        if self._is_turn:
            return TURNING
        return MEASURING if self._hold.is_settled(now_ns) else SETTLING

    def _text(self, phase, now_ns):
        hold = self._hold
        steering = self._survey.positions.steering(hold.duty)
        side = "straight on" if abs(steering) < 0.005 else f"{abs(steering):.0%} {'left' if steering > 0 else 'right'}"
        if phase == AVOIDING:
            return f"a sonar sees something: it turns at {side}"
        if phase == TURNING:
            return f"it turns back into the area at {side}"
        if phase == SETTLING:
            return f"to {side}, duty {hold.duty}"
        return f"it measures {side}, duty {hold.duty}: {hold.length_m:.1f} of {self._want_m:.1f} m"


def wanted_length_m(curvature_per_m):
    """How long a turn is to be measured."""
    return WANT_WIDE_M if abs(curvature_per_m) < WIDE_PER_M else WANT_TIGHT_M + 0.8 * max(
        0.0, 1 - abs(curvature_per_m) / 0.5)
