"""Check whether the car turns as commanded: find a wrong calibration, a reversed servo, a bent linkage.

Consumes the commanded turn radius (by the steering's calibration), and speed and yaw rate by odometry, each as it
arrives; answers with a ``Judgement``.

It compares curvatures, 1 / radius, left positive, which are also defined for straight ahead. Yaw rate = speed ×
curvature, forward and in reverse. Pure: ``now_ns`` (monotonic) is passed in.
"""
from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

from car_interface.common.staleness import TimedInput
from car_interface.common.units import NS_PER_S

MIN_SPEED_MPS = 0.5  # below it nothing is judged
OFF_RATIO = 0.5  # tolerance of the driven radius, as a ratio of the commanded one
OFF_FOR_NS = 2 * NS_PER_S  # so long out of tolerance, at speed, is a warning
WRONG_SIDE_FOR_NS = NS_PER_S // 2  # so long turning to the other side is a warning
STRAIGHT_PER_M = 1 / 20.0  # a turn wider than 20 m is taken for straight ahead
GRIP_MPS2 = 4.0  # above this commanded lateral acceleration tyres may slide, and nothing is judged
SETTLING_NS = NS_PER_S // 2  # the servo may take so long after a change of command
TIMEOUT_S = 0.5  # command or motion older than this are stale, and the history is discarded
SLICE_NS = NS_PER_S // 10  # the resolution of the history: five reports of odometry at 50 Hz
ESTIMATE_NS = NS_PER_S // 2  # the window of the reported radius
SPEED_HYSTERESIS = 0.8  # judging stops below this ratio of MIN_SPEED_MPS
WARNING_HYSTERESIS = 0.8  # a warning ends when the error is below this ratio of the tolerance
# Uncertainty of the wheels' heading over any distance: one pulse of one wheel, 1.5 cm, on a track of 0.3 m.
HEADING_SIGMA_RAD = 0.05
LEFT, RIGHT, STRAIGHT = "left", "right", "straight on"
UNCALIBRATED = "steering calibration? Measure which duty drives"


class Judgement(NamedTuple):
    """Commanded and driven radius: left positive, right negative, inf = straight ahead, NaN = unknown."""

    commanded_m: float
    estimated_m: float  # over the last 0.5 s; unknown below MIN_SPEED_MPS
    warning: str  # empty: no fault is known


class _Slice(NamedTuple):
    """A tenth of a second at speed."""

    duration_ns: int
    distance_m: float  # negative in reverse
    yaw_rad: float
    min_per_m: float  # of the curvatures that were commanded in it
    max_per_m: float


class SteeringCheck:
    """Compare the driven curvature with the commanded one.

    The mean of the last OFF_FOR_NS, all of it at speed, is compared with the range of commands in that time and in
    SETTLING_NS before it: each curvature in that range is accepted. So a command that changes often has a larger
    tolerance, and a command that changes sides isn't judged.

    Left, right and straight ahead have a warning each. It stays, also while the car stands, until the mean on that side
    is within tolerance again.
    """

    def __init__(self):
        self._command = TimedInput("command", TIMEOUT_S)
        self._motion = TimedInput("motion", TIMEOUT_S)
        self._slices: deque = deque(maxlen=(OFF_FOR_NS + SETTLING_NS) // SLICE_NS + 1)
        self._since_ns: int | None = None  # start of the current slice; None: not at speed
        self._warnings: dict[str, str] = {}
        self._begin_slice(None)

    def update_command(self, radius_m: float, now_ns: int) -> None:
        """Take the commanded radius by the calibration: inf = straight ahead, NaN = unknown."""
        self._command.update(1 / radius_m if radius_m else math.nan, now_ns)
        self._extend_command_range(now_ns)

    def mark_stale(self) -> None:
        """Take note that messages were dropped before they got here: the motion is stale until the next one."""
        self._motion.mark_stale()

    def update_motion(self, speed_mps: float, yaw_rate_radps: float, now_ns: int) -> None:
        """Take speed and yaw rate by odometry, backward and right negative; the last values were valid until now."""
        before, was_stale = self._motion.value, self._motion.is_stale(now_ns)
        elapsed_ns = 0 if was_stale else round(self._motion.age_s(now_ns) * NS_PER_S)
        self._motion.update((speed_mps, yaw_rate_radps), now_ns)
        min_mps = MIN_SPEED_MPS * (1.0 if self._since_ns is None else SPEED_HYSTERESIS)
        has_reversed = before is not None and before[0] * speed_mps < 0
        if was_stale or has_reversed or not (abs(speed_mps) >= min_mps and math.isfinite(speed_mps * yaw_rate_radps)):
            self._slices.clear()
            self._begin_slice(None)
            return
        if self._since_ns is None:
            self._begin_slice(now_ns)
            return
        self._distance_m += before[0] * elapsed_ns / NS_PER_S
        self._yaw_rad += before[1] * elapsed_ns / NS_PER_S
        self._extend_command_range(now_ns)
        if now_ns - self._since_ns >= SLICE_NS:
            self._end_slice(now_ns)

    def judge(self, now_ns: int) -> Judgement:
        """Return commanded and driven radius at ``now_ns``, and the warnings."""
        commanded_per_m = math.nan if self._command.is_stale(now_ns) else self._command.value
        estimated_per_m = math.nan
        if not self._motion.is_stale(now_ns):
            driven = self._driven(ESTIMATE_NS)
            estimated_per_m = driven.yaw_rad / driven.distance_m if driven is not None else math.nan
        return Judgement(_radius_m(commanded_per_m), _radius_m(estimated_per_m), "; ".join(self._warnings.values()))

    def _begin_slice(self, now_ns):
        self._since_ns = now_ns
        self._distance_m = self._yaw_rad = 0.0
        self._min_per_m, self._max_per_m = math.inf, -math.inf
        if now_ns is not None:
            self._extend_command_range(now_ns)

    def _extend_command_range(self, now_ns):
        """Extend the slice's range of commands; a command that is stale, unknown or beyond grip makes it unbounded."""
        low_per_m = high_per_m = self._command.value
        if self._command.is_stale(now_ns) or math.isnan(low_per_m) or self._may_slide(low_per_m):
            low_per_m, high_per_m = -math.inf, math.inf
        self._min_per_m = min(self._min_per_m, low_per_m)
        self._max_per_m = max(self._max_per_m, high_per_m)

    def _may_slide(self, curvature_per_m):
        speed_mps = self._motion.value[0] if self._motion.was_received else 0.0
        return abs(curvature_per_m) * speed_mps * speed_mps > GRIP_MPS2

    def _end_slice(self, now_ns):
        self._slices.append(_Slice(now_ns - self._since_ns, self._distance_m, self._yaw_rad,
                                   self._min_per_m, self._max_per_m))
        self._begin_slice(now_ns)
        recent = self._driven(WRONG_SIDE_FOR_NS, SETTLING_NS)
        driven = self._driven(OFF_FOR_NS, SETTLING_NS)
        side = self._side(driven)
        if self._turns_to_the_wrong_side(recent):
            self._warn(self._side(recent), recent)
        elif side and not self._is_within(driven, 1.0):
            self._warn(side, driven)
        elif side and self._is_within(driven, WARNING_HYSTERESIS):
            self._warnings.pop(side, None)

    def _driven(self, window_ns, settling_ns=0):
        """Return a window's newest slices as one, with commands since ``settling_ns`` earlier; ``None``: too few."""
        duration_ns, distance_m, yaw_rad = 0, 0.0, 0.0
        min_per_m, max_per_m = math.inf, -math.inf
        for slice_ in reversed(self._slices):
            if duration_ns < window_ns:
                distance_m += slice_.distance_m
                yaw_rad += slice_.yaw_rad
            min_per_m = min(min_per_m, slice_.min_per_m)
            max_per_m = max(max_per_m, slice_.max_per_m)
            duration_ns += slice_.duration_ns
            if duration_ns >= window_ns + settling_ns:
                return _Slice(duration_ns, distance_m, yaw_rad, min_per_m, max_per_m)
        return None

    def _side(self, driven):
        """Return the commanded side; ``None``: unknown, or not one side."""
        if driven is None:
            return None
        if driven.min_per_m > STRAIGHT_PER_M:
            return LEFT
        if driven.max_per_m < -STRAIGHT_PER_M:
            return RIGHT
        straight = max(-driven.min_per_m, driven.max_per_m) <= STRAIGHT_PER_M
        return STRAIGHT if straight else None

    def _turns_to_the_wrong_side(self, driven):
        side = self._side(driven)
        if side not in (LEFT, RIGHT):
            return False
        other_side = -1 if side == LEFT else 1
        return other_side * driven.yaw_rad / driven.distance_m > STRAIGHT_PER_M + _sigma_per_m(driven)

    def _is_within(self, driven, strictness):
        """Return whether the driven curvature is within tolerance of the range of commands."""
        low, high, curvature = driven.min_per_m, driven.max_per_m, driven.yaw_rad / driven.distance_m
        if high < -STRAIGHT_PER_M:
            low, high, curvature = -high, -low, -curvature
        ratio, sigma_per_m = OFF_RATIO * strictness, _sigma_per_m(driven)
        margin_per_m = (STRAIGHT_PER_M + sigma_per_m) * strictness
        lower, upper = min(low, 0.0) - margin_per_m, max(high, 0.0) + margin_per_m
        if low > STRAIGHT_PER_M:
            # A radius that is larger by a ratio r is a curvature that is smaller by a factor 1 + r, and vice versa.
            wider = min(low / (1 + ratio), low - sigma_per_m)
            lower = wider if wider > STRAIGHT_PER_M else -margin_per_m  # any straight course is accepted
            upper = max(high / (1 - ratio), high + sigma_per_m)
        return lower <= curvature <= upper

    def _warn(self, side, driven):
        commanded = _curvature_text((driven.min_per_m + driven.max_per_m) / 2)
        went = _curvature_text(driven.yaw_rad / driven.distance_m)
        self._warnings[side] = f"commanded {commanded}, the car went {went}: " + (
            "steering calibration? See whether the servo, or the wheels' sensors, are the wrong way round"
            if self._turns_to_the_wrong_side(driven) else f"{UNCALIBRATED} {commanded}")


def _sigma_per_m(driven):
    """Return the uncertainty of a curvature by the wheels; it falls with the distance."""
    return HEADING_SIGMA_RAD / abs(driven.distance_m)


def _radius_m(curvature_per_m):
    return math.inf if curvature_per_m == 0 else 1 / curvature_per_m


def _curvature_text(curvature_per_m):
    """Return a curvature as text: ``left, 2.0 m``."""
    radius_m = _radius_m(curvature_per_m)
    return STRAIGHT if abs(radius_m) >= 1000 else f"{LEFT if radius_m > 0 else RIGHT}, {abs(radius_m):.1f} m"
