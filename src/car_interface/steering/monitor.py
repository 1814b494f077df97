"""Whether the car turns as its steering was told to.

Consumes the turn radius that the steering's calibration has for what was commanded, and the speed and yaw rate that
the wheels make, each as it arrives; answers with a ``Judgement``. A calibration that is another car's, a servo that is
the wrong way round, a bent linkage: the wheels tell.

It compares curvatures, 1 / radius, left positive: a car that goes straight on has one, too. Yaw rate = speed ×
curvature, forward and in reverse. Pure: ``now_ns`` (monotonic) is passed in.
"""
from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

from car_interface.common.errors import ConfigError
from car_interface.common.staleness import TimedInput
from car_interface.common.units import NS_PER_S

SLICE_NS = NS_PER_S // 10  # of the history; what is asked of it is asked in multiples of this
ESTIMATE_S = 0.5  # the radius that is shown is over so long
SLOWER = 0.8  # at speed it stays until it's slower than this share of min_speed
CLEARLY = 0.8  # a warning ends when the curvature is inside this share of what it may be off by
# How far the wheels' heading may be off over any way: one pulse of one wheel, 1.5 cm, on a track of 0.3 m.
HEADING_RAD = 0.05
LEFT, RIGHT, STRAIGHT = "left", "right", "straight on"


@dataclass(frozen=True)
class SteeringCheckConfig:
    """When the steering is judged, and how strictly.

    Attributes:
        min_speed_mps: slower than this nothing is judged.
        off_ratio: the driven radius may differ from the commanded one by this share of it.
        off_for_s: for so long it must be off, at speed, to be worth a warning.
        wrong_way_for_s: for so long a car must turn to the other side.
        straight_m: a wider turn than this counts as straight on.
        grip_mps2: where speed and command ask for more to the side than this, tyres may slide: nothing is judged.
        settling_s: after a change of command the servo may take so long.
        timeout_s: command or motion silent for longer are lost; what was driven before doesn't count.

    Raises:
        ConfigError: when one of them isn't a number above 0, or the share isn't below 1.
    """

    min_speed_mps: float = 0.5
    off_ratio: float = 0.5
    off_for_s: float = 2.0
    wrong_way_for_s: float = 0.5
    straight_m: float = 20.0
    grip_mps2: float = 4.0
    settling_s: float = 0.5
    timeout_s: float = 0.5

    def __post_init__(self):
        for name, value in vars(self).items():
            if not 0 < value < math.inf:
                raise ConfigError(name, value, "a number above 0")
        if self.off_ratio >= 1:
            raise ConfigError("off_ratio", self.off_ratio, "a share below 1")


class Judgement(NamedTuple):
    """What was asked for, what came of it. Radii: left positive, right negative, inf = straight on, NaN = unknown."""

    commanded_m: float
    estimated_m: float  # over the last half second; unknown when slower than min_speed_mps
    warning: str  # empty: nothing is known to be wrong


class _Slice(NamedTuple):
    """A tenth of a second at speed."""

    duration_ns: int
    distance_m: float  # negative in reverse
    turned_rad: float
    lowest_per_m: float  # of the curvatures that were commanded in it
    highest_per_m: float


class SteeringCheck:
    """Holds the driven curvature against the commanded one.

    The mean of the last ``off_for_s``, all of it at speed, is held against all that was commanded in that time and in
    the ``settling_s`` before it: the car may have done any of that, or what lies between. So a command that changes all
    the time is judged more mildly, one that changes sides not at all, and a servo on its way neither.

    Left, right and straight on have a warning each. It stays, standing and stopping included, until the mean is clearly
    right where it was wrong.
    """

    def __init__(self, config: SteeringCheckConfig = SteeringCheckConfig()):
        self._config = config
        self._straight_per_m = 1 / config.straight_m
        self._off_for_ns = round(config.off_for_s * NS_PER_S)
        self._wrong_way_for_ns = round(config.wrong_way_for_s * NS_PER_S)
        self._settling_ns = round(config.settling_s * NS_PER_S)
        self._command = TimedInput("command", config.timeout_s)
        self._motion = TimedInput("motion", config.timeout_s)
        max_ns = max(self._off_for_ns, self._wrong_way_for_ns) + self._settling_ns
        self._slices: deque = deque(maxlen=math.ceil(max_ns / SLICE_NS) + 1)
        self._since_ns: int | None = None  # of the slice under way; None: not at speed
        self._warnings: dict[str, str] = {}
        self._begin_slice(None)

    def update_command(self, radius_m: float, now_ns: int) -> None:
        """What the steering is commanded to: the calibration's radius, inf = straight on, NaN = unknown."""
        self._command.update(1 / radius_m if radius_m else math.nan, now_ns)
        self._take_command(now_ns)

    def mark_stale(self) -> None:
        """Messages were dropped before they got here: the command is lost."""
        self._command.mark_stale()

    def update_motion(self, speed_mps: float, yaw_rate_radps: float, now_ns: int) -> None:
        """What the wheels make, backward and to the right negative. What it said before held until now."""
        before, was_stale = self._motion.value, self._motion.is_stale(now_ns)
        passed_ns = 0 if was_stale else round(self._motion.age_s(now_ns) * NS_PER_S)
        self._motion.update((speed_mps, yaw_rate_radps), now_ns)
        min_mps = self._config.min_speed_mps * (1.0 if self._since_ns is None else SLOWER)
        reversed_ = before is not None and before[0] * speed_mps < 0
        if was_stale or reversed_ or not (abs(speed_mps) >= min_mps and math.isfinite(speed_mps * yaw_rate_radps)):
            self._slices.clear()
            self._begin_slice(None)
            return
        if self._since_ns is None:
            self._begin_slice(now_ns)
            return
        self._distance_m += before[0] * passed_ns / NS_PER_S
        self._turned_rad += before[1] * passed_ns / NS_PER_S
        self._take_command(now_ns)
        if now_ns - self._since_ns >= SLICE_NS:
            self._end_slice(now_ns)

    def judge(self, now_ns: int) -> Judgement:
        """What is known now."""
        commanded_per_m = math.nan if self._command.is_stale(now_ns) else self._command.value
        estimated_per_m = math.nan
        if not self._motion.is_stale(now_ns):
            driven = self._driven(round(ESTIMATE_S * NS_PER_S))
            estimated_per_m = driven.turned_rad / driven.distance_m if driven is not None else math.nan
        return Judgement(_radius_m(commanded_per_m), _radius_m(estimated_per_m), "; ".join(self._warnings.values()))

    def _begin_slice(self, now_ns):
        self._since_ns = now_ns
        self._distance_m = self._turned_rad = 0.0
        self._lowest_per_m, self._highest_per_m = math.inf, -math.inf
        if now_ns is not None:
            self._take_command(now_ns)

    def _take_command(self, now_ns):
        """Count what is commanded among the slice's; where it says nothing about the way, it could be anything."""
        low_per_m = high_per_m = self._command.value
        if self._command.is_stale(now_ns) or math.isnan(low_per_m) or self._may_slide(low_per_m):
            low_per_m, high_per_m = -math.inf, math.inf
        self._lowest_per_m = min(self._lowest_per_m, low_per_m)
        self._highest_per_m = max(self._highest_per_m, high_per_m)

    def _may_slide(self, curvature_per_m):
        speed_mps = self._motion.value[0] if self._motion.was_received else 0.0
        return abs(curvature_per_m) * speed_mps * speed_mps > self._config.grip_mps2

    def _end_slice(self, now_ns):
        self._slices.append(_Slice(now_ns - self._since_ns, self._distance_m, self._turned_rad,
                                   self._lowest_per_m, self._highest_per_m))
        self._begin_slice(now_ns)
        lately = self._driven(self._wrong_way_for_ns, self._settling_ns)
        driven = self._driven(self._off_for_ns, self._settling_ns)
        side = self._side(driven)
        if self._turns_the_wrong_way(lately):
            self._warn(self._side(lately), lately)
        elif side and not self._is_within(driven, 1.0):
            self._warn(side, driven)
        elif side and self._is_within(driven, CLEARLY):
            self._warnings.pop(side, None)

    def _driven(self, window_ns, settling_ns=0):
        """The newest slices of a window as one, with what was commanded since before it; ``None``: not that many."""
        duration_ns, distance_m, turned_rad = 0, 0.0, 0.0
        lowest_per_m, highest_per_m = math.inf, -math.inf
        for piece in reversed(self._slices):
            if duration_ns < window_ns:
                distance_m += piece.distance_m
                turned_rad += piece.turned_rad
            lowest_per_m = min(lowest_per_m, piece.lowest_per_m)
            highest_per_m = max(highest_per_m, piece.highest_per_m)
            duration_ns += piece.duration_ns
            if duration_ns >= window_ns + settling_ns:
                return _Slice(duration_ns, distance_m, turned_rad, lowest_per_m, highest_per_m)
        return None

    def _side(self, driven):
        """Where the car was told to go; ``None``: not known, or now here, now there."""
        if driven is None:
            return None
        if driven.lowest_per_m > self._straight_per_m:
            return LEFT
        if driven.highest_per_m < -self._straight_per_m:
            return RIGHT
        straight = max(-driven.lowest_per_m, driven.highest_per_m) <= self._straight_per_m
        return STRAIGHT if straight else None

    def _turns_the_wrong_way(self, driven):
        side = self._side(driven)
        if side not in (LEFT, RIGHT):
            return False
        other_way = -1 if side == LEFT else 1
        return other_way * driven.turned_rad / driven.distance_m > self._straight_per_m + _doubt_per_m(driven)

    def _is_within(self, driven, strictness):
        """Whether the driven curvature is near enough to something that was commanded."""
        low, high, turned = driven.lowest_per_m, driven.highest_per_m, driven.turned_rad / driven.distance_m
        if high < -self._straight_per_m:
            low, high, turned = -high, -low, -turned
        share, doubt_per_m = self._config.off_ratio * strictness, _doubt_per_m(driven)
        margin_per_m = (self._straight_per_m + doubt_per_m) * strictness
        least, most = min(low, 0.0) - margin_per_m, max(high, 0.0) + margin_per_m
        if low > self._straight_per_m:
            # A radius larger by a share s is a curvature smaller by a factor 1 + s, and the other way round.
            wider = min(low / (1 + share), low - doubt_per_m)
            least = wider if wider > self._straight_per_m else -margin_per_m  # all that is straight is alike
            most = max(high / (1 - share), high + doubt_per_m)
        return least <= turned <= most

    def _warn(self, side, driven):
        commanded = _turn((driven.lowest_per_m + driven.highest_per_m) / 2)
        went = _turn(driven.turned_rad / driven.distance_m)
        text = f"commanded {commanded}, the car went {went}: steering calibration? "
        self._warnings[side] = text + (
            "See whether the servo, or the wheels' sensors, are the wrong way round"
            if self._turns_the_wrong_way(driven) else f"Measure which duty drives {commanded}")


def _doubt_per_m(driven):
    """What the wheels can't tell of a curvature; the longer the way, the less."""
    return HEADING_RAD / abs(driven.distance_m)


def _radius_m(curvature_per_m):
    return math.inf if curvature_per_m == 0 else 1 / curvature_per_m


def _turn(curvature_per_m):
    """A curvature in words: ``left, 2.0 m``."""
    radius_m = _radius_m(curvature_per_m)
    return STRAIGHT if abs(radius_m) >= 1000 else f"{LEFT if radius_m > 0 else RIGHT}, {abs(radius_m):.1f} m"
