"""Estimates a wheel's position, speed and acceleration from its pulses, and where the magnets stood at the start.

- A wheel's magnets are fixed: with c the sum of its signed pulses, a wheel is within [c, c + 1) pulses, at c when it
  makes a pulse forward and at c + 1 when it makes one backward, since rolling back over a magnet also makes one. Errors
  don't add up when it reverses.
- Between pulses a Kalman filter estimates position, speed and an acceleration that fades (R. Singer, "Estimating
  optimal tracking filter performance for manned maneuvering targets", IEEE Trans. AES 1970). A pulse's time is known to
  a tick; where the next one has not come yet, the wheel can't have passed it.

Pure: pulses and milliseconds of the Teensy's clock in, the same out.
"""
from __future__ import annotations

import math
from typing import NamedTuple

TICK_MIDDLE_MS = 0.5
TICK_VARIANCE = 1 / 12  # of a moment within its tick, ms²
# Without a pulse for longer a wheel stands. A standing car reports every 201 ms: its speed is 0 within a second.
STANDS_AFTER_MS = 790
# With pulses farther apart than this the speed is taken from the interval: the acceleration has faded by then.
FAR_APART_MS = 60
FADING_MS = 500.0  # time constant of an acceleration: 1 / alpha of Singer's model
# A wheel's usual acceleration, and the largest from standstill: pulses/ms², of 1.5 cm: 1 and 3.3 m/s². With 2 m/s² as
# the usual one the speed is noisier, on a straight by a quarter (accuracy.odometry). But at a change by 2 m/s² the
# truth is beyond three sigma of this filter for 50 ms (test_captures), so that its sigma of the speed is extended.
USUAL_ACCELERATION, STARTING_ACCELERATION = 7e-5, 2.2e-4
SPEED_SIGMAS = 1.6
SPEED_CHANGE = 0.5  # from pulse to pulse a slow wheel's speed changes by this ratio at most
STARTING_PULSES = 3
# A pulse that is farther from where it was expected than its sigma, as after a change of the acceleration, shows that
# the speed is as far off. The filter follows within five pulses: per pulse the surprise fades to this ratio.
SURPRISE_FADES = 0.8
MAGNET_VARIANCE = 1e-4  # of a magnet's place, pulses²
# At the first pulse after a stand, with one sigma. A car with the usual acceleration has 0.18 m/s after half a pulse,
# another one less: 0.15 and 0.12 m/s.
FIRST_SPEED, FIRST_SPEED_SIGMA = 0.01, 0.008
PASSED_BY, PASSED_VARIANCE = 0.02, 0.003  # pulses: how far before the next magnet a wheel is whose pulse is overdue
STANDING_SPEED_VARIANCE = 1e-10
SPEED_RATIO = 0.15  # one sigma of a slow wheel's speed
UNKNOWN_TIME_VARIANCE = 100.0  # of a pulse whose time can't be, ms²
MAX_BLIND_MS = 2_000.0  # after a longer time without counts the speed in between is unknown
PENDING_SPEED_SIGMA = 0.03  # pulses/ms, 0.45 m/s: of a car that has started when its pulses can be placed
ALIGNING_PULSES, LAST_ALIGNING_PULSES = 6, 24
ALIGNED_PULSES = 0.12  # of the difference after that, one sigma
UNALIGNED_PULSES = 0.41  # the same before: 1 / √6, the difference of two positions anywhere within a pulse
MAX_RATIO = 2.0  # of the wheels' speeds in a turn: 1.35 on a radius of 1 m with a track of 0.3 m


class WheelStart(NamedTuple):
    """The state in which a wheel goes on after pulses that weren't counted."""

    place: float  # of its first pulse's magnet; without pulses the wheel's own, anywhere between two
    speed: float  # at that time, pulses per ms
    forward: bool  # its direction
    pulses: list  # (number, at ms), the first of which was at ``place``


class WheelFilter:
    """One wheel at the time of the last call: position in pulses, speed in pulses/ms, acceleration in pulses/ms²."""

    def __init__(self):
        self.count = 0  # signed pulses so far: the wheel is within [count, count + 1)
        self.first_pulses: list | None = []  # as (ms, position), for the alignment; ``None`` once it is done
        self.is_uncounted = False  # it has made pulses that the Teensy didn't count; the next one shows where it is
        self.pending = 0  # pulses that were counted but whose positions aren't known yet
        self.position, self.speed, self.acceleration = 0.5, 0.0, 0.0
        self._time_ms = 0.0
        self._pulse_ms = -math.inf  # of the newest
        self._forward = True
        self._since_stop = 0
        self._interval_speed = 0.0  # the mean over the newest interval between pulses
        self._surprise = 0.0  # square of the newest innovations over their variance; 1 is as expected
        self._stand()

    @property
    def position_variance(self) -> float:
        """The variance of the position, pulses²; without uncounted pulses a whole one is three sigma."""
        known = self._variances[0] if self.is_uncounted else min(self._variances[0], 1 / 9)
        return known + self.pending ** 2

    @property
    def speed_variance(self) -> float:
        """The variance of the speed, (pulses/ms)²."""
        pending = PENDING_SPEED_SIGMA ** 2 if self.pending else 0.0
        return max(SPEED_SIGMAS ** 2, self._surprise) * self._variances[3] + pending

    def begin(self, now_ms: float) -> None:
        """Begin with the first report: the wheel is taken to stand until its first pulse."""
        self._time_ms = now_ms

    def update(self, pulses: int, forward: bool, at_ms: float, now_ms: float) -> None:
        """Take the newest pulse.

        Args:
            pulses: signed, since the last update, this one included.
            forward: the direction of the newest.
            at_ms: its time.
            now_ms: the time of the report.
        """
        # An impossible time, because of a reboot that isn't detected yet, means any time until now.
        is_known = self._pulse_ms < at_ms <= now_ms + TICK_MIDDLE_MS
        at_ms = min(max(at_ms, self._time_ms), now_ms) if is_known else now_ms
        self.count += pulses
        self._since_stop += 1
        place = self.count if forward else self.count + 1
        self._predict(at_ms)
        if self._since_stop == 1:  # the first pulse after a stand: v² grows with the pulses that come in one report
            self.speed = (1 if forward else -1) * FIRST_SPEED * math.sqrt(abs(pulses))
            self._variances = (self._variances[0], 0.0, 0.0, FIRST_SPEED_SIGMA ** 2 * abs(pulses), 0.0,
                               STARTING_ACCELERATION ** 2)
        speed_square = self.speed * self.speed + self._variances[3]
        variance = speed_square * (TICK_VARIANCE if is_known else UNKNOWN_TIME_VARIANCE) + MAGNET_VARIANCE
        interval_ms = at_ms - self._pulse_ms
        if (FAR_APART_MS < interval_ms <= STANDS_AFTER_MS and forward == self._forward and self._since_stop > 1
                and is_known):
            self._set_by_interval(place, pulses / interval_ms, interval_ms, variance)
        else:
            self._correct(place, variance)
        self._interval_speed = pulses / max(interval_ms, 1.0)
        self._forward, self._pulse_ms = forward, at_ms
        if self.first_pulses is not None:
            self.first_pulses.append((at_ms, place))

    def resume(self, pulses: int, forward: bool, at_ms: float, now_ms: float) -> None:
        """Take the first pulse after some that weren't counted, as ``update``; its magnet is the nearest possible one.

        This is the magnet nearest to where the wheel should be, but not before the pulses counted since, nor before the
        next magnet: a wheel that stood has made no uncounted pulse.
        """
        self.is_uncounted = False
        if now_ms - self._pulse_ms > STANDS_AFTER_MS:
            self._stand()
            self._time_ms = now_ms
        at_ms = at_ms if self._time_ms <= at_ms <= now_ms else now_ms
        self._predict(at_ms)
        if forward:
            count = max(self.count + max(pulses, 1), round(self.position))
        else:
            count = min(self.count + min(pulses, -1), round(self.position) - 1)
        self.update(count - self.count, forward, at_ms, now_ms)

    def stop_at(self, position: float) -> None:
        """Set the position at which the wheel stopped while its pulses weren't counted."""
        self.position = position
        self._stand()

    def start(self, start: WheelStart, was_rolling: bool, now_ms: float) -> None:
        """Follow the wheel from its first pulse after a restart."""
        self.is_uncounted = False
        first_count, first_ms = start.pulses[0]
        sign = 1 if start.forward else -1
        self.count = start.place - first_count if start.forward else start.place - 1 + first_count
        self._forward = start.forward
        self._time_ms = min(self._time_ms, first_ms)
        if was_rolling:
            self.position, self.speed, self.acceleration = float(start.place), start.speed, 0.0
            self._variances = (MAGNET_VARIANCE, 0.0, 0.0, (SPEED_RATIO * start.speed) ** 2, 0.0,
                               STARTING_ACCELERATION ** 2)
            self._since_stop = STARTING_PULSES
            self._pulse_ms = -math.inf
        for count, at_ms in start.pulses:
            self.update(sign * count, start.forward, at_ms, max(now_ms, at_ms))
        if len(start.pulses) > 1 and start.pulses[-1][1] - start.pulses[-2][1] > FAR_APART_MS:
            # A mean over so long: it may be starting, or turning round; or it has stopped, and ``when`` is a repeat's.
            pp, pv, pa, vv, va, aa = self._variances
            self._variances = (pp, pv, pa, vv + max(FIRST_SPEED_SIGMA, abs(self.speed)) ** 2, va, aa)

    def advance(self, now_ms: float) -> None:
        """Predict until now, within the magnets that the wheel can't have passed without a pulse."""
        if self.is_uncounted and self._variances[3] > STANDING_SPEED_VARIANCE:
            # It may have passed magnets, and may roll on until the reports show that it has stopped.
            if now_ms - self._time_ms > MAX_BLIND_MS:
                speed_variance = self._variances[3] + self.speed ** 2
                self._stand()
                self._variances = (1 / 12, 0.0, 0.0, speed_variance, 0.0, STARTING_ACCELERATION ** 2)
                self._time_ms = now_ms
            self._predict(now_ms)
            return
        self._predict(now_ms)
        since_ms = now_ms - self._pulse_ms
        fastest = 1 / since_ms if since_ms > FAR_APART_MS / 3 else math.inf  # or the next pulse would have come
        # The newest pulse was anywhere in its tick, and none had come before: half a tick to either side.
        slack = min(abs(self.speed), fastest) * TICK_MIDDLE_MS if since_ms <= FAR_APART_MS else 0.0
        low, high = self.count - slack, self.count + 1 + slack
        if since_ms > STANDS_AFTER_MS:
            self.position = min(max(self.position, low), high) if not self.is_uncounted else self.position
            self._stand()
            return
        if since_ms <= FAR_APART_MS:
            if self.position > high:
                self._correct(high - PASSED_BY, PASSED_VARIANCE)
            elif self.position < low:
                self._correct(low + PASSED_BY, PASSED_VARIANCE)
            slack = min(abs(self.speed), slack / TICK_MIDDLE_MS) * TICK_MIDDLE_MS
        self.position = min(max(self.position, self.count - slack), self.count + 1 + slack)
        if abs(self.speed) > fastest:
            self.speed = math.copysign(fastest, self.speed)
            self.acceleration = 0.0

    def _stand(self):
        """Let the wheel stand, anywhere between two magnets."""
        self.speed = self.acceleration = 0.0
        self._since_stop = 0
        self._variances = (1 / 12, 0.0, 0.0, STANDING_SPEED_VARIANCE, 0.0, STARTING_ACCELERATION ** 2)

    def _set_by_interval(self, place, speed, interval_ms, variance):
        """Set a slow wheel's speed to the mean over its last interval; estimating its acceleration would ring."""
        self.position, self.speed, self.acceleration = float(place), speed, 0.0
        speed_variance = (SPEED_RATIO * speed) ** 2 + (speed - self._interval_speed) ** 2 / 4
        acceleration_variance = min(STARTING_ACCELERATION ** 2, speed_variance / interval_ms ** 2)
        self._variances = (variance, 0.0, 0.0, speed_variance, 0.0, acceleration_variance)

    def _predict(self, at_ms):
        """Predict by the Kalman filter, with Singer's model."""
        elapsed_ms = at_ms - self._time_ms
        if elapsed_ms <= 0:
            return
        self._time_ms = at_ms
        ratio = elapsed_ms / FADING_MS
        fade = math.exp(-ratio)
        to_speed = FADING_MS * (1 - fade)
        to_position = FADING_MS * (elapsed_ms - to_speed)
        self.position += self.speed * elapsed_ms + self.acceleration * to_position
        self.speed += self.acceleration * to_speed
        self.acceleration *= fade
        pp, pv, pa, vv, va, aa = self._variances
        pa_, va_ = pa + elapsed_ms * va + to_position * aa, va + to_speed * aa
        pv_ = pv + elapsed_ms * vv + to_position * va
        noise = self._noise(elapsed_ms, ratio, fade)
        self._variances = (
            pp + elapsed_ms * (pv + pv_) + to_position * (pa + pa_) + noise[0],
            pv_ + to_speed * pa_ + noise[1],
            fade * pa_ + noise[2],
            vv + to_speed * (va + va_) + noise[3],
            fade * va_ + noise[4],
            fade * fade * aa + noise[5])

    def _noise(self, elapsed_ms, ratio, fade):
        """Return the variances that unknown changes of acceleration add: Singer's, and its limit for a short time."""
        acceleration = (STARTING_ACCELERATION if self._since_stop < STARTING_PULSES else
                        USUAL_ACCELERATION if self.is_uncounted else
                        min(USUAL_ACCELERATION, SPEED_CHANGE * self.speed * self.speed))
        variance = acceleration * acceleration
        if ratio < 0.05:
            rate, square = 2 * variance / FADING_MS, elapsed_ms * elapsed_ms
            return (rate * square * square * elapsed_ms / 20, rate * square * square / 8,
                    rate * square * elapsed_ms / 6, rate * square * elapsed_ms / 3, rate * square / 2,
                    rate * elapsed_ms)
        faded = fade * fade
        return (
            variance * FADING_MS ** 4 * (
                1 - faded + 2 * ratio + 2 * ratio ** 3 / 3 - 2 * ratio ** 2 - 4 * ratio * fade),
            variance * FADING_MS ** 3 * (faded + 1 - 2 * fade + 2 * ratio * fade - 2 * ratio + ratio ** 2),
            variance * FADING_MS ** 2 * (1 - faded - 2 * ratio * fade),
            variance * FADING_MS ** 2 * (4 * fade - 3 - faded + 2 * ratio),
            variance * FADING_MS * (faded + 1 - 2 * fade),
            variance * (1 - faded))

    def _correct(self, place, variance):
        """Correct the Kalman filter by a measured position."""
        pp, pv, pa, vv, va, aa = self._variances
        total = pp + variance
        innovation = (place - self.position) / total
        self._surprise = max(self._surprise * SURPRISE_FADES, innovation * (place - self.position))
        self.position += pp * innovation
        self.speed += pv * innovation
        self.acceleration += pa * innovation
        self._variances = (pp - pp * pp / total, pv - pp * pv / total, pa - pp * pa / total,
                           vv - pv * pv / total, va - pv * pa / total, aa - pa * pa / total)


def starting_difference(left: list, right: list) -> float | None:
    """Return by how much two wheels' magnets differ at the start, right minus left, in pulses; ``None``: not known yet.

    There each wheel is anywhere between two of its magnets. The first few pulses show by how much they differ if the
    curvature stayed the same over these centimetres. While the ratio of the wheels' distances stays the same, their
    positions lie on a line, and the start is where that line meets the possible positions. After many pulses without an
    answer it is 0, the mean of all possible values.

    Args:
        left, right: each wheel's ``first_pulses``.
    """
    counts = len(left), len(right)
    pairs = [] if min(counts) < ALIGNING_PULSES else _pairs(left, right)
    if len(pairs) < ALIGNING_PULSES and max(counts) < LAST_ALIGNING_PULSES:
        return None
    slope, at_0 = _line(pairs)
    if not 1 / MAX_RATIO < slope < MAX_RATIO:
        return 0.0
    low, high = max(0.0, -at_0 / slope), min(1.0, (1 - at_0) / slope)
    start = (low + high) / 2
    return max(-1.0, min(1.0, at_0 + slope * start - start))


def _pairs(left, right):
    """Return positions (left, right) of both wheels at the same time: at each pulse of one between two of the other."""
    pairs = []
    for pulses, others, is_left in ((left, right, True), (right, left, False)):
        for at_ms, place in pulses:
            for (before_ms, before), (after_ms, after) in zip(others, others[1:]):
                if before_ms <= at_ms <= after_ms and before_ms < after_ms:
                    other = before + (after - before) * (at_ms - before_ms) / (after_ms - before_ms)
                    pairs.append((place, other) if is_left else (other, place))
                    break
    return pairs


def _line(pairs):
    """Return slope and value at 0 by least squares; slope 0 when the points are too few or give none."""
    if len(pairs) < ALIGNING_PULSES:
        return 0.0, 0.0
    mean_x, mean_y = (sum(values) / len(pairs) for values in zip(*pairs))
    spread = sum((x - mean_x) ** 2 for x, _ in pairs)
    slope = sum((x - mean_x) * y for x, y in pairs) / spread if spread > 0 else 0.0
    return slope, mean_y - slope * mean_x
