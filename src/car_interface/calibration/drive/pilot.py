"""Drives from position to position, inside the area and around what the sonars see.

It holds one position after another. Each is chosen by what measuring it is worth for the time that it takes, among
those for which there is room from here: along its arc, until no tight turn would keep the car inside any more. Where
there is room for none, it turns tightly, and measures that turn. Wide turns thus become chords through the area, with
tight circles at both ends.
"""
from __future__ import annotations

import math
from typing import NamedTuple

from car_interface.calibration.drive.area import INWARD_RAD, Area, Turn, moved
from car_interface.calibration.drive.config import DriveConfig
from car_interface.calibration.drive.hold import Hold
from car_interface.calibration.drive.motion import Motion
from car_interface.calibration.drive.positions import Candidate
from car_interface.calibration.drive.step import AVOIDING, BLOCKED, MEASURING, SETTLING, TURNING, Step
from car_interface.calibration.drive.survey import Survey
from car_interface.common.units import NS_PER_S
from car_interface.steering.calibration import SteeringCalibration
from car_interface.throttle.obstacle_stop import Guarantee, ObstacleStop, stopping_speed_mps

REACTION_S = 0.12  # from the decision to turn until the servo's lag begins, and what a step takes
MIN_LENGTH_M = 0.9  # of a position that is begun
KEPT_LENGTH_M = 0.6  # one that was cut short counts from here on
WANT_TIGHT_M, WANT_WIDE_M, WIDE_PER_M = 1.3, 2.2, 0.12  # to measure: a wide turn's curvature is known less well
TIGHT_PER_M = 0.8  # the tight speed holds from here on
LITTLE_NEED = 0.3
NEED_POWER = 2.0  # of a need, in what measuring it is worth: what is known least comes first, though it takes longer
LENGTH_POWER = 1.5  # of the length: a slope's variance falls with the third power, and the fit smooths
BEGIN_RATIO, LEAVE_RATIO = 0.3, 0.9  # of the best worth: what is begun, and for what a turn is left
TIGHT_RATIO = 0.6  # of the tightest curvature: tight enough to turn back with
TURNED_RAD = 2 * math.pi  # after a whole turn another one may be tried
PATIENT_RAD = 1.3 * math.pi  # a turn that has lasted this long makes do with any room
RELEASE_S = 0.15  # from the button to the ESC
CHOICE_NS = NS_PER_S // 10
WRONG_M, WRONG_PER_M = 0.3, 0.1  # so far, and as tightly to the other side
TIGHT_DUTY = 20.0  # so near to its end a servo surely turns the wheels tightly
MAX_LAGS = 2.0
SLOW_MPS = 0.45
EARLY_MPS = 0.8  # as long as there is no curve
FREE_MPS, CREEP_MPS = 0.35, 0.2  # a sonar that allows less means: not there; and stop, if it was begun
SEEN_RATIO = 0.7  # of its speed, that the sonars must allow a position that is begun
STUCK_NS, STUCK_M = 3 * NS_PER_S, 0.15  # so long without moving so far: it can't go on
QUICK_MPS2, MAX_QUICK_MPS = 2.2, 1.6  # sideways, in every other turn: shows by how much turns widen with speed


class _Choice(NamedTuple):
    """A position that could be begun now.

    Attributes:
        score: what measuring it is worth for each second: with the room that there is. 0 = there is no room for it.
        ideal: the same with all the room that it wants.
        want_m: the length that it wants.
        hold: its hold, if it is begun now.
        length_m: how long it could be measured, negative where it wouldn't even settle.
    """

    score: float
    ideal: float
    want_m: float
    hold: Hold
    length_m: float = -math.inf


class Pilot:
    """Decides steering and speed while the button is held."""

    def __init__(self, base: SteeringCalibration, config: DriveConfig, survey: Survey, motion: Motion, area: Area,
                 obstacles: ObstacleStop | None):
        self.area = area
        self._base, self._config, self._survey, self._motion = base, config, survey, motion
        self._obstacles = obstacles
        self._guarantee = Guarantee(config.braking_mps2, 0.0, config.braking_mps2)
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
        self._servo_duty = float(base.servo_center)

    def pause(self) -> None:
        """The button was let go: what was half measured is left."""
        self._finish_hold()
        self._free_ns = None
        self._avoids = False

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
        self._servo_duty = held_duty
        if self._free_ns is None or self._stood_m >= STUCK_M:
            self._free_ns, self._stood_m = now_ns, 0.0
        self._steer_on(now_ns)
        hold = self._hold
        speed_mps, text = self._allowed_mps(now_ns)
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
        pose, curvature = self._motion.pose, self._expected(self._hold.duty)
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
        if self._sonar_mps(self._path_per_m(now_ns), now_ns) < FREE_MPS:
            self._avoids = True
            return True
        return min(self._extents_m(now_ns)) > self.area.radius_m

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

    def _choices(self, now_ns):
        """All candidates as they could be begun now."""
        return [self._choice(candidate, now_ns) for candidate in self._survey.positions.candidates()]

    def _choice(self, candidate: Candidate, now_ns):
        """What a candidate is worth from here."""
        curvature = self._expected(candidate.duty)
        speed_mps = self._cruise_mps(curvature)
        hold = self._hold_for(candidate, now_ns)
        settle_s = hold.seconds_to_settle(now_ns)
        want_m = wanted_length_m(curvature)
        worth = candidate.need ** NEED_POWER
        ideal = worth / (settle_s + want_m / speed_mps)
        nothing = _Choice(0.0, ideal, want_m, hold)
        if self._sonar_mps(curvature, now_ns) < SEEN_RATIO * speed_mps:
            return nothing
        # What is expected of a position between others that were held may be far off: it may turn as little as the one.
        curvatures = {curvature}
        if candidate.duty not in self._ends:
            curvatures.add(self._survey.positions.least_per_m(candidate.duty))
        rooms_m = [self._room_m(candidate.duty, one, speed_mps, want_m + speed_mps * settle_s) for one in curvatures]
        length_m = min(rooms_m) - speed_mps * settle_s
        if length_m < MIN_LENGTH_M:
            return nothing._replace(length_m=length_m)
        known = min(1.0, length_m / want_m) ** LENGTH_POWER
        return _Choice(worth * known / (settle_s + length_m / speed_mps), ideal, want_m, hold)

    def _room_m(self, duty, curvature, speed_mps, max_m):
        """How far the car can go from here if it steers that duty now and that gives that curvature."""
        lead_m = speed_mps * (self._survey.servo_delay_s + self._survey.servo_lag_s)
        after = moved(self._motion.pose, lead_m, (self._live_per_m() + curvature) / 2)
        return lead_m + self.area.free_m(after, curvature, self._turns(duty, speed_mps), max_m - lead_m)

    def _turn(self, now_ns, tightest=False):
        """Turn tightly towards where there is room."""
        turn_per_m = self._way_per_m(now_ns)
        reaction_m = self._motion.speed_mps * (REACTION_S + self._survey.servo_delay_s + self._survey.servo_lag_s)
        pose = moved(self._motion.pose, reaction_m, self._path_per_m(now_ns))
        best = Candidate(self._base.servo_left if turn_per_m > 0 else self._base.servo_right, 0.0, 0)
        positions = self._survey.positions
        for candidate in [] if tightest else positions.candidates(
                lambda duty: positions.least_per_m(duty) / turn_per_m > TIGHT_RATIO):
            curvature = positions.least_per_m(candidate.duty)
            if (candidate.need > best.need and self.area.turn_extent_m(pose, curvature) <= self.area.radius_m
                    and self._sonar_mps(curvature, now_ns) >= SEEN_RATIO * self._cruise_mps(curvature)):
                best = candidate
        hold = self._hold
        if hold is not None and hold.duty == best.duty:
            self._is_turn = True
            return
        choice = _Choice(0.0, 0.0, wanted_length_m(turn_per_m), self._hold_for(best, now_ns))
        self._begin(choice, True, now_ns, best.need)

    def _way_per_m(self, now_ns):
        """The tight turn to take: the one that stays inside and is free; of two the one about which less is known."""
        turns = [self._expected(end) for end in self._ends]
        seen = [self._sonar_mps(turn, now_ns) for turn in turns]
        if min(seen) < FREE_MPS and max(seen) > min(seen) + 0.1:
            return turns[seen.index(max(seen))]
        # A car that looks inward gets out again on the other turn: what counts here is the whole circle of each.
        reacted = [moved(self._motion.pose, turn.reaction_m, self._path_per_m(now_ns))
                   for turn in self._turns(self._servo_duty, max(SLOW_MPS, self._motion.speed_mps))]
        is_inward = self.area.inward_rad(self._motion.pose) < INWARD_RAD
        extents = [max(partly_m, self.area.circle_extent_m(pose, turn)) if is_inward else partly_m
                   for partly_m, pose, turn in zip(self._extents_m(now_ns), reacted, turns)]
        if max(extents) > self.area.radius_m:
            return turns[extents.index(min(extents))]
        needs = [max((candidate.need for candidate in self._survey.positions.candidates()
                      if self._tight_per_m(candidate.duty) / turn > TIGHT_RATIO), default=0.0)
                 for turn in turns]
        return turns[needs.index(max(needs))]

    def _begin(self, choice, is_turn, now_ns, need=0.0):
        was_turn = self._is_turn
        self._finish_hold()
        self._hold, self._want_m, self._is_turn, self._need = choice.hold, choice.want_m, is_turn, need
        self._chosen_ns = now_ns
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
        return Hold(candidate.duty, candidate.from_side, self._servo_duty, self._limits, survey.servo_lag_s,
                    survey.servo_delay_s, now_ns)

    # --- where it goes ---

    def _extents_m(self, now_ns):
        """How far the car's corners get from the center if it turns tightly now, to the left and to the right."""
        speed_mps = max(SLOW_MPS, self._motion.speed_mps)
        return self.area.ways_out(self._motion.pose, self._path_per_m(now_ns), self._turns(self._servo_duty, speed_mps))

    def _turns(self, from_duty, speed_mps):
        """The tight turns to the left and to the right, begun with the servo at a duty."""
        survey = self._survey
        found = []
        for end in self._ends:
            # The servo creeps up to its end, and some linkages turn the wheels within the last counts.
            near_duty = max(TIGHT_DUTY, abs(end - survey.positions.half_way_duty(end)))
            lags = min(MAX_LAGS, max(1.0, math.log(max(1.0, abs(end - from_duty) / near_duty))))
            reaction_s = REACTION_S + survey.servo_delay_s + survey.servo_lag_s * lags
            curvature, live = self._expected(end), self._motion.curvature_per_m()
            if abs(from_duty - end) < TIGHT_DUTY and live is not None and live / curvature > 1.0:
                curvature = live  # an end that is just being found out
            found.append(Turn(curvature, speed_mps * reaction_s))
        return found

    def _expected(self, duty):
        return self._survey.positions.expected_per_m(duty)

    def _tight_per_m(self, duty):
        """What a position turns at least; of an end what is expected of it."""
        return self._expected(duty) if duty in self._ends else self._survey.positions.least_per_m(duty)

    def _live_per_m(self):
        """The curvature now; that of the duty that is held, where the car hardly moves."""
        curvature = self._motion.curvature_per_m()
        return self._expected(self._servo_duty) if curvature is None else curvature

    def _path_per_m(self, now_ns):
        """The curvature of the arc ahead: as it is measured, or, while the servo is on its way, as is expected."""
        hold = self._hold
        if hold is None or hold.is_settled(now_ns):
            return self._live_per_m()
        return (self._live_per_m() + 2 * self._expected(hold.duty)) / 3

    # --- how fast ---

    def _cruise_mps(self, curvature_per_m):
        config = self._config
        ratio = min(1.0, abs(curvature_per_m) / TIGHT_PER_M)
        speed_mps = config.speed_mps + (config.tight_speed_mps - config.speed_mps) * ratio
        return min(speed_mps, EARLY_MPS) if self._survey.knowledge is None else speed_mps

    def _sonar_mps(self, curvature_per_m, now_ns):
        """What the sonars allow on an arc."""
        if self._obstacles is None:
            return math.inf
        bound = self._obstacles.bound(curvature_per_m, False, self._guarantee, now_ns)
        return math.inf if bound is None else bound.speed_mps

    def _allowed_mps(self, now_ns):
        """(the speed, why it stands)."""
        hold = self._hold
        speed_mps = self._cruise_mps(self._expected(hold.duty))
        if self._is_turn and self._is_quick and hold.is_settled(now_ns):
            speed_mps = max(speed_mps, min(MAX_QUICK_MPS, math.sqrt(QUICK_MPS2 / abs(self._expected(hold.duty)))))
        seen_mps = min(self._sonar_mps(self._expected(hold.duty), now_ns),
                       self._sonar_mps(self._live_per_m(), now_ns) if self._motion.speed_mps > FREE_MPS else math.inf)
        if seen_mps < (CREEP_MPS if self._motion.speed_mps > CREEP_MPS / 2 else FREE_MPS):
            return 0.0, self._obstacle_text(now_ns)
        pose, hard_m = self._motion.pose, self._config.radius_m
        extent_m = min(self._extents_m(now_ns))
        if extent_m > hard_m:
            speed_mps = min(speed_mps, SLOW_MPS)
            if extent_m > hard_m + 0.1 and self.area.inward_rad(pose) > math.pi / 2:
                return 0.0, (f"it stands {self.area.extent_m(pose):.1f} m from where it began, with no room to turn: "
                             "move it towards the middle by hand or by the manual deadman, then hold the button again")
        # Whenever the button is let go the steering goes to the center, and the car is to stop inside all the same.
        ahead_m = self.area.ahead_m(pose, hard_m)
        speed_mps = min(speed_mps, max(SLOW_MPS, stopping_speed_mps(ahead_m, RELEASE_S, self._guarantee)))
        return min(speed_mps, seen_mps), ""

    def _obstacle_text(self, now_ns):
        bound = self._obstacles.bound(self._expected(self._hold.duty), False, self._guarantee, now_ns)
        why = f"{bound.words} {bound.speed_mps:.1f} m/s" if bound is not None else "something is near"
        return f"{why}: no way on from here; move the car to where it is free by hand, then hold the button again"

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
    return WANT_WIDE_M if abs(curvature_per_m) < WIDE_PER_M else WANT_TIGHT_M + 0.5 * max(
        0.0, 1 - abs(curvature_per_m) / 0.5)
