"""Where the car goes from here, and how fast it may: inside the area, around what the sonars see, and so that it stops
inside when the button is let go, with the servo's lag and with the least deceleration that was seen.
"""
from __future__ import annotations

import math

from car_interface.throttle.obstacle_stop import ObstacleStop, stopping_speed_mps
from car_interface.tools.calibration.drive.area import Area, Pose, Turn, WayOut, moved
from car_interface.tools.calibration.drive.positions import Hold
from car_interface.tools.calibration.drive.stops import Stops
from car_interface.tools.calibration.drive.survey import Survey

REACTION_S = 0.12  # from the decision to turn until the servo's lag begins, and what a step takes
TIGHT_PER_M = 0.8  # the tight speed holds from here on
TIGHT_DUTY = 20.0  # so near to its end a servo surely turns the wheels tightly
MAX_LAGS = 4.0
RELEASE_S = 0.25  # from the button until it coasts
COASTS_MPS2 = 0.2  # as long as it wasn't seen to stop: a car's drag, less a gentle slope
LATE_M = 0.35  # by so much sooner it slows: without a brake its speed is behind what is asked for
STEP_M = 0.2  # from one pose that is looked at to the next
SPARE_M = 0.15  # a way isn't begun from where it could stop only just inside
EARLY_MPS = 0.8  # as long as there is no curve
FREE_MPS, CREEP_MPS = 0.35, 0.2  # a sonar that allows less means: not there; and stop, if it was begun
QUICK_MPS2, MAX_QUICK_MPS = 2.2, 1.6  # sideways, in every other turn: shows by how much turns widen with speed
BY_HAND = "by hand or by the manual deadman, then hold the button again"


class Outlook:
    """The way ahead of one car, which stays in an area."""

    slow_mps = 0.33  # at the edge

    def __init__(self, survey: Survey, area: Area, obstacles: ObstacleStop, stops: Stops):
        self.area = area
        self.servo_duty = float(survey.base.servo_center)
        self._survey, self._config, self._motion, self._positions = (
            survey, survey.config, survey.motion, survey.positions)
        self._ends, self._obstacles, self._stops = survey.ends, obstacles, stops

    def _coasts_mps2(self):
        """Return the deceleration once the button is let go."""
        return min(self._config.braking_mps2, COASTS_MPS2, self._stops.least_mps2)

    # --- where it goes ---

    def turns_per_m(self) -> list[float]:
        """Return the curvatures of the tight turns to the left and to the right."""
        return [self._positions.expected_per_m(end) for end in self._ends]

    def live_per_m(self) -> float:
        """Return the curvature now; that of the duty that is held, where the car hardly moves."""
        curvature = self._motion.curvature_per_m()
        return self._positions.expected_per_m(self.servo_duty) if curvature is None else curvature

    def path_per_m(self, hold: Hold | None, now_ns: int) -> float:
        """Return the curvature of the arc ahead: as measured, or, while the servo is on its way, as expected."""
        if hold is None or hold.is_settled(now_ns):
            return self.live_per_m()
        return (self.live_per_m() + 2 * self._positions.expected_per_m(hold.duty)) / 3

    def turns(self, from_duty: float) -> list[Turn]:
        """Return the tight turns to the left and to the right, begun with the servo at a duty."""
        live, delay, found = self._motion.curvature_per_m(), self._survey.servo_delay, []
        for end, expected in zip(self._ends, self.turns_per_m()):
            # The servo creeps up to its end, and some linkages turn the wheels within the last counts.
            near_duty = max(TIGHT_DUTY, abs(end - self._positions.half_way_duty(end)))
            lags = min(MAX_LAGS, max(1.0, math.log(max(1.0, abs(end - from_duty) / near_duty))))
            # An end that is just being found out turns as it is seen to.
            is_seen = abs(from_duty - end) < TIGHT_DUTY and live is not None and live / expected > 1.0
            found.append(Turn(live if is_seen else expected, REACTION_S + delay.delay_s + delay.lag_s * lags))
        return found

    @property
    def now_mps(self) -> float:
        """The speed now; the slow one at least."""
        return max(self.slow_mps, self._motion.speed_mps)

    def ways_out(self, hold: Hold | None, now_ns: int) -> list[WayOut]:
        """Return what comes of a tight turn to the left, and of one to the right."""
        return self.area.ways_out(self._motion.pose, self.path_per_m(hold, now_ns), self.turns(self.servo_duty),
                                  self.now_mps, self._stop_m())

    def rooms_m(self, duty: float, curvature_per_m: float, speed_mps: float, max_m: float) -> list[float]:
        """Return how far the car can go from here, at most ``max_m``, to end with the tight turn to the left and with
        that to the right, if it steers that duty now and that gives that curvature.

        From everywhere on its way one of them, whichever, keeps it inside; so does that one at its end.
        """
        area, turns, stop_m, slow_mps = self.area, self.turns(duty), self._stop_m(), self.slow_mps
        lead_m = min(speed_mps, self.now_mps) * sum(self._survey.servo_delay)
        pose = moved(self._motion.pose, lead_m, (self.live_per_m() + curvature_per_m) / 2)
        if curvature_per_m and area.circle_extent_m(pose, curvature_per_m) <= area.radius_m:
            return [max_m, max_m]
        rooms_m, gone_m = [lead_m, lead_m], lead_m
        while True:
            # Let go, it has to stop inside; nothing brakes a car that begins this faster than it may be there.
            square = self.now_mps ** 2 - 2 * self._coasts_mps2() * gone_m
            if area.ahead_m(pose, area.radius_m) < SPARE_M + self._stop_m(math.sqrt(max(slow_mps ** 2, square))):
                return rooms_m
            turn_mps = min(speed_mps, self._slowed_mps(area.ahead_m(pose, self._config.radius_m)))
            ways = area.ways_out(pose, curvature_per_m, turns, turn_mps, stop_m)
            rooms_m = [gone_m if way.excess_m <= 0 else room_m for way, room_m in zip(ways, rooms_m)]
            if min(way.excess_m for way in ways) > 0 or gone_m >= max_m:
                return rooms_m
            step_m = min(STEP_M, max_m - gone_m)
            pose, gone_m = moved(pose, step_m, curvature_per_m), gone_m + step_m

    def is_outside_soon(self, hold: Hold, now_ns: int) -> bool:
        """Return whether it has to turn now to stay inside, or to stop inside when it is let go."""
        return (min(way.excess_m for way in self.ways_out(hold, now_ns)) > 0
                or self.area.ahead_m(self._motion.pose, self.area.radius_m) < self._stop_m())

    def _stop_m(self, speed_mps=None):
        """Return what it takes to stop when the button is let go, from a speed or from that at the edge."""
        speed_mps = self.slow_mps if speed_mps is None else speed_mps
        return RELEASE_S * speed_mps + speed_mps ** 2 / (2 * self._coasts_mps2())

    # --- how fast ---

    def cruise_mps(self, curvature_per_m: float) -> float:
        """Return the speed in such a turn."""
        config = self._config
        ratio = min(1.0, abs(curvature_per_m) / TIGHT_PER_M)
        speed_mps = config.speed_mps + (config.tight_speed_mps - config.speed_mps) * ratio
        return min(speed_mps, EARLY_MPS) if self._positions.knowledge.reason else speed_mps

    def sonar_mps(self, curvature_per_m: float, now_ns: int) -> float:
        """Return what the sonars allow on an arc."""
        bound = self._bound(curvature_per_m, now_ns)
        return math.inf if bound is None else bound.speed_mps

    def _bound(self, curvature_per_m, now_ns):
        return self._obstacles.bound(curvature_per_m, False, self._config.braking_mps2, now_ns, counts_sides=False)

    def allowed_mps(self, hold: Hold, is_quick: bool, now_ns: int) -> tuple[float, str]:
        """Return (the speed for a position, why it stands); ``is_quick``: as fast as the tyres hold, once it is
        settled.
        """
        expected, speed_now_mps = self._positions.expected_per_m(hold.duty), self._motion.speed_mps
        speed_mps = self.cruise_mps(expected)
        if is_quick and hold.is_settled(now_ns):
            speed_mps = max(speed_mps, min(MAX_QUICK_MPS, math.sqrt(QUICK_MPS2 / abs(expected))))
        seen_mps = min(self.sonar_mps(expected, now_ns),
                       self.sonar_mps(self.live_per_m(), now_ns) if speed_now_mps > FREE_MPS else math.inf)
        if seen_mps < (CREEP_MPS if speed_now_mps > CREEP_MPS / 2 else FREE_MPS):
            bound = self._bound(expected, now_ns)
            why = "something is near" if bound is None else f"{bound.words} {bound.speed_mps:.1f} m/s"
            return 0.0, (f"{why}: no way on from here; move the car to where it is free by hand, then hold the button "
                         "again")
        pose, hard_m = self._motion.pose, self._config.radius_m
        extent_m = min(way.extent_m for way in self.ways_out(hold, now_ns))
        if extent_m > hard_m:
            speed_mps = min(speed_mps, self.slow_mps)
            if extent_m > hard_m + 0.1 and self.area.inward_rad(pose) > math.pi / 2:
                return 0.0, (f"it stands {self.area.extent_m(pose):.1f} m from where it began, with no room to turn: "
                             f"{self._way_back()} {BY_HAND}")
        # Whenever the button is let go the steering goes to the center, and the car is to stop inside all the same.
        speed_mps = min(speed_mps, self._slowed_mps(self.area.ahead_m(pose, hard_m) - LATE_M))
        return min(speed_mps, seen_mps), ""

    def _slowed_mps(self, ahead_m):
        """Return the speed from which it stops within a distance when it is let go, and the slow one at least."""
        return max(self.slow_mps, stopping_speed_mps(ahead_m, RELEASE_S, self._coasts_mps2()))

    def _way_back(self):
        """Return where a person is to bring a car without room to turn; in the middle a wide turn has none either."""
        per_m = max(self.turns_per_m(), key=abs)
        area = self.area
        if area.circle_extent_m(Pose(*area.center, 0.0), per_m, self._stop_m()) <= area.stop_radius_m:
            return "move it towards the middle"
        return f"place it {beside_middle(per_m)},"


def beside_middle(curvature_per_m: float) -> str:
    """Return in words how a car is to be placed for a turn around the middle of the area."""
    return (f"so that the middle is about {1 / abs(curvature_per_m):.1f} m to its "
            f"{'left' if curvature_per_m > 0 else 'right'}")
