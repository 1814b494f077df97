"""Drives from position to position, inside the area and around what the sonars see.

It holds one position after another. Each is chosen by what measuring it is worth for the time that it takes, among
those for which there is room from here: along its arc, until no tight turn would keep the car inside any more. Where
there is room for none, it turns tightly, and measures that turn. Wide turns thus become chords through the area, with
tight circles at both ends.
"""
from __future__ import annotations

import math
from typing import Sequence

from car_interface.common.units import NS_PER_S
from car_interface.tools.calibration.drive.area import INWARD_RAD, moved
from car_interface.tools.calibration.drive.choices import MIN_LENGTH_M, MISSING_NEED, Choices
from car_interface.tools.calibration.drive.outlook import FREE_MPS, REACTION_S, Outlook
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


class LostTurns:
    """Notices that turns to one side are missing, and that the car only ever turns to the other: after two of those one
    to that side is sought for a whole turn, and then a person has to place the car.

    A car that turns widely goes from one turn to the next one to the same side, as no way across the area leads to one
    to the other side that stays inside. Of the tight turns 0 is the one to the left, 1 that to the right.

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
        """Seek that one; return for how many turns it is sought by now: from 1 on it is lost."""
        if self._sought != side:
            self._sought, self._since_rad[side] = side, SOUGHT_RAD
        return (self._since_rad[side] - SOUGHT_RAD) / (LOST_RAD - SOUGHT_RAD)

    def ask(self, side: int) -> None:
        """Ask a person for that one; it is sought again after two more turns to the other side."""
        self.asked, self._sought, self._since_rad[side] = side, None, 0.0

    def text(self, turns_per_m: Sequence[float]) -> str:
        """Return what to do, for a person; the turns have these curvatures, (2,)."""
        name, radius_m = ("left", "right")[self.asked], 1 / abs(turns_per_m[self.asked])
        return (f"{name} turns are missing, and no way leads to one: place the car so that the middle is about "
                f"{radius_m:.1f} m to its {name}, by hand or by the manual deadman, then hold the button again")


class Pilot:
    """Decides steering and speed while the button is held."""

    def __init__(self, survey: Survey, outlook: Outlook):
        self.outlook = outlook
        self._survey, self._motion, self._ends = survey, survey.motion, survey.ends
        self._choices = Choices(survey, outlook)
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
        self._side: int | None = None  # of the turn with which the position is to end
        self._is_side_free = False  # that turn stayed inside a step ago
        self._lost = LostTurns()

    def pause(self) -> None:
        """Leave what was half measured: the button was let go."""
        self._finish_hold()
        self._free_ns = None
        self._avoids = False
        self._was_paused = True
        self._lost.asked = None

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
        speed_mps, text = self.outlook.allowed_mps(hold, self._is_turn and self._is_quick, now_ns)
        phase, said = self._phase(now_ns)
        if self._lost.asked is not None:
            speed_mps, phase, text = 0.0, BLOCKED, self._lost.text(self.outlook.turns_per_m())
        elif now_ns - self._free_ns > STUCK_NS:
            phase, said = BLOCKED, f"it doesn't move at {speed_mps:.1f} m/s: is the car held, or the battery empty?"
        steering = self._survey.positions.steering(hold.asked_duty(now_ns))
        return Step(steering, speed_mps, phase, text or said, hold.duty)

    def expected_path(self) -> list[tuple[float, float]]:
        """Return the next 2 m, by the position that is held."""
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
        elif self._misses_turn(now_ns):
            self._turn(now_ns, side=self._side)
        elif self._is_turn:
            if self._takes_lost_turn(now_ns):
                return
            if is_due and (hold.length_m >= self._want_m or self._need < LITTLE_NEED and hold.is_settled(now_ns)):
                self._leave_turn(now_ns)
        elif hold.length_m >= self._want_m:
            self._begin_any(now_ns)

    def _takes_lost_turn(self, now_ns):
        """Return whether a turn to the other side is sought: its positions are missing, and it only turns to this one.

        The tight turn to this side is held, which leads to the middle of the area, until one to the other side stays
        inside; the longer it is sought, the less room will do. After a whole turn a person is asked for help.
        """
        lost = self._lost.drive(0 if self.outlook.expected_per_m(self._hold.duty) > 0 else 1)
        if lost is None or self._choices.turns_needs()[lost] < MISSING_NEED:
            return False
        turn_per_m = self.outlook.turns_per_m()[lost]
        if not self.outlook.area.has_circle(turn_per_m):
            return False
        sought = self._lost.seek(lost)
        if sought >= 1:
            self._lost.ask(lost)
        elif (self._circle_excesses_m(now_ns)[lost] <= -ACROSS_M * (1 - sought)
                and self.outlook.sonar_mps(turn_per_m, now_ns) >= FREE_MPS):
            self._turn(now_ns, side=lost)
        else:
            self._turn(now_ns, tightest=True, side=1 - lost)
        return True

    def _misses_turn(self, now_ns):
        """Return whether the turn with which it is to end would leave the area from now on."""
        if self._side is None:
            return False
        was_free = self._is_side_free
        self._is_side_free = self.outlook.ways_out(self._hold, now_ns)[self._side].excess_m <= 0
        return (was_free and not self._is_side_free and self._hold.length_m >= KEPT_LENGTH_M
                and self.outlook.sonar_mps(self.outlook.turns_per_m()[self._side], now_ns) >= FREE_MPS)

    def _is_cut_off(self, now_ns):
        """Return whether the arc ends here: by the area, or by a sonar."""
        look = self.outlook
        if look.sonar_mps(look.path_per_m(self._hold, now_ns), now_ns) < FREE_MPS:
            self._avoids = True
            return True
        if self._is_turn:  # it is on its way back
            return min(way.excess_m for way in look.ways_out(self._hold, now_ns)) > 0
        return look.is_outside_soon(self._hold, now_ns)

    def _begin_any(self, now_ns):
        """Begin the best position for which there is room; else a tight turn."""
        self._note_hold()
        self._chosen_ns = now_ns
        choices = self._choices.all(now_ns)
        best = max(choices, key=lambda choice: choice.score, default=None)
        if best is None or best.score < BEGIN_RATIO * max(choice.ideal for choice in choices):
            self._turn(now_ns)
        else:
            self._begin(best, False, now_ns)

    def _leave_turn(self, now_ns):
        """Take the best position once there is room for it; the longer the turn, the less will do."""
        self._chosen_ns = now_ns
        self._note_hold(self._want_m)
        choices = self._choices.all(now_ns)
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

    def _turn(self, now_ns, tightest=False, side=None):
        """Turn tightly towards where there is room, or to a side."""
        turn_per_m = self._way_per_m(now_ns) if side is None else self.outlook.turns_per_m()[side]
        reaction_m = self._motion.speed_mps * (REACTION_S + sum(self._survey.servo_delay))
        pose = moved(self._motion.pose, reaction_m, self.outlook.path_per_m(self._hold, now_ns))
        best = Candidate(self._ends[0 if turn_per_m > 0 else 1], 0.0, 0)
        if not tightest:
            best = self._choices.tight(turn_per_m, pose, now_ns) or best
        if self._hold is not None and self._hold.duty == best.duty:
            self._is_turn, self._side = True, None
            return
        self._begin(self._choices.turn(best, turn_per_m, now_ns), True, now_ns, best.need)

    def _measure_in_turn(self, now_ns):
        """In a turn that has to go on, at a position that is known by now, take another one that turns to the same
        side.

        One that is missing may turn less tightly, where there is room for it; else one that is as tight will do.
        """
        turn_per_m = self.outlook.turns_per_m()[0 if self.outlook.expected_per_m(self._hold.duty) > 0 else 1]
        missing = self._choices.missing_in_turn(self._hold.duty, turn_per_m, now_ns)
        if missing is not None:
            self._begin(missing, True, now_ns, MISSING_NEED)
        elif self._is_noted:
            other = self._choices.tight(turn_per_m, self._motion.pose, now_ns, LITTLE_NEED)
            if other is not None and other.duty != self._hold.duty:
                self._begin(self._choices.turn(other, turn_per_m, now_ns), True, now_ns, other.need)

    def _way_per_m(self, now_ns):
        """Return the tight turn to take: the one that stays inside and is free; of two the one about which less is
        known.
        """
        turns = self.outlook.turns_per_m()
        seen = [self.outlook.sonar_mps(turn, now_ns) for turn in turns]
        if min(seen) < FREE_MPS and max(seen) > min(seen) + 0.1:
            return turns[seen.index(max(seen))]
        # A car that looks inward gets out again on the other turn: what counts here is the whole circle of each.
        is_inward = self.outlook.area.inward_rad(self._motion.pose) < INWARD_RAD
        excesses = self._circle_excesses_m(now_ns) if is_inward else [
            way.excess_m for way in self.outlook.ways_out(self._hold, now_ns)]
        if max(excesses) > 0:
            return turns[excesses.index(min(excesses))]
        needs = self._choices.turns_needs()
        return turns[needs.index(max(needs))]

    def _circle_excesses_m(self, now_ns):
        """Return by how much the whole circle of each tight turn leaves the area."""
        look, area, path_per_m = self.outlook, self.outlook.area, self.outlook.path_per_m(self._hold, now_ns)
        reacted = [moved(self._motion.pose, look.now_mps * turn.reaction_s, path_per_m)
                   for turn in look.turns(look.servo_duty)]
        ways = look.ways_out(self._hold, now_ns)
        return [max(way.excess_m, area.circle_extent_m(pose, turn_per_m) - area.radius_m)
                for way, pose, turn_per_m in zip(ways, reacted, look.turns_per_m())]

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
        self._side, self._is_side_free = None if is_turn else choice.side, False
        if not is_turn:
            self._avoids = False
            return
        known = self._survey.positions.knowledge  # while it doesn't show by how much turns widen with speed every other is quick
        self._is_quick = (known is not None and not known.has_understeer and choice.hold.duty in self._ends
                          and not self._is_quick)

    def _finish_hold(self):
        """Note what was measured, and hold it no more."""
        self._note_hold()
        self._hold, self._is_noted = None, False

    def _note_hold(self, least_m=KEPT_LENGTH_M):
        """Note what was measured, if it was enough."""
        hold = self._hold
        if hold is not None and hold.length_m >= least_m and not self._is_noted:
            self._survey.positions.add(hold.measured())
            self._is_noted = True

    def _phase(self, now_ns):
        """Return (the phase, the same in words)."""
        hold = self._hold
        side = steering_text(self._survey.positions.steering(hold.duty), "straight on")
        if self._avoids:
            return AVOIDING, f"a sonar sees something: it turns at {side}"
        if self._is_turn:
            return TURNING, f"it turns back into the area at {side}"
        if not hold.is_settled(now_ns):
            return SETTLING, f"to {side}, duty {hold.duty}"
        return MEASURING, f"it measures {side}, duty {hold.duty}: {hold.length_m:.1f} of {self._want_m:.1f} m"
