"""How the car moved by odometry: path, distance, acceleration, and how tightly it turned against what was sent."""
from __future__ import annotations

import math
from collections import deque
from typing import Any, Callable, Mapping

from car_interface.common.units import NS_PER_S, stamp_ns, yaw_rad
from car_interface.tools.recordings.columns import MAX_NUMBER
from car_interface.tools.report.asked import AskedWatch
from car_interface.tools.report.downsample import Path, Trace
from car_interface.tools.report.faults import WARN, Fault, FaultLog
from car_interface.tools.report.following import MAX_LATERAL_MPS2, Accelerating, Following
from car_interface.tools.report.steering_state import SteeringWatch

WINDOW_S = 0.3  # over which accelerations and curvatures are taken: a dozen reports of the wheels
MIN_DISTANCE_M = 0.05  # in it, for a curvature
MIN_SAMPLES = 4
MOVING_MPS = 0.05
JUMP_M = 1.0  # from one odometry message to the next: odometry was reset
MAX_GAP_S = 0.5  # the hub reports at least every 0.2 s
MAX_POSES = 60
TRACES = ("speed", "acceleration", "driven curvature", "turn rate")


class MotionWatch:
    """Follows odometry.

    Args:
        traces: those of TRACES are written to.
        faults: gaps and resets are added.
        steering: who steers, and with what curvature.
        asked: what a planner asks for.
        planner_drives: returns whether the throttle is the planner's now.
        start_ns: ROS time of the recording's first message.

    Attributes:
        path: where the car was, by who steered.
        distance_m, moving_s: how far, and how long it drove.
        turn_rate_radps: in the last WINDOW_S, left positive; ``None`` = not known yet.
        by_tables, by_planner: how tightly it turned against what turn_arb sent (in slow bends, by which the tables can
            be judged), and against what a planner asked for.
        accelerating: how its accelerations differed from those that a planner requested.
    """

    def __init__(self, traces: Mapping[str, Trace], faults: FaultLog, steering: SteeringWatch, asked: AskedWatch,
                 planner_drives: Callable[[], bool], start_ns: int):
        self._traces, self._faults, self._steering, self._start_ns = traces, faults, steering, start_ns
        self._asked, self._planner_drives = asked, planner_drives
        self.path = Path()
        self.distance_m = self.moving_s = 0.0
        self.turn_rate_radps: float | None = None
        self.by_tables, self.by_planner = Following(steering, MAX_LATERAL_MPS2), Following(asked)
        self.accelerating = Accelerating()
        self._window: deque = deque()  # stamp in s, speed, yaw, distance of the last WINDOW_S
        self._yaw = self._signed_distance_m = 0.0
        self._poses: deque = deque(maxlen=MAX_POSES)  # stamp in s, x, y, yaw
        self._newest = None  # time, x, y, yaw

    def on_odom(self, time_s: float, message: Any) -> None:
        """nav_msgs/Odometry."""
        position, yaw = message.pose.pose.position, yaw_rad(message.pose.pose.orientation)
        speed = message.twist.twist.linear.x
        if not all(abs(number) <= MAX_NUMBER for number in (position.x, position.y, yaw, speed)):  # nor of NaN
            return
        stamp_s = (stamp_ns(message.header.stamp) - self._start_ns) / NS_PER_S
        if self._newest is not None:
            self._move(time_s, position, yaw, speed)
        self._newest = (time_s, position.x, position.y, yaw)
        self._poses.append((stamp_s, position.x, position.y, yaw))
        self._traces["speed"].add(time_s, speed)
        self._asked.compare_speed(time_s, speed)
        self.path.add(position.x, position.y, self._steering.source)
        self._update_window(time_s, stamp_s, speed)

    def pose_at(self, stamp_s: float) -> tuple[float, float, float] | None:
        """(x, y, yaw) of the recent odometry that is nearest in time; ``None`` without any."""
        if not self._poses:
            return None
        return min(self._poses, key=lambda pose: abs(pose[0] - stamp_s))[1:]

    def _move(self, time_s, position, yaw, speed):
        before_s, x, y, yaw_before = self._newest
        step_m = math.hypot(position.x - x, position.y - y)
        if time_s - before_s > MAX_GAP_S:
            self._faults.add(Fault(before_s, time_s, WARN, "odom", f"silent for {time_s - before_s:.2f} s"))
        if step_m > JUMP_M:
            self._faults.add_moment(time_s, WARN, "odom", f"began anew: {step_m:.1f} m from where it was")
            self._window.clear()
            self.path.interrupt()
        else:
            self.distance_m += step_m
            self._signed_distance_m += math.copysign(step_m, speed)
        self._yaw += math.remainder(yaw - yaw_before, 2 * math.pi)
        if abs(speed) > MOVING_MPS and 0 < time_s - before_s < MAX_GAP_S:
            self.moving_s += time_s - before_s

    def _update_window(self, time_s, stamp_s, speed):
        """Acceleration and curvature of the last WINDOW_S, at its middle."""
        window = self._window
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
        if self._planner_drives():
            self.accelerating.add(time_s - span_s, time_s, acceleration_mps2, speed)
        self.turn_rate_radps = (self._yaw - window[0][2]) / span_s
        self._traces["turn rate"].add(middle_s, self.turn_rate_radps)
        distance_m = self._signed_distance_m - window[0][3]
        if abs(distance_m) >= MIN_DISTANCE_M:
            curvature = (self._yaw - window[0][2]) / distance_m
            self._traces["driven curvature"].add(middle_s, curvature)
            self.by_tables.add(time_s, curvature, speed)
            self.by_planner.add(time_s, curvature, speed)


def _slope(samples):
    """The slope of a line through (time, value, …) in least squares."""
    count, begin = len(samples), samples[0][0]
    mean_t = sum(sample[0] - begin for sample in samples) / count
    mean_v = sum(sample[1] for sample in samples) / count
    spread = sum((sample[0] - begin - mean_t) ** 2 for sample in samples)
    if not spread:
        return math.nan
    return sum((sample[0] - begin - mean_t) * (sample[1] - mean_v) for sample in samples) / spread
