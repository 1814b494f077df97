"""Follows how the car moved, by odometry and IMU: against what was sent and what was asked for, past what it saw.

A place in the plane is a complex number, x + yi in m: turned by an angle it is multiplied by a number of length 1.
"""
from __future__ import annotations

import cmath
import math
from collections import Counter, deque
from statistics import median_low
from typing import Any

import numpy as np

from car_interface.common.sources import DRIVE, PLANNER
from car_interface.common.units import NS_PER_S, stamp_ns, yaw_rad
from car_interface.tools.recordings import columns
from car_interface.tools.report.downsample import Path, Spots, Traces
from car_interface.tools.report.faults import WARN, Fault, FaultLog
from car_interface.tools.report.states import Episodes, PlannerWatch, SteeringWatch, is_fresh

WINDOW_S = 0.3  # over which accelerations and curvatures are taken: a dozen reports of the wheels
MIN_DISTANCE_M = 0.05  # in it, for a curvature
MIN_SAMPLES = 4
MOVING_MPS = 0.05
JUMP_M = 1.0  # from one odometry message to the next: odometry was reset
MAX_GAP_S = 0.5  # the hub reports at least every 0.2 s
MAX_POSES = 60
SAME_RAD, SAME_MPS = 0.02, 0.1  # planners change what they ask for by less all the time
MIN_RATE_RADPS = 0.2  # of a turn, for its rate to be compared with the IMU's
LAG_S = WINDOW_S / 2  # as much as odometry's turn rate, which is that of a window
# The car is compared with what it was sent at speed, and in a real bend or straight on, a while after the last change.
STEADY_S, MIN_CURVATURE_PER_M, STRAIGHT_PER_M, MIN_SPEED_MPS = 0.7, 0.1, 0.02, 0.3
# Faster in a bend tyres widen it: by an understeer of 0.009, as measured on a 3.5 kg car, 0.028 1/m.
MAX_LATERAL_MPS2 = 1.5
# From, to, a bin; what fits exactly, 1 or 0, is the middle of one. A ratio is never 0: radii have its inverse.
RATIOS, OFFSETS_PER_M, OFFSETS_MPS2 = (0.001, 3.001, 0.002), (-1.0005, 1.0005, 0.001), (-5.005, 5.005, 0.01)
MIN_COMPARED = 30  # for a median
MIN_REQUEST_MPS2 = 0.2  # less holds the speed
REACTION_S, KEPT_S = 0.1, 2.0  # from a request to the acceleration; how long requests are kept


class Bins:
    """Numbers counted in bins, for a median as exact as they are wide; the first and the last take what lies beyond."""

    def __init__(self, low: float, high: float, width: float):
        self._low, self._width, self._last = low, width, round((high - low) / width) - 1
        self._counts: Counter = Counter()  # by the bin's index

    def add(self, number: float) -> None:
        """Add a finite number."""
        self._counts[min(max(int((number - self._low) / self._width), 0), self._last)] += 1

    @property
    def samples(self) -> int:
        """Return how many numbers there are."""
        return sum(self._counts.values())

    def median(self) -> float | None:
        """Return the median, the middle of its bin; ``None`` with fewer than MIN_COMPARED."""
        if self.samples < MIN_COMPARED:
            return None
        return self._low + (median_low(self._counts.elements()) + 0.5) * self._width


class Following:
    """How tightly a car turned against what it was sent.

    Args:
        sender: with ``curvature_per_m`` that is sent now, left positive, ``None`` = unknown, and ``unchanged_since_s``.
        max_lateral_mps2: faster bends don't count; MAX_LATERAL_MPS2 judges a table, which knows no tyres.
    """

    def __init__(self, sender: Any, max_lateral_mps2: float = math.inf):
        self._sender, self._max_lateral_mps2 = sender, max_lateral_mps2
        self.left, self.right = Bins(*RATIOS), Bins(*RATIOS)  # the driven curvature as a ratio of the sent one
        self.straight_per_m = Bins(*OFFSETS_PER_M)  # the driven less the sent one where that was straight on

    def add(self, time_s: float, curvature_per_m: float, speed_mps: float) -> None:
        """Compare what the car drives now."""
        sent = self._sender.curvature_per_m
        if (sent is None or not math.isfinite(sent) or abs(speed_mps) <= MIN_SPEED_MPS
                or time_s - self._sender.unchanged_since_s <= STEADY_S):
            return
        if abs(sent) > MIN_CURVATURE_PER_M:
            if speed_mps ** 2 * abs(curvature_per_m) <= self._max_lateral_mps2:
                (self.left if sent > 0 else self.right).add(curvature_per_m / sent)
        elif abs(sent) <= STRAIGHT_PER_M:
            self.straight_per_m.add(curvature_per_m - sent)


class Accelerating:
    """By how much the car's acceleration differed from the one that the planner requested, while the planner drove.

    The value map turns requests into values, so that this is how far the map is off.
    """

    def __init__(self):
        self._requests: deque = deque()  # time, m/s²
        # By how much it accelerated more than requested where it was to drive, to hold its speed, to brake; in m/s².
        self.driving, self.holding, self.braking = (Bins(*OFFSETS_MPS2) for _ in range(3))

    def request(self, time_s: float, acceleration_mps2: float) -> None:
        """Take the planner's request."""
        if not math.isfinite(acceleration_mps2):
            return
        self._requests.append((time_s, acceleration_mps2))
        while not 0 <= time_s - self._requests[0][0] <= KEPT_S:
            self._requests.popleft()

    def add(self, start_s: float, end_s: float, acceleration_mps2: float, speed_mps: float) -> None:
        """Compare what the car did from ``start_s`` to ``end_s``, while the planner drove, with the mean request."""
        if speed_mps <= MIN_SPEED_MPS or not math.isfinite(acceleration_mps2):
            return
        requested = [wanted for time_s, wanted in self._requests if start_s <= time_s + REACTION_S <= end_s]
        if requested:
            mean_mps2 = sum(requested) / len(requested)
            bins = (self.holding if abs(mean_mps2) <= MIN_REQUEST_MPS2 else
                    self.driving if mean_mps2 > 0 else self.braking)
            bins.add(acceleration_mps2 - mean_mps2)


class AskedWatch:
    """Follows ackermann_msgs/AckermannDriveStamped or AckermannDrive: what a planner asked for.

    A request that is stale is none any more, and while somebody else has the car, as the watches of the states show, or
    another source is obeyed, there is none either; a watch is ``None`` where no state was recorded that shows it.
    """

    def __init__(self, traces: Traces, wheelbase_m: float | None, steering: Episodes | None, throttle: Episodes | None,
                 planner: PlannerWatch | None):
        self._traces, self._steering, self._throttle, self._planner = traces, steering, throttle, planner
        self.wheelbase_m = wheelbase_m  # None = unknown, and so is the curvature that an angle asks for
        self.curvature_per_m: float | None = None  # asked for now, left positive; None = unknown
        self.unchanged_since_s = 0.0  # when the angle last changed by more than SAME_RAD
        self._angle_rad = self._speed_mps = math.nan  # from which changes count; NaN = no request
        self._speed_since_s, self._received_s = 0.0, -math.inf
        self.speed_ratios = Bins(*RATIOS)  # the driven speed to the one that was asked for, where that was steady

    def on_drive(self, time_s: float, message: Any) -> None:
        """Take a request."""
        asked = columns.ackermann_drive(message)
        angle_rad, speed_mps = asked.steering_angle, asked.speed
        if not (math.isfinite(angle_rad) and math.isfinite(speed_mps)):
            return
        self.expire(time_s)
        self._received_s = time_s
        self._traces["requested angle"].add(time_s, math.degrees(angle_rad))
        self._traces["requested speed"].add(time_s, speed_mps)
        if not abs(angle_rad - self._angle_rad) <= SAME_RAD:
            self._angle_rad, self.unchanged_since_s = angle_rad, time_s
        if not abs(speed_mps - self._speed_mps) <= SAME_MPS:
            self._speed_mps, self._speed_since_s = speed_mps, time_s
        if self.wheelbase_m is not None:
            self.curvature_per_m = math.tan(angle_rad) / self.wheelbase_m
            self._traces["requested curvature"].add(time_s, self.curvature_per_m)

    def expire(self, time_s: float) -> None:
        """Drop the request if it is stale, or its part that somebody else decides."""
        is_obeyed = self._planner is None or self._planner.obeyed_at(time_s) == DRIVE
        holds = is_obeyed and is_fresh(self._received_s, time_s)
        if not holds or self._steering is not None and self._steering.driver_at(time_s) != PLANNER:
            self._angle_rad, self.curvature_per_m = math.nan, None
        if not holds or self._throttle is not None and self._throttle.driver_at(time_s) != PLANNER:
            self._speed_mps = math.nan

    def compare_speed(self, time_s: float, speed_mps: float) -> None:
        """Compare the speed with the one that was asked for."""
        if abs(self._speed_mps) > MIN_SPEED_MPS and time_s - self._speed_since_s > STEADY_S:
            self.speed_ratios.add(speed_mps / self._speed_mps)


class MotionWatch:
    """Follows odometry, and compares it with what steered and drove; gaps and resets are faults."""

    def __init__(self, traces: Traces, faults: FaultLog, steering: SteeringWatch, asked: AskedWatch,
                 throttle: Episodes | None, start_ns: int):
        self._traces, self._faults, self._steering, self._start_ns = traces, faults, steering, start_ns
        self._asked, self._throttle = asked, throttle  # None: no state was recorded that shows who drives
        self._others_s = -math.inf  # when the throttle was last not the planner's
        self.path = Path()  # where the car was, by who steered
        self.distance_m = self.moving_s = 0.0  # how far, and how long it drove
        # In slow bends: a table knows no tyres. Empty after a calibration drive, which drove by the table before.
        self.by_tables = Following(steering, MAX_LATERAL_MPS2)
        self.by_planner = Following(asked)
        self.accelerating = Accelerating()
        self._window: deque = deque()  # stamp in s, speed, yaw, distance of the last WINDOW_S
        self._yaw = self._signed_distance_m = 0.0
        self._turn_rate_radps: float | None = None  # in the last WINDOW_S, left positive; None = unknown
        self._has_twist = False  # until one isn't 0 the speed is the pose's: motion capture sends poses alone
        self._poses: deque = deque(maxlen=MAX_POSES)  # stamp in s, place, yaw
        self._last_poses: deque = deque()  # the same in the last POSE_WINDOW_S, two at least, while there is no twist
        self._newest_s = math.nan  # when the newest of them was recorded; NaN = there is none

    def on_odom(self, time_s: float, message: Any) -> None:
        """Take a nav_msgs/Odometry."""
        pose, speed, lag_s = message.pose.pose, message.twist.twist.linear.x, 0.0
        x_m, y_m, yaw = pose.position.x, pose.position.y, yaw_rad(pose.orientation)
        if not all(abs(number) <= columns.MAX_NUMBER for number in (x_m, y_m, yaw, speed)):  # nor of NaN
            return
        place = complex(x_m, y_m)
        stamp = stamp_ns(message.header.stamp)
        stamp_s = (stamp - self._start_ns) / NS_PER_S if stamp else time_s
        self._has_twist = self._has_twist or columns.has_twist(message)
        if not self._has_twist:
            speed, lag_s = self._pose_speed(stamp_s, place, yaw)
        for sender in (self._steering, self._asked):
            sender.expire(time_s)
        if self._poses:
            self._move(time_s, place, yaw, speed)
        self._newest_s = time_s
        self._poses.append((stamp_s, place, yaw))
        self.path.add(place, self._steering.driver)
        if math.isfinite(speed):
            self._traces["speed"].add(time_s - lag_s, speed)
            self._asked.compare_speed(time_s, speed)
            self._update_window(time_s, stamp_s, speed)

    def pose_at(self, stamp: Any) -> tuple[complex, float] | None:
        """Return (place, yaw) of the recent odometry that is nearest to a stamp; ``None`` without any."""
        stamp_s = (stamp_ns(stamp) - self._start_ns) / NS_PER_S
        nearest = min(self._poses, key=lambda pose: abs(pose[0] - stamp_s), default=None)
        return nearest and nearest[1:]

    def turn_rate_at(self, time_s: float) -> float | None:
        """Return the turn rate in rad/s, left positive; ``None`` = unknown, or odometry is silent."""
        return self._turn_rate_radps if 0 <= time_s - self._newest_s <= MAX_GAP_S else None

    def note(self, topic: str) -> str:
        """Return what the speed is by if not by the twist of odometry on a topic; empty: by that."""
        return "" if self._has_twist or not self.distance_m else f"{topic}: {columns.POSE_ONLY}"

    def _pose_speed(self, stamp_s, place, yaw):
        """Take a pose of an odometry that sends poses alone.

        Returns:
            The speed in m/s over POSE_WINDOW_S or from the pose before, forward positive, and how long ago the middle
            of that is, in s. NaN while the poses span less: noise would be too large a part of it.
        """
        poses = self._last_poses
        if poses and (stamp_s < poses[-1][0] or abs(place - poses[-1][1]) > JUMP_M):
            poses.clear()
        poses.append((stamp_s, place, yaw))
        while len(poses) > 1 and stamp_s - poses[1][0] >= columns.POSE_WINDOW_S:
            poses.popleft()
        begin_s, begin, begin_yaw = poses[0]
        span_s, step = stamp_s - begin_s, place - begin
        if span_s < columns.POSE_WINDOW_S:
            return math.nan, 0.0
        heading = begin_yaw + math.remainder(yaw - begin_yaw, 2 * math.pi) / 2
        # By the length, not by its part along the heading: a body of motion capture may be turned against the car.
        return math.copysign(abs(step), (step * cmath.rect(1, -heading)).real) / span_s, span_s / 2

    def _move(self, time_s, place, yaw, speed):
        before_s, (_, before, yaw_before) = self._newest_s, self._poses[-1]
        step_m = abs(place - before)
        if time_s - before_s > MAX_GAP_S:
            self._faults.add(Fault(before_s, WARN, "odom", f"silent for {time_s - before_s:.2f} s", time_s))
        if step_m > JUMP_M:
            self._faults.add(Fault(time_s, WARN, "odom", f"began anew: {step_m:.1f} m from where it was"))
            self._window.clear()
            self.path.interrupt()
        else:
            if not self._has_twist:  # a sum of a pose's steps would be mostly its noise
                step_m = abs(speed) * max(0.0, time_s - before_s) if abs(speed) > MOVING_MPS else 0.0
            self.distance_m += step_m
            self._signed_distance_m += math.copysign(step_m, speed)
        self._yaw += math.remainder(yaw - yaw_before, 2 * math.pi)
        if abs(speed) > MOVING_MPS and 0 < time_s - before_s < MAX_GAP_S:
            self.moving_s += time_s - before_s

    def _update_window(self, time_s, stamp_s, speed):
        """Compute acceleration and curvature of the last WINDOW_S, at its middle."""
        window, self._turn_rate_radps = self._window, None
        if window and not 0 <= stamp_s - window[-1][0] < MAX_GAP_S:
            window.clear()  # the clock was set, or messages are missing
        window.append((stamp_s, speed, self._yaw, self._signed_distance_m))
        while stamp_s - window[0][0] > WINDOW_S and len(window) > MIN_SAMPLES:  # another robot's odometry may be slow
            window.popleft()
        span_s = stamp_s - window[0][0]
        if span_s < WINDOW_S / 2 or len(window) < MIN_SAMPLES:
            return
        middle_s = time_s - span_s / 2
        acceleration_mps2 = _slope(window)
        self._traces["acceleration"].add(middle_s, acceleration_mps2)
        if self._throttle is None or self._throttle.driver_at(time_s) != PLANNER:
            self._others_s = time_s
        elif self._others_s < time_s - span_s:
            self.accelerating.add(time_s - span_s, time_s, acceleration_mps2, speed)
        self._turn_rate_radps = (self._yaw - window[0][2]) / span_s
        self._traces["turn rate"].add(middle_s, self._turn_rate_radps)
        distance_m = self._signed_distance_m - window[0][3]
        if abs(distance_m) >= MIN_DISTANCE_M:
            curvature = (self._yaw - window[0][2]) / distance_m
            self._traces["driven curvature"].add(middle_s, curvature)
            self.by_tables.add(time_s, curvature, speed)
            self.by_planner.add(time_s, curvature, speed)


def _slope(samples):
    """Return the slope of a line through (time, value, …) in least squares; the times differ."""
    times, values = np.transpose([sample[:2] for sample in samples])
    offsets = times - times[0]
    offsets -= offsets.mean()
    return float(offsets @ (values - values[0]) / (offsets @ offsets))  # exactly 0 of values that are all the same


class ImuWatch:
    """Follows sensor_msgs/Imu: how fast the car turned, beside its odometry."""

    def __init__(self, traces: Traces, motion: MotionWatch):
        self._traces, self._motion = traces, motion
        self.gravity = columns.Gravity()  # shows how it is mounted
        self.ratios = Bins(*RATIOS)  # odometry's turn rate to the IMU's
        self._rate_radps, self._last_s = 0.0, math.nan

    def on_imu(self, time_s: float, message: Any) -> None:
        """Take a measurement."""
        rate_radps, acceleration = message.angular_velocity.z, message.linear_acceleration
        if not math.isfinite(rate_radps):
            return
        self.gravity.add(acceleration.x, acceleration.y, acceleration.z)
        self._traces["imu turn rate"].add(time_s, rate_radps)
        step_s = time_s - self._last_s
        weight = 1 - math.exp(-step_s / LAG_S) if 0 <= step_s < 1 else 1.0
        self._last_s, self._rate_radps = time_s, self._rate_radps + weight * (rate_radps - self._rate_radps)
        by_odometry_radps = self._motion.turn_rate_at(time_s)
        if by_odometry_radps is not None and abs(self._rate_radps) > MIN_RATE_RADPS:
            self.ratios.add(by_odometry_radps / self._rate_radps)


class SonarWatch:
    """Follows the sonars' ranges and /tf_static: where they saw something, in odometry's frame."""

    def __init__(self, motion: MotionWatch):
        self._motion = motion
        self.echoes = Spots()
        self.nearest_m, self.nearest_s, self.nearest_sonar = math.inf, math.nan, ""  # the shortest range; inf = none
        self.frames_without_mount: set = set()  # of sonars whose place on the car wasn't recorded
        self._mounts: dict = {}  # (place, yaw) on the car by frame

    def on_static_tf(self, time_s: float, message: Any) -> None:
        """Take a tf2_msgs/TFMessage."""
        for transform in message.transforms:
            place, rotation = transform.transform.translation, transform.transform.rotation
            self._mounts[transform.child_frame_id] = complex(place.x, place.y), yaw_rad(rotation)

    def on_range(self, time_s: float, message: Any, topic: str) -> None:
        """Take a sensor_msgs/Range."""
        range_m = message.range
        if not message.min_range < range_m < message.max_range:
            return
        if range_m < self.nearest_m:
            self.nearest_m, self.nearest_s, self.nearest_sonar = range_m, time_s, topic.rsplit("/", 1)[-1]
        mount, pose = self._mounts.get(message.header.frame_id), self._motion.pose_at(message.header.stamp)
        if mount is None:
            self.frames_without_mount.add(message.header.frame_id)
        elif pose is not None:
            (place, yaw), (ahead, mount_yaw) = pose, mount
            self.echoes.add(place + cmath.rect(1, yaw) * (ahead + cmath.rect(range_m, mount_yaw)))
