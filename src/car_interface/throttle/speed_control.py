"""Turn a requested speed into an acceleration for the converter, whose inverse map is the feed-forward.

``SpeedControl.step`` takes a planner's request, and uses the speed by odometry and throttle_arb's state; it returns a
``SpeedCommand``. Limits of acceleration and jerk make a reference speed of the request (``SpeedReference``). The
reference's acceleration is fed forward, and a small PI controller on the measured speed corrects the errors of map,
battery and slope. It doesn't wind up: while somebody else drives, or the ESC can't follow (ESC_WAITS), it starts over
at the measured speed, and while a limit cuts the command the integral stays.

The direction changes at standstill only: until then the gear stays, and the car brakes. Pure: ``now_ns`` is passed in.
"""
from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

from car_interface.common import causes, declared
from car_interface.common.measured_speed import MAX_SPEED_MPS, MeasuredSpeed
from car_interface.common.sources import PLANNER
from car_interface.common.staleness import TimedInput
from car_interface.common.units import NS_PER_S
from car_interface.planner.messages import PlannerRequest
from car_interface.throttle.arbiter import COAST_GEAR
from car_interface.throttle.esc_intention import DRIVE, REVERSE_GEAR
from car_interface.throttle.esc_motion import STANDSTILL_MPS

MIN_MAX_SPEED_MPS = 0.2  # twice STANDSTILL_MPS: no car of this kind holds a lower speed
MAX_STEP_S = 0.1  # a step of a delayed node counts as no longer than this, so that the speed doesn't jump
THROTTLE_TIMEOUT_S = 0.5  # five periods of throttle_arb's state, which comes at 10 Hz
HOLD_MPS2 = 1.5  # the brake at standstill, as Autoware's −1.5 m/s²; the ESC's rules keep it from reversing
STALL_NS = 2_000_000_000
RUNAWAY_MPS, RUNAWAY_NS = 0.3, 1_000_000_000
ROLLS_BY_ITSELF = "downhill, and its ESC isn't certain to brake it, or something else pushes it"
# A start takes at least this long: odometry sees nothing of the first 4 cm, and a wrong map makes the car too fast.
START_S = 0.5
# Odometry shows the reference of DELAY_NS ago, and of DELAY_M before here (two pulses of 1.5 cm); but none older than
# MAX_DELAY_NS, or a stop would never show.
DELAY_NS, DELAY_M, MAX_DELAY_NS = 60_000_000, 0.03, 300_000_000
# The lag with which a motor follows; 0.02 to 0.15 s in test/rooms. What the motor hasn't done yet is no error: without
# this the speed overshot by up to 30 % at a lag of 0.1 s.
MOTOR_LAG_S = 0.1
# What the ESC gets is cut if it is less than the request by more than this: two of the board's counts (0.01 each).
CUT = 0.02
# The ESC is on its way to the request, or can't follow it: the car doesn't move by the request.
ESC_WAITS = frozenset({causes.ESC_ARMING, causes.ESC_MOTION, causes.REVERSE_PENDING, causes.REVERSE_REFUSED})
# The ESC gets neutral instead of a brake that could become reverse.
ESC_COASTS = frozenset({causes.BRAKE_UNCERTAIN, causes.AT_STANDSTILL})


@dataclass(frozen=True)
class SpeedControlConfig:
    """Configure the limits and gains of the speed control."""

    max_speed_mps: float = declared.number(
        "max_speed", 3.0, "a faster request is cut to this, forward and backward", "m/s", low=MIN_MAX_SPEED_MPS,
        high=MAX_SPEED_MPS)
    max_acceleration_mps2: float = declared.number(
        "max_acceleration", 2.0, "limit of what is asked for", "m/s²", low=0.1, high=15.0)
    max_braking_mps2: float = declared.number(
        "max_braking", 3.0, "limit of what is asked for", "m/s²", low=0.1, high=15.0)
    max_jerk_mps3: float = declared.number(
        "max_jerk", 20.0, "limit of how quickly that changes", "m/s³", low=0.5, high=1000.0)
    speed_p: float = declared.number(
        "speed_p", 4.0, "of the speed control: m/s² for each m/s of error", low=0.0, high=20.0)
    speed_i: float = declared.number(
        "speed_i", 3.0, "and for each m/s of error in a second", low=0.0, high=20.0)
    max_correction_mps2: float = declared.number("max_correction", 2.0, "limit of both", "m/s²", low=0, high=10)
    odometry_timeout_s: float = declared.number(
        "odometry_timeout", 0.5, "an older speed is unknown: the car stops, the steering goes on", "s", low=0.05,
        high=0.5)


STOP = PlannerRequest(None, 0.0)


class SpeedCommand(NamedTuple):
    """A command for the converter and throttle_arb.

    Attributes:
        acceleration_mps2: along the car's forward axis.
        reference_mps: the speed that the car should have now, backward negative.
        gear: ``drive``, ``reverse`` or ``neutral``, as throttle_arb takes it.
        is_known: the speed is known; else the car has to stop.
        note: differences from the request, in words; empty = none.
    """

    acceleration_mps2: float
    reference_mps: float
    gear: str
    is_known: bool
    note: str


class _Throttle(NamedTuple):
    """The part of throttle_arb's state that the speed control needs."""

    is_ours: bool
    waits: bool
    holds_back: int  # 1: less forward than asked, −1: less backward or brake, 0: neither


class _Past(NamedTuple):
    at_ns: int
    distance_m: float  # by the references
    speed_mps: float


class SpeedReference:
    """Lead a speed to a target, within limits of acceleration, braking and jerk.

    Attributes:
        speed_mps: the present speed, 0 or more.
        acceleration_mps2: the present acceleration; negative = it slows down.
    """

    def __init__(self):
        self.speed_mps = self.acceleration_mps2 = 0.0

    def reset(self, speed_mps: float) -> None:
        """Start over at a speed, without acceleration."""
        self.speed_mps, self.acceleration_mps2 = max(0.0, speed_mps), 0.0

    def step(self, target_mps: float, max_acceleration_mps2: float, max_braking_mps2: float, max_jerk_mps3: float,
             dt_s: float) -> None:
        """Move on by ``dt_s`` towards a target of 0 or more, without overshooting it.

        Near the target the acceleration falls early enough to keep the limit of the jerk j: while an acceleration a
        falls to 0 in steps of j·dt, the speed still changes by a² / 2j + a·dt / 2.
        """
        if dt_s <= 0:
            return
        gap_mps = target_mps - self.speed_mps
        limit_mps2 = max_acceleration_mps2 if gap_mps > 0 else max_braking_mps2
        step_mps2 = max_jerk_mps3 * dt_s
        falling_mps2 = math.sqrt((step_mps2 / 2) ** 2 + 2 * max_jerk_mps3 * abs(gap_mps)) - step_mps2 / 2
        wanted_mps2 = math.copysign(min(limit_mps2, falling_mps2), gap_mps)
        self.acceleration_mps2 += max(-step_mps2, min(step_mps2, wanted_mps2 - self.acceleration_mps2))
        speed_mps = self.speed_mps + self.acceleration_mps2 * dt_s
        if (target_mps - speed_mps) * gap_mps <= 0 or speed_mps < 0:
            self.speed_mps, self.acceleration_mps2 = target_mps, 0.0
        else:
            self.speed_mps = speed_mps


class SpeedControl:
    """Control one car's speed.

    Attributes:
        speed: takes odometry's.
    """

    def __init__(self, config: SpeedControlConfig = SpeedControlConfig()):
        self._config = config
        self.speed = MeasuredSpeed(config.odometry_timeout_s, "odometry")
        self._throttle = TimedInput("throttle_arb's state", THROTTLE_TIMEOUT_S)
        self._reference = SpeedReference()
        self._integral_mps2 = 0.0
        self._gear = DRIVE
        self._stepped_ns: int | None = None
        self._since_ns: dict[str, int] = {}  # since when what a note tells holds
        self._was_known = False  # whether the speed was, at the last step
        self._driven_mps = 0.0  # the reference, delayed by the motor's lag
        self._past: deque = deque()  # from the reference that odometry shows now up to the newest

    def update_throttle(self, source: int, asked: float, granted: float, esc_cause: str, now_ns: int) -> None:
        """Take throttle_arb's state: who drives, the request, what the ESC gets, and the cause of the ESC's state."""
        cut = abs(asked) - abs(granted) > CUT and (granted or esc_cause != causes.NO_THROTTLE)
        holds_back = int(math.copysign(1, asked)) if cut or esc_cause in ESC_COASTS else 0
        self._throttle.update(_Throttle(source == PLANNER, esc_cause in ESC_WAITS, holds_back), now_ns)

    def mark_stale(self) -> None:
        """Treat all inputs as stale, since messages were dropped on their way here."""
        self.speed.mark_stale()
        self._throttle.mark_stale()

    def step(self, request: PlannerRequest, now_ns: int) -> SpeedCommand:
        """Return the command from ``now_ns`` on. Call it at 20 Hz at least."""
        dt_s = 0.0 if self._stepped_ns is None else (now_ns - self._stepped_ns) / NS_PER_S
        self._stepped_ns = now_ns
        if self.speed.is_stale(now_ns):
            self._was_known = False
            return SpeedCommand(-self._sign * self._config.max_braking_mps2, 0.0, self._gear, False,
                                self.speed.stale_reason(now_ns))
        target_mps, notes = self._target(request)
        speed_mps = self._sign * self.speed.value  # in the gear's direction
        if request.gear == COAST_GEAR or not self._was_known:
            self._begin_anew(speed_mps)
        self._was_known = True
        if request.gear == COAST_GEAR:
            return SpeedCommand(0.0, self.speed.value, COAST_GEAR, True, "")
        acceleration_mps2 = self._follow(request, target_mps, speed_mps, max(0.0, min(dt_s, MAX_STEP_S)), now_ns)
        notes += self._notes(speed_mps, now_ns)
        return SpeedCommand(self._sign * acceleration_mps2, self._sign * self._reference.speed_mps, self._gear, True,
                            "; ".join(notes))

    @property
    def _sign(self):
        return -1.0 if self._gear == REVERSE_GEAR else 1.0

    def _begin_anew(self, speed_mps):
        self._reference.reset(speed_mps)
        self._driven_mps = self._reference.speed_mps
        self._integral_mps2 = 0.0
        self._past.clear()

    def _target(self, request):
        """Return (the speed to reach in the gear's direction, notes). Change the gear, if the car stands."""
        notes = []
        wanted_mps = request.speed_mps
        if abs(wanted_mps) > self._config.max_speed_mps:
            notes.append(f"{abs(wanted_mps):.2f} m/s is above max_speed {self._config.max_speed_mps:g} m/s")
            wanted_mps = math.copysign(self._config.max_speed_mps, wanted_mps)
        elif 0 < abs(wanted_mps) < STANDSTILL_MPS:
            notes.append(f"{abs(wanted_mps):.2f} m/s is below {STANDSTILL_MPS:g} m/s, which counts as standstill")
            wanted_mps = 0.0
        gear = self._wanted_gear(request, wanted_mps)
        if gear != self._gear:
            if abs(self.speed.value) >= STANDSTILL_MPS:
                notes.append(f"it stops before {gear.upper()}: it rolls at {self.speed.value:.2f} m/s")
                return 0.0, notes
            self._gear = gear
            self._begin_anew(0.0)
        return abs(wanted_mps), notes

    def _notes(self, speed_mps, now_ns):
        """Return notes on a car that should have moved for STALL_NS and hasn't, or is too fast for RUNAWAY_NS."""
        notes, reference_mps = [], self._reference.speed_mps
        if self._lasts("stall", reference_mps < STANDSTILL_MPS or abs(speed_mps) >= STANDSTILL_MPS, STALL_NS, now_ns):
            notes.append(f"it doesn't move at {reference_mps:.2f} m/s: too slow for this car, or it is held")
        if self._lasts("runaway", speed_mps <= reference_mps + RUNAWAY_MPS, RUNAWAY_NS, now_ns):
            notes.append(f"it rolls at {speed_mps:.2f} m/s instead of {reference_mps:.2f}: {ROLLS_BY_ITSELF}")
        return notes

    def _lasts(self, what, is_over, for_ns, now_ns):
        """Return whether something has lasted for a time; it begins anew once it is over."""
        if is_over:
            self._since_ns.pop(what, None)
            return False
        return now_ns - self._since_ns.setdefault(what, now_ns) >= for_ns

    def _wanted_gear(self, request, wanted_mps):
        if request.gear in (DRIVE, REVERSE_GEAR):
            return request.gear
        if not wanted_mps:
            return self._gear
        return DRIVE if wanted_mps > 0 else REVERSE_GEAR

    def _follow(self, request, target_mps, speed_mps, dt_s, now_ns):
        """Return the acceleration in the gear's direction: feed-forward and correction, or the hold at standstill."""
        config = self._config
        throttle = self._newest_throttle(now_ns)
        if not throttle.is_ours or throttle.waits:
            self._begin_anew(speed_mps)
        self._step_reference(request, target_mps, dt_s)
        if not target_mps and abs(speed_mps) < STANDSTILL_MPS:
            self._begin_anew(0.0)
            return -HOLD_MPS2
        if throttle.waits:
            return HOLD_MPS2  # a clear pull until the ESC is in reverse
        correction_mps2 = self._correction(self._seen_reference_mps(dt_s, now_ns) - speed_mps, throttle, dt_s)
        asked_mps2 = self._reference.acceleration_mps2 + correction_mps2
        if request.braking_mps2:
            asked_mps2 = min(asked_mps2, -min(request.braking_mps2, config.max_braking_mps2))
        return asked_mps2

    def _step_reference(self, request, target_mps, dt_s):
        """Move the reference towards the target within the request's limits and the configured ones."""
        config = self._config
        jerk_mps3 = min(request.jerk_mps3 or math.inf, config.max_jerk_mps3)
        acceleration_mps2 = min(request.acceleration_mps2 or math.inf, config.max_acceleration_mps2,
                                target_mps / START_S) or config.max_acceleration_mps2
        braking_mps2 = min(max(request.acceleration_mps2 or math.inf, request.braking_mps2), config.max_braking_mps2)
        self._reference.step(target_mps, acceleration_mps2, braking_mps2, jerk_mps3, dt_s)

    def _newest_throttle(self, now_ns):
        if not self._throttle.was_received:
            return _Throttle(True, False, 0)  # another node drives the ESC by the values
        return _Throttle(False, False, 0) if self._throttle.is_stale(now_ns) else self._throttle.value

    def _seen_reference_mps(self, dt_s, now_ns):
        """Return the reference that odometry can show by now: a newer one would look like an error."""
        self._driven_mps += (self._reference.speed_mps - self._driven_mps) * -math.expm1(-dt_s / MOTOR_LAG_S)
        past, speed_mps = self._past, self._driven_mps
        distance_m = past[-1].distance_m if past else 0.0
        past.append(_Past(now_ns, distance_m + speed_mps * dt_s, speed_mps))
        until_ns, until_m = now_ns - DELAY_NS, past[-1].distance_m - DELAY_M
        surely_ns = now_ns - MAX_DELAY_NS
        while len(past) > 1 and (past[1].at_ns <= surely_ns
                                 or past[1].at_ns <= until_ns and past[1].distance_m <= until_m):
            past.popleft()
        return past[0].speed_mps

    def _correction(self, error_mps, throttle, dt_s):
        """Return P and I of the error; the integral stays while a limit cuts in that direction."""
        config = self._config
        limit_mps2 = config.max_correction_mps2
        integral_mps2 = self._integral_mps2 + config.speed_i * error_mps * dt_s
        wanted_mps2 = config.speed_p * error_mps + integral_mps2
        is_cut = throttle.holds_back * self._sign * error_mps > 0
        if not is_cut and (abs(wanted_mps2) <= limit_mps2 or wanted_mps2 * error_mps < 0):
            self._integral_mps2 = max(-limit_mps2, min(limit_mps2, integral_mps2))
        return max(-limit_mps2, min(limit_mps2, config.speed_p * error_mps + self._integral_mps2))
