"""A car that drives its own steering calibration while a person holds a button and watches, and the same by hand.

Consumes odometry, the duty that the servo board holds, six sonars' ranges and whether it may drive; answers with a
steering and a speed. Pure: ``now_ns`` is passed in. A node passes on what it hears and calls ``step`` 50 times a
second; in a second thread it has ``assess`` do what ``take_fit_task`` returns, and ``conclude`` once the step is DONE.
"""
from __future__ import annotations

import math

from car_interface.common.staleness import TimedInput
from car_interface.common.units import NS_PER_S
from car_interface.steering.calibration import SteeringCalibration
from car_interface.throttle.obstacle_stop import ObstacleStop
from car_interface.tools.calibration.drive.area import Area, moved
from car_interface.tools.calibration.drive.config import CalibrationDriveConfig
from car_interface.tools.calibration.drive.outlook import Outlook
from car_interface.tools.calibration.drive.pilot import Pilot
from car_interface.tools.calibration.drive.positions import Candidate, Measured
from car_interface.tools.calibration.drive.stops import Stops
from car_interface.tools.calibration.drive.survey import (
    DONE,
    MEASURING,
    PAUSED,
    SETTLING,
    WAITING,
    Step,
    Survey,
    steering_text,
)
from car_interface.tools.calibration.steering.drive import MIN_SPEED_MPS
from car_interface.tools.calibration.steering.segments import MAX_LATERAL_MPS2, MAX_WANDER_DUTY

MARGIN_M = 0.12  # of the area, for odometry's drift and for what isn't known of the steering
# By hand:
HOLD_M = 2.0  # of each position; a person needs no more precision than the fit, which takes what it gets
NEAR_DUTY = 24.0  # a stick that is held as near as this to the position holds it
SETTLE_NS = NS_PER_S // 2
LEAST_COUNTED_M = 0.6


class CalibrationDrive(Survey):
    """One drive, by turn_arb's calibration, which makes duties of av_steer_req: its ends and its rough center are the
    car's, its radii aren't believed.
    """

    def __init__(self, base: SteeringCalibration, config: CalibrationDriveConfig):
        super().__init__(base, config)
        self._stops = Stops()
        self._obstacles = ObstacleStop(config.obstacles)
        self._pilot: Pilot | None = None  # from when the button was first held
        self._ranges = {name: TimedInput(name, config.obstacles.timeout_s)
                        for name, mount in config.obstacles.mounts.items() if not mount.looks_back}
        self._drives = False  # a car that is pushed, or steered by hand meanwhile, shows nothing about its steering

    def _update_motion(self, distance_m, turned_rad, measured_ns, now_ns):
        if self.is_slowed:
            self._stops.discard()
        self._stops.update(distance_m, self.motion.speed_mps, self._drives, measured_ns)
        if self._pilot is not None:
            self._pilot.update_motion(distance_m, turned_rad, measured_ns)

    def update_range(self, name: str, range_m: float, now_ns: int) -> None:
        """Take a sonar's range, as on its topic: inf = no echo, −inf = too near, NaN = nonsense. See ``obstacle_stop``.
        """
        self._obstacles.update_range(name, range_m, now_ns)
        if name in self._ranges:
            self._ranges[name].update(range_m, now_ns)

    def step(self, now_ns: int, refusal: str) -> Step:
        """Return what to ask for now. Call it 20 to 100 times a second; it takes 0.1 to 3 ms on a PC.

        Args:
            refusal: why turn_arb and throttle_arb don't obey the planner, nor would if something were asked for, in
                their own words; empty: the autonomous deadman is held, no e-stop, armed.
        """
        since_ns = self._tick(now_ns)
        if self._end:
            return Step(None, 0.0, DONE, self._end)
        trouble = self._trouble(refusal, now_ns)
        self._drives = not trouble
        if trouble:
            if self._pilot is not None:
                self._pilot.pause()
            return Step(None, 0.0, WAITING if self._pilot is None else PAUSED, trouble)
        if self._pilot is None:
            outline, radius_m = self.config.obstacles.outline, self.config.radius_m
            middle = moved(self.motion.pose, (outline.front_m - outline.rear_m) / 2, 0.0)
            area = Area(middle[:2], radius_m - MARGIN_M, outline, radius_m)
            self._pilot = Pilot(self, Outlook(self, area, self._obstacles, self._stops))
        if self._pilot.turns_wrongly:
            self._end = (f"servo_left {self.base.servo_left} turns right: exchange servo_left and servo_right in "
                         "turn_arb's file, and begin again")
        if self._is_over(since_ns):
            return Step(None, 0.0, DONE, self._end)
        return self._pilot.step(self._duty.value, now_ns)

    def _trouble(self, refusal, now_ns):
        """Return why it can't drive now; empty: it can."""
        silence = self._silence(now_ns)
        if silence:
            return silence
        for timed in self._ranges.values():
            if timed.is_stale(now_ns) or math.isnan(timed.value):
                why = timed.stale_reason(now_ns) if timed.is_stale(now_ns) else f"{timed.name} measures nonsense"
                return f"{why}, and the car doesn't drive blind"
        verb = "begins" if self._pilot is None else "goes on"
        return refusal and f"{refusal}; hold the autonomous deadman and it {verb}"

    def picture(self) -> tuple[tuple[float, float] | None, list[tuple[float, float]]]:
        """Return the area's center and the path, as Survey; none before the button was first held."""
        return super().picture() if self._pilot is None else (self._pilot.outlook.area.center, self._pilot.path())


class StickGuide(Survey):
    """The same drive by hand: it tells a person who steers with the stick where to hold it, and for how long still.

    The person keeps the car away from walls, and slow; nothing is published. A stick is never held exactly where it is
    asked: what counts is a position that is held still near it. One that is held still somewhere else is evidence, too:
    the fit takes all of it.
    """

    OF_DRIVING = " of driving"

    def __init__(self, base: SteeringCalibration, config: CalibrationDriveConfig):
        super().__init__(base, config)
        self._target: Candidate | None = None
        self._low_duty = self._high_duty = math.nan  # between which the stick is held, and since when
        self._still_ns = 0
        self._length_m = self._turned_rad = 0.0  # while it was held
        self._passed = False  # the stick came from the side that was asked for

    def _update_motion(self, distance_m, turned_rad, measured_ns, now_ns):
        if self._is_held(now_ns) and abs(self.motion.speed_mps) >= MIN_SPEED_MPS:
            self._length_m += abs(distance_m)
            self._turned_rad += turned_rad * (1 if distance_m > 0 else -1)

    def update_duty(self, duty: float, now_ns: int) -> None:
        """Take a duty, as CalibrationDrive does: it shows where the stick is."""
        super().update_duty(duty, now_ns)
        low_duty, high_duty = min(self._low_duty, duty), max(self._high_duty, duty)  # NaN stays
        if high_duty - low_duty <= MAX_WANDER_DUTY:  # as the fit takes a segment: a thumb is on two counts
            self._low_duty, self._high_duty = low_duty, high_duty
        else:
            self._note()
            self._low_duty, self._high_duty, self._still_ns = duty, duty, now_ns
        if self._target is not None and (duty - self._target.duty) * self._target.from_side >= NEAR_DUTY:
            self._passed = True

    def step(self, now_ns: int, refusal: str) -> Step:
        """Return what to do now; 10 times a second and more.

        Args:
            refusal: why turn_arb doesn't obey the stick, in its own words; empty: the manual deadman is held.
        """
        since_ns = self._tick(now_ns)
        moves = not self._odom.is_stale(now_ns) and abs(self.motion.speed_mps) >= MIN_SPEED_MPS
        if self._is_over(since_ns if moves else 0):
            return Step(0.0, 0.0, DONE, self._end, held=self._held_steering())
        if self._target is None or self._is_held(now_ns) and self._length_m >= HOLD_M:
            self._note()
            self._target, self._passed = self.positions.candidates()[0], False  # of which least is known
        steering = self.positions.steering(self._target.duty)
        return Step(steering, 0.0, *self._guidance(steering, moves, refusal, now_ns), self._target.duty,
                    self._held_steering())

    def _guidance(self, steering, moves, refusal, now_ns):
        """Return (the phase, what the person has to do now)."""
        silence = self._silence(now_ns)
        if silence:
            return PAUSED, f"it waits: {silence}"
        target, where, speed_mps = self._target, steering_text(steering), abs(self.motion.speed_mps)
        if not moves:
            return PAUSED, (f"{refusal}; hold the manual deadman" if refusal else
                            f"drive slowly, about 1 m/s, with the stick at {where}")
        if abs(self.motion.curvature_per_m() or 0.0) * speed_mps ** 2 > MAX_LATERAL_MPS2:
            return PAUSED, "slower: at this speed tyres may slide"
        if self._is_held(now_ns):
            left_s = max(0.0, HOLD_M - self._length_m) / max(MIN_SPEED_MPS, speed_mps)
            return MEASURING, f"hold {where}: {left_s:.0f} s more at this speed"
        if target.from_side and not self._passed and abs(steering) < 1:
            past = steering_text(self.positions.steering(target.duty + target.from_side * 80))
            return SETTLING, f"push to {past} first, then come back to {where}"
        return SETTLING, f"hold the stick still at {where}"

    def _is_held(self, now_ns):
        """Return whether the stick is held still at the position, come to from the right side, and the servo has
        followed.
        """
        target = self._target
        return (target is not None and abs((self._low_duty + self._high_duty) / 2 - target.duty) <= NEAR_DUTY
                and (self._passed or not target.from_side or target.duty in self.ends)
                and now_ns - self._still_ns >= SETTLE_NS)

    def _note(self):
        """Note what was held, if it was enough."""
        if self._target is not None and self._length_m >= LEAST_COUNTED_M:
            self.positions.add(Measured(self._target.duty, self._target.from_side or 1,
                                        self._turned_rad / self._length_m))
        self._length_m = self._turned_rad = 0.0

    def _held_steering(self):
        return math.nan if self._duty.value is None else self.positions.steering(self._duty.value)
