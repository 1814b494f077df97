"""Converts wheel pulses to the car's pose, speed and yaw rate, with their covariances.

Consumes the reports of the wheels with the verdicts of the plausibility gates, in the Teensy's own time. REP-103:
metres, radians, x forward, y left; the pose of the middle of the rear axle, which begins at 0.

One pulse is 1.5 cm, and 2.9° of heading when only one wheel has made it, so that counting pulses isn't enough:
``wheel_filter`` estimates each wheel between its pulses and finds where the magnets stood at the start,
``restart`` bridges pulses that a rebooting Teensy didn't count, and ``pose`` filters the difference of the wheels and
integrates. Position comes from pulses, never from the reports' ``speed``. Pure.
"""
from __future__ import annotations

import copy
import math
from dataclasses import dataclass
from typing import NamedTuple, Sequence

from car_interface.common import declared
from car_interface.common.vehicle_geometry import PULSES_PER_REVOLUTION, TRACK_M, WHEEL_DIAMETER_M, WHEELBASE_M
from car_interface.teensy.link.protocol import BACKWARD, FORWARD, NO_DIRECTION, WheelStatus
from car_interface.teensy.sensing.plausibility import LEARNING_PULSES, TOP_SPEED_MPS, Verdict
from car_interface.teensy.sensing.pose import (
    CURVATURE_VARIANCE,
    HEADING_VARIANCE,
    HeadingFilter,
    Pose,
    curved_path,
    reversed_path,
)
from car_interface.teensy.sensing.restart import REPEAT_MS, RestartBridge
from car_interface.teensy.sensing.wheel_filter import (
    ALIGNED_PULSES,
    ALIGNING_PULSES,
    TICK_MIDDLE_MS,
    UNALIGNED_PULSES,
    WheelFilter,
    starting_difference,
)

MIN_LENGTH_M = 0.001  # of a car's dimensions: a division by far less would overflow floats


@dataclass(frozen=True)
class OdometryConfig:
    """One car's wheels."""

    pulses_per_revolution: int = declared.integer(
        "pulses_per_revolution", PULSES_PER_REVOLUTION, "of a rear wheel", low=1, high=10_000)
    wheel_diameter_m: float = declared.number(
        "wheel_diameter", WHEEL_DIAMETER_M, "measure your car's", "m", low=MIN_LENGTH_M, high=10)
    track_m: float = declared.number(
        "track", TRACK_M, "measure your car's", "m", low=MIN_LENGTH_M, high=10)
    wheelbase_m: float = declared.number("wheelbase", WHEELBASE_M, "measure your car's", "m", low=MIN_LENGTH_M, high=10)
    use_steering: bool = declared.flag(
        "use_steering", False, "true = the commanded curvature helps the heading between two pulses")
    distance_sigma: float = declared.number(
        "distance_sigma", 0.02, "standard error of the distance after a metre",
        "m", low=0.0, high=1)
    heading_sigma: float = declared.number(
        "heading_sigma", 0.01, "the same of the heading", "rad", low=0.0, high=1)
    top_speed_mps: float = declared.number(
        "top_speed", TOP_SPEED_MPS, "of a wheel; anything faster is rejected as line noise", "m/s",
        above=0.0, high=1000)

    def __post_init__(self):
        declared.check(self)

    @property
    def pulse_m(self) -> float:
        """A wheel's distance from pulse to pulse."""
        return math.pi * self.wheel_diameter_m / self.pulses_per_revolution


class Motion(NamedTuple):
    """The car's pose and motion."""

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


@dataclass
class _Car:
    """The car at the last report."""

    pose: Pose
    heading: HeadingFilter
    mean: float  # of its wheels' positions, pulses
    was_rolling: bool = False
    time_ms: float = -math.inf


class Odometry:
    """Follows one car from its wheels' reports."""

    def __init__(self, config: OdometryConfig = OdometryConfig()):
        self._config = config
        self._pulse_m = config.pulse_m
        self._rad_per_pulse = config.pulse_m / config.track_m  # of heading
        self._wheels = (WheelFilter(), WheelFilter())
        self._difference: float | None = None  # of the wheels' magnets at the start, pulses, right minus left
        self._car = _Car(Pose(config.distance_sigma, config.heading_sigma), HeadingFilter(), self._wheels[0].position)
        self._last: WheelStatus | None = None
        self._steering_per_m: float | None = None
        self._bridge: RestartBridge | None = None  # over pulses that weren't counted, until enough is known
        self._before_bridge = self._car  # what is published since then, until it is crossed, is a prediction

    @property
    def acceleration_mps2(self) -> float:
        """The car's acceleration at the time of the last report, backward negative."""
        return sum(wheel.acceleration for wheel in self._wheels) / 2 * self._pulse_m * 1e6

    def steer(self, curvature_per_m: float) -> None:
        """Set the commanded curvature, left positive; ``use_steering`` only. NaN: not known."""
        if self._config.use_steering:
            self._steering_per_m = curvature_per_m if math.isfinite(curvature_per_m) else None

    def report(self, record: WheelStatus, verdict: Verdict, times_ms: Sequence[float], report_ms: float,
               counted_ms: float | None = None) -> Motion:
        """Take a report that the gates have accepted, with their verdict.

        Args:
            times_ms: the ticks of each wheel's last pulse or repeat, in ticks that never restart; −inf = unknown.
            report_ms: a time before which there was no later pulse; never earlier than the newest of them.
            counted_ms: the time from which on a Teensy that has rebooted counted all pulses.
        """
        pulses, unproven = verdict.pulses, verdict.unproven
        now_ms = max(report_ms, self._car.time_ms)
        last, self._last = self._last, record
        if last is None:
            for wheel in self._wheels:
                wheel.begin(now_ms)
            if any(wheel.dist_abs < LEARNING_PULSES for wheel in record):  # the next ones may have no known direction
                self._begin_bridge(now_ms)
            return self._move(record, False, now_ms)
        if verdict.restarted:
            self._begin_bridge(self._car.time_ms, counted_ms)
        elif self._bridge is None and any(unproven):
            self._begin_bridge(now_ms)
        if self._bridge is not None and self._bridge.is_reset(pulses, unproven, now_ms):
            self._bridge = None  # each wheel's next pulse shows where it is
        path = self._reversed_path(record, last, verdict.unsplit)
        if self._bridge is None:
            has_pulse = self._update_wheels(record, last, pulses, times_ms, now_ms)
            return self._move(record, has_pulse, now_ms, path=path)
        if path is not None:
            self._bridge.reversed_paths.append(path)
            self._car.pose.add_path(path)
        return self._cross_bridge(record, pulses, unproven, times_ms, now_ms)

    def _update_wheels(self, record, last, pulses, times_ms, now_ms):
        """Pass the wheels their pulses; return whether there was a new one."""
        has_pulse = False
        for wheel, now, before, count, at_ms in zip(self._wheels, record, last, pulses, times_ms):
            if count or now.dist_abs not in (0, before.dist_abs):
                has_pulse = True
                take = wheel.resume if wheel.is_uncounted else wheel.update
                take(count, now.direction != BACKWARD, at_ms + TICK_MIDDLE_MS, now_ms)
            wheel.advance(now_ms)
        return has_pulse

    def _begin_bridge(self, at_ms, counted_ms=None):
        if self._bridge is not None:
            self._bridge.restart(counted_ms)
            return
        self._bridge = RestartBridge(at_ms, self._wheels, self._car.heading, self._config.track_m, counted_ms)
        self._before_bridge, self._car = self._car, copy.deepcopy(self._car)
        for wheel in self._wheels:
            wheel.is_uncounted = True

    def _cross_bridge(self, record, pulses, unproven, times_ms, now_ms):
        """Collect pulses until they show how the car goes on."""
        bridge = self._bridge
        for side, wheel in enumerate(self._wheels):
            is_known = times_ms[side] > -math.inf  # not that of a damaged report: it has pulses, but no direction
            bridge.add(side, unproven[side], pulses[side],
                       min(times_ms[side] + TICK_MIDDLE_MS, now_ms) if is_known else now_ms)
            wheel.pending = bridge.pending(side)
            wheel.advance(now_ms)
        positions = bridge.report(now_ms)
        if positions:
            for wheel, position in zip(self._wheels, positions):
                wheel.stop_at(position)
            self._car = copy.deepcopy(self._before_bridge)  # the path since then was only predicted
            for path in bridge.reversed_paths:
                self._car.pose.add_path(path)
        if not bridge.is_ready(now_ms):
            return self._move(record, False, now_ms)
        self._bridge, self._car = None, self._before_bridge
        outcome = bridge.solve(now_ms)
        for wheel, start in zip(self._wheels, outcome.wheels):
            wheel.pending = 0
            if start.pulses:
                wheel.start(start, outcome.was_rolling, now_ms)
                wheel.advance(now_ms)
            else:
                wheel.stop_at(start.place)  # its next pulse shows the magnet
        return self._move(record, True, now_ms, outcome)

    def _reversed_path(self, record, last, unsplit):
        """Return the path before the last reversal, or ``None`` if the direction of each pulse is known."""
        if min(unsplit) <= 1:  # both reverse together: a wheel without a reversal shows that the other has one at most
            return None
        sign = 1 if last.left.direction == FORWARD else -1
        left, right = unsplit
        return reversed_path(sign * (left + right) / 2 * self._pulse_m, sign * (right - left) * self._rad_per_pulse,
                             last.left.direction != record.left.direction)

    def _move(self, record, has_pulse, now_ms, outcome=None, path=None):
        """Move the pose by the distances of the wheels.

        Args:
            outcome: of a bridge that was just crossed.
            path: driven before the last reversal, since the report before.
        """
        (left, right), car = self._wheels, self._car
        heading, pose = car.heading, car.pose
        elapsed_s = max(0.0, now_ms - car.time_ms) / 1000 if car.time_ms > -math.inf else 0.0
        mean, before_rad = (left.position + right.position) / 2, heading.yaw_rad
        before, distance_m = car.mean, (mean - car.mean) * self._pulse_m
        car.time_ms, car.mean = now_ms, mean
        is_blind = elapsed_s > REPEAT_MS / 1000 and has_pulse
        curvature_per_m = heading.recent_curvature if car.was_rolling else None
        if self._difference is not None:
            heading.predict(distance_m, elapsed_s)
            if self._steering_per_m is not None:
                heading.update_curvature(self._steering_per_m, elapsed_s)
            self._update_heading(record, has_pulse, outcome, path is not None)
        elif self._bridge is None:  # else the wheels' places are only predicted
            has_jumped = abs(distance_m) > 2 * ALIGNING_PULSES * self._pulse_m  # which tells nothing of the difference
            self._difference = 0.0 if has_jumped else starting_difference(left.first_pulses, right.first_pulses)
            if self._difference is not None:
                left.first_pulses = right.first_pulses = None
                variance = ((UNALIGNED_PULSES if has_jumped else ALIGNED_PULSES) * self._rad_per_pulse) ** 2
                heading.begin(self._measured_yaw_rad(), variance)
                before_rad = pose.yaw_rad = 0.0 if has_jumped else heading.yaw_rad
                pose.add_variance(0.0, variance)
        turned_rad = heading.yaw_rad - before_rad
        if path is not None:
            distance_m, turned_rad = self._move_unseen(path, distance_m, turned_rad)
            curvature_per_m = None  # of the last leg it is unknown
        if outcome is not None:
            distance_m, turned_rad = self._move_uncounted(outcome, before, distance_m, turned_rad)
        if path is not None or is_blind:
            path = curved_path(distance_m, turned_rad, curvature_per_m, heading.usual_square)
            distance_m, turned_rad = self._move_unseen(path, distance_m, turned_rad)
        pose.move(distance_m, turned_rad)
        car.was_rolling = any(wheel.speed for wheel in self._wheels)
        return self._motion(record, now_ms)

    def _move_uncounted(self, outcome, before, distance_m, turned_rad):
        """Move along the part of a path without counts, whose variance has grown on it; return what is left."""
        uncounted_m = (sum(start.place for start in outcome.wheels) / 2 - before) * self._pulse_m
        part = max(0.0, min(1.0, uncounted_m / distance_m)) / 2 if distance_m else 0.0
        half = part * distance_m, part * turned_rad
        pose = self._car.pose
        pose.move(*half)
        along_variance = outcome.mean_variance * self._pulse_m ** 2
        turn_variance = outcome.difference_variance * self._rad_per_pulse ** 2
        # It is unknown where on the way the car turned: evenly, with a variance of 1/12.
        pose.add_variance(along_variance, turn_variance, turn_variance * (uncounted_m ** 2 + along_variance) / 12)
        left_m, left_rad = distance_m - half[0], turned_rad - half[1]
        if outcome.reversed_paths:
            pose.move(*half)
            left_m, left_rad = left_m - half[0], left_rad - half[1]
        for path in outcome.reversed_paths:
            pose.add_path(path)
        return left_m, left_rad

    def _move_unseen(self, path, distance_m, turned_rad):
        """Move along a path that wasn't reported; return distance and turn of its last leg."""
        self._car.pose.add_path(path)
        self._car.pose.move(*path.leg)
        return distance_m - path.leg[0], turned_rad - path.leg[1]

    def _measured_yaw_rad(self):
        left, right = self._wheels
        return (right.position - left.position - self._difference) * self._rad_per_pulse

    def _turns_on_the_spot(self, record):
        """Return whether the wheels turn in opposite directions; while a bridge is open these aren't known."""
        directions = (record.left.direction, record.right.direction)
        return self._bridge is None and NO_DIRECTION not in directions and directions[0] != directions[1]

    def _update_heading(self, record, has_pulse, outcome, has_reversed):
        """Correct the heading by the wheels' difference, if a wheel has made a pulse."""
        heading = self._car.heading
        if has_reversed or self._turns_on_the_spot(record):
            heading.begin(self._measured_yaw_rad(), HEADING_VARIANCE)
        elif has_pulse:
            left, right = self._wheels
            variance = ((left.position_variance + right.position_variance) * self._rad_per_pulse * self._rad_per_pulse
                        + HEADING_VARIANCE)
            if outcome is None:
                heading.update(self._measured_yaw_rad(), variance)
            else:
                heading.curvature_per_m = outcome.curvature_per_m
                heading.begin(self._measured_yaw_rad(), variance, outcome.curvature_variance)

    def _motion(self, record, now_ms):
        left, right = self._wheels
        scale = self._rad_per_pulse
        speed_mps = (left.speed + right.speed) / 2 * self._pulse_m * 1000
        variance = left.speed_variance + right.speed_variance
        differs = self._difference is None or self._turns_on_the_spot(record)
        yaw_rate_radps = ((right.speed - left.speed) * scale * 1000 if differs else
                          self._car.heading.curvature_per_m * speed_mps)
        to_rad = 2 * self._pulse_m / self._config.wheel_diameter_m
        place = (left.position_variance + right.position_variance) * self._pulse_m ** 2
        heading = place / self._config.track_m ** 2
        if self._bridge is not None:
            place, heading = self._bridge_variances(place, now_ms)
            variance += 4 * self._bridge.speed_variance(now_ms)
        if self._difference is None:
            heading += (UNALIGNED_PULSES * scale) ** 2
        pose = self._car.pose
        return Motion(
            now_ms, pose.x_m, pose.y_m, pose.yaw_rad, speed_mps, yaw_rate_radps,
            pose.covariance(place / 4 + HEADING_VARIANCE, heading + HEADING_VARIANCE),
            variance / 4 * (1000 * self._pulse_m) ** 2 + 1e-6, variance * (1000 * scale) ** 2 + 1e-6,
            (left.position * to_rad, right.position * to_rad),
            (left.speed * 1000 * to_rad, right.speed * 1000 * to_rad), pose.distance_m)

    def _bridge_variances(self, place_variance, now_ms):
        """Return the variances of the sum of both wheels' places, m², and of the heading, while both are predicted.

        A car rolls by both wheels, whose accelerations are mistaken alike: its heading changes by curvature × distance,
        and its place by the distance times half of that. The curvature changes at an unknown time, for a part of the
        distance that is evenly in 0 .. 1: its mean has a third of the variance. With the distance the turn by the
        curvature before is missing, too.
        """
        alike = 2 if self._before_bridge.was_rolling else 4
        along = place_variance / alike + self._bridge.place_variance(now_ms) * self._pulse_m ** 2
        square = ((self._car.mean - self._before_bridge.mean) * self._pulse_m) ** 2
        turn = CURVATURE_VARIANCE / 3 * (square + along) + self._before_bridge.heading.curvature_per_m ** 2 * along
        return 4 * along + turn * square, turn + (UNALIGNED_PULSES * self._rad_per_pulse) ** 2
