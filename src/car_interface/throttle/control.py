"""Decide the duty that the ESC gets, from the newest message of each input.

``ThrottleControl.decide`` takes five steps, a module each:

1. ``arbiter``: e-stop, deadman, steering, board, mode, stick and planner say who drives and what is requested. An
   input that forbids to drive, is stale or not finite makes it a stop (``Arbitration.is_stop``).
2. ``obstacle_guard``: the sonars bound the speed, or demand a stop.
3. ``limits``: reduces the request to those bounds and to the configured limits; a stop passes unchanged.
4. ``esc``: turns the request into a fraction −1..1; no brake becomes reverse. A stop brakes where that is certain
   (``Esc._stop``); else it is neutral, and the car coasts.
5. ``calibration``: turns the fraction into the duty, which throttle_arb publishes for the ESC's channel.

``ThrottleDecision`` carries the result of each step with its cause and reason. Pure: ``now_ns`` is passed in.
"""
from __future__ import annotations

from typing import NamedTuple, Sequence

from car_interface.throttle.arbiter import PLANNER, Arbitration, ThrottleArbiter, ThrottleArbiterConfig
from car_interface.throttle.calibration import ThrottleCalibration
from car_interface.throttle.esc import FORWARD, REVERSE, Esc, EscDecision
from car_interface.throttle.esc_config import EscConfig
from car_interface.throttle.esc_intention import AUTO, Request
from car_interface.throttle.limits import Limited, ThrottleLimiter, ThrottleLimits
from car_interface.throttle.obstacle_guard import ObstacleGuard
from car_interface.throttle.obstacle_stop import ObstacleConfig, ObstacleStop

DRIVES = (FORWARD, REVERSE)


class ThrottleDecision(NamedTuple):
    """The duty for the ESC's channel, and the result of each step on the way to it."""

    duty: int
    arbitration: Arbitration
    esc: EscDecision
    mode: str
    scale: float
    limited: Limited  # what the limits granted

    @property
    def differs_by(self) -> tuple:
        """Return what makes two decisions differ: all but ages and the numbers in reasons, which change every time."""
        return (self.duty, self.arbitration.source, self.arbitration.cause, self.esc.state, self.esc.cause, self.mode,
                self.scale, self.limited.cause)

    @property
    def kind(self) -> tuple:
        """Return who drives and why, and the ESC's state and cause: the log reports a change of these."""
        return self.arbitration.source, self.arbitration.cause, self.esc.state, self.esc.cause


class ThrottleControl:
    """Decide one ESC's duty from the newest message of each input.

    Attributes:
        arbiter: takes e-stop, deadman, steering, teleop, mode, buttons and the converter's state directly.
        calibration: the ESC's; another one counts from the next call on.
        limiter: counts how often it began to cut a request.
    """

    def __init__(self, calibration: ThrottleCalibration, arbiter: ThrottleArbiterConfig, esc: EscConfig,
                 limits: ThrottleLimits | None = None, obstacles: ObstacleConfig | None = None):
        self.arbiter = ThrottleArbiter(arbiter)
        self.calibration = calibration
        self.esc_config, self._esc = esc, Esc(esc)
        self.limiter = ThrottleLimiter(limits or ThrottleLimits(), self._request_of_value)
        self._guard = None if obstacles is None else ObstacleGuard(ObstacleStop(obstacles), esc)
        self._turn_max_mps = self._curvature_per_m = 0.0

    def update_planner(self, value: float, now_ns: int) -> None:
        """Take the converter's value for the planner's command."""
        self.arbiter.update_planner(value, self.calibration.request_of_value(value), now_ns)

    def update_odometry(self, speed_mps: float, now_ns: int, age_ns: int, sigma_mps: float = 0.0) -> None:
        """Take the measured speed, forward positive, its age at arrival by its stamp (0 = unknown), and its
        standard deviation.
        """
        self.arbiter.update_odometry(speed_mps, now_ns, age_ns)
        self.limiter.speed.update(speed_mps, now_ns, age_ns)
        self._esc.update_speed(speed_mps, now_ns, age_ns, sigma_mps)
        if self._guard is not None:
            self._guard.slope.update_speed(speed_mps, now_ns - max(0, age_ns), self._curvature_per_m)

    def update_turn(self, radius_m: float, max_speed_mps: float) -> None:
        """Take the radius that turn_arb steers, and the speed up to which the requested turn keeps within its limit.

        The radius is left positive. Both are inf straight on; a speed of 0 = no limit.
        """
        self._curvature_per_m = 1.0 / radius_m if abs(radius_m) > 0 else 0.0  # also for NaN
        self._turn_max_mps = max_speed_mps if max_speed_mps > 0 else 0.0

    def update_range(self, sonar: str, range_m: float, now_ns: int) -> None:
        """Take a sonar's range; ``sonar`` is one of ``vehicle_geometry.SONARS``."""
        if self._guard is not None:
            self._guard.sonars.update_range(sonar, range_m, now_ns)

    def update_output(self, duties: Sequence[int], now_ns: int) -> None:
        """Take the 16 duties that the servo board holds, −1 = never set."""
        self.arbiter.update_output(duties, now_ns)
        self._esc.update_held(self.calibration.request_of_duty(duties[self.calibration.channel]), now_ns)

    def _request_of_value(self, value):
        return self.calibration.request_of_value(value)

    def mark_stale(self, now_ns: int) -> None:
        """Treat all inputs as stale, since messages were dropped on their way here."""
        self.arbiter.mark_stale(now_ns)
        self.limiter.speed.mark_stale()
        if self._guard is not None:
            self._guard.sonars.mark_stale()
        self._esc.mark_stale()

    def decide(self, now_ns: int) -> ThrottleDecision:
        """Return what the ESC gets from ``now_ns`` on. The rules remember earlier calls: call it at 20 Hz at least."""
        arbitration = self.arbiter.decide(now_ns)
        bound = self._guard and self._guard.check(arbitration, self.limiter.speed, self._curvature_per_m, now_ns)
        limited = self.limiter.limit(arbitration, self._esc.state == REVERSE, self._turn_max_mps, now_ns, bound)
        esc = self._step(limited, now_ns)
        if self._guard is not None:
            self._guard.update_esc(esc, now_ns)
        return ThrottleDecision(self.calibration.duty(esc.fraction), arbitration, esc, self.arbiter.mode,
                                self.arbiter.scale.value, limited)

    def _step(self, limited, now_ns):
        """Return the ESC's answer to what the limits granted.

        A stick has one scale for driving and one for braking, and only the ESC's rules know which of the two a pull is
        now. So they first get the request with the likely scale, and once more with the other if it turns out wrong.
        """
        # Without a mode the source is NEUTRAL while the stick is centered between two pulls, which are a human's.
        arbitration = limited.arbitration
        is_human = arbitration.source != PLANNER
        request = Request(arbitration.drive, arbitration.gear, is_human=is_human, is_stop=arbitration.is_stop,
                          is_centered=self.arbiter.is_centered(now_ns), is_released=self.arbiter.is_released(now_ns),
                          cruise_mps=arbitration.cruise_mps)
        is_as_it_is = self.esc_config.calibration_drive and arbitration.gear == AUTO
        if arbitration.drive == arbitration.brake or is_as_it_is:
            return self._esc.step(request, now_ns)  # one scale: a pull stays the same when the car stops
        pulls = arbitration.asked < 0 and self._esc.state != REVERSE
        answer = self._esc.step(request._replace(value=arbitration.brake) if pulls else request, now_ns)
        # The way into reverse may begin with neutral, so the state counts, too. By the driving scale the same pull may
        # be within the dead band, and no reverse at all.
        if (answer.fraction or answer.state == REVERSE) and (answer.state in DRIVES) == pulls:
            answer = self._esc.step(request._replace(value=arbitration.drive if pulls else arbitration.brake), now_ns)
        return answer
