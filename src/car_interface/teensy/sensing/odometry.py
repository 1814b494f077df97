"""Wheel pulses → where the car is, and how it moves.

Consumes the reports of the wheels as the plausibility gates have judged them, in the Teensy's own time; produces pose,
speed and yaw rate with their covariances. REP-103: metres, radians, x forward, y left; the pose is that of the middle
of the rear axle, and begins at 0.

One pulse is 1.5 cm, and 2.9° of heading when only one wheel has made it, so that counting pulses isn't enough:

- A wheel's magnets are fixed: with c the sum of its signed pulses, a wheel is within [c, c + 1) pulses, at c when it
  makes a pulse forward and at c + 1 when it makes one backward, for rolling back over a magnet makes one, too. Errors
  don't add up, however often it turns round.
- Between pulses a Kalman filter for each wheel knows better: position, speed and an acceleration that fades (R. Singer,
  "Estimating optimal tracking filter performance for manned maneuvering targets", IEEE Trans. AES 1970). A pulse's time
  is known to a tick; where the next one has not come yet, the wheel can't have passed it.
- Where the magnets stood at the start nobody knows. The first few pulses tell what the two wheels' differ by, if the
  curvature stayed the same over these centimetres; until then the heading is 0.
- Heading = (right − left) / track. Over a pulse's way the curvature hardly changes, so a second filter carries heading
  and curvature on by the way, and takes the wheels' difference whenever one of them has made a pulse.

Position comes from pulses, never from the reports' ``speed``. Pure: numbers in, numbers out.
"""
from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, Sequence

from car_interface.common.errors import ConfigError
from car_interface.teensy.link.protocol import BACKWARD, NO_DIRECTION, WheelStatus
from car_interface.teensy.sensing.plausibility import LEARNING_PULSES
from car_interface.teensy.sensing.restart import MAX_BLIND_MS, CarState, RestartBridge, WheelState

TICK_MIDDLE_MS = 0.5
TICK_VARIANCE = 1 / 12  # of a moment within its tick, ms²
# Without a pulse for longer a wheel stands. A standing car reports every 201 ms: its speed is 0 within a second.
STANDS_AFTER_MS = 790
# Pulses farther apart than this tell the speed by themselves; what fades is the acceleration, long before.
FAR_APART_MS = 60
FADING_MS = 500.0  # of an acceleration
# Half a wheel's usual acceleration, and what it can do from standstill: pulses/ms², of 1.5 cm: 1 and 3.3 m/s².
USUAL_ACCELERATION, STARTING_ACCELERATION = 7e-5, 2.2e-4
SPEED_CHANGE = 0.5  # from pulse to pulse a slow wheel's speed changes by this share at most
STARTING_PULSES = 3
MAGNET_VARIANCE = 1e-4  # of a magnet's place, pulses²
PASSED_BY, PASSED_VARIANCE = 0.02, 0.003  # where a wheel is that should have made its next pulse, pulses
STANDING_SPEED_VARIANCE = 1e-10
PENDING_SPEED_SIGMA = 0.03  # pulses/ms: a car that stood may go half a metre a second when its pulses can be placed
SPEED_RATIO = 0.15  # by which a slow wheel's speed may be off
ALIGNING_PULSES, LAST_ALIGNING_PULSES = 6, 24
ALIGNED_PULSES = 0.12  # what the wheels' magnets may differ by, after that, as a standard deviation
UNALIGNED_PULSES = 0.41  # the same before: the difference of two places that are anywhere within a pulse
LARGEST_RATIO = 2.0  # of the wheels' speeds in a turn
CURVATURE_WANDER = 3.0  # (1/m)²/s: a servo goes from end to end in a fifth of a second
CURVATURE_VARIANCE = 0.5  # of a curvature that nothing is known of, (1/m)²
HEADING_VARIANCE = 1e-6  # rad²: what a covariance claims at the least; 1 mm² for places
# The commanded curvature counts like one measurement every half second that is off by this share of it, and this much.
STEERING_S, STEERING_RATIO, STEERING_PER_M = 0.5, 0.3, 0.05
SHORTEST_M = 0.001  # of a car's dimensions: divided by what is far less, numbers leave the range of floats


@dataclass(frozen=True)
class OdometryConfig:
    """One car's wheels, named as the ROS parameters.

    Attributes:
        pulses_per_revolution: of a rear wheel.
        wheel_diameter_m: of a rear wheel.
        track_m: between the middles of the rear wheels.
        wheelbase_m: between the axles.
        use_steering: the commanded curvature helps the heading between pulses.
        distance_sigma: how much the way may be off after a metre, in m; it grows with the root of the way.
        heading_sigma: the same of the heading, in rad.

    Raises:
        ConfigError: naming the parameter.
    """

    pulses_per_revolution: int = 20
    wheel_diameter_m: float = 0.095
    track_m: float = 0.296
    wheelbase_m: float = 0.324
    use_steering: bool = False
    distance_sigma: float = 0.02
    heading_sigma: float = 0.01

    def __post_init__(self):
        for name, least in (("pulses_per_revolution", 1), ("wheel_diameter_m", SHORTEST_M), ("track_m", SHORTEST_M),
                            ("wheelbase_m", SHORTEST_M)):
            if not least <= getattr(self, name) < math.inf:
                raise ConfigError(name, getattr(self, name), f"a number of at least {least}")
        for name in ("distance_sigma", "heading_sigma"):
            if not 0 <= getattr(self, name) < math.inf:
                raise ConfigError(name, getattr(self, name), "a number of at least 0")

    @property
    def pulse_m(self) -> float:
        """A wheel's way from pulse to pulse."""
        return math.pi * self.wheel_diameter_m / self.pulses_per_revolution


class Motion(NamedTuple):
    """Where the car was at a moment, and how it moved."""

    time_ms: float  # the Teensy's
    x_m: float
    y_m: float
    yaw_rad: float  # not wrapped
    speed_mps: float  # backward negative
    yaw_rate_radps: float  # left positive
    pose_covariance: tuple  # 3×3, of x, y, yaw
    speed_variance: float  # (m/s)²
    yaw_rate_variance: float  # (rad/s)²
    wheel_angles_rad: tuple[float, float]  # left, right: how far each has turned, forward positive
    wheel_speeds_radps: tuple[float, float]
    distance_m: float  # driven, forward and backward


class Odometry:
    """Follows one car from its wheels' reports."""

    def __init__(self, config: OdometryConfig = OdometryConfig()):
        self._config = config
        self._pulse_m = config.pulse_m
        self._wheels = (_WheelFilter(), _WheelFilter())
        self._alignment = _Alignment()
        self._heading = _HeadingFilter()
        self._pose = _Pose(config.distance_sigma, config.heading_sigma)
        self._last: WheelStatus | None = None
        self._time_ms = -math.inf
        self._mean = (self._wheels[0].position + self._wheels[1].position) / 2  # pulses
        self._yaw_rad = 0.0
        self._steering_per_m: float | None = None
        self._bridge: RestartBridge | None = None  # over pulses that nobody counted, until enough is known of it

    def steer(self, curvature_per_m: float) -> None:
        """What the steering is commanded to, left positive; it counts with ``use_steering`` only. NaN: not known."""
        if self._config.use_steering:
            self._steering_per_m = curvature_per_m if math.isfinite(curvature_per_m) else None

    def report(self, record: WheelStatus, pulses: Sequence[int], restarted: bool, left_ms: float, right_ms: float,
               report_ms: float, unproven: Sequence[int] = (0, 0)) -> Motion:
        """Take a report that the gates have accepted.

        Args:
            record: the report.
            pulses: signed, that it adds to the left and to the right wheel, as the gates say.
            restarted: the odometers began anew; nobody knows how many pulses were lost.
            left_ms, right_ms: the ticks of each wheel's last pulse or repeat, in ticks that never begin anew.
            report_ms: a moment until which there was no later pulse; never earlier than the newest of them.
            unproven: further pulses, before those, of which nobody knows the direction yet.
        """
        now_ms = max(report_ms, self._time_ms)
        last, self._last = self._last, record
        if last is None:
            for wheel in self._wheels:
                wheel.begin(now_ms)
            if _may_learn(record):
                self._begin_bridge(now_ms)
            return self._move(record, False, now_ms)
        if restarted:
            self._begin_bridge(self._time_ms)
        elif self._bridge is None and any(unproven):
            self._begin_bridge(now_ms)
        if self._bridge is not None and self._bridge.is_reset(pulses, unproven, now_ms):
            self._bridge = None  # each wheel by itself tells where it is with its next pulse
        if self._bridge is None:
            is_news = self._take_pulses(record, last, pulses, (left_ms, right_ms), now_ms)
            for wheel in self._wheels:
                wheel.wait(now_ms)
            return self._move(record, is_news, now_ms)
        return self._cross_bridge(record, pulses, unproven, (left_ms, right_ms), now_ms)

    def _take_pulses(self, record, last, pulses, times_ms, now_ms):
        """Whether there was a new one."""
        is_news = False
        for wheel, now, before, count, at_ms in zip(self._wheels, record, last, pulses, times_ms):
            if not count and now.dist_abs in (0, before.dist_abs):
                continue
            is_news = True
            if wheel.is_lost:
                wheel.resume(count, now.direction != BACKWARD, at_ms + TICK_MIDDLE_MS, now_ms)
            else:
                wheel.pulse(count, now.direction != BACKWARD, at_ms + TICK_MIDDLE_MS, now_ms)
        return is_news

    def _begin_bridge(self, at_ms):
        if self._bridge is not None:
            self._bridge.restart()
            return
        heading = self._heading
        self._bridge = RestartBridge(
            CarState(at_ms, tuple(WheelState(wheel.count, wheel.position, wheel.speed) for wheel in self._wheels),
                     heading.curvature_per_m, heading.curvature_variance), self._config.track_m)
        for wheel in self._wheels:
            wheel.is_lost = True

    def _cross_bridge(self, record, pulses, unproven, times_ms, now_ms):
        """Collect pulses until they say how the car goes on."""
        bridge = self._bridge
        for side, wheel in enumerate(self._wheels):
            bridge.add(side, unproven[side], pulses[side], min(times_ms[side] + TICK_MIDDLE_MS, now_ms))
            wheel.pending = bridge.pending(side)
            wheel.wait(now_ms)
        if bridge.report(now_ms):
            for wheel, position in zip(self._wheels, bridge.positions):
                wheel.stop_at(position)
        if not bridge.is_ready(now_ms):
            return self._move(record, False, now_ms)
        self._bridge = None
        outcome = bridge.solve(now_ms)
        for wheel, start in zip(self._wheels, outcome.wheels):
            wheel.pending = 0
            if start.pulses:
                wheel.go_on(start, outcome.was_rolling, now_ms)
                wheel.wait(now_ms)
            else:
                wheel.stop_at(start.place)  # its next pulse tells the magnet
        return self._move(record, True, now_ms, outcome)

    def _move(self, record, is_news, now_ms, outcome=None):
        left, right = self._wheels
        scale = self._pulse_m / self._config.track_m
        elapsed_s = max(0.0, now_ms - self._time_ms) / 1000 if self._time_ms > -math.inf else 0.0
        mean = (left.position + right.position) / 2
        distance_m = (mean - self._mean) * self._pulse_m
        self._time_ms, self._mean = now_ms, mean
        if outcome is not None:
            self._pose.doubt(outcome.mean_variance * self._pulse_m ** 2, outcome.difference_variance * scale ** 2)
        if not self._alignment.is_done:
            if self._alignment.try_(left, right):
                yaw_rad = (right.position - left.position - self._alignment.difference) * scale
                self._heading.begin(yaw_rad, (ALIGNED_PULSES * scale) ** 2)
                self._pose.turn_to(yaw_rad, (ALIGNED_PULSES * scale) ** 2)
                self._yaw_rad = yaw_rad
        else:
            self._heading.roll(distance_m, elapsed_s)
            if self._steering_per_m is not None:
                self._heading.see_steering(self._steering_per_m, elapsed_s)
            measured_rad = (right.position - left.position - self._alignment.difference) * scale
            if _on_the_spot(record):
                self._heading.begin(measured_rad, HEADING_VARIANCE)
            elif outcome is not None:
                variance = (left.position_variance + right.position_variance) * scale * scale
                self._heading.resume(measured_rad, variance + HEADING_VARIANCE, outcome.curvature_per_m,
                                     outcome.curvature_variance)
            elif is_news:
                variance = (left.position_variance + right.position_variance) * scale * scale
                self._heading.see(measured_rad, variance + HEADING_VARIANCE)
        turned_rad = self._heading.yaw_rad - self._yaw_rad
        self._yaw_rad = self._heading.yaw_rad
        self._pose.move(distance_m, turned_rad)
        return self._motion(record, now_ms, scale)

    def _motion(self, record, now_ms, scale):
        left, right = self._wheels
        speed_mps = (left.speed + right.speed) / 2 * self._pulse_m * 1000
        variance = left.speed_variance + right.speed_variance
        differs = not self._alignment.is_done or _on_the_spot(record)
        yaw_rate_radps = ((right.speed - left.speed) * scale * 1000 if differs else
                          self._heading.curvature_per_m * speed_mps)
        to_rad = 2 * self._pulse_m / self._config.wheel_diameter_m
        place = (left.position_variance + right.position_variance) * self._pulse_m ** 2
        heading = place / self._config.track_m ** 2
        if not self._alignment.is_done:
            heading += (UNALIGNED_PULSES * scale) ** 2
        pose = self._pose
        return Motion(
            now_ms, pose.x_m, pose.y_m, pose.yaw_rad, speed_mps, yaw_rate_radps,
            pose.covariance(place / 4 + HEADING_VARIANCE, heading + HEADING_VARIANCE),
            variance / 4 * (1000 * self._pulse_m) ** 2 + 1e-6, variance * (1000 * scale) ** 2 + 1e-6,
            (left.position * to_rad, right.position * to_rad),
            (left.speed * 1000 * to_rad, right.speed * 1000 * to_rad), pose.distance_m)


def _may_learn(record):
    """Whether the Teensy may not know the direction of a wheel's next pulses yet."""
    return any(wheel.dist_abs < LEARNING_PULSES for wheel in record)


def _on_the_spot(record):
    """Whether the wheels turn in opposite directions."""
    directions = (record.left.direction, record.right.direction)
    return NO_DIRECTION not in directions and directions[0] != directions[1]


class _WheelFilter:
    """One wheel: position in pulses, speed in pulses/ms, acceleration in pulses/ms².

    Attributes:
        count: signed pulses so far: the wheel is within [count, count + 1).
        made: how many times a report had news of it.
        first: the first pulses, as (ms, position); ``None`` once nobody needs them.
        is_lost: pulses were made that nobody counted; the next one tells where it is.
        pending: pulses that were counted but can't be placed yet.
    """

    def __init__(self):
        self.count = 0
        self.made = 0
        self.first: list | None = []
        self.is_lost = False
        self.pending = 0
        self.position, self.speed, self._acceleration = 0.5, 0.0, 0.0
        self._time_ms = 0.0
        self._pulse_ms = -math.inf  # of the newest
        self._forward = True
        self._since_stop = 0
        self._stand()

    @property
    def position_variance(self):
        return self._variances[0] + self.pending ** 2

    @property
    def speed_variance(self):
        return self._variances[3] + (PENDING_SPEED_SIGMA ** 2 if self.pending else 0.0)

    def begin(self, now_ms):
        self._time_ms = now_ms

    def pulse(self, pulses, forward, at_ms, now_ms):
        """Take the newest pulse; ``pulses`` were made since the one before."""
        # A moment that can't be, because the Teensy rebooted and nobody has noticed yet, is some moment until now.
        is_known = self._pulse_ms < at_ms <= now_ms + TICK_MIDDLE_MS
        at_ms = min(max(at_ms, self._time_ms), now_ms) if is_known else now_ms
        self.count += pulses
        self.made += 1
        self._since_stop += 1
        place = self.count if forward else self.count + 1
        self._predict(at_ms)
        variance = self.speed * self.speed * (TICK_VARIANCE if is_known else 100.0) + MAGNET_VARIANCE
        interval_ms = at_ms - self._pulse_ms
        if (FAR_APART_MS < interval_ms <= STANDS_AFTER_MS and forward == self._forward and self._since_stop > 1
                and is_known):
            self._take_interval(place, pulses / interval_ms, interval_ms, variance)
        else:
            self._update(place, variance)
        self._forward, self._pulse_ms = forward, at_ms
        if self.first is not None:
            self.first.append((at_ms, place))

    def resume(self, pulses, forward, at_ms, now_ms):
        """Take the first pulse after some that nobody counted: the magnet nearest to where the wheel should be is it.

        It can't be nearer than what was counted since, nor than the next one: a wheel that stood has lost none.
        """
        self.is_lost = False
        if now_ms - self._pulse_ms > STANDS_AFTER_MS:
            self._stand()
            self._time_ms = now_ms
        at_ms = at_ms if self._time_ms <= at_ms <= now_ms else now_ms
        self._predict(at_ms)
        if forward:
            count = max(self.count + max(pulses, 1), round(self.position))
        else:
            count = min(self.count + min(pulses, -1), round(self.position) - 1)
        self.pulse(count - self.count, forward, at_ms, now_ms)

    def stop_at(self, position):
        """It has stopped there while nobody counted its pulses."""
        self.position = position
        self._stand()

    def go_on(self, start, was_rolling, now_ms):
        """Follow it from its first pulse after a restart."""
        self.is_lost = False
        first_count, first_ms = start.pulses[0]
        sign = 1 if start.forward else -1
        self.count = start.place - first_count if start.forward else start.place - 1 + first_count
        self._forward = start.forward
        self._time_ms = min(self._time_ms, first_ms)
        if was_rolling:
            self.position, self.speed, self._acceleration = float(start.place), start.speed, 0.0
            self._variances = (MAGNET_VARIANCE, 0.0, 0.0, (SPEED_RATIO * start.speed) ** 2, 0.0,
                               STARTING_ACCELERATION ** 2)
            self._since_stop = STARTING_PULSES
            self._pulse_ms = -math.inf
        for count, at_ms in start.pulses:
            self.pulse(sign * count, start.forward, at_ms, max(now_ms, at_ms))

    def wait(self, now_ms):
        """No pulse has come until now."""
        if self.is_lost and now_ms - self._time_ms > MAX_BLIND_MS:
            self._time_ms = now_ms
            self._stand()
            return
        self._predict(now_ms)
        since_ms = now_ms - self._pulse_ms
        # The newest pulse was somewhere in its tick, and until then no other had come: half a tick to either side.
        slack = abs(self.speed) * TICK_MIDDLE_MS if since_ms <= FAR_APART_MS else 0.0
        low, high = self.count - slack, self.count + 1 + slack
        if since_ms > STANDS_AFTER_MS:
            self.position = min(max(self.position, low), high) if not self.is_lost else self.position
            self._stand()
            return
        if self.is_lost:
            return  # it may have passed magnets
        if since_ms <= FAR_APART_MS:
            if self.position > high:
                self._update(high - PASSED_BY, PASSED_VARIANCE)
            elif self.position < low:
                self._update(low + PASSED_BY, PASSED_VARIANCE)
        self.position = min(max(self.position, low), high)
        fastest = 1 / max(since_ms, FAR_APART_MS / 3)
        if abs(self.speed) > fastest and since_ms > FAR_APART_MS / 3:
            self.speed = math.copysign(fastest, self.speed)
            self._acceleration = 0.0

    def _stand(self):
        self.speed = self._acceleration = 0.0
        self._since_stop = 0
        self._variances = (1 / 12, 0.0, 0.0, STANDING_SPEED_VARIANCE, 0.0, STARTING_ACCELERATION ** 2)

    def _take_interval(self, place, speed, interval_ms, variance):
        """From a slow wheel's pulses comes its mean speed; a filter that made an acceleration of it would ring."""
        self.position, self.speed, self._acceleration = float(place), speed, 0.0
        of_speed = (SPEED_RATIO * speed) ** 2
        of_acceleration = min(STARTING_ACCELERATION ** 2, of_speed / interval_ms ** 2)
        self._variances = (variance, 0.0, 0.0, of_speed, 0.0, of_acceleration)

    def _predict(self, at_ms):
        elapsed_ms = at_ms - self._time_ms
        if elapsed_ms <= 0:
            return
        self._time_ms = at_ms
        share = elapsed_ms / FADING_MS
        fade = math.exp(-share)
        to_speed = FADING_MS * (1 - fade)
        to_position = FADING_MS * (elapsed_ms - to_speed)
        self.position += self.speed * elapsed_ms + self._acceleration * to_position
        self.speed += self._acceleration * to_speed
        self._acceleration *= fade
        pp, pv, pa, vv, va, aa = self._variances
        pa_, va_ = pa + elapsed_ms * va + to_position * aa, va + to_speed * aa
        pv_ = pv + elapsed_ms * vv + to_position * va
        noise = self._noise(elapsed_ms, share, fade)
        self._variances = (
            pp + elapsed_ms * (pv + pv_) + to_position * (pa + pa_) + noise[0],
            pv_ + to_speed * pa_ + noise[1],
            fade * pa_ + noise[2],
            vv + to_speed * (va + va_) + noise[3],
            fade * va_ + noise[4],
            fade * fade * aa + noise[5])

    def _noise(self, elapsed_ms, share, fade):
        """What unknown changes of the acceleration add to the variances; Singer's, and for a short time its limit."""
        acceleration = (STARTING_ACCELERATION if self._since_stop < STARTING_PULSES else
                        min(USUAL_ACCELERATION, SPEED_CHANGE * self.speed * self.speed))
        variance = acceleration * acceleration
        if share < 0.05:
            rate, square = 2 * variance / FADING_MS, elapsed_ms * elapsed_ms
            return (rate * square * square * elapsed_ms / 20, rate * square * square / 8,
                    rate * square * elapsed_ms / 6, rate * square * elapsed_ms / 3, rate * square / 2,
                    rate * elapsed_ms)
        faded = fade * fade
        return (
            variance * FADING_MS ** 4 * (
                1 - faded + 2 * share + 2 * share ** 3 / 3 - 2 * share ** 2 - 4 * share * fade),
            variance * FADING_MS ** 3 * (faded + 1 - 2 * fade + 2 * share * fade - 2 * share + share ** 2),
            variance * FADING_MS ** 2 * (1 - faded - 2 * share * fade),
            variance * FADING_MS ** 2 * (4 * fade - 3 - faded + 2 * share),
            variance * FADING_MS * (faded + 1 - 2 * fade),
            variance * (1 - faded))

    def _update(self, place, variance):
        pp, pv, pa, vv, va, aa = self._variances
        total = pp + variance
        innovation = (place - self.position) / total
        self.position += pp * innovation
        self.speed += pv * innovation
        self._acceleration += pa * innovation
        self._variances = (pp - pp * pp / total, pv - pp * pv / total, pa - pp * pa / total,
                           vv - pv * pv / total, va - pv * pa / total, aa - pa * pa / total)


class _Alignment:
    """What both wheels' magnets differ by at the start, from the first pulses.

    Attributes:
        difference: of the starting places, right minus left, in pulses; 0 is the mean of all that is possible.
    """

    def __init__(self):
        self.is_done = False
        self.difference = 0.0

    def try_(self, left, right) -> bool:
        """Whether it's known now, well or badly.

        While the ratio of the wheels' ways stays the same, their places lie on a line, and the start is where that line
        meets the places that are possible: each between two magnets.
        """
        few = min(left.made, right.made) < ALIGNING_PULSES
        pairs = [] if few else _pairs(left.first, right.first)
        if len(pairs) < ALIGNING_PULSES and max(left.made, right.made) < LAST_ALIGNING_PULSES:
            return False
        self.is_done = True
        left.first = right.first = None
        slope, at_0 = _line(pairs)
        if not 1 / LARGEST_RATIO < slope < LARGEST_RATIO:
            return True
        low, high = max(0.0, -at_0 / slope), min(1.0, (1 - at_0) / slope)
        start = (low + high) / 2
        self.difference = at_0 + slope * start - start
        return True


def _pairs(left, right):
    """Places of both wheels at the same moment: at each pulse of one, between two of the other."""
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
    """Least squares: slope, and the value at 0; slope 0 when they tell none."""
    if len(pairs) < 2:
        return 0.0, 0.0
    mean_x, mean_y = (sum(values) / len(pairs) for values in zip(*pairs))
    spread = sum((x - mean_x) ** 2 for x, _ in pairs)
    slope = sum((x - mean_x) * (y - mean_y) for x, y in pairs) / spread if spread > 0 else 0.0
    return slope, mean_y - slope * mean_x


class _HeadingFilter:
    """Heading, and the curvature that it changes by with the way."""

    def __init__(self):
        self.yaw_rad, self.curvature_per_m = 0.0, 0.0
        self._variances = (HEADING_VARIANCE, 0.0, CURVATURE_VARIANCE)

    @property
    def curvature_variance(self):
        return self._variances[2]

    def begin(self, yaw_rad, variance):
        self.yaw_rad = yaw_rad
        self._variances = (variance, 0.0, CURVATURE_VARIANCE)

    def roll(self, distance_m, elapsed_s):
        """Go so far, within this time."""
        self.yaw_rad += self.curvature_per_m * distance_m
        yy, yc, cc = self._variances
        yy += distance_m * (2 * yc + distance_m * cc)
        yc += distance_m * cc
        if distance_m:
            cc = min(cc + CURVATURE_WANDER * elapsed_s, 2 * CURVATURE_VARIANCE)
        self._variances = (yy, yc, cc)

    def resume(self, yaw_rad, variance, curvature_per_m, curvature_variance):
        """Nothing was seen for a while; that is what is known now."""
        self.yaw_rad, self.curvature_per_m = yaw_rad, curvature_per_m
        self._variances = (variance, 0.0, curvature_variance)

    def see(self, yaw_rad, variance):
        """Take what the wheels say."""
        yy, yc, cc = self._variances
        total = yy + variance
        innovation = (yaw_rad - self.yaw_rad) / total
        self.yaw_rad += yy * innovation
        self.curvature_per_m += yc * innovation
        self._variances = (yy - yy * yy / total, yc - yy * yc / total, cc - yc * yc / total)

    def see_steering(self, curvature_per_m, elapsed_s):
        """Take what is commanded, as much as the time since it was taken last is worth."""
        if elapsed_s <= 0:
            return
        yy, yc, cc = self._variances
        variance = (STEERING_RATIO * abs(curvature_per_m) + STEERING_PER_M) ** 2 * max(1.0, STEERING_S / elapsed_s)
        total = cc + variance
        innovation = (curvature_per_m - self.curvature_per_m) / total
        self.yaw_rad += yc * innovation
        self.curvature_per_m += cc * innovation
        self._variances = (yy - yc * yc / total, yc - yc * cc / total, cc - cc * cc / total)


class _Pose:
    """Place and heading, with their covariance."""

    def __init__(self, distance_sigma, heading_sigma):
        self._distance_variance, self._heading_variance = distance_sigma ** 2, heading_sigma ** 2  # per metre
        self.x_m = self.y_m = self.yaw_rad = self.distance_m = 0.0
        self._variances = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)  # xx, xy, xa, yy, ya, aa

    def turn_to(self, yaw_rad, variance):
        """The heading has just become known."""
        self.yaw_rad = yaw_rad
        self._variances = (*self._variances[:5], self._variances[5] + variance)

    def doubt(self, along_variance, heading_variance):
        """So much more is unknown, along the heading and of it."""
        cos, sin = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        xx, xy, xa, yy, ya, aa = self._variances
        self._variances = (xx + along_variance * cos * cos, xy + along_variance * cos * sin, xa,
                           yy + along_variance * sin * sin, ya, aa + heading_variance)

    def move(self, distance_m, turned_rad):
        """Along an arc: its chord is way · sin(h) / h long and points to the mean heading (h: half the turn)."""
        half_rad = turned_rad / 2
        chord_m = distance_m * (math.sin(half_rad) / half_rad if abs(half_rad) > 1e-6 else 1.0)
        cos, sin = math.cos(self.yaw_rad + half_rad), math.sin(self.yaw_rad + half_rad)
        dx_m, dy_m = chord_m * cos, chord_m * sin
        self.x_m += dx_m
        self.y_m += dy_m
        self.yaw_rad += turned_rad
        self.distance_m += abs(distance_m)
        xx, xy, xa, yy, ya, aa = self._variances
        xa_, ya_ = xa - dy_m * aa, ya + dx_m * aa
        along, turn = self._distance_variance * abs(distance_m), self._heading_variance * abs(distance_m)
        self._variances = (
            xx - dy_m * (xa + xa_) + along * cos * cos, xy + dx_m * xa - dy_m * ya_ + along * cos * sin, xa_,
            yy + dx_m * (ya + ya_) + along * sin * sin, ya_, aa + turn)

    def covariance(self, of_place, of_heading):
        """With what is unknown below a pulse, which doesn't add up."""
        xx, xy, xa, yy, ya, aa = self._variances
        return (xx + of_place, xy, xa), (xy, yy + of_place, ya), (xa, ya, aa + of_heading)
