"""A car that drives its own steering calibration while a person holds a button and watches.

Consumes odometry, the duty that the servo board holds, six sonars' ranges and whether it may drive; answers with a
steering and a speed. Pure: ``now_ns`` is passed in. A node passes on what it hears and calls ``step`` 50 times a
second; in a second thread it has ``assess`` do what ``take_fit_task`` returns, and ``conclude`` once the step is DONE.
"""
from __future__ import annotations

import math

from car_interface.common.staleness import TimedInput
from car_interface.steering.calibration import SteeringCalibration
from car_interface.throttle.obstacle_stop import ObstacleStop
from car_interface.tools.calibration.drive.area import Area, moved
from car_interface.tools.calibration.drive.config import CalibrationDriveConfig
from car_interface.tools.calibration.drive.outlook import Outlook
from car_interface.tools.calibration.drive.pilot import Pilot
from car_interface.tools.calibration.drive.stops import Stops
from car_interface.tools.calibration.drive.survey import DONE, PAUSED, WAITING, Step, Survey

MARGIN_M = 0.12  # of the area, for odometry's drift and for what isn't known of the steering


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
        self._stops.update(distance_m, self.motion.speed_mps, self.motion.pose.yaw_rad, self._drives, measured_ns)
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
