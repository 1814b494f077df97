"""Reconstructs the wheels' motion while pulses weren't counted, and the direction of the first pulses after that.

A Teensy that reboots counts no pulse for about 0.3 s, and does not know the direction of each wheel's first two pulses
after that (see ``plausibility``). ``RestartBridge`` collects the pulses after the restart until they are enough, and
then finds the magnets at which both wheels were, from four things:

- a wheel makes pulses at fixed places, one magnet apart, so that each wheel has skipped a whole number of them;
- speed before and after, which changes evenly in between: this gives the distance, within some magnets;
- curvature before and after, which gives the difference of the wheels' distances. Heading depends on that difference
  alone, and is known to the magnet if the car keeps its curvature;
- a direction that one wheel proves holds for both, as it does for a wheel's own first two pulses.

The likelihoods of the next best answers give the variances that are added: a heading is never claimed to be better
than a pulse in three sigma. Pure; units are pulses and milliseconds.
"""
from __future__ import annotations

import copy
import math
from collections import deque
from itertools import product
from typing import NamedTuple, Sequence

from car_interface.teensy.sensing.pose import HeadingFilter, UnseenPath
from car_interface.teensy.sensing.wheel_filter import MAX_BLIND_MS, PENDING_SPEED_SIGMA, WheelFilter, WheelStart

LEFT, RIGHT = 0, 1
ROLLING_PER_MS = 0.01  # 0.15 m/s: a wheel that rolls faster is expected to go on
BLIND_MS = 100.0  # a longer restart was a reboot; a reset of the odometers loses only a report or two
REPEAT_MS = 450.0  # a standing car is reported more often than this: every 201 ms, and a report may be lost
STANDING_REPORTS = 16  # 3 s: a reboot is found by the first pong, and one ping a second may be lost
# A driver steers to one side and back within this time, so that the mean curvature may be any up to the usual one: 1/3
# of its square. With 2 s or 1/4 slaloms of accuracy.reboot (--fault off) are beyond three sigma. At the most it is a
# car's tightest one, to either side: three sigma. Within a shorter time the mean of a blip that is steered as smoothly,
# by the same angular acceleration, is smaller by the square of the time.
MANOEUVRE_MS = 1_500.0
MAX_CURVATURE = 1.0  # 1/m: a car's tightest turns
# After the restart each wheel's speed is taken over this many pulses and this time, at most until the last of these.
ENOUGH_PULSES, ENOUGH_SPAN_MS, ENOUGH_MS = 6, 100.0, 250.0
LATE_INTERVALS = 1.6  # a first pulse later than this many intervals means that the car started only then
STOPPED_INTERVALS = 3.0  # without a pulse for this many of the earlier intervals: it has stopped
SEARCHED = 6  # magnets to either side of the likeliest
UNEVEN_PER_MS2 = 1.34e-4  # the most that the acceleration differs from its mean: 2 m/s²
CLOCK_MS = 4.0  # one sigma of the duration of a reboot
REST_MS, UNPROVEN_VARIANCE = 1000.0, 4.0  # ms; pulses²: two of them in the other direction in less than three sigma
TICK_MS = 0.45  # of the interval between two ticks, one sigma
CURVATURE_SIGMA = 0.05  # 1/m: the smallest that is claimed for the curvature in between
UNEVEN_START_RATIO = 0.3  # one sigma, of the distance of a car that started while pulses weren't counted
PLACE_SIGMA, DIFFERENCE_SIGMA = 0.3, 0.2  # pulses: of where the wheels were before
STANDING_DIFFERENCE_VARIANCE = 0.4  # pulses²: of wheels that stood, each anywhere between two magnets
MIN_DIFFERENCE_VARIANCE = 1 / 9  # pulses²: a whole one within three sigma


class Outcome(NamedTuple):
    """The result of a bridge."""

    wheels: tuple  # of WheelStart
    was_rolling: bool
    curvature_per_m: float
    curvature_variance: float
    mean_variance: float  # pulses², of the mean distance of both wheels
    difference_variance: float  # pulses², of the right wheel's distance minus the left one's
    reversed_paths: list[UnseenPath]  # driven since the boot, until the last reversal


class RestartBridge:
    """From the last report before a restart to the pulses that show how the car goes on.

    Args:
        at_ms: when pulses were last counted; ``wheels`` (left, right) and ``heading``: as they were then.
    """

    def __init__(self, at_ms: float, wheels: Sequence[WheelFilter], heading: HeadingFilter, track_m: float,
                 boot_ms: float | None = None):
        self._at_ms = at_ms
        self._wheels = [copy.copy(wheel) for wheel in wheels]
        self._heading = heading
        self._track_m = track_m
        self._stood_ms: deque = deque(maxlen=STANDING_REPORTS)  # of the reports without a pulse since they are counted
        self.reversed_paths: list[UnseenPath] = []  # those after the restart, by the counts
        self._stop_variance = self._stop_within_ms = 0.0  # of a car that has stopped while pulses weren't counted
        self.restart(boot_ms)

    def place_variance(self, now_ms: float) -> float:
        """Return the variance of the place that a change of speed on the way or a long time adds, pulses²."""
        if self._seen_ms is None:
            return 0.0
        elapsed_ms, variance = now_ms - self._at_ms, self._stop_variance
        if self._stop_within_ms:
            variance += self._uneven_variance()
        if self._may_have_changed(now_ms):
            variance += (UNEVEN_PER_MS2 * elapsed_ms ** 2 / 6) ** 2  # 2 m/s² for all of the time is three sigma
        if elapsed_ms > MAX_BLIND_MS:  # the wheels are no longer predicted to roll
            variance += (self._mean_before() * elapsed_ms / 2) ** 2
        return variance

    def speed_variance(self, now_ms: float) -> float:
        """Return the variance of the speed that its change on the way adds, of both wheels alike, (pulses/ms)²."""
        if not self._may_have_changed(now_ms):
            return 0.0
        return max(PENDING_SPEED_SIGMA, UNEVEN_PER_MS2 * (now_ms - self._at_ms) / 3) ** 2

    def _may_have_changed(self, now_ms):
        if self._seen_ms is None or self._blind_ms() <= BLIND_MS:
            return False
        if any(self._pulses):
            return self._first_ms() - self._seen_ms <= ENOUGH_MS
        return now_ms - self._seen_ms < BLIND_MS

    def restart(self, boot_ms: float | None = None) -> None:
        """Begin again after another restart: earlier pulses are dropped.

        A car that stood until then has stood until the last report before the boot, where that is known. From such a
        boot on every pulse is counted, though the first report comes later.
        """
        if self._stood_ms and not any(wheel.speed for wheel in self._wheels):
            before = [at_ms for at_ms in self._stood_ms if boot_ms is None or at_ms < boot_ms - BLIND_MS]
            self._at_ms = (before or self._stood_ms)[-1] - self._blind_ms()
            self._stood_ms.clear()
        self._boot_ms = None if boot_ms is None else max(boot_ms, self._at_ms)  # each pulse after it is reported
        self._seen_ms = self._boot_ms  # from when on pulses were counted again
        self._pulses: tuple[list, list] = ([], [])
        self._signs = [0, 0]

    def pending(self, side: int) -> int:
        """Return the pulses of a wheel since the restart."""
        return sum(count for count, _ in self._pulses[side])

    def is_reset(self, pulses: Sequence[int], unproven: Sequence[int], now_ms: float) -> bool:
        """Return whether the first pulses show a WHEEL_RESET: each direction is known, hardly a pulse is missing."""
        seen_ms = now_ms if self._seen_ms is None else self._seen_ms
        return (any(pulses) and not any(unproven) and not any(self._pulses)
                and seen_ms - self._at_ms <= REPEAT_MS)

    def report(self, now_ms: float) -> list[float] | None:
        """Take note that pulses are counted; return once where the wheels are if they stopped while none were."""
        if self._seen_ms is None:
            self._seen_ms = now_ms
        if not any(self._pulses):
            self._stood_ms.append(now_ms)
        fastest = max(abs(wheel.speed) for wheel in self._wheels)
        if fastest == 0.0 or any(self._pulses) or now_ms - self._seen_ms < max(BLIND_MS, STOPPED_INTERVALS / fastest):
            return None
        blind_ms = min(self._seen_ms - self._at_ms, MAX_BLIND_MS)
        self._note_stop(blind_ms)
        for wheel in self._wheels:
            wheel.stop_at(wheel.position + wheel.speed * blind_ms / 2)
        self._at_ms = now_ms
        return [wheel.position for wheel in self._wheels]

    def _uneven_variance(self):
        """Return the variance of the distance if the speed didn't change evenly while pulses weren't counted, pulses².

        Half of the time with 2 m/s² more and half of it with as much less is three sigma.
        """
        within_ms = self._blind_ms()
        if self._was_rolling():
            within_ms = max(within_ms, self._first_ms() - self._at_ms)
        elif abs(self._mean_before()) <= ROLLING_PER_MS:
            within_ms = min(within_ms, MAX_BLIND_MS)  # a parked car
        within_ms = max(within_ms, self._stop_within_ms)
        return (UNEVEN_PER_MS2 * within_ms ** 2 / 12) ** 2 if within_ms > BLIND_MS else 0.0

    def _note_stop(self, blind_ms):
        """Take note that the car has stopped within this time, after a quarter to all of it, as one sigma."""
        fastest = max(abs(wheel.speed) for wheel in self._wheels)
        self._stop_variance, self._stop_within_ms = (fastest * blind_ms / 4) ** 2, blind_ms

    def add(self, side: int, unproven: int, proven: int, at_ms: float) -> None:
        """Take pulses of a wheel, without and (signed) with a known direction; the newest was at ``at_ms``."""
        if any(sign * proven < 0 for sign in self._signs):
            self.restart()  # the car reverses just now: only what follows shows how it goes on
        count, pulses = unproven + abs(proven), self._pulses[side]
        if count > 1 and not pulses and self._boot_ms is not None:
            # At an even pace, the first one half an interval after the boot on average.
            pulses.append((1, self._boot_ms + max(0.0, at_ms - self._boot_ms) * 0.5 / (count - 0.5)))
            count -= 1
        if count:
            pulses.append((count, at_ms))
        if proven:
            self._signs[side] = 1 if proven > 0 else -1

    def is_ready(self, now_ms: float) -> bool:
        """Return whether enough is known to go on."""
        if not any(self._pulses) or not self._find_sign():
            return False
        if now_ms - self._first_ms() > ENOUGH_MS:
            return True
        if not self._was_rolling():
            return all(sign or not pulses for sign, pulses in zip(self._signs, self._pulses))
        if self._blind_ms() <= BLIND_MS:
            return all(self._pulses)
        return all(self.pending(side) >= ENOUGH_PULSES and pulses[-1][1] - pulses[0][1] >= ENOUGH_SPAN_MS
                   for side, pulses in enumerate(self._pulses))

    def solve(self, now_ms: float) -> Outcome:
        """Return how the wheels go on; call it only when ``is_ready``."""
        was_rolling = self._was_rolling()
        if not was_rolling and abs(self._mean_before()) > ROLLING_PER_MS and self._blind_ms() > BLIND_MS:
            self._note_stop(min(self._blind_ms(), MAX_BLIND_MS))
        for pulses in self._pulses if self._boot_ms is not None else ():
            _date_first(pulses)
        sign = self._find_sign()
        signs = [proven or sign for proven in self._signs]
        speeds = self._speeds(signs, now_ms)
        curvature, curvature_variance = self._curvature(was_rolling)
        guesses = [self._guess(side, speeds, curvature, was_rolling, signs) for side in (LEFT, RIGHT)]
        blind_ms, started = self._blind_ms(), 0.0
        mean_speed = sum(speeds) / 2
        rolled = sum(guess - wheel.position for guess, wheel in zip(guesses, self._wheels)) / 2
        length = self._length(rolled, mean_speed) if was_rolling else self._mean_before() * blind_ms / 2
        mean_variance = self._stop_variance + PLACE_SIGMA ** 2 + self._uneven_variance()
        if was_rolling and blind_ms > BLIND_MS:
            mean_variance += (mean_speed * CLOCK_MS) ** 2
            if abs(self._mean_before()) <= ROLLING_PER_MS:
                mean_variance += (UNEVEN_START_RATIO * rolled) ** 2
            if self._is_late:  # its speed at the boot is between none and twice the mean after it; or, reversed, minus
                mean_variance += (mean_speed * blind_ms / 2) ** 2 * (7 / 3 if self.reversed_paths else 1 / 3)
                if self.reversed_paths:  # at 2 m/s² all of the time, or against it
                    mean_variance += (UNEVEN_PER_MS2 * blind_ms ** 2 / 6) ** 2
        elif self._is_late:  # it may have started before the boot, at any time; with 2 m/s² is three sigma
            started = min(UNEVEN_PER_MS2 * blind_ms ** 2 / 6, abs(mean_speed) * blind_ms / math.sqrt(3))
            mean_variance += started ** 2
        # The turn is curvature × distance, and both are uncertain.
        difference_variance = DIFFERENCE_SIGMA ** 2 + self._track_m ** 2 * (
            mean_variance * (curvature_variance + curvature ** 2) + curvature_variance * length ** 2)
        if abs(self._mean_before()) <= ROLLING_PER_MS and was_rolling:
            difference_variance += STANDING_DIFFERENCE_VARIANCE
        places, doubt = self._search(guesses, signs, mean_variance, difference_variance)
        if was_rolling and blind_ms > BLIND_MS or self._stop_variance:
            doubt = max(doubt, MIN_DIFFERENCE_VARIANCE)
        if blind_ms + self._stop_within_ms > BLIND_MS and difference_variance > 1.0:
            # Magnets tell nothing, and the searched ones are too few.
            doubt = max(doubt, difference_variance)
        doubt += (started * (self._curvature_after()[0] or 0.0) * self._track_m) ** 2
        # After a rest a car may have turned round, and the direction of its first pulses isn't known.
        unknown = UNPROVEN_VARIANCE if not was_rolling and now_ms - self._first_ms() > REST_MS else 0.0
        return Outcome(
            wheels=tuple(map(WheelStart, places, speeds, [sign > 0 for sign in signs], self._pulses)),
            was_rolling=was_rolling, curvature_per_m=curvature, curvature_variance=curvature_variance,
            mean_variance=mean_variance + unknown, difference_variance=doubt + unknown,
            reversed_paths=self.reversed_paths)

    @property
    def _is_late(self):
        """Whether the first report came long after the boot from which on pulses are counted."""
        return any(later[1] - first[1] > ENOUGH_MS for pulses in self._pulses if len(pulses) > 1
                   for first, later in [pulses[:2]]) and self._boot_ms is not None

    def _first_ms(self):
        return min(pulses[0][1] for pulses in self._pulses if pulses)

    def _blind_ms(self):
        return max(0.0, self._seen_ms - self._at_ms)

    def _mean_before(self):
        return sum(wheel.speed for wheel in self._wheels) / 2

    def _find_sign(self):
        """Return the car's direction, proven by a wheel or as it rolled before; 0 = unknown."""
        before, sign = self._mean_before(), 0
        if abs(before) > ROLLING_PER_MS and self._blind_ms() < MAX_BLIND_MS:
            sign = 1 if before > 0 else -1
        return self._signs[LEFT] or self._signs[RIGHT] or sign

    def _was_rolling(self):
        """Return whether the car rolled when pulses were counted again; else it started later."""
        if self._is_late and abs(self._mean_before()) <= ROLLING_PER_MS:
            return False  # it stood, and most of the time was after the boot
        for pulses in self._pulses:
            rate = _rate(pulses)
            if rate > ROLLING_PER_MS / 2 and pulses[0][1] - self._seen_ms <= LATE_INTERVALS / rate:
                return True
        return not any(_rate(pulses) for pulses in self._pulses) and abs(self._mean_before()) > ROLLING_PER_MS

    def _speeds(self, signs, now_ms):
        """Return both wheels' speeds at their pulses; an unknown one is taken from the other wheel, or from before."""
        rates = [_rate(pulses) for pulses in self._pulses]
        known = [sign * rate for sign, rate in zip(signs, rates) if rate]
        # A wheel of which no second pulse has come for a while has become slow.
        fastest = 1 / max(now_ms - self._first_ms(), 1.0)
        slowed = [wheel.speed if abs(wheel.speed) < 2 * fastest else math.copysign(fastest, wheel.speed)
                  for wheel in self._wheels]
        return [sign * rate if rate else known[0] if known else speed
                for sign, rate, speed in zip(signs, rates, slowed)]

    def _curvature(self, was_rolling):
        """Return the curvature over the time without counts, and its variance, by the ones before and after."""
        before, usual_square = self._heading.curvature_per_m, self._heading.usual_square
        after, after_variance = self._curvature_after()
        if not was_rolling or after is None or self._blind_ms() <= BLIND_MS:
            within_ms = self._stop_within_ms or self._blind_ms()
            return before, self._heading.curvature_variance + _steered_variance(before, usual_square, within_ms)
        if abs(self._mean_before()) <= ROLLING_PER_MS:
            return after, after_variance + CURVATURE_SIGMA ** 2 + _steered_variance(after, 0.0, self._blind_ms())
        # Exact where it changes evenly; a step at an unknown time in between has this spread. Within seconds it may
        # have been another one, and likewise if the one after is a mean over a long time.
        usual_square = max(usual_square, after ** 2)
        within_ms = MANOEUVRE_MS if self._is_late else self._blind_ms()
        return (before + after) / 2, ((after - before) ** 2 / 12 + CURVATURE_SIGMA ** 2
                                      + _steered_variance((before + after) / 2, usual_square, within_ms))

    def _curvature_after(self):
        """Return curvature and variance by both wheels over the same time; ``None``: there are too few pulses."""
        if any(len(pulses) < 2 for pulses in self._pulses):
            return None, math.inf
        begin_ms = max(pulses[0][1] for pulses in self._pulses)
        end_ms = min(pulses[-1][1] for pulses in self._pulses)
        left, right = (_count_at(pulses, end_ms) - _count_at(pulses, begin_ms) for pulses in self._pulses)
        if end_ms <= begin_ms or not left + right:
            return None, math.inf
        return (2 * (right - left) / (left + right) / self._track_m,
                2 * (TICK_MS / (end_ms - begin_ms) / self._track_m) ** 2)

    def _guess(self, side, speeds, curvature, was_rolling, signs):
        """Return where a wheel was at its first pulse, or the other's, in pulses, regardless of magnets."""
        wheel = self._wheels[side]
        pulses = self._pulses[side]
        before = self._mean_before()
        if not was_rolling:
            # It was somewhere between two magnets, half a pulse from the next one on average.
            rolled = before * self._blind_ms() / 2 + (signs[side] * (pulses[0][0] - 0.5) if pulses else 0.0)
        else:
            mean = (speeds[LEFT] + speeds[RIGHT]) / 2
            at_ms = pulses[0][1] if pulses else self._first_ms()
            counted = [each for each in self._pulses if each]
            middle_ms = sum(each[0][1] + each[-1][1] for each in counted) / (2 * len(counted))
            # Both from the same time on: a slow wheel's first pulse may come long after the other's.
            first_ms = self._first_ms()
            elapsed_ms = max(0.0, first_ms - self._at_ms)
            until_middle_ms = max(elapsed_ms, middle_ms - self._at_ms, 1.0)
            then = before + (mean - before) * elapsed_ms / until_middle_ms
            rolled = (before + then) / 2 * elapsed_ms
            first = min(counted, key=lambda each: each[0][1])
            if at_ms > first_ms:  # the other wheel's pulses show how far it rolled meanwhile
                rolled += math.copysign(_count_at(first, at_ms), mean) if _rate(first) else mean * (at_ms - first_ms)
            if abs(before) <= ROLLING_PER_MS:
                rolled = math.copysign(min(abs(rolled), self._distance_from_rest(at_ms)), then)
        turned = rolled * curvature + (self._uneven_turn(speeds, curvature) if was_rolling else 0.0)
        return wheel.position + rolled + (1 if side == RIGHT else -1) * turned * self._track_m / 2

    def _length(self, rolled, speed):
        """Return the length of the path, in pulses: a car that has reversed on the way went to and fro."""
        before = self._mean_before()
        if before * speed >= 0:
            return rolled
        return (before ** 2 + speed ** 2) / abs(before - speed) / 2 * self._blind_ms()

    def _uneven_turn(self, speeds, curvature):
        """Return what curvature × distance misses of a turn where curvature and speed both change evenly.

        The mean of their product is the product of their means plus a twelfth of that of their changes.
        """
        before = self._mean_before()
        if abs(before) <= ROLLING_PER_MS or self._blind_ms() <= BLIND_MS:
            return 0.0
        curvature_change = 2 * (curvature - self._heading.curvature_per_m)
        return curvature_change * (sum(speeds) / 2 - before) * self._blind_ms() / 12

    def _distance_from_rest(self, at_ms):
        """Return the distance since the car stood, by its speed v and acceleration a: v² / 2a."""
        early_rate, late_rate, early_ms, late_ms = (
            sum(values) / 2 for values in zip(*(_early_and_late(pulses or max(self._pulses, key=len))
                                                for pulses in self._pulses)))
        if not early_rate < late_rate:
            return math.inf
        acceleration = (late_rate - early_rate) / (late_ms - early_ms)
        return max(0.0, early_rate + acceleration * (at_ms - early_ms)) ** 2 / (2 * acceleration)

    def _search(self, guesses, signs, mean_variance, difference_variance):
        """Return the likeliest magnets of the first pulses, and the variance of their difference."""
        mean = sum(guesses) / 2
        difference = guesses[RIGHT] - guesses[LEFT]
        around = [range(round(guess) - SEARCHED, round(guess) + SEARCHED + 1) if self._pulses[side] else
                  (guess,) for side, guess in enumerate(guesses)]
        around = [self._possible(side, places, signs[side]) for side, places in enumerate(around)]
        scored = []
        for left, right in product(*around):
            cost = (((left + right) / 2 - mean) ** 2 / mean_variance
                    + (right - left - difference) ** 2 / difference_variance)
            scored.append((cost, left, right))
        min_cost, left, right = min(scored)
        weights = [(math.exp((min_cost - cost) / 2), one, other) for cost, one, other in scored]
        total = sum(weight for weight, _, _ in weights)
        return (left, right), sum(weight * (other - one - right + left) ** 2 for weight, one, other in weights) / total

    def _possible(self, side, places, sign):
        """Return the places that a wheel can have reached: a wheel that rolled on can't be where it was."""
        wheel = self._wheels[side]
        first = self._pulses[side][0][0] if self._pulses[side] else 0
        if not first or wheel.speed * sign < 0 or self._stop_variance:
            return places
        nearest = wheel.count + first if sign > 0 else wheel.count + 1 - first
        if not self._blind_ms() or wheel.speed == 0.0 and not self._was_rolling():
            return [nearest]  # no pulse was lost, or it stood until pulses were counted again
        possible = [place for place in places if (place - nearest) * sign >= 0]
        return possible or [nearest]


def _steered_variance(mean_per_m, usual_square, within_ms):
    """Return the variance of the mean curvature that a driver can have steered unseen within a time, (1/m)²."""
    part = min(1.0, within_ms / MANOEUVRE_MS)
    return max(usual_square / 3 * part ** 2, ((MAX_CURVATURE + abs(mean_per_m)) / 3 * part ** 2) ** 2)


def _rate(pulses):
    """Return pulses per ms; 0 when there are too few."""
    if len(pulses) < 2 or pulses[-1][1] <= pulses[0][1]:
        return 0.0
    return sum(count for count, _ in pulses[1:]) / (pulses[-1][1] - pulses[0][1])


def _date_first(pulses):
    """Date a first pulse that was reported with others soon after, by the pace of those that followed."""
    rate = _rate(pulses[1:])
    if rate and pulses[1][1] - pulses[0][1] <= ENOUGH_MS:
        pulses[0] = (1, pulses[1][1] - pulses[1][0] / rate)


def _count_at(pulses, at_ms):
    """Return the number of a wheel's pulses since its first, interpolated between two of them."""
    counted = 0
    for (_, before_ms), (count, after_ms) in zip(pulses, pulses[1:]):
        if at_ms <= after_ms:
            return counted + (count * (at_ms - before_ms) / (after_ms - before_ms) if after_ms > before_ms else count)
        counted += count
    return counted


def _early_and_late(pulses):
    """Return the rates of the first and last half of a wheel's pulses, and the middles of these times."""
    middle = len(pulses) // 2
    early, late = pulses[:middle + 1], pulses[middle:]
    return _rate(early), _rate(late), (early[0][1] + early[-1][1]) / 2, (late[0][1] + late[-1][1]) / 2
