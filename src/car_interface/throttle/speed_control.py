"""A speed that is asked for → an acceleration for the converter, whose inverse map is the feed-forward.

Consumes requests, the speed by odometry and throttle_arb's state, each at its arrival. The request passes the limits of
acceleration and jerk; what they make of it is fed forward, and a small PI on the measured speed corrects what map,
battery and slope make wrong. It doesn't wind up: while somebody else drives it begins anew at the measured speed, and
while the ESC waits or a limit cuts the integral stays.

The direction changes at standstill only: until then the gear stays, and the car brakes. Pure: ``now_ns`` is passed in.
"""
from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

from car_interface.common import causes, declared
from car_interface.common.measured_speed import MAX_SPEED_MPS
from car_interface.common.staleness import TimedInput
from car_interface.common.units import NS_PER_S
from car_interface.steering.arbiter import PLANNER
from car_interface.throttle.arbiter import COAST_GEAR
from car_interface.throttle.esc_intention import DRIVE, REVERSE_GEAR
from car_interface.throttle.esc_motion import STANDSTILL_MPS
from car_interface.throttle.speed_reference import SpeedReference

MIN_MAX_SPEED_MPS = 0.2  # 0.1 m/s counts as standstill, and no car of this kind holds less than twice that
MAX_STEP_S = 0.1  # the longest time that one step counts, so that a delayed node makes no jump
THROTTLE_TIMEOUT_S = 0.5  # throttle_arb's state comes 10 times a second
HOLD_MPS2 = 1.5  # brakes at standstill, as Autoware does; the ESC's rules see to it that this doesn't reverse
STALL_NS = 2_000_000_000
RUNAWAY_MPS, RUNAWAY_NS = 0.3, 1_000_000_000
ROLLS_BY_ITSELF = "downhill, and its ESC isn't certain to brake it, or something else pushes it"
# The least that a start takes: odometry sees nothing for the first 4 cm, and a wrong map makes the car too fast.
START_S = 0.5
# Odometry is this old, and sees a speed only after two pulses; but no later than that, or a stop would never be seen.
DELAY_NS, DELAY_M, MAX_DELAY_NS = 60_000_000, 0.03, 300_000_000
# With which a motor follows: 0.02 to 0.15 s. What it hasn't done yet is no error that more of it would mend.
MOTOR_LAG_S = 0.1
# What the ESC gets differs from what is asked by no more than this unless something cuts it: a count of the board.
CUT = 0.02
# The ESC is on its way to what is asked, or can't do it: the car doesn't move by what is asked meanwhile.
ESC_WAITS = frozenset({causes.ESC_ARMING, causes.ESC_MOTION, causes.REVERSE_PENDING, causes.REVERSE_REFUSED})
# It leaves out a brake that could become reverse.
ESC_COASTS = frozenset({causes.BRAKE_UNCERTAIN, causes.AT_STANDSTILL})


@dataclass(frozen=True)
class SpeedControlConfig:
    """Limits and gains."""

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


class SpeedRequest(NamedTuple):
    """What is asked for.

    Attributes:
        speed_mps: backward negative; finite.
        acceleration_mps2, jerk_mps3: how quickly, within the limits; 0 = as quickly as they allow.
        braking_mps2: brake with at least this, whatever the speed; 0 = by the speed alone.
        gear: ``drive``, ``reverse``, ``neutral`` (coast), ``park``; ``None`` = by the sign of the speed.
    """

    speed_mps: float
    acceleration_mps2: float = 0.0
    jerk_mps3: float = 0.0
    braking_mps2: float = 0.0
    gear: str | None = None


STOP = SpeedRequest(0.0)


class SpeedCommand(NamedTuple):
    """What the car is to do.

    Attributes:
        acceleration_mps2: along the car's forward axis.
        reference_mps: the speed that it should have now, backward negative.
        gear: ``drive``, ``reverse`` or ``neutral``, as throttle_arb takes it.
        is_known: the speed is known; else the car is to stop.
        note: in words, what differs from the request; empty = nothing.
    """

    acceleration_mps2: float
    reference_mps: float
    gear: str
    is_known: bool
    note: str


class _Throttle(NamedTuple):
    """What throttle_arb says."""

    is_ours: bool
    waits: bool
    holds_back: int  # 1: less forward than asked, −1: less backward or brake, 0: neither


class _Past(NamedTuple):
    at_ns: int
    distance_m: float  # by the references
    speed_mps: float


class SpeedControl:
    """Follows the newest request."""

    def __init__(self, config: SpeedControlConfig = SpeedControlConfig()):
        self._config = config
        self._speed = TimedInput("odometry", config.odometry_timeout_s)
        self._throttle = TimedInput("throttle_arb's state", THROTTLE_TIMEOUT_S)
        self._reference = SpeedReference()
        self._integral_mps2 = 0.0
        self._gear = DRIVE
        self._stepped_ns: int | None = None
        self._stalled_ns: int | None = None  # since when it should move and doesn't
        self._too_fast_ns: int | None = None  # since when it rolls faster than it should
        self._was_known = False  # the speed, at the last step
        self._driven_mps = 0.0  # the reference as a motor with a lag follows it
        self._past: deque = deque()  # what odometry can have seen by now, and all references since

    def update_odometry(self, speed_mps: float, now_ns: int, age_ns: int = 0) -> None:
        """The car's speed, forward positive, and its age at arrival; one that no car has, or no number, is unknown."""
        if abs(speed_mps) <= MAX_SPEED_MPS:  # not for NaN
            self._speed.update(speed_mps, now_ns, age_ns)
        else:
            self._speed.mark_stale(f"it was {speed_mps}")

    def update_throttle(self, source: int, asked: float, granted: float, esc_cause: str, now_ns: int) -> None:
        """throttle_arb's state: who drives, the request, what the ESC gets of it, and the cause of the ESC's state."""
        cut = abs(asked) - abs(granted) > CUT and (granted or esc_cause != causes.NO_THROTTLE)
        holds_back = int(math.copysign(1, asked)) if cut or esc_cause in ESC_COASTS else 0
        self._throttle.update(_Throttle(source == PLANNER, esc_cause in ESC_WAITS, holds_back), now_ns)

    def mark_stale(self) -> None:
        """Messages were dropped before they got here: nothing is known."""
        self._speed.mark_stale()
        self._throttle.mark_stale()

    def odometry_age_s(self, now_ns: int) -> float:
        """Seconds since the last odometry; inf = never received."""
        return self._speed.age_s(now_ns)

    @property
    def max_braking_mps2(self) -> float:
        """The limit of braking."""
        return self._config.max_braking_mps2

    @property
    def measured_mps(self) -> float:
        """The newest speed; NaN = none."""
        return math.nan if self._speed.value is None else self._speed.value

    def step(self, request: SpeedRequest, now_ns: int) -> SpeedCommand:
        """What the car is to do from ``now_ns`` on. Call it at 20 Hz at least."""
        dt_s = 0.0 if self._stepped_ns is None else (now_ns - self._stepped_ns) / NS_PER_S
        self._stepped_ns = now_ns
        if self._speed.is_stale(now_ns):
            self._was_known = False
            return SpeedCommand(-self._sign * self._config.max_braking_mps2, 0.0, self._gear, False,
                                self._speed.stale_reason(now_ns))
        target_mps, notes = self._target(request)
        speed_mps = self._sign * self._speed.value  # in the gear's direction
        if request.gear == COAST_GEAR or not self._was_known:
            self._begin_anew(speed_mps)
        self._was_known = True
        if request.gear == COAST_GEAR:
            return SpeedCommand(0.0, self._speed.value, COAST_GEAR, True, "")
        acceleration_mps2 = self._follow(request, target_mps, speed_mps, max(0.0, min(dt_s, MAX_STEP_S)), now_ns)
        notes += self._stall(speed_mps, now_ns) + self._runaway(speed_mps, now_ns)
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
        """(the speed to reach in the gear's direction, what differs from the request). Changes gear at standstill."""
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
            if abs(self._speed.value) >= STANDSTILL_MPS:
                notes.append(f"it stops before {gear.upper()}: it rolls at {self._speed.value:.2f} m/s")
                return 0.0, notes
            self._gear = gear
            self._begin_anew(0.0)
        return abs(wanted_mps), notes

    def _stall(self, speed_mps, now_ns):
        """That the car should move for long and doesn't."""
        if self._reference.speed_mps < STANDSTILL_MPS or abs(speed_mps) >= STANDSTILL_MPS:
            self._stalled_ns = None
        elif self._stalled_ns is None:
            self._stalled_ns = now_ns
        elif now_ns - self._stalled_ns >= STALL_NS:
            return [f"it doesn't move at {self._reference.speed_mps:.2f} m/s: too slow for this car, or it is held"]
        return []

    def _runaway(self, speed_mps, now_ns):
        """That the car rolls faster than it should for long."""
        if speed_mps <= self._reference.speed_mps + RUNAWAY_MPS:
            self._too_fast_ns = None
        elif self._too_fast_ns is None:
            self._too_fast_ns = now_ns
        elif now_ns - self._too_fast_ns >= RUNAWAY_NS:
            return [f"it rolls at {speed_mps:.2f} m/s instead of {self._reference.speed_mps:.2f}: {ROLLS_BY_ITSELF}"]
        return []

    def _wanted_gear(self, request, wanted_mps):
        if request.gear in (DRIVE, REVERSE_GEAR):
            return request.gear
        if not wanted_mps:
            return self._gear
        return DRIVE if wanted_mps > 0 else REVERSE_GEAR

    def _follow(self, request, target_mps, speed_mps, dt_s, now_ns):
        """The acceleration in the gear's direction."""
        config = self._config
        throttle = self._heard_throttle(now_ns)
        if not throttle.is_ours or throttle.waits:
            self._begin_anew(speed_mps)
        jerk_mps3 = min(request.jerk_mps3 or math.inf, config.max_jerk_mps3)
        acceleration_mps2 = min(request.acceleration_mps2 or math.inf, config.max_acceleration_mps2,
                                target_mps / START_S) or config.max_acceleration_mps2
        braking_mps2 = min(max(request.acceleration_mps2 or math.inf, request.braking_mps2), config.max_braking_mps2)
        self._reference.step(target_mps, acceleration_mps2, braking_mps2, jerk_mps3, dt_s)
        if not target_mps and abs(speed_mps) < STANDSTILL_MPS:
            self._begin_anew(0.0)
            return -HOLD_MPS2
        if throttle.waits:
            return HOLD_MPS2  # a pull that the ESC takes for one, until it is in reverse
        correction_mps2 = self._correction(self._seen_reference_mps(dt_s, now_ns) - speed_mps, throttle, dt_s)
        asked_mps2 = self._reference.acceleration_mps2 + correction_mps2
        if request.braking_mps2:
            asked_mps2 = min(asked_mps2, -min(request.braking_mps2, config.max_braking_mps2))
        return asked_mps2

    def _heard_throttle(self, now_ns):
        if not self._throttle.was_received:
            return _Throttle(True, False, 0)  # somebody else converts the values to an ESC
        return _Throttle(False, False, 0) if self._throttle.is_stale(now_ns) else self._throttle.value

    def _seen_reference_mps(self, dt_s, now_ns):
        """The reference that odometry can have seen by now: later ones only look like an error."""
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
        """P and I on the error, which doesn't grow against what cuts it."""
        config = self._config
        limit_mps2 = config.max_correction_mps2
        integral_mps2 = self._integral_mps2 + config.speed_i * error_mps * dt_s
        wanted_mps2 = config.speed_p * error_mps + integral_mps2
        is_cut = throttle.holds_back * self._sign * error_mps > 0
        if not is_cut and (abs(wanted_mps2) <= limit_mps2 or wanted_mps2 * error_mps < 0):
            self._integral_mps2 = max(-limit_mps2, min(limit_mps2, integral_mps2))
        return max(-limit_mps2, min(limit_mps2, config.speed_p * error_mps + self._integral_mps2))
